"""Rungs: a room configuration with training and test sets.

Room i of a set is generated from the seed `derive_seed(benchmark, rung, role, i)`. If a rung holds out tasks, a tenth
of all tasks, chosen by their hash, occurs only in `test_task`.
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
    """Derive an instance seed: the first 63 bits of SHA-256 over the words, joined by slashes."""
    digest = hashlib.sha256("/".join(map(str, words)).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


HELD_OUT = 10
"""One task in this many is reserved for `test_task`."""


def is_held_out(task: str) -> bool:
    """Return whether a task is reserved for `test_task`, by its key."""
    return int(task[:8], 16) % HELD_OUT == 0


class Rung:
    """Rung of a benchmark: a room configuration with training and test sets.

    Args:
        benchmark: name of the benchmark.
        record: the rung in the manifest.
        source: name or file for `load_benchmark`, which gives environments of its sets a `spec`.
        layouts: version of layouts, see `Manifest`.

    Attributes:
        isolates: ability that it requires beyond the previous rung.
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
        """Rooms to learn in, disjoint from the other sets."""
        return self._make("train")

    @cached_property
    def valid(self) -> InstanceSet:
        """Rooms to choose settings by, disjoint from the other sets."""
        return self._make("valid")

    @cached_property
    def test(self) -> InstanceSet:
        """Test rooms with unseen layouts; some tasks occur in training, see `record.task_overlap`."""
        return self._make("test")

    @cached_property
    def test_task(self) -> InstanceSet | None:
        """Test rooms with unseen layouts and tasks, or None if the rung has too few tasks to hold out."""
        return None if self.record.test_task is None else self._make("test_task")

    @property
    def sets(self) -> dict[str, InstanceSet]:
        """Sets of the rung by role: `train`, `valid`, `test` and, if present, `test_task`."""
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
        """Yield (index, seed) of the candidates for a set, without tasks that are reserved for another set."""
        for index in itertools.count():
            seed = derive_seed(self.benchmark, self.name, role, index)
            if self.record.test_task is None or (
                    is_held_out(derive_task(self.config, seed)) == (role == "test_task")):
                yield index, seed


def choose_seeds(config: RoomConfig, candidates: Iterator[tuple[int, int]], count: int, seen: Container[LayoutKey],
                 layouts: int = 1) -> tuple[list[int], dict[int, RoomKeys]]:
    """Choose the first seeds whose rooms can be generated and are not alike to a known layout.

    Args:
        config: room configuration.
        candidates: (index, seed) pairs, in order.
        count: number of rooms.
        seen: known layouts.
        layouts: version of layouts.

    Returns:
        Skipped indices, and the keys of the chosen rooms by seed.

    Raises:
        EscapeError: almost every candidate was skipped.
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
    raise EscapeError(f"of the first {len(kept) + len(skipped)} rooms, {len(skipped)} are alike to known ones or "
                      "cannot be generated: give the room configuration more room to vary")
