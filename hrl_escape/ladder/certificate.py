"""Certificates: proof that a rung's sets are what the manifest says and that training rooms do not occur in tests.

No room of one set has the content or the layout of a room of another. The tasks of `test_task` occur in no other set.
The share of `test` whose tasks occur in training is reported, since small rungs have few tasks.

By a Merkle tree one hash commits to a whole set, and a few hashes prove that a room belongs to it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence

from hrl_escape.errors import VerificationError
from hrl_escape.ladder.hidden import derive_seed
from hrl_escape.ladder.instance_set import InstanceSet, derive_task
from hrl_escape.ladder.keys import RoomKeys, compute_keys
from hrl_escape.ladder.layouts import LATEST_LAYOUTS, SeenLayouts
from hrl_escape.ladder.manifest import ROLES, Manifest, RungRecord
from hrl_escape.ladder.rung import HELD_OUT, Rung, choose_seeds, is_held_out
from hrl_escape.names import count_nouns

Proof = tuple[tuple[str, str], ...]
"""For each level from the leaf upwards: the side, `left` or `right`, of the other node, and its hash."""


def _join(left: str, right: str) -> str:
    return hashlib.sha256(b"\x01" + bytes.fromhex(left) + bytes.fromhex(right)).hexdigest()


def _climb(level: Sequence[str]) -> list[str]:
    """Next level up; a last node without partner rises as it is."""
    pairs = [_join(left, right) for left, right in zip(level[::2], level[1::2], strict=False)]
    return pairs + list(level[-1:]) * (len(level) % 2)


def compute_root(leaves: Sequence[str]) -> str:
    """Root of leaves, hexadecimal SHA-256 digests in order; that of no leaves is the hash of nothing."""
    level = list(leaves)
    while len(level) > 1:
        level = _climb(level)
    return level[0] if level else hashlib.sha256(b"").hexdigest()


def prove_leaf(leaves: Sequence[str], index: int) -> Proof:
    """Proof that a leaf is in the tree, for `check_proof`."""
    level, proof = list(leaves), []
    while len(level) > 1:
        other = index ^ 1
        if other < len(level):
            proof.append(("left" if other < index else "right", level[other]))
        level, index = _climb(level), index // 2
    return tuple(proof)


def check_proof(leaf: str, proof: Proof, root: str) -> bool:
    """Return whether a proof shows that a leaf is in the tree of this root."""
    for side, other in proof:
        leaf = _join(other, leaf) if side == "left" else _join(leaf, other)
    return leaf == root


# --- certificates ------------------------------------------------------------------------

LEAST_TASKS = 20
"""Different tasks without which a set of unseen tasks says little."""


@dataclasses.dataclass(frozen=True)
class RungCertificate:
    """Facts about a rung that were computed from its rooms."""

    rung: str  # name of the rung
    rooms: Mapping[str, int]  # number of rooms of each set
    roots: Mapping[str, str]  # Merkle root of each set
    task_overlap: float  # share of the test's rooms whose task some training room has
    tasks: Mapping[str, int]  # number of different tasks in each set

    def __str__(self) -> str:
        rooms = ", ".join(f"{role} {count} ({count_nouns(self.tasks[role], 'task')})"
                          for role, count in self.rooms.items())
        return f"{self.rung}: {rooms}; disjoint in content and layout; task overlap {self.task_overlap:.0%}"


def find_overlaps(sets: Mapping[str, Sequence[RoomKeys]]) -> list[str]:
    """Rooms that two sets share, in words: by content or layout for any two, by task for `test_task` and another."""
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
    """Share of test rooms, by the keys of their tasks, whose task some training room has."""
    known = set(train)
    return sum(task in known for task in test) / len(test)


def _list_tasks(keys: Iterable[RoomKeys]) -> list[str]:
    return [each.task for each in keys]


def certify_rung(rung: Rung) -> RungCertificate:
    """Generate a rung's rooms and check them against the manifest and each other.

    Raises:
        VerificationError: a root differs, or two sets share a room.
    """
    keys = {role: [compute_keys(room, rung.layouts) for room in rooms] for role, rooms in rung.sets.items()}
    roots = {role: compute_root([each.content for each in keys[role]]) for role in keys}
    overlap = compute_task_overlap(_list_tasks(keys["train"]), _list_tasks(keys["test"]))
    problems = [f"the root of {role} is {root[:16]}..., not {stated[:16]}..." for role, root in roots.items()
                if root != (stated := getattr(rung.record, role).root)]
    problems += find_overlaps(keys)
    if abs(overlap - rung.record.task_overlap) > 1e-9:
        problems.append(f"the task overlap is {overlap:g}, not {rung.record.task_overlap:g}")
    if problems:
        raise VerificationError(f"{rung.benchmark}/{rung.name}: {'; '.join(problems[:5])}"
                                + (f"; and {len(problems) - 5} more" if len(problems) > 5 else ""))
    return RungCertificate(rung.name, {role: len(each) for role, each in keys.items()}, roots, overlap,
                           {role: len(set(_list_tasks(each))) for role, each in keys.items()})


def freeze_rung(benchmark: str, record: RungRecord, layouts: int) -> RungRecord:
    """Fill in what a rung's rooms decide: indices to skip, roots, task overlap, and whether tasks are held out."""
    if layouts > 1 and record.test_task is not None and not _has_tasks(Rung(benchmark, record)):
        record = dataclasses.replace(record, test_task=None)
    rung, seen = Rung(benchmark, record, layouts=layouts), SeenLayouts()
    keys: dict[str, list[RoomKeys]] = {}
    for role in ROLES:
        stated = record.get_record(role)
        if stated is None:
            continue
        skipped: list[int] = []
        if stated.seeds:
            keys[role] = [compute_keys(room, layouts) for room in InstanceSet("", rung.config, stated.seeds)]
        else:
            skipped, chosen = choose_seeds(rung.config, rung.iterate_seeds(role), stated.count, seen, layouts)
            keys[role] = list(chosen.values())
        seen.update(each.layout for each in keys[role])
        root = compute_root([each.content for each in keys[role]])
        record = dataclasses.replace(record, **{role: dataclasses.replace(stated, root=root, skipped=tuple(skipped))})
    overlap = compute_task_overlap(_list_tasks(keys["train"]), _list_tasks(keys["test"]))
    return dataclasses.replace(record, task_overlap=overlap)


def _has_tasks(rung: Rung) -> bool:
    """Return whether the tasks that a rung holds out are enough different ones to be tested on."""
    record = rung.record.test_task
    assert record is not None
    seeds = record.seeds or [derive_seed(rung.benchmark, rung.name, "test_task", i)
                             for i in range(2 * HELD_OUT * record.count)]  # there may be no such task at all
    drawn = [task for seed in seeds if is_held_out(task := derive_task(rung.config, seed))]
    return len(set(drawn[: record.count])) >= min(LEAST_TASKS, math.ceil(record.count / 2))


def freeze_manifest(manifest: Manifest, version: str) -> Manifest:
    """Fill in what the rooms of all rungs decide, for this version of the package.

    A manifest that has no roots yet gets the latest version of layouts; and rungs whose tasks held out are fewer than
    `LEAST_TASKS`, or than half the rooms of a smaller set, get no `test_task`.
    """
    is_new = not any(record.train.root for record in manifest.rungs)
    layouts = LATEST_LAYOUTS if is_new else manifest.layouts
    rungs = tuple(freeze_rung(manifest.name, record, layouts) for record in manifest.rungs)
    return dataclasses.replace(manifest, package=version, layouts=layouts, rungs=rungs)
