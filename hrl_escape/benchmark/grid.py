"""Grids: agents, rooms or an environment, and training seeds of a comparison, as settings that TOML can hold.

All agents have the same rooms, seeds and evaluation episodes (a paired design). `execution.py` executes one run,
`launching` all of them.
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

from hrl_escape.agents.registry import find_given_agent
from hrl_escape.agents.spec import LARGEST, AgentSpec
from hrl_escape.agents.training.env_description import compute_code_digest
from hrl_escape.benchmark.env_spec import EnvPlace, EnvSpec
from hrl_escape.env.observations.base import get_observation
from hrl_escape.errors import EscapeError, GridError
from hrl_escape.files import read_json, read_toml
from hrl_escape.names import make_file_name
from hrl_escape.options.option_sets import check_option_set
from hrl_escape.sets.grammar import find_sets
from hrl_escape.sets.places import RunPlace
from hrl_escape.sets.room_spec import RoomSpec
from hrl_escape.settings import Range, Settings
from hrl_escape.version import __version__, find_versions

GRID_FORMAT = 2
"""Version of grid files; files of version 0.3 have none."""
DEFAULT_ROOMS = (RoomSpec("paper-two-button"),)


@dataclasses.dataclass(frozen=True)
class Grid(Settings):
    """A comparison: every agent in every room with every training seed."""

    _section = "grid"
    name: str = "comparison"
    """Name of the comparison and of its folder."""
    description: str = ""
    """Purpose, in one sentence."""
    agents: tuple[AgentSpec, ...] = (AgentSpec("random"),)
    """Agents to compare, each in every room: specs, their texts, or agent classes; labels must differ."""
    rooms: tuple[RoomSpec, ...] = DEFAULT_ROOMS
    """Rooms for both training and evaluation, as texts such as clutter#3; empty with `train_rooms`."""
    train_rooms: tuple[str, ...] = ()
    """Training sets, such as ladder-1/lattice/train#0..64 or clutter#0..16; see `sets.grammar`."""
    test_rooms: tuple[str, ...] = ()
    """Test sets: one for all `train_rooms`, or one for each."""
    runs: Annotated[int, Range(1, 10_000)] = 10
    """Number of training seeds in each room; use ten or more for published tables."""
    first_seed: Annotated[int, Range(0, 2**31)] = 0
    """First of the training seeds."""
    primitives: Annotated[int, Range(1, LARGEST, "primitives")] = 20_000
    """Training budget of a run."""
    decisions: Annotated[int, Range(1, LARGEST)] | None = None
    """Largest number of decisions in a run, or None for no limit."""
    eval_every: Annotated[int, Range(1, LARGEST, "primitives")] | None = None
    """Primitives between evaluations, or None for a twentieth of the budget."""
    eval_episodes: Annotated[int, Range(1, 10_000)] = 5
    """Episodes in an evaluation, the same for all agents."""
    eval_seed: Annotated[int, Range(0, 2**31)] = 0
    """Seed that fixes the evaluation episodes, together with the training seed."""
    observation: str = "features"
    """Vector observation of every agent."""
    env: EnvSpec | None = None
    """Environment from elsewhere, in place of rooms."""
    trials: Annotated[int, Range(1, 1000)] = 1
    """Trials per episode in each room of `train_rooms` and `test_rooms`; memories persist. See `SequenceEnv`."""
    format: Literal[2] = GRID_FORMAT
    """Version of the fields."""

    def __post_init__(self) -> None:
        if isinstance(self.agents, (tuple, list)):
            agents = (each if isinstance(each, Mapping) else AgentSpec.parse(each) for each in self.agents)
            object.__setattr__(self, "agents", tuple(agents))
        if isinstance(self.rooms, (list, tuple)):
            object.__setattr__(self, "rooms", tuple(
                RoomSpec.parse(room) if isinstance(room, str) else room for room in self.rooms))
        super().__post_init__()

    def check(self) -> None:
        """Require agents, rooms, and labels that distinguish the agents."""
        if self.env is not None:
            self._check_env()
        elif self.train_rooms or self.test_rooms:
            self._check_sets()
        elif self.trials > 1:
            raise GridError(f"grid {self.name!r}: trials are made in train_rooms and test_rooms, not in rooms")
        for what, members in (("agents", self.agents), ("rooms", self.rooms or self.train_rooms or self.env)):
            if not members:
                raise GridError(f"grid {self.name!r} has no {what}: give at least one")
        _refuse_duplicates("agent label", [agent.label for agent in self.agents])
        for agent in self.agents:
            check_option_set(agent.options.option_set)
        if not get_observation(self.observation).is_vector:
            raise GridError(f"grid {self.name!r}: agents learn from vectors, not from {self.observation!r}")

    def _check_env(self) -> None:
        if self.rooms == DEFAULT_ROOMS:
            object.__setattr__(self, "rooms", ())
        if self.rooms or self.train_rooms or self.test_rooms or self.trials > 1:
            raise GridError(f"grid {self.name!r}: an environment does not go with rooms and trials: give one of them")

    def _check_sets(self) -> None:
        if self.rooms == DEFAULT_ROOMS:
            object.__setattr__(self, "rooms", ())
        if self.rooms:
            raise GridError(f"grid {self.name!r}: give rooms, or train_rooms with test_rooms, not both")
        if len(self.test_rooms) not in (1, len(self.train_rooms)):
            raise GridError(f"grid {self.name!r}: {len(self.train_rooms)} train_rooms go with one set of test_rooms, "
                            f"or as many, not {len(self.test_rooms)}")
        given = [agent.label for agent in self.agents if agent.low_level is not None]
        if self.trials > 1 and given:
            raise GridError(f"grid {self.name!r}: the hierarchy of {given[0]} ends with an episode: give it no trials")

    def make_places(self) -> tuple[RunPlace | EnvPlace, ...]:
        """Make the rooms, the sets of rooms, or the environment of the runs.

        Raises:
            EscapeError: no such preset, set or file; an impossible room configuration.
        """
        if self.env is not None:
            return (self.env.make_place(self.agents),)
        if not self.train_rooms:
            return tuple(room.make_place() for room in self.rooms)
        tests = self.test_rooms * (len(self.train_rooms) if len(self.test_rooms) == 1 else 1)
        return tuple(RunPlace.of_split(find_sets(train), find_sets(test))
                     for train, test in zip(self.train_rooms, tests, strict=True))

    def _check_transfer(self, resolved: Sequence[Mapping[str, Any]]) -> None:
        """Require that agents can act in rooms of another configuration than in training."""
        if self.observation != "objects":
            raise GridError(f"grid {self.name!r}: rooms of different configurations have no observation in common but "
                            f"objects; set observation to objects, not {self.observation}")
        for agent, settings in zip(self.agents, resolved, strict=True):
            if agent.learns and settings.get("network") != "objects":
                cure = (f"set network to objects, in short {agent.label}+objects" if "network" in settings else
                        "take one with a setting network, such as dqn+objects or ppo+objects")
                raise GridError(f"{agent.label} cannot act in rooms of another configuration than in training, "
                                f"because its network depends on the number of objects; {cure}")

    @property
    def evaluation_step(self) -> int:
        """Primitives of training between evaluations: `eval_every`, or a twentieth of the budget."""
        return self.eval_every or max(1, self.primitives // 20)

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build from nested dicts; agents and rooms can be short texts, see `AgentSpec.parse`, `RoomSpec.parse`."""
        if isinstance(data, Mapping) and isinstance(data.get("rooms"), list):
            rooms = [RoomSpec.parse(item).to_dict() if isinstance(item, str) else item for item in data["rooms"]]
            data = {**data, "rooms": rooms}
        return super().from_dict(data)

    def make_runs(self, places: Sequence[RunPlace | EnvPlace]) -> list[GridRun]:
        """Make all runs, ordered by seed, so early results include all agents.

        Args:
            places: from `make_places`.

        Raises:
            GridError: two rooms or two agents are equal, or an agent drives velocities in rooms.
            EscapeError: an agent or one of its settings does not exist.
        """
        _refuse_duplicates("room", [place.id for place in places])
        counts = Counter(place.name for place in places)
        names = [f"{place.name}-{place.id[:6]}" if counts[place.name] > 1 else place.name for place in places]
        resolved = [agent.resolve_settings() for agent in self.agents]
        driving = [agent.label for agent in self.agents if self.env is None and agent.drives_velocities]
        if driving:
            raise GridError(f"{driving[0]} drives velocities, and rooms are compared by numbers of primitives: give "
                            "env a function that makes hrl_escape/EscapeRoomContinuous-v1 with the room")
        given = [find_given_agent(agent.name) for agent in self.agents]
        codes = [None if kind is None else compute_code_digest(kind) for kind in given]
        if any(place.split is not None and place.split.is_transfer for place in places):
            self._check_transfer(resolved)
        runs = [
            GridRun(self, number, resolved[number], place.id, room, seed, codes[number])
            for seed in range(self.first_seed, self.first_seed + self.runs)
            for (room, place), number in itertools.product(zip(names, places, strict=True), range(len(self.agents)))
        ]
        _refuse_duplicates("agent with the same settings", [run.key for run in runs])
        return runs


@dataclasses.dataclass(frozen=True)
class GridRun:
    """One run of a grid."""

    grid: Grid  # the grid
    number: int  # number of the agent
    settings: dict[str, Any]  # that agent's settings, resolved
    place_id: str  # content hash of the room, or of the sets of rooms
    room: str  # its name in tables
    seed: int  # training seed
    code: str | None = None  # hash of the agent's code, for a class that this process registered

    @property
    def agent(self) -> AgentSpec:
        """Agent of the run."""
        return self.grid.agents[self.number]

    @property
    def name(self) -> str:
        """Agent, room and training seed, for messages."""
        return f"{self.agent.label}, {self.room}, seed {self.seed}"

    @property
    def source(self) -> str:
        """Agent and training seed, as the source of a return."""
        return f"{self.agent.label}, seed {self.seed}"

    @property
    def eval_seed(self) -> int:
        """Seed of its evaluation episodes: the same for all agents, different for each training seed."""
        return self.grid.eval_seed + self.seed

    @property
    def identity(self) -> dict[str, Any]:
        """Everything that decides the numbers of the run, as a JSON value; labels are not included."""
        identity = {
            "version": __version__,
            "versions": find_versions(),
            "agent": self.agent.name,
            "settings": self.settings,
            "options": self.agent.options.to_dict() if self.agent.chooses_options else None,
            "room": self.place_id,
            "observation": self.grid.observation if self.grid.env is None else None,
            "primitives": self.grid.primitives,
            "decisions": self.grid.decisions,
            "eval_every": self.grid.evaluation_step,
            "eval_episodes": self.grid.eval_episodes,
            "eval_seed": self.eval_seed,
            "seed": self.seed,
        }
        trials = self.grid.trials
        asked_for = {"low_level": self.agent.low_level, "trials": trials if trials > 1 else None,
                     "code": self.code}
        return identity | {name: value for name, value in asked_for.items() if value is not None}

    @cached_property
    def key(self) -> str:
        """Hash of the identity, equal in all grids."""
        text = json.dumps(self.identity, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:10]

    @cached_property
    def folder(self) -> str:
        """Name of its folder, which ends with the key."""
        return f"{make_file_name(f'{self.agent.label}--{self.room}--seed-{self.seed}')}--{self.key}"


def _refuse_duplicates(what: str, names: Sequence[str]) -> None:
    repeated = sorted(name for name, count in Counter(names).items() if count > 1)
    if repeated:
        raise GridError(f"the same {what} twice: {', '.join(repeated)}. Remove one, or make them differ")


def load_grid(path: str | Path) -> Grid:
    """Read a grid from a TOML or JSON file; paths of rooms are relative to its folder.

    Raises:
        FileReadError: the file is missing or malformed.
        GridError: the grid is impossible or of version 0.3; the message names file and field.
    """
    path = Path(path)
    content = read_toml(path, "grid") if path.suffix.lower() == ".toml" else read_json(path, "grid")
    if isinstance(content, dict) and "format" not in content:
        raise GridError(f"{path} has no `format = {GRID_FORMAT}`: its agents may be of version 0.3, where `smdp-dqn` "
                        f"also chose primitives. `hrl-escape convert {path}` writes them in the new form; in a grid of "
                        f"your own for this version add `format = {GRID_FORMAT}`")
    try:
        grid = Grid.from_dict({"name": path.stem} | content if isinstance(content, dict) else content)
    except EscapeError as error:
        raise GridError(f"{path}: {error}") from error
    return dataclasses.replace(grid, rooms=tuple(room.move_to(path.parent) for room in grid.rooms))
