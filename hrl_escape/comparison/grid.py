"""Grids: the agents, rooms and training seeds of a comparison, as frozen settings that read from TOML.

A grid is data and knows neither processes nor files; `runs.py` executes one run, `launching` all of them. Every
agent meets the same rooms, seeds and evaluation episodes (a paired design).
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from typing_extensions import Self

from hrl_escape.agents.label import DEFAULT_RECIPE, SMDP_PREFIX, AgentLabel
from hrl_escape.agents.registry import check_agent_name, get_agent_class, get_recipe
from hrl_escape.comparison.places import RoomSpec, RunPlace
from hrl_escape.comparison.references.registry import REFERENCES
from hrl_escape.env.observations.base import get_observation
from hrl_escape.errors import EscapeError, GridError
from hrl_escape.files import read_json, read_text, read_toml
from hrl_escape.hierarchies.kinds import find_kind, list_privileges
from hrl_escape.ladder.room_sets import parse_rooms
from hrl_escape.names import make_file_name
from hrl_escape.options.option_sets import DEFAULT_SET, check_option_set
from hrl_escape.settings import Range, Settings, replace_settings
from hrl_escape.text.settings import TOOLS, ToolsSettings
from hrl_escape.version import __version__, find_versions

LARGEST = 100_000_000
DEFAULT_ROOMS = (RoomSpec("paper-two-button"),)


@dataclasses.dataclass(frozen=True)
class OptionsView(Settings):
    """Options that an agent chooses among; see `OptionsEnv`."""

    _section = "options"
    include_primitives: bool = True
    """Include the primitives among the choices."""
    option_set: str = DEFAULT_SET
    """Named option set: press one button, press its ancestors first, or another; `hrl-escape list option-sets`."""
    interruptible: bool = False
    """Options return to the agent after every primitive."""
    max_duration: Annotated[int, Range(1, LARGEST)] | None = None
    """Primitives after which an option is stopped."""
    memory: bool = False
    """Append an episode's failures and successes to the rows of the observation `objects`; see `DecisionMemory`."""

    def check(self) -> None:
        """Refuse an unknown option set."""
        check_option_set(self.option_set)


@dataclasses.dataclass(frozen=True)
class AgentSpec(Settings):
    """An agent of the comparison: name, recipe, changed settings and options."""

    _section = "agent"
    name: str = "random"
    """Name in the registry, smdp- in front to choose options; or one of `REFERENCES`, which learn nothing."""
    label: str = ""
    """Name in tables and curves; empty for the agent's name (and recipe)."""
    recipe: str = "corrected"
    """Recipe of its settings."""
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Settings that differ from the recipe's, by name."""
    options: OptionsView = OptionsView()
    """Options it chooses among, if its name begins with smdp-."""
    leaves: Literal["planned", "learned"] | None = None
    """Leaves of the hierarchy that is synthesised from the room, for agents such as maxq-q or hamq; None for none."""

    def check(self) -> None:
        """Refuse an unknown agent, and fill in the label."""
        check_agent_name(self.name, (*REFERENCES, TOOLS))
        if not self.label:
            recipe = f"@{self.recipe}" if self.recipe != "corrected" else ""
            object.__setattr__(self, "label", self.name + recipe + (f"+{self.leaves}" if self.leaves else ""))

    @property
    def chooses_options(self) -> bool:
        """Agent acts on the SMDP view of a room."""
        return self.name.startswith(SMDP_PREFIX)

    @property
    def algorithm(self) -> str:
        """Name without the prefix smdp-."""
        return self.name.removeprefix(SMDP_PREFIX)

    @property
    def is_reference(self) -> bool:
        """Agent follows a rule or calls tools, without training: one of `REFERENCES`, or `smdp-tools`."""
        return self.name in REFERENCES or self.name == TOOLS

    @property
    def learns(self) -> bool:
        """Agent learns, so is neither chance nor a reference."""
        return not self.is_reference and self.algorithm != "random"

    def resolve_settings(self) -> dict[str, Any]:
        """All its settings, as a JSON value; of the references only `smdp-tools` has some.

        Raises:
            EscapeError: no such agent, recipe or setting, an impossible value, or no hierarchy for this agent.
        """
        if self.leaves is not None:
            find_kind(self.name, self.leaves)
        if self.name == TOOLS:
            return self._resolve_tools()
        if self.is_reference:
            if self.settings or self.recipe != "corrected":
                raise GridError(f"{self.label}: a reference has no settings and no recipe")
            return {}
        chosen = replace_settings(get_recipe(self.name, self.recipe), self.settings)
        return json.loads(json.dumps(dataclasses.asdict(chosen)))

    def _resolve_tools(self) -> dict[str, Any]:
        """Settings of the agent that calls tools; of recorded games the content counts, not the file's name alone."""
        chosen = dataclasses.asdict(replace_settings(ToolsSettings(), self.settings))
        recorded = chosen["model"].endswith(".jsonl")
        content = read_text(chosen["model"], "recorded game") if recorded else ""
        return chosen | ({"recorded": hashlib.sha256(content.encode()).hexdigest()[:12]} if recorded else {})

    @property
    def remembers(self) -> bool:
        """Agent keeps what it has met in a room through the trials there."""
        return self.settings.get("memory", "none") != "none" or (self.chooses_options and self.options.memory)

    @property
    def reads_objects(self) -> bool:
        """Agent needs the observation `objects`."""
        return self.settings.get("network") == "objects" or (self.chooses_options and self.options.memory)

    @property
    def default_observation(self) -> str:
        """Observation of the agent where none is asked for."""
        return "objects" if self.reads_objects else "features"

    @property
    def privileges(self) -> tuple[str, ...]:
        """Information that its hierarchy gives it and that others lack; printed in tables."""
        return () if self.leaves is None else list_privileges(self.name, self.leaves)

    @property
    def needs_trace(self) -> bool:
        """Agent learns from the primitives inside options."""
        return self.chooses_options and not self.is_reference and get_agent_class(self.name).needs_trace

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a label such as `dqn`, `smdp-dqn@paper`, `maxq-q+planned` or `smdp-dqn+objects+memory`.

        Raises:
            UnknownNameError: no such trait; see `agents.label.TRAITS`.
            AgentSettingsError: traits contradict each other or the agent.
        """
        label = AgentLabel.parse(text)
        return cls(label.name, text if "+" in text else "", label.recipe or DEFAULT_RECIPE, dict(label.settings),
                   OptionsView(**label.options), label.leaves)


@dataclasses.dataclass(frozen=True)
class SolvedRule(Settings):
    """End of a run before its budget: its agent has solved the room.

    It has once two checks of its frozen policy in a row are near the best and, if it learns a dependency graph,
    that graph is the true one. A random agent, which gets no better, is done with its first escape.
    """

    _section = "until_solved"
    score: float
    """Score near the best, from no escape (0) to the best return of the agent's actions (1)."""
    check_every: Annotated[int, Range(1, LARGEST, "primitives")] = 500
    """Between checks of one episode each, from the first escape on."""
    graph_every: Annotated[int, Range(1, LARGEST, "primitives")] = 100
    """Between comparisons of the graph."""


@dataclasses.dataclass(frozen=True)
class Grid(Settings):
    """A comparison: every agent in every room with every training seed."""

    _section = "grid"
    name: str = "comparison"
    """Name of the comparison and of its folder."""
    description: str = ""
    """Purpose, in one sentence."""
    agents: tuple[AgentSpec, ...] = (AgentSpec("random"),)
    """Agents to compare, each in every room; labels must differ."""
    rooms: tuple[RoomSpec, ...] = DEFAULT_ROOMS
    """Rooms to train and be tested in, one after another; empty with `train_rooms`."""
    train_rooms: tuple[str, ...] = ()
    """Sets of rooms to train in, as ladder-1/lattice/train[:64] or clutter#0..15; plus joins the floors of a tower."""
    test_rooms: tuple[str, ...] = ()
    """Sets of rooms to be tested in: one for all `train_rooms`, or one for each."""
    runs: Annotated[int, Range(1, 10_000)] = 10
    """Training seeds in each room; ten or more in a published table."""
    first_seed: Annotated[int, Range(0, 2**31)] = 0
    """First of the training seeds."""
    primitives: Annotated[int, Range(1, LARGEST, "primitives")] = 20_000
    """Training budget of a run."""
    decisions: Annotated[int, Range(1, LARGEST)] | None = None
    """Largest number of decisions in a run; None for no limit."""
    eval_every: Annotated[int, Range(1, LARGEST, "primitives")] | None = None
    """Primitives between evaluations; None for a twentieth of the budget."""
    eval_episodes: Annotated[int, Range(1, 10_000)] = 5
    """Episodes in an evaluation, the same for all agents."""
    eval_seed: Annotated[int, Range(0, 2**31)] = 0
    """Seed that fixes the evaluation episodes, together with the training seed."""
    observation: str = "features"
    """Vector observation of every agent."""
    trials: Annotated[int, Range(1, 1000)] = 1
    """Trials in each room of `train_rooms` and `test_rooms`, through which memories last; see `SequenceEnv`."""
    until_solved: SolvedRule | None = None
    """Rule that ends a run before its budget; None for none."""

    def check(self) -> None:
        """Require agents, rooms, and labels that tell the agents apart."""
        if self.train_rooms or self.test_rooms:
            self._check_sets()
        elif self.trials > 1:
            raise GridError(f"grid {self.name!r}: trials are made in train_rooms and test_rooms, not in rooms")
        for what, members in (("agents", self.agents), ("rooms", self.rooms or self.train_rooms)):
            if not members:
                raise GridError(f"grid {self.name!r} has no {what}: give at least one")
        _refuse_duplicates("agent label", [agent.label for agent in self.agents])
        if not get_observation(self.observation).is_vector:
            raise GridError(f"grid {self.name!r}: agents learn from vectors, not from {self.observation!r}")

    def _check_sets(self) -> None:
        if self.rooms == DEFAULT_ROOMS:
            object.__setattr__(self, "rooms", ())
        if self.rooms:
            raise GridError(f"grid {self.name!r}: give rooms, or train_rooms with test_rooms, not both")
        if len(self.test_rooms) not in (1, len(self.train_rooms)):
            raise GridError(f"grid {self.name!r}: {len(self.train_rooms)} train_rooms go with one set of test_rooms, "
                            f"or as many, not {len(self.test_rooms)}")
        if self.until_solved is not None:
            raise GridError(f"grid {self.name!r}: until_solved is about one room, not about train_rooms")
        given = [agent.label for agent in self.agents if agent.leaves is not None]
        if self.trials > 1 and given:
            raise GridError(f"grid {self.name!r}: the hierarchy of {given[0]} ends with an episode: give it no trials")

    def make_places(self) -> tuple[RunPlace, ...]:
        """Rooms, or sets of rooms, in which the runs are made.

        Raises:
            EscapeError: no such preset, set or file; an impossible room configuration.
        """
        if not self.train_rooms:
            return tuple(room.make_place() for room in self.rooms)
        tests = self.test_rooms * (len(self.train_rooms) if len(self.test_rooms) == 1 else 1)
        return tuple(RunPlace.of_split(parse_rooms(train), parse_rooms(test))
                     for train, test in zip(self.train_rooms, tests, strict=True))

    def _check_transfer(self, resolved: Sequence[Mapping[str, Any]]) -> None:
        """Require that agents can act in rooms of another room configuration than they train in."""
        if self.observation != "objects":
            raise GridError(f"grid {self.name!r}: rooms of different configurations have no observation in common but "
                            f"objects; set observation to objects, not {self.observation}")
        for agent, settings in zip(self.agents, resolved, strict=True):
            if agent.learns and settings.get("network") != "objects":
                cure = (f"set network to objects, in short {agent.label}+objects" if "network" in settings else
                        "take one with a setting network, such as dqn+objects or ppo+objects")
                raise GridError(f"{agent.label} cannot act in rooms of another room configuration than it trains in: "
                                f"what it learns is tied to the number of objects; {cure}")

    @property
    def evaluation_step(self) -> int:
        """Primitives of training between evaluations: `eval_every`, or a twentieth of the budget if that is 0."""
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

    def make_runs(self, places: Sequence[RunPlace]) -> list[GridRun]:
        """All runs, in the order they are best run: seed by seed, so that early results compare everybody.

        Args:
            places: from `make_places`.

        Raises:
            GridError: two rooms, or two agents, are the same.
            EscapeError: an agent or one of its settings does not exist.
        """
        _refuse_duplicates("room", [place.id for place in places])
        counts = Counter(place.name for place in places)
        names = [f"{place.name}-{place.id[:6]}" if counts[place.name] > 1 else place.name for place in places]
        resolved = [agent.resolve_settings() for agent in self.agents]
        if any(place.split is not None and place.split.is_transfer for place in places):
            self._check_transfer(resolved)
        runs = [
            GridRun(self, number, resolved[number], place.id, room, seed)
            for seed in range(self.first_seed, self.first_seed + self.runs)
            for (room, place), number in itertools.product(zip(names, places, strict=True), range(len(self.agents)))
        ]
        _refuse_duplicates("agent with the same settings", [run.key for run in runs])
        return runs


@dataclasses.dataclass(frozen=True)
class GridRun:
    """One run of a grid."""

    grid: Grid  # what it is a part of
    number: int  # which agent
    settings: dict[str, Any]  # that agent's settings, resolved
    place_id: str  # content hash of the room, or of the sets of rooms
    room: str  # its name in tables
    seed: int  # training seed

    @property
    def agent(self) -> AgentSpec:
        """Agent of the run."""
        return self.grid.agents[self.number]

    @property
    def name(self) -> str:
        """Agent, room and training seed, as messages name the run."""
        return f"{self.agent.label}, {self.room}, seed {self.seed}"

    @property
    def source(self) -> str:
        """Agent and training seed, as the origin of a return."""
        return f"{self.agent.label}, seed {self.seed}"

    @property
    def eval_seed(self) -> int:
        """Fixes its evaluation episodes: the same for every agent, others for each training seed."""
        return self.grid.eval_seed + self.seed

    @property
    def identity(self) -> dict[str, Any]:
        """Everything that decides its numbers, as a JSON value; labels and other runs do not."""
        identity = {
            "version": __version__,
            "versions": find_versions(),
            "agent": self.agent.name,
            "settings": self.settings,
            "options": self.agent.options.to_dict() if self.agent.chooses_options else None,
            "room": self.place_id,
            "observation": self.grid.observation,
            "primitives": self.grid.primitives,
            "decisions": self.grid.decisions,
            "eval_every": self.grid.evaluation_step,
            "eval_episodes": self.grid.eval_episodes,
            "eval_seed": self.eval_seed,
            "seed": self.seed,
        }
        rule, trials = self.grid.until_solved, self.grid.trials
        asked_for = {"leaves": self.agent.leaves, "trials": trials if trials > 1 else None,
                     "until_solved": None if rule is None else rule.to_dict()}
        return identity | {name: value for name, value in asked_for.items() if value is not None}

    @cached_property
    def key(self) -> str:
        """Hash of its identity: the same numbers, the same key, whatever grid it is in."""
        text = json.dumps(self.identity, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:10]

    @cached_property
    def folder(self) -> str:
        """Name of its folder: readable, and its key."""
        return f"{make_file_name(f'{self.agent.label}--{self.room}--seed-{self.seed}')}--{self.key}"


def _refuse_duplicates(what: str, names: Sequence[str]) -> None:
    repeated = sorted(name for name, count in Counter(names).items() if count > 1)
    if repeated:
        raise GridError(f"the same {what} twice: {', '.join(repeated)}. Remove one, or change what tells them apart")


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
