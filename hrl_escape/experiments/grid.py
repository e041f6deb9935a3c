"""What is compared: agents, rooms and training seeds, as frozen settings that read from TOML.

A grid is data. It says nothing about processes or files; `cell.py` says what one of its cells
does, `launcher.py` runs them. Every agent meets the same rooms, seeds and evaluation episodes (a paired design).
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from typing_extensions import Self

from hrl_escape.agents.registry import SMDP_PREFIX, get_agent_class, get_recipe
from hrl_escape.agents.settings import replace_settings
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.generation import generate
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.settings import Settings, knob
from hrl_escape.errors import EscapeError, GridError
from hrl_escape.files import read_json, read_toml

__all__ = ["AgentSpec", "Cell", "Grid", "OptionsView", "RoomSpec", "load_grid"]

OBSERVATIONS = ("features", "state", "egocentric")
LARGEST = 100_000_000


@dataclasses.dataclass(frozen=True)
class OptionsView(Settings):
    """How a room is wrapped for an agent that chooses options; see `OptionsEnv`."""

    _section = "options"
    include_primitives: bool = knob(True, "Primitives are choices too, beside the options.")
    flavour: str = knob("press", "What a meta-action does.", choices=("press", "press-with-ancestors"))
    interruptible: bool = knob(False, "Options return to the agent after every primitive.")
    max_duration: int | None = knob(None, "Primitives after which an option is ended.", "", 1, LARGEST)


@dataclasses.dataclass(frozen=True)
class AgentSpec(Settings):
    """One competitor: an agent's name, and how it differs from its recipe."""

    _section = "agent"
    name: str = knob("random", "Name in the registry; with the prefix smdp- it chooses options.")
    label: str = knob("", "What tables and curves call it; empty for the name (and recipe).")
    recipe: str = knob("corrected", "Recipe its settings come from.")
    settings: dict[str, Any] = knob(factory=dict, doc="Fields of its settings to change.")
    options: OptionsView = knob(factory=OptionsView, doc="The options it chooses, if its name begins with smdp-.")

    def check(self) -> None:
        """Fill in the label."""
        if not self.label:
            object.__setattr__(self, "label", self.name + (f"@{self.recipe}" if self.recipe != "corrected" else ""))

    @property
    def chooses_options(self) -> bool:
        """It acts on the SMDP view of a room."""
        return self.name.startswith(SMDP_PREFIX)

    @property
    def algorithm(self) -> str:
        """Its name without the view."""
        return self.name.removeprefix(SMDP_PREFIX)

    def resolve_settings(self) -> dict[str, Any]:
        """Every setting it will run with, as a JSON value.

        Raises:
            UnknownNameError: no such agent, recipe or setting.
            AgentSettingsError: a value is not possible.
        """
        chosen = replace_settings(get_recipe(self.name, self.recipe), self.settings)
        return json.loads(json.dumps(dataclasses.asdict(chosen)))

    @property
    def needs_trace(self) -> bool:
        """It learns from the primitives inside options."""
        return self.chooses_options and getattr(get_agent_class(self.name), "needs_trace", False)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read `dqn`, `smdp-dqn` or `smdp-dqn@paper`."""
        name, _, recipe = text.partition("@")
        return cls(name=name, recipe=recipe or "corrected")


@dataclasses.dataclass(frozen=True)
class RoomSpec(Settings):
    """One room: an instance of a preset or of a schematic, or one from a file."""

    _section = "room"
    preset: str | None = knob(None, "Name of a preset.")
    arguments: dict[str, Any] = knob(factory=dict, doc="Arguments of the preset, where it takes some.")
    config: dict[str, Any] | None = knob(None, "A schematic, as RoomConfig.to_dict() gives it.", optional=True)
    file: str | None = knob(None, "A saved instance.")
    seed: int = knob(0, "Which instance of the schematic.", "", 0, 2**63 - 1)

    def check(self) -> None:
        """Exactly one source."""
        if sum(source is not None for source in (self.preset, self.config, self.file)) != 1:
            raise GridError(f"a room is one of preset, config or file, not {self.to_dict()}")

    def make_instance(self) -> RoomInstance:
        """Sample or read it.

        Raises:
            EscapeError: no such preset, an impossible schematic, a damaged file.
        """
        if self.file is not None:
            return RoomInstance.load(self.file)
        if self.preset is not None:
            return generate(get_preset(self.preset, **self.arguments), self.seed)
        return generate(RoomConfig.from_dict(self.config), self.seed)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read `clutter`, `clutter#3` (instance 3) or `room.json`."""
        if text.endswith(".json"):
            return cls(file=text)
        preset, _, seed = text.partition("#")
        if seed and not seed.isdecimal():
            raise GridError(f"room {text!r}: after # comes the number of the instance, such as {preset}#3")
        return cls(preset=preset, seed=int(seed or 0))


@dataclasses.dataclass(frozen=True)
class Grid(Settings):
    """A comparison: every agent in every room with every training seed."""

    _section = "grid"
    name: str = knob("comparison", "Its name; also of its folder.")
    description: str = knob("", "What it is for, one sentence.")
    agents: tuple[AgentSpec, ...] = knob((AgentSpec("random"),), "Who is compared.")
    rooms: tuple[RoomSpec, ...] = knob((RoomSpec("paper-two-button"),), "Where.")
    runs: int = knob(10, "Training seeds, 0 to runs - 1; ten or more in a published table.", "", 1, 10_000)
    primitives: int = knob(20_000, "Training budget of a run.", "primitives", 1, LARGEST)
    decisions: int | None = knob(None, "A run ends after so many decisions too, if these are fewer.", "", 1, LARGEST)
    eval_every: int | None = knob(None, "Between evaluations; None for a twentieth.", "primitives", 1, LARGEST)
    eval_episodes: int = knob(5, "Episodes in an evaluation, the same for all.", "", 1, 10_000)
    eval_seed: int = knob(0, "With the training seed, fixes the evaluation episodes.", "", 0, 2**31)
    observation: str = knob("features", "What agents see.", choices=OBSERVATIONS)

    def check(self) -> None:
        """Names must tell the agents apart, and there must be something to run."""
        for what, members in (("agents", self.agents), ("rooms", self.rooms)):
            if not members:
                raise GridError(f"grid {self.name!r} has no {what}: give at least one")
        _refuse_twins("agent label", [agent.label for agent in self.agents])

    @property
    def evaluation_step(self) -> int:
        """Primitives between evaluations."""
        return self.eval_every or max(1, self.primitives // 20)

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build from nested dicts; agents and rooms may be short texts, see `AgentSpec.parse`, `RoomSpec.parse`."""
        if isinstance(data, Mapping):
            data = dict(data)
            for key, kind in (("agents", AgentSpec), ("rooms", RoomSpec)):
                if isinstance(data.get(key), list):
                    data[key] = [kind.parse(item).to_dict() if isinstance(item, str) else item for item in data[key]]
        return super().from_dict(data)

    def make_cells(self, instances: Sequence[RoomInstance]) -> list[Cell]:
        """All cells, in the order they are best run: seed by seed, so that early results compare everybody.

        Args:
            instances: one a room, in order.

        Raises:
            GridError: two rooms, or two agents, are the same.
            EscapeError: an agent or one of its settings does not exist.
        """
        _refuse_twins("room", [instance.id for instance in instances])
        names = [name_room(instance) for instance in instances]
        names = [f"{name}-{instance.id[:6]}" if names.count(name) > 1 else name
                 for name, instance in zip(names, instances, strict=True)]
        resolved = [agent.resolve_settings() for agent in self.agents]
        cells = [
            Cell(self, number, resolved[number], instance.id, room, seed)
            for seed in range(self.runs)
            for (room, instance), number in itertools.product(
                zip(names, instances, strict=True), range(len(self.agents)))
        ]
        _refuse_twins("agent with the same settings", [cell.key for cell in cells])
        return cells


def name_room(instance: RoomInstance) -> str:
    """`clutter`, or `clutter#3` for another than the first instance."""
    return f"{instance.name}#{instance.seed}" if instance.seed else instance.name


@dataclasses.dataclass(frozen=True)
class Cell:
    """One run of a grid.

    Attributes:
        grid: what it is a part of.
        number: which agent.
        settings: that agent's settings, resolved.
        instance_id: the room's content hash.
        room: the room's name in tables.
        seed: training seed.
    """

    grid: Grid
    number: int
    settings: dict[str, Any]
    instance_id: str
    room: str
    seed: int

    @property
    def agent(self) -> AgentSpec:
        """Who runs."""
        return self.grid.agents[self.number]

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"{self.agent.label}, {self.room}, seed {self.seed}"

    @property
    def eval_seed(self) -> int:
        """Fixes its evaluation episodes: the same for every agent, others for each training seed."""
        return self.grid.eval_seed + self.seed

    @property
    def identity(self) -> dict[str, Any]:
        """Everything that decides its numbers, as a JSON value; labels and other cells do not."""
        from hrl_escape import __version__

        return {
            "version": __version__,
            "agent": self.agent.name,
            "settings": self.settings,
            "options": self.agent.options.to_dict() if self.agent.chooses_options else None,
            "room": self.instance_id,
            "observation": self.grid.observation,
            "primitives": self.grid.primitives,
            "decisions": self.grid.decisions,
            "eval_every": self.grid.evaluation_step,
            "eval_episodes": self.grid.eval_episodes,
            "eval_seed": self.eval_seed,
            "seed": self.seed,
        }

    @property
    def key(self) -> str:
        """Hash of its identity: the same numbers, the same key, whatever grid it is in."""
        text = json.dumps(self.identity, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:10]

    @property
    def folder(self) -> str:
        """Name of its folder: readable, and its key."""
        words = re.sub(r"[^\w.@#+-]+", "_", f"{self.agent.label}--{self.room}--seed-{self.seed}")
        return f"{words}--{self.key}"


def _refuse_twins(what: str, names: Sequence[str]) -> None:
    twins = sorted({name for name in names if names.count(name) > 1})
    if twins:
        raise GridError(f"the same {what} twice: {', '.join(twins)}. Remove one, or change what tells them apart")


def load_grid(path: str | Path) -> Grid:
    """Read a grid from a TOML or JSON file; files of rooms are looked for beside it.

    Raises:
        FileReadError: the file is missing, or neither.
        GridError: it holds no possible grid; the message names file and field.
    """
    path = Path(path)
    content = read_toml(path, "grid") if path.suffix.lower() == ".toml" else read_json(path, "grid")
    try:
        grid = Grid.from_dict({"name": path.stem} | content if isinstance(content, dict) else content)
    except EscapeError as error:
        raise GridError(f"{path}: {error}") from error
    rooms = [dataclasses.replace(room, file=str(path.parent / room.file)) if room.file else room for room in grid.rooms]
    return dataclasses.replace(grid, rooms=tuple(rooms))
