"""Freezing of a benchmark: what its rooms decide is computed once and written into its manifest."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

from hrl_escape.sets.benchmark import compute_root, compute_task_overlap
from hrl_escape.sets.instance_set import InstanceSet, derive_task
from hrl_escape.sets.keys import LATEST_LAYOUTS, RoomKeys, SeenLayouts, compute_keys
from hrl_escape.sets.manifest import ROLES, Manifest, RungRecord
from hrl_escape.sets.rung import HELD_OUT, Rung, choose_seeds, derive_seed, is_held_out
from hrl_escape.sets.seasons import choose_season

LEAST_TASKS = 20
"""Different tasks without which a set of unseen tasks says little."""


def freeze_rung(benchmark: str, record: RungRecord, layouts: int) -> RungRecord:
    """Fill in what a rung's rooms decide: indices to skip, roots, task overlap, and whether tasks are held out."""
    if layouts > 1 and record.test_task is not None and not _has_tasks(Rung(benchmark, record)):
        record = dataclasses.replace(record, test_task=None)
    rung, seen = Rung(benchmark, record, layouts=layouts), SeenLayouts()
    keys: dict[str, list[RoomKeys]] = {}
    for role in ROLES:
        stated = getattr(record, role)
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
    overlap = compute_task_overlap(*([each.task for each in keys[role]] for role in ("train", "test")))
    return dataclasses.replace(record, task_overlap=overlap)


def _has_tasks(rung: Rung) -> bool:
    """Return whether the tasks that a rung holds out are enough different ones to be tested on."""
    record = rung.record.test_task
    assert record is not None
    seeds = record.seeds or [derive_seed(rung.benchmark, rung.name, "test_task", i)
                             for i in range(2 * HELD_OUT * record.count)]  # there may be no such task at all
    drawn = [task for seed in seeds if is_held_out(task := derive_task(rung.config, seed))]
    return len(set(drawn[: record.count])) >= min(LEAST_TASKS, math.ceil(record.count / 2))


COVERED = 1
"""Rooms of each set of a season that its root covers."""


def _freeze_seasons(seasons: Sequence[RungRecord], record: RungRecord, names: Sequence[str]) -> RungRecord:
    """Fill in the roots of a rung's sets in each season."""
    for role in ("train", "valid", "test"):
        roots = []
        for name, season in zip(names, seasons, strict=True):
            sampled = dataclasses.replace(season, **{role: dataclasses.replace(getattr(season, role), root="")})
            rooms = getattr(Rung(name, sampled, layouts=LATEST_LAYOUTS), role)
            roots.append(compute_root([rooms[number].digest for number in range(COVERED)]))
        stated = dataclasses.replace(getattr(record, role), roots=tuple(roots), covered=COVERED)
        record = dataclasses.replace(record, **{role: stated})
    return record


def freeze_manifest(manifest: Manifest, version: str) -> Manifest:
    """Fill in what the rooms of all rungs decide, for this version of the package.

    A manifest that has no roots yet gets the latest version of layouts; and rungs whose tasks held out are fewer than
    `LEAST_TASKS`, or than half the rooms of a smaller set, get no `test_task`. A benchmark with seasons gets a root of
    the first rooms of each set in each season; `Benchmark.verify` checks that all its rooms are different.
    """
    if manifest.seasons:
        seasons = [choose_season(manifest, season) for season in range(manifest.seasons)]
        rungs = tuple(_freeze_seasons([season.rungs[number] for season in seasons], record,
                                      [season.name for season in seasons])
                      for number, record in enumerate(manifest.rungs))
        return dataclasses.replace(manifest, package=version, layouts=LATEST_LAYOUTS, rungs=rungs)
    is_new = not any(record.train.root for record in manifest.rungs)
    layouts = LATEST_LAYOUTS if is_new else manifest.layouts
    rungs = tuple(freeze_rung(manifest.name, record, layouts) for record in manifest.rungs)
    return dataclasses.replace(manifest, package=version, layouts=layouts, rungs=rungs)
