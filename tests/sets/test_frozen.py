"""Rooms of the frozen benchmarks are those of version 0.3: seeds of all, content of the first and the last of each set.

`frozen_rooms.json` was written by version 0.3: number of rooms, hash of the seeds, digests of two rooms, hash of the
set.
"""

import hashlib
import json
from pathlib import Path

import pytest

from hrl_escape.sets import find_set, list_benchmarks, load_benchmark
from hrl_escape.sets.manifest import load_manifest

KNOWN = json.loads((Path(__file__).parent / "frozen_rooms.json").read_text(encoding="utf-8"))
FROZEN = tuple(name for name in list_benchmarks() if not load_manifest(name).seasons)
QUICK = ("ladder-1/doormat/test", "ladder-1/reach/train", "ladder-2/violations-2/train")


def describe(name):
    rooms = find_set(name)
    seeds = hashlib.sha256(json.dumps(list(rooms.seeds)).encode()).hexdigest()
    return [len(rooms), seeds[:16], rooms[0].digest[:16], rooms[-1].digest[:16], rooms.describe()["id"]]


def test_every_set_of_every_benchmark_is_known():
    assert KNOWN.keys() == {rooms.name for name in FROZEN for rung in load_benchmark(name)
                            for rooms in rung.sets.values()}


@pytest.mark.nightly
@pytest.mark.parametrize("name", QUICK)
def test_a_frozen_set_names_the_rooms_of_version_0_3(name):
    assert describe(name) == KNOWN[name]


@pytest.mark.slow
@pytest.mark.parametrize("benchmark", FROZEN)
def test_every_frozen_set_names_the_rooms_of_version_0_3(benchmark):
    names = [name for name in KNOWN if name.startswith(f"{benchmark}/")]
    assert {name: describe(name) for name in names} == {name: KNOWN[name] for name in names}
