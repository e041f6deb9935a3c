"""Sets of rooms: sequences that generate their rooms on demand, and the environment over one."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import gymnasium
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import EzPickle

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.rewards import Events
from hrl_escape.env.sampling.generation import generate, sample_puzzle
from hrl_escape.errors import ConfigError, FileReadError, UnknownNameError, describe_damage
from hrl_escape.figures import Pictured
from hrl_escape.files import read_json, write_json
from hrl_escape.sets.keys import compute_task_key

if TYPE_CHECKING:
    from hrl_escape.env.vector_env import EscapeRoomVectorEnv
    from hrl_escape.options.batched.env import BatchedOptionsEnv

LADDER_ID, LADDER_ENTRY = "hrl_escape/Ladder-v1", "hrl_escape.sets.environments:make_ladder_env"
CHOOSING_ROOMS = ("config", "instance", "instance_seed", "instances", "resample_instance")
"""Arguments of `EscapeRoomEnv` that a set gives itself."""


def derive_task(config: RoomConfig, seed: int) -> str:
    """Compute the key of a room's task without generating the room."""
    return compute_task_key(sample_puzzle(config, seed)[1])


class LazySeeds(Sequence[int]):
    """A given number of instance seeds, drawn from an iterator on demand."""

    def __init__(self, seeds: Iterator[int], count: int) -> None:
        self._seeds, self._count = seeds, count
        self._known: list[int] = []

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> int: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[int]: ...
    def __getitem__(self, index: int | slice) -> int | Sequence[int]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(self._count))]
        if not -self._count <= index < self._count:
            raise IndexError(f"seed {index} of {self._count}")
        index %= self._count
        while len(self._known) <= index:
            self._known.append(next(self._seeds))
        return self._known[index]


class InstanceSet(Pictured, Sequence[RoomInstance]):
    """Rooms of one room configuration, generated on demand and cached.

        rooms = load_benchmark("ladder-1")["lattice"].train
        few, rest = rooms.split(0.1, key=0)
        env = few.make_env(options=True)

    Args:
        name: such as `ladder-1/lattice/train`.
        config: the room configuration.
        seeds: instance seeds, in order.
        place: arguments of `hrl_escape/Ladder-v1` for this set, which give its environments a `spec`.
    """

    _picture = "hrl_escape.env.pictures.maps:make_strip"

    def __init__(self, name: str, config: RoomConfig, seeds: Sequence[int], place: Mapping[str, str] | None = None
                 ) -> None:
        self.name, self.config, self.seeds, self.place = name, config, seeds, place
        self._rooms: dict[int, RoomInstance] = {}

    def __len__(self) -> int:
        return len(self.seeds)

    @overload
    def __getitem__(self, index: int) -> RoomInstance: ...
    @overload
    def __getitem__(self, index: slice) -> InstanceSet: ...
    def __getitem__(self, index: int | slice) -> RoomInstance | InstanceSet:
        if isinstance(index, slice):
            chosen = range(*index.indices(len(self)))
            rooms = self._choose(_name_slice(self.name, chosen), chosen)
            if self.place is not None and "slice" not in self.place and chosen.step == 1 and len(chosen):
                rooms.place = {**self.place, "slice": f"{chosen.start}..{chosen.stop}"}
            return rooms
        seed = self.seeds[index]
        if seed not in self._rooms:
            self._rooms[seed] = generate(self.config, seed)
        return self._rooms[seed]

    def __repr__(self) -> str:
        return f"<InstanceSet {self.name}: {len(self)} rooms>"

    def __getstate__(self) -> dict[str, Any]:
        return {"name": self.name, "config": self.config, "seeds": list(self.seeds), "place": self.place, "_rooms": {}}

    @property
    def ids(self) -> tuple[str, ...]:
        """Content hashes of all rooms, 64 hexadecimal digits each; generates them."""
        return tuple(room.digest for room in self)

    @property
    def tasks(self) -> tuple[str, ...]:
        """Keys of the rooms' tasks; equal keys are the same task. Generates no room."""
        return tuple(derive_task(self.config, seed) for seed in self.seeds)

    # --- parts -------------------------------------------------------------------------

    def split(self, fraction: float, key: int = 0) -> tuple[InstanceSet, InstanceSet]:
        """Split the set in two at random, reproducibly.

        The order of rooms depends only on key and seeds: with the same key, the first part of a smaller fraction is a
        subset of the first part of a larger one.

        Args:
            fraction: share of the first part, from 0 to 1.
            key: any whole number.
        """
        if not 0.0 <= fraction <= 1.0:
            raise ConfigError("split.fraction", fraction, "a number from 0 to 1")
        order = sorted(range(len(self)),
                       key=lambda index: hashlib.sha256(f"{key}/{self.seeds[index]}".encode()).digest())
        cut = round(fraction * len(self))
        return (self._choose(f"{self.name}.split({fraction:g}, {key})[0]", sorted(order[:cut])),
                self._choose(f"{self.name}.split({fraction:g}, {key})[1]", sorted(order[cut:])))

    def filter(self, keep: Callable[[RoomInstance], bool]) -> InstanceSet:
        """Return the rooms for which `keep` is true; generates all rooms."""
        return self._choose(f"{self.name}.filter", [index for index, room in enumerate(self) if keep(room)])

    def _choose(self, name: str, indices: Iterable[int]) -> InstanceSet:
        chosen = InstanceSet(name, self.config, [self.seeds[index] for index in indices])
        chosen._rooms = self._rooms  # one cache, by seed
        return chosen

    # --- environments ------------------------------------------------------------------

    def make_env(self, options: bool | Mapping[str, Any] = False, **arguments: Any) -> gymnasium.Env:
        """Make an environment whose resets draw a room of the set from the episode's stream.

        `reset(options={"instance_index": i})` chooses room i. Environments of a rung's set, or of a slice of one, have
        a `spec`; see `make_ladder_env`.

        Args:
            options: wrap it in an `OptionsEnv`; a table gives its arguments.
            arguments: all other arguments of `EscapeRoomEnv`, such as `observation="features"`.

        Raises:
            UnknownNameError: `EscapeRoomEnv` or `OptionsEnv` takes no such argument. Arguments of `OptionsEnv` go
                into `options`.
        """
        check_names("EscapeRoomEnv (OptionsEnv's go into options={...})", arguments, EscapeRoomEnv, CHOOSING_ROOMS)
        env = InstanceSetEnv(self, **arguments)
        if self.place is not None:
            env.spec = EnvSpec(LADDER_ID, entry_point=LADDER_ENTRY, kwargs={**self.place, **arguments})
        return add_options(env, options)

    def make_vec(self, num_envs: int, options: bool | Mapping[str, Any] = False, **arguments: Any
                 ) -> EscapeRoomVectorEnv | BatchedOptionsEnv:
        """Make a vector environment over all rooms of the set; every episode draws one.

        Args:
            num_envs: number of environments.
            options: make a `BatchedOptionsEnv`; a table gives its arguments.
            arguments: all other arguments of the batch, such as `device="cuda"`.
        """
        arguments = {"instance": list(self), "resample_instance": True} | arguments
        if isinstance(options, Mapping) or options:
            from hrl_escape.options.batched.env import BatchedOptionsEnv  # loads torch

            return BatchedOptionsEnv(num_envs, **(arguments | dict(options if isinstance(options, Mapping) else {})))
        from hrl_escape.env.vector_env import EscapeRoomVectorEnv  # loads torch

        return EscapeRoomVectorEnv(num_envs, **arguments)

    # --- JSON --------------------------------------------------------------------------

    def describe(self) -> dict[str, Any]:
        """Return the set as JSON values, `{"id": hash, "content": ...}`, for `from_description`."""
        content = {"name": self.name, "config": self.config.to_dict(), "seeds": list(self.seeds)}
        text = json.dumps({**content, "name": ""}, sort_keys=True)
        return {"id": hashlib.sha256(text.encode()).hexdigest()[:16], "content": content}

    @classmethod
    def from_description(cls, content: Mapping[str, Any]) -> InstanceSet:
        """Make a set from the content of its description."""
        return cls(content["name"], RoomConfig.from_dict(content["config"]), [int(seed) for seed in content["seeds"]])

    def save(self, path: str | Path) -> None:
        """Write the set as a JSON file of a few kB: its name, room configuration and seeds."""
        write_json(path, self.describe()["content"], indent=1)

    @classmethod
    def load(cls, path: str | Path) -> InstanceSet:
        """Load a set from its file.

        Raises:
            FileReadError: the file is missing or holds no set.
        """
        content = read_json(path, "set of rooms")
        try:
            return cls.from_description(content)
        except (KeyError, TypeError, ValueError) as error:
            raise FileReadError(f"{path}: this is not a set of rooms ({describe_damage(error)})") from error


def _name_slice(name: str, chosen: range) -> str:
    """Name a range of rooms by the grammar of `sets.grammar`; a part of a part is named after the whole set."""
    if chosen.step != 1:
        return f"{name}[{chosen.start}:{chosen.stop}:{chosen.step}]"
    part = re.fullmatch(r"(.+)#(\d+)(?:\.\.\d+)?", name, re.DOTALL)
    base, first = (part[1], int(part[2])) if part else (name, 0)
    return f"{base}#{first + chosen.start}..{first + chosen.stop}"


def check_names(words: str, given: Iterable[str], maker: Callable[..., Any], left_out: tuple[str, ...]) -> None:
    """Raise for an argument that a maker does not take.

    Raises:
        UnknownNameError: the message names the closest.
    """
    known = [name for name in signature(maker).parameters if name not in left_out]
    for name in given:
        if name not in known:
            raise UnknownNameError(f"argument of {words}", name, known)


def add_options(env: gymnasium.Env, options: bool | Mapping[str, Any]) -> gymnasium.Env:
    """Wrap an environment in an `OptionsEnv` if `options` is true or a table of its arguments.

    Raises:
        UnknownNameError: `OptionsEnv` takes no such argument.
    """
    if not isinstance(options, Mapping) and not options:
        return env
    from hrl_escape.options.options_env import OptionsEnv

    table = options if isinstance(options, Mapping) else {}
    check_names("OptionsEnv", table, OptionsEnv, ("env",))
    return OptionsEnv(env, **table)


class InstanceSetEnv(EscapeRoomEnv):
    """`EscapeRoomEnv` that draws a room of a set at every reset.

    `info["instance"]` numbers rooms from 0 in the order of their first appearance. It distinguishes rooms without
    naming them, because a content hash would reveal the graph of a published room.

    Args:
        rooms: the set, or its description.
        arguments: of `EscapeRoomEnv`.
    """

    def __init__(self, rooms: InstanceSet | Mapping[str, Any], **arguments: Any) -> None:
        self.rooms = rooms if isinstance(rooms, InstanceSet) else InstanceSet.from_description(rooms)
        self._numbers: dict[str, int] = {}
        super().__init__(instances=self.rooms, **arguments)
        EzPickle.__init__(self, self.rooms, **arguments)

    def __getstate__(self) -> dict[str, Any]:
        """Return arguments, running episode and the numbers of rooms."""
        state = super().__getstate__()
        return state | {"episode": state["episode"] | {"_numbers": dict(self._numbers)}}

    def _inform(self, events: Events) -> dict[str, Any]:
        number = self._numbers.setdefault(self.instance.id, len(self._numbers))
        return super()._inform(events) | {"instance": number}

    def describe(self) -> dict[str, Any]:
        """Return the arguments that decide this environment's numbers, as JSON values."""
        return {"rooms": self.rooms.describe(), "observation": self._kind, "engine": self._engine}
