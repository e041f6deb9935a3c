"""Places of a comparison: one room to train and be tested in, or rooms to train in and others to be tested in."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import gymnasium
from gymnasium.utils import RecordConstructorArgs
from typing_extensions import Self

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import GridError
from hrl_escape.files import read_json, write_json
from hrl_escape.ladder.benchmark import compute_task_overlap
from hrl_escape.ladder.instance_set import InstanceSet
from hrl_escape.ladder.room_sets import RoomSets, Tower, list_sets, load_rooms, parse_room_set
from hrl_escape.names import parse_whole
from hrl_escape.settings import Range, Settings


@dataclasses.dataclass(frozen=True)
class Split:
    """Rooms to train in, and rooms to be tested in, of the same room configuration or of another; or two towers."""

    train: RoomSets  # rooms to train in
    test: RoomSets  # rooms to be tested in

    def __post_init__(self) -> None:
        first, *others = self.sets
        for other in others:
            robots = first.config.robot, other.config.robot
            if robots[0].joints != robots[1].joints:
                raise GridError(f"the robot of {first.name} has {robots[0].joints} joints and that of {other.name} "
                                f"{robots[1].joints}, so that what is trained in one cannot act in the other: take "
                                "sets of rooms with the same robot.joints")
            if robots[0].actions != robots[1].actions:
                raise GridError(f"the robots of {first.name} and {other.name} have different primitives, so that what "
                                "is trained in one cannot act in the other: take sets of rooms with the same "
                                "robot.gripper, robot.use and robot.drive")
        if isinstance(self.train, Tower) != isinstance(self.test, Tower):
            raise GridError(f"a tower is trained in for a tower: {self.train.name} goes not with {self.test.name}")

    @property
    def sets(self) -> tuple[InstanceSet, ...]:
        """Sets to train in, then those to be tested in."""
        return (*list_sets(self.train), *list_sets(self.test))

    @property
    def is_transfer(self) -> bool:
        """Agents act in rooms of several room configurations."""
        return len({rooms.config for rooms in self.sets}) > 1

    @cached_property
    def id(self) -> str:
        """Content hash, 16 hexadecimal digits."""
        parts = self.train.describe()["id"] + self.test.describe()["id"]
        return hashlib.sha256(parts.encode()).hexdigest()[:16]

    @property
    def room_overlap(self) -> float:
        """Share of the rooms to be tested in that are trained in too."""
        known = {(rooms.config, seed) for rooms in list_sets(self.train) for seed in rooms.seeds}
        tested = {(rooms.config, seed) for rooms in list_sets(self.test) for seed in rooms.seeds}
        return len(known & tested) / len(self.test)

    @cached_property
    def task_overlap(self) -> float:
        """Share of the rooms to be tested in whose puzzle, up to the numbers of buttons, is trained on too."""
        return compute_task_overlap(*([task for each in list_sets(rooms) for task in each.tasks]
                                      for rooms in (self.train, self.test)))


@dataclasses.dataclass(frozen=True)
class RunPlace:
    """Surroundings of runs: where they train and where they are tested."""

    name: str  # in tables
    instance: RoomInstance  # the room; of a split, the first room to be tested in, which stands for all in pictures
    split: Split | None = None  # rooms to train in and to be tested in; None for one room that is both

    @classmethod
    def of_room(cls, instance: RoomInstance, name: str = "") -> RunPlace:
        """One room, `clutter`, or `clutter#3` for another than the first instance."""
        return cls(name or (f"{instance.name}#{instance.seed}" if instance.seed else instance.name), instance)

    @classmethod
    def of_split(cls, train: RoomSets, test: RoomSets) -> RunPlace:
        """Rooms to train in, and rooms to be tested in."""
        return cls(f"{train.name} > {test.name}", test[0], Split(train, test))

    @property
    def id(self) -> str:
        """Content hash of everything in it."""
        return self.instance.id if self.split is None else self.split.id

    def save(self, folder: Path) -> None:
        """Write the instance, and the split, each under its id."""
        self.instance.save(folder / f"{self.instance.id}.json")
        if self.split is not None:
            write_json(folder / f"{self.id}.json", {role: getattr(self.split, role).describe()["content"]
                                                    for role in ("train", "test")}, indent=None)

    @classmethod
    def load(cls, folder: Path, place_id: str) -> RunPlace:
        """Load what `save` wrote."""
        path = folder / f"{place_id}.json"
        content = read_json(path, "room")
        if isinstance(content, Mapping) and content.keys() == {"train", "test"}:
            return cls.of_split(*(load_rooms(content[role]) for role in ("train", "test")))
        return cls.of_room(RoomInstance.load(path))


@dataclasses.dataclass(frozen=True)
class RoomSpec(Settings):
    """One room: an instance of a preset or of a room configuration, one from a file, or one of a set."""

    _section = "room"
    preset: str | None = None
    """Name of a preset."""
    arguments: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Arguments of the preset, if it takes any."""
    config: dict[str, Any] | None = None
    """Room configuration, as RoomConfig.to_dict() gives it."""
    file: str | None = None
    """File of a saved instance."""
    set: str | None = None
    """Room of a set, such as ladder-1/lattice/test[3]."""
    seed: Annotated[int, Range(0, 2**63 - 1)] = 0
    """Instance seed for a preset or a room configuration."""

    @property
    def label(self) -> str:
        """Name in short text: of the preset, configuration, file or set, and `#` with the number of an instance."""
        name = self.preset or (self.config or {}).get("name") or self.file or self.set or ""
        return f"{name}#{self.seed}" if self.seed else name

    def check(self) -> None:
        """Require exactly one source."""
        if sum(source is not None for source in (self.preset, self.config, self.file, self.set)) != 1:
            raise GridError(f"a room is one of preset, config, file or set, not {self.to_dict()}")

    def make_instance(self) -> RoomInstance:
        """Sample the instance, or read it from its file.

        Raises:
            EscapeError: no such preset, an impossible room configuration, a damaged file.
        """
        if self.file is not None:
            return RoomInstance.load(self.file)
        if self.preset is not None:
            return generate(get_preset(self.preset, **self.arguments), self.seed)
        if self.set is not None:
            rooms = parse_room_set(self.set)
            if len(rooms) != 1:
                raise GridError(f"{self.set} is {len(rooms)} rooms: name one, such as {self.set.partition('[')[0]}[0], "
                                "or give sets as train_rooms and test_rooms")
            return rooms[0]
        return generate(RoomConfig.from_dict(self.config), self.seed)

    def make_place(self) -> RunPlace:
        """The room as a place of a comparison."""
        return RunPlace.of_room(self.make_instance(), self.set or "")

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read `clutter`, `clutter#3` (instance 3), `room.json` or `ladder-1/lattice/test[3]`."""
        if text.endswith(".json"):
            return cls(file=text)
        if "/" in text:
            return cls(set=text)
        preset, _, seed = text.partition("#")
        number = parse_whole(seed or "0")
        if number is None:
            raise GridError(f"room {text!r}: after # comes the number of the instance, such as {preset}#3")
        return cls(preset=preset, seed=number)


class RoomSchedule(gymnasium.Wrapper, RecordConstructorArgs):
    """Chooses the room of an episode by its seed, so that evaluations go round a set.

    Args:
        env: an `InstanceSetEnv`.
        rooms: episode seed -> number of the room in the set. Other seeds draw a room.
    """

    def __init__(self, env: gymnasium.Env, rooms: Mapping[str, int]) -> None:
        RecordConstructorArgs.__init__(self, rooms=dict(rooms))
        super().__init__(env)
        self._rooms = {int(seed): number for seed, number in rooms.items()}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in the room of its seed."""
        if seed in self._rooms:
            options = {"instance_index": self._rooms[seed], **(options or {})}
        return self.env.reset(seed=seed, options=options)
