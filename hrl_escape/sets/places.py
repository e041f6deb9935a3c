"""Training and evaluation rooms of runs: one room for both, or separate sets."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import GridError
from hrl_escape.files import read_json, write_json
from hrl_escape.sets.benchmark import compute_task_overlap
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.room_sequence import RoomSequence, RoomSets, list_sets, load_rooms


@dataclasses.dataclass(frozen=True)
class Split:
    """Training and test rooms: sets of the same or different configurations, or two room sequences."""

    train: RoomSets  # training rooms
    test: RoomSets  # test rooms

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
        if isinstance(self.train, RoomSequence) != isinstance(self.test, RoomSequence):
            raise GridError(f"agents that are tested in sequences of rooms are trained in sequences: {self.train.name} "
                            f"does not go with {self.test.name}")

    @property
    def sets(self) -> tuple[InstanceSet, ...]:
        """Training sets, then test sets."""
        return (*list_sets(self.train), *list_sets(self.test))

    @property
    def is_transfer(self) -> bool:
        """Training and test rooms have different configurations."""
        return len({rooms.config for rooms in self.sets}) > 1

    @cached_property
    def id(self) -> str:
        """Content hash, 16 hexadecimal digits."""
        parts = self.train.describe()["id"] + self.test.describe()["id"]
        return hashlib.sha256(parts.encode()).hexdigest()[:16]

    @property
    def room_overlap(self) -> float:
        """Share of test rooms that occur in training."""
        known = {(rooms.config, seed) for rooms in list_sets(self.train) for seed in rooms.seeds}
        tested = {(rooms.config, seed) for rooms in list_sets(self.test) for seed in rooms.seeds}
        return len(known & tested) / len(self.test)

    @cached_property
    def task_overlap(self) -> float:
        """Share of test rooms whose puzzle, up to the numbers of buttons, occurs in training."""
        return compute_task_overlap(*([task for each in list_sets(rooms) for task in each.tasks]
                                      for rooms in (self.train, self.test)))


@dataclasses.dataclass(frozen=True)
class RunPlace:
    """Training and evaluation rooms of a run."""

    name: str  # in tables
    instance: RoomInstance  # the room; of a split, the first test room, for pictures
    split: Split | None = None  # training and test rooms, or None for one room that is both

    @classmethod
    def of_room(cls, instance: RoomInstance, name: str = "") -> RunPlace:
        """Use one room for training and evaluation."""
        return cls(name or (f"{instance.name}#{instance.seed}" if instance.seed else instance.name), instance)

    @classmethod
    def of_split(cls, train: RoomSets, test: RoomSets) -> RunPlace:
        """Use separate training and test rooms."""
        return cls(f"{train.name} > {test.name}", test[0], Split(train, test))

    @property
    def id(self) -> str:
        """Content hash of all rooms."""
        return self.instance.id if self.split is None else self.split.id

    def save(self, folder: Path) -> None:
        """Write the instance and the split, each to a file named by its id."""
        self.instance.save(folder / f"{self.instance.id}.json")
        if self.split is not None:
            write_json(folder / f"{self.id}.json", {role: getattr(self.split, role).describe()["content"]
                                                    for role in ("train", "test")}, indent=None)

    @classmethod
    def load(cls, folder: Path, place_id: str) -> RunPlace:
        """Load the files of `save`."""
        path = folder / f"{place_id}.json"
        content = read_json(path, "room")
        if isinstance(content, Mapping) and content.keys() == {"train", "test"}:
            return cls.of_split(*(load_rooms(content[role]) for role in ("train", "test")))
        return cls.of_room(RoomInstance.load(path))
