"""Certificates: sets are the manifest's and disjoint, and what is planted is found."""

import dataclasses
import hashlib
import json
import os
import subprocess
import sys

import pytest

from benchmarks.freezing import freeze_manifest
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EscapeError, UnknownNameError, VerificationError
from hrl_escape.sets.benchmark import Benchmark, certify_rung, find_overlaps, list_benchmarks, load_benchmark
from hrl_escape.sets.keys import RoomKeys, compute_keys, compute_task_key
from hrl_escape.sets.manifest import Manifest, SetRecord
from hrl_escape.sets.rung import choose_seeds, derive_seed, is_held_out
from tests.command_line import run_here
from tests.covering import thin
from tests.sets.small import make_manifest


def change(rung: str, **fields) -> Benchmark:
    """The small benchmark with fields of one rung changed."""
    manifest = make_manifest()
    rungs = [dataclasses.replace(record, **fields) if record.name == rung else record for record in manifest.rungs]
    return Benchmark(dataclasses.replace(manifest, rungs=tuple(rungs)))


def test_a_frozen_benchmark_verifies(capsys):
    bench = Benchmark(make_manifest())
    lines: list[str] = []
    bench.verify(report=lines.append)
    assert lines[0] == (
        "one: train 12 (1 task), valid 4 (1 task), test 4 (1 task); disjoint in content and layout; task overlap 100%")
    assert lines[1].startswith("five: train 12 (")


def test_a_manifest_survives_its_file(tmp_path):
    path = tmp_path / "small.json"
    make_manifest().save(path)
    assert load_benchmark(path).manifest == load_benchmark(str(path)).manifest == make_manifest()
    assert path.stat().st_size < 3_000


@pytest.mark.parametrize("fields", [
    {"config": dataclasses.replace(make_manifest().rungs[0].config, horizon=999)},
    {"name": "won"},
    {"test": dataclasses.replace(make_manifest().rungs[0].test, root="0" * 64)},
    {"train": dataclasses.replace(make_manifest().rungs[0].train, count=11)},
    {"train": dataclasses.replace(make_manifest().rungs[0].train, skipped=(0,))},
])
def test_a_planted_change_is_found(fields):
    bench = change("one", **fields)
    with pytest.raises(VerificationError, match="root of"):
        bench.verify([fields.get("name", "one")])


def test_a_training_room_planted_into_the_test_is_found():
    bench = Benchmark(make_manifest())
    seeds = (*bench["one"].test.seeds[:3], bench["one"].train.seeds[5])
    planted = change("one", test=SetRecord(count=4, seeds=seeds))
    with pytest.raises(VerificationError, match="room 3 of test has the content of room 5 of train"):
        certify_rung(planted["one"])


@pytest.mark.nightly
def test_a_training_task_planted_into_the_tasks_held_out_is_found():
    bench = Benchmark(make_manifest())
    seeds = (*bench["five"].test_task.seeds[:3], bench["five"].test.seeds[0])
    planted = change("five", test_task=SetRecord(count=4, seeds=seeds))
    with pytest.raises(VerificationError, match="room 3 of test_task has the task of room 0 of test"):
        certify_rung(planted["five"])


def test_overlaps_are_named_by_key():
    keys = [RoomKeys(f"c{i}", f"l{i}", "t") for i in range(4)]
    assert find_overlaps({"train": keys[:2], "test": keys[2:]}) == []
    alike = RoomKeys("c9", "l1", "t")
    assert find_overlaps({"train": keys[:2], "test": [keys[2], alike]}) == [
        "room 1 of test has the layout of room 1 of train"]
    assert len(find_overlaps({"train": keys[:2], "test_task": keys[2:]})) == 2


def test_rooms_that_look_like_known_ones_are_skipped_and_listed():
    rung = Benchmark(make_manifest())["one"]
    known = {compute_keys(rung.valid[i]).layout for i in (0, 2)}
    skipped, chosen = choose_seeds(rung.config, rung.iterate_seeds("valid"), 3, known)
    assert skipped == [0, 2]
    planted = change("one", valid=SetRecord(count=3, skipped=tuple(skipped)))
    seeds = list(chosen)
    assert list(planted["one"].valid.seeds) == seeds and seeds[0] == rung.valid.seeds[1]
    assert list(chosen.values()) == [compute_keys(room) for room in planted["one"].valid]


def test_a_room_configuration_that_cannot_vary_is_refused():
    fixed = get_preset("paper-one-button")
    known = {compute_keys(generate(fixed, 0)).layout}
    with pytest.raises(EscapeError, match="more room to vary") as refused:
        choose_seeds(fixed, ((i, i) for i in range(100)), 2, known)
    assert "of the first 21 rooms, 21 are alike to" in str(refused.value)


def test_one_task_in_ten_is_held_out_by_the_first_32_bits_of_its_key():
    keys = [f"{number:08x}{'f' * 24}" for number in (0, 9, 10, 160, 161, 2**32 - 6)]
    assert [is_held_out(key) for key in keys] == [True, False, True, True, False, True]


def test_every_frozen_set_avoids_the_layouts_of_all_before_it():
    """The first room of the test is planted into training; the set between the two does not make it forgotten."""
    manifest = make_manifest()
    rung = Benchmark(manifest)["one"]
    train, valid = (SetRecord(count=1, seeds=(rooms.seeds[0],)) for rooms in (rung.test, rung.valid))
    planted = dataclasses.replace(manifest.rungs[0], train=train, valid=valid)
    (frozen,) = freeze_manifest(dataclasses.replace(manifest, rungs=(planted,)), "0").rungs
    assert manifest.rungs[0].test.skipped == () and frozen.test.skipped == (0,)


def test_tasks_held_out_are_decided_by_their_hash():
    rung = Benchmark(make_manifest())["five"]
    tasks = {role: {compute_task_key(room.puzzle) for room in rooms} for role, rooms in rung.sets.items()}
    assert all(map(is_held_out, tasks.pop("test_task")))
    assert not any(is_held_out(task) for each in tasks.values() for task in each)


# --- the benchmark that comes with the package ---------------------------------------------


def test_the_first_ladder_has_its_rungs_in_a_few_kilobytes():
    assert list_benchmarks() == ("cues-1", "families-1", "ladder-1", "ladder-2")
    bench = load_benchmark("ladder-1")
    assert [rung.name for rung in bench] == [
        "doormat", "pair", "reach", "chain-3", "chain-4", "doors", "chain", "lattice-5", "drift", "code", "freight",
        "lattice-6", "lattice-7", "clutter", "lattice-8", "switchboard", "lattice", "house"]
    few = {"doormat", "pair", "reach", "chain-3", "chain-4", "chain", "switchboard"}
    assert {rung.name for rung in bench if rung.test_task is None} == few, "too few tasks to hold some out"
    with pytest.raises(UnknownNameError, match="did you mean 'lattice'"):
        bench["latice"]
    with pytest.raises(UnknownNameError, match="ladder-1"):
        load_benchmark("ladder-0")


@pytest.mark.parametrize(("source", "name"), thin([(source, rung.name) for source in list_benchmarks()
                                                   for rung in load_benchmark(source)], 8))
def test_every_rung_gives_relabelled_rooms_of_one_shape(source, name):
    rung = load_benchmark(source)[name]
    rooms = [rung.train[0], rung.test[0], rung.valid[0], *([rung.test_task[0]] if rung.test_task else [])]
    assert len({room.frame for room in rooms}) == 1
    assert not isinstance(rung.config.puzzle, ButtonsConfig) or rung.config.puzzle.graph.relabel
    assert len({compute_keys(room).layout for room in rooms}) == len(rooms)


def test_rungs_that_were_there_before_others_keep_their_rooms():
    """Roots and room configurations of the fourteen rungs of before, to the last bit: seeds come from names, not from
    places."""
    before = ("doormat", "pair", "reach", "chain-3", "chain-4", "chain", "lattice-5", "drift", "lattice-6", "lattice-7",
              "clutter", "lattice-8", "lattice", "house")
    bench = load_benchmark("ladder-1")
    text = json.dumps([bench[name].record.to_dict() for name in before], sort_keys=True)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == "fce5ee8d7f0e2d6a"


@pytest.mark.slow
def test_the_easiest_rungs_verify():
    load_benchmark("ladder-1").verify(["doormat"])


@pytest.mark.slow
def test_rungs_of_every_kind_verify():
    """All rungs, seven minutes of a core: `hrl-escape ladder verify`."""
    load_benchmark("ladder-1").verify(["reach", "doors", "freight", "lattice"])
    load_benchmark("cues-1@3").verify()
    load_benchmark("families-1@5").verify(["ignore-6", "reset-10-control"])
    load_benchmark("ladder-2").verify()


def test_axes_are_series_of_rungs_of_their_benchmark_each_in_one():
    bench = load_benchmark("ladder-2")
    rungs = [name for axis in bench.manifest.axes for name in axis.rungs]
    assert rungs == [rung.name for rung in bench] and all(3 <= len(axis.rungs) <= 4 for axis in bench.manifest.axes)
    assert not load_benchmark("ladder-1").manifest.axes


SCRIPT = """
from hrl_escape.sets.benchmark import load_benchmark
from benchmarks.freezing import freeze_manifest
for name in ("pair", "lattice", "clutter", "reach", "doors", "freight"):
    rung = load_benchmark("ladder-1")[name]
    print(rung.train[0].digest, rung.test[1].digest)
"""


@pytest.mark.nightly
def test_rooms_are_the_same_whatever_the_processor_and_the_hash_seed():
    features = "AVX512_SKX AVX512F AVX512CD AVX2 FMA3"
    machine = {"PYTHONHASHSEED": "7", "OMP_NUM_THREADS": "1", "NPY_DISABLE_CPU_FEATURES": features}
    there = subprocess.run([sys.executable, "-W", "ignore", "-c", SCRIPT], env=os.environ | machine, text=True,
                           capture_output=True, check=True).stdout
    assert there == run_here(SCRIPT) and len(there.split()) == 12


def test_the_manifest_of_another_version_is_still_read():
    manifest = load_benchmark("ladder-1").manifest
    assert Manifest.from_dict(manifest.to_dict()) == manifest


def test_a_seed_is_the_hash_of_all_that_names_its_room():
    """Anybody can compute it: the first 63 bits of SHA-256 over benchmark/rung/role/index."""
    digest = hashlib.sha256(b"ladder-1/pair/test/7").hexdigest()
    seed = derive_seed("ladder-1", "pair", "test", 7)
    assert seed == int(digest[:16], 16) >> 1 and seed != derive_seed("ladder-2", "pair", "test", 7)
