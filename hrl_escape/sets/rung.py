"""Rungs: a room configuration, and sets of rooms to train and test on whose seeds follow from names.

Room i of a set is generated from `derive_seed(benchmark, rung, role, i)`. Where a rung holds out tasks, a tenth of all
tasks, chosen by their hash, occurs in `test_task` only.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Container, Iterator
from functools import cached_property

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EscapeError, GenerationError
from hrl_escape.sets.instance_set import InstanceSet, LazySeeds, derive_task
from hrl_escape.sets.keys import LayoutKey, RoomKeys, compute_keys
from hrl_escape.sets.manifest import ROLES, RungRecord


def derive_seed(*words: str | int) -> int:
    """Instance seed that follows from words: the first 63 bits of SHA-256 over them, joined by slashes."""
    digest = hashlib.sha256("/".join(map(str, words)).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


HELD_OUT = 10
"""One task in this many is kept for `test_task`."""


def is_held_out(task: str) -> bool:
    """Return whether a task, by its key, is kept for `test_task`."""
    return int(task[:8], 16) % HELD_OUT == 0


class Rung:
    """One rung: a room configuration, and the sets of rooms to train and test on.

    Args:
        benchmark: name of the benchmark.
        record: the rung in the manifest.
        source: name or file by which `load_benchmark` finds it, so that environments of its sets have a `spec`.
        layouts: version by which rooms look alike, see `Manifest`.

    Attributes:
        isolates: ability that it asks for beyond the rung before.
        config: room configuration of its rooms.
    """

    def __init__(self, benchmark: str, record: RungRecord, source: str = "", layouts: int = 1) -> None:
        self.benchmark, self.record, self.source, self.layouts = benchmark, record, source, layouts
        self.name, self.isolates, self.config = record.name, record.isolates, record.config

    def __repr__(self) -> str:
        return f"<Rung {self.benchmark}/{self.name}: {self.isolates}>"

    def _repr_svg_(self) -> str:
        return self.train._repr_svg_()

    @cached_property
    def train(self) -> InstanceSet:
        """Rooms to learn on."""
        return self._make("train")

    @cached_property
    def valid(self) -> InstanceSet:
        """Rooms to choose settings by."""
        return self._make("valid")

    @cached_property
    def test(self) -> InstanceSet:
        """Rooms with unseen layouts; their tasks may occur in training, see `record.task_overlap`."""
        return self._make("test")

    @cached_property
    def test_task(self) -> InstanceSet | None:
        """Rooms with unseen layouts and unseen tasks; None where the rung has too few tasks to hold some out."""
        return None if self.record.test_task is None else self._make("test_task")

    @property
    def sets(self) -> dict[str, InstanceSet]:
        """Sets that the rung has, by role: `train`, `valid`, `test` and, if there is one, `test_task`."""
        every = {role: getattr(self, role) for role in ROLES}
        return {role: rooms for role, rooms in every.items() if rooms is not None}

    def _make(self, role: str) -> InstanceSet:
        record = getattr(self.record, role)
        skipped = set(record.skipped)
        seeds = record.seeds or LazySeeds(
            (seed for index, seed in self.iterate_seeds(role) if index not in skipped), record.count)
        place = {"benchmark": self.source, "rung": self.name, "set": role} if self.source else None
        return InstanceSet(f"{self.benchmark}/{self.name}/{role}", self.config, seeds, place)

    def iterate_seeds(self, role: str) -> Iterator[tuple[int, int]]:
        """Yield (index, seed) of the candidates for a set: all but those whose task belongs elsewhere."""
        for index in itertools.count():
            seed = derive_seed(self.benchmark, self.name, role, index)
            if self.record.test_task is None or (
                    is_held_out(derive_task(self.config, seed)) == (role == "test_task")):
                yield index, seed


def choose_seeds(config: RoomConfig, candidates: Iterator[tuple[int, int]], count: int, seen: Container[LayoutKey],
                 layouts: int = 1) -> tuple[list[int], dict[int, RoomKeys]]:
    """Choose the first seeds, of (index, seed) pairs, whose rooms can be generated and look like none that was seen.

    Returns:
        Indices skipped, and the keys of the rooms chosen, by seed.

    Raises:
        EscapeError: almost every candidate must be skipped.
    """
    skipped: list[int] = []
    kept: dict[int, RoomKeys] = {}
    for index, seed in candidates:
        try:
            keys = compute_keys(generate(config, seed), layouts)
        except GenerationError:
            keys = None
        if keys is not None and keys.layout not in seen:
            kept[seed] = keys
        else:
            skipped.append(index)
        if len(kept) == count:
            return skipped, kept
        if len(skipped) > 10 * (count + len(kept)):
            break
    raise EscapeError(f"of the first {len(kept) + len(skipped)} rooms, {len(skipped)} look like known ones or cannot "
                      "be generated: give the room configuration more room to vary")
