"""Benchmarks: rungs by name, generated from a manifest of a few kB and verified against it.

Sets of a rung are disjoint in content and in layout. The tasks of `test_task` occur in no other set. The share of test
rooms whose tasks occur in training is reported, because small rungs have few tasks. The root of a Merkle tree is the
hash of a whole set.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from hrl_escape.errors import UnknownNameError, VerificationError
from hrl_escape.names import count_nouns
from hrl_escape.sets.keys import RoomKeys, SeenLayouts, compute_keys
from hrl_escape.sets.manifest import Manifest, list_benchmarks, load_manifest
from hrl_escape.sets.rung import Rung
from hrl_escape.sets.seasons import choose_season, split_season


def _join(left: str, right: str) -> str:
    return hashlib.sha256(b"\x01" + bytes.fromhex(left) + bytes.fromhex(right)).hexdigest()


def _climb(level: Sequence[str]) -> list[str]:
    """Return the next level of the tree; a last node without a partner is copied."""
    pairs = [_join(left, right) for left, right in zip(level[::2], level[1::2], strict=False)]
    return pairs + list(level[-1:]) * (len(level) % 2)


def compute_root(leaves: Sequence[str]) -> str:
    """Compute the Merkle root of leaves, hexadecimal SHA-256 digests in order."""
    level = list(leaves)
    while len(level) > 1:
        level = _climb(level)
    return level[0] if level else hashlib.sha256(b"").hexdigest()


# --- certificates ------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class RungCertificate:
    """Facts about a rung, computed from its rooms."""

    rung: str  # name of the rung
    rooms: Mapping[str, int]  # number of rooms of each set
    roots: Mapping[str, str]  # Merkle root of each set
    task_overlap: float  # share of test rooms whose task occurs in training
    tasks: Mapping[str, int]  # number of different tasks in each set

    def __str__(self) -> str:
        rooms = ", ".join(f"{role} {count} ({count_nouns(self.tasks[role], 'task')})"
                          for role, count in self.rooms.items())
        return f"{self.rung}: {rooms}; disjoint in content and layout; task overlap {self.task_overlap:.0%}"


def find_overlaps(sets: Mapping[str, Sequence[RoomKeys]]) -> list[str]:
    """Describe the rooms that two sets share: by content or layout for any two, by task with `test_task`."""
    found = []
    for (first, those), (second, these) in itertools.combinations(sets.items(), 2):
        for key in ("content", "layout", "task"):
            if key == "task" and "test_task" not in (first, second):
                continue
            seen = SeenLayouts(getattr(keys, key) for keys in those)  # hashes are found by equality
            found += [f"room {index} of {second} has the {key} of room {other} of {first}"
                      for index, keys in enumerate(these) if (other := seen.find(getattr(keys, key))) is not None]
    return found


def compute_task_overlap(train: Sequence[str], test: Sequence[str]) -> float:
    """Return the share of test rooms whose task, by its key, occurs in training."""
    known = set(train)
    return sum(task in known for task in test) / len(test)


def certify_rung(rung: Rung) -> RungCertificate:
    """Generate a rung's rooms and check them against the manifest and each other.

    Raises:
        VerificationError: a root differs, or two sets share a room.
    """
    keys = {role: [compute_keys(room, rung.layouts) for room in rooms] for role, rooms in rung.sets.items()}
    covered = {role: getattr(rung.record, role).covered or None for role in keys}
    roots = {role: compute_root([each.content for each in keys[role][: covered[role]]]) for role in keys}
    tasks = {role: [each.task for each in keys[role]] for role in keys}
    overlap = compute_task_overlap(tasks["train"], tasks["test"])
    problems = [f"the root of {role} is {root[:16]}..., not {stated[:16]}..." for role, root in roots.items()
                if root != (stated := getattr(rung.record, role).root)]
    problems += find_overlaps(keys)
    if not covered["train"] and abs(overlap - rung.record.task_overlap) > 1e-9:
        problems.append(f"the task overlap is {overlap:g}, not {rung.record.task_overlap:g}")
    if problems:
        raise VerificationError(f"{rung.benchmark}/{rung.name}: {'; '.join(problems[:5])}"
                                + (f"; and {len(problems) - 5} more" if len(problems) > 5 else ""))
    return RungCertificate(rung.name, {role: len(each) for role, each in keys.items()}, roots, overlap,
                           {role: len(set(each)) for role, each in tasks.items()})


__all__ = ["Benchmark", "list_benchmarks", "load_benchmark"]


class Benchmark:
    """Rungs by name, such as `bench["lattice"].train`.

    Args:
        manifest: the benchmark's rungs.
        source: name or file that `load_benchmark` takes.
    """

    def __init__(self, manifest: Manifest, source: str = "") -> None:
        self.manifest, self.name, self.source = manifest, manifest.name, source or manifest.name
        self._rungs = {record.name: Rung(manifest.name, record, self.source, manifest.layouts)
                       for record in manifest.rungs}

    def __repr__(self) -> str:
        return f"<Benchmark {self.name}: {', '.join(self._rungs)}>"

    def __len__(self) -> int:
        return len(self._rungs)

    def __iter__(self) -> Iterator[Rung]:
        return iter(self._rungs.values())

    def __getitem__(self, name: str) -> Rung:
        if name not in self._rungs:
            raise UnknownNameError(f"rung of {self.name}", name, self._rungs)
        return self._rungs[name]

    def verify(self, rungs: Iterable[str] = (), report: Callable[[str], None] = lambda line: None) -> None:
        """Generate the rooms of rungs and check roots and disjointness; takes 10 to 100 ms a room.

        Args:
            rungs: names; all by default.
            report: called with a line for each rung that passes.

        Raises:
            VerificationError: a root, an overlap or a room differs.
        """
        for rung in [self[name] for name in rungs] or self:
            report(str(certify_rung(rung)))


def load_benchmark(name: str | Path) -> Benchmark:
    """Load a benchmark that comes with the package, or one from a manifest file.

    Args:
        name: of the benchmark, such as `ladder-1`, or with a season, such as `cues-1@7`. Without one it is season 0.

    Raises:
        UnknownNameError: no such benchmark.
        ConfigError: no such season.
        EscapeError: the file is damaged.
    """
    base, season = split_season(str(name))
    manifest = load_manifest(base)
    return Benchmark(choose_season(manifest, season), f"{base}@{season or 0}" if manifest.seasons else base)
