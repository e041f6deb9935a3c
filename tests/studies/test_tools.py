"""Callers of tools: gains by hand, sentences from data of other truths, and a recording that becomes a row."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from hrl_escape.errors import ComparisonError, VerificationError
from studies.store import Store
from studies.study import Study, find_study
from studies.tools.analysis import LINES, Args, GameRun, analyse, compute_gain, measure, tell_gain

STUDY = find_study("tools")


def make_runs(caller: str, told, efficiency) -> list[GameRun]:
    return [GameRun(caller, told, rung, room, False, efficiency(rung, room), 5, 50, 0, 9_000)
            for rung in ("pair", "lattice") for room in range(10)]


def test_a_gain_is_the_mean_of_paired_differences_rungs_alike():
    low = make_runs("search-random", "names", lambda rung, room: 0.01 * room)
    high = make_runs("search-nearest", "places", lambda rung, room: 0.01 * room + (0.1 if rung == "pair" else 0.3))
    *found, by_rung = compute_gain(high, low, 500)
    assert found == pytest.approx([0.2, 0.2, 0.2]) and by_rung == pytest.approx({"pair": 0.1, "lattice": 0.3})
    assert compute_gain(high[:11], low, 500).value == pytest.approx(0.2)  # one room of lattice counts as ten of pair
    with pytest.raises(ComparisonError):
        compute_gain(high[:10], low[10:], 500)


@pytest.mark.parametrize(("shift", "verb"), [(0.2, "raises efficiency over names alone, by +"),
                                             (-0.2, "lowers efficiency below names"),
                                             (0.0, "changes efficiency from names alone: ")])
def test_data_of_another_truth_gets_another_sentence(shift: float, verb: str):
    noise = [0.1, -0.1] * 5
    near = make_runs("search-nearest", "places", lambda rung, room: 0.5 + shift + noise[room])
    gain = compute_gain(near, make_runs("search-random", "names", lambda rung, room: 0.5), 500)
    assert verb in tell_gain("Being told where things are", "names alone", gain)
    page = analyse(STUDY, [*near, *make_runs("search-random", "names", lambda rung, room: 0.5)])
    assert verb in page.values["headline"]


def test_the_rungs_on_which_a_gain_is_least_and_most_are_named():
    low = make_runs("search-random", "names", lambda rung, room: 0.3)
    for most, least in (("pair", "lattice"), ("lattice", "pair")):
        high = make_runs("search-nearest", "places", lambda rung, room, most=most: 0.7 if rung == most else 0.35)
        assert f", from +0.05 in `{least}` to +0.40 in `{most}`." in analyse(STUDY, [*low, *high]).values["headline"]


def test_a_recording_becomes_a_row_once_its_replay_agrees(tmp_path: Path):
    (tmp_path / "recordings").mkdir()
    lines = (STUDY.folder / "recordings/buttons-by-number.jsonl").read_text().splitlines()
    end = next(number for number, line in enumerate(lines, 1) if line.startswith('{"score"'))
    file = tmp_path / "recordings/mine.jsonl"
    file.write_text("\n".join(lines[:end]) + "\n")
    study = Study(tmp_path, dataclasses.replace(STUDY).data | {"callers": [], "rungs": ["pair"], "rooms": 1})
    store = Store(tmp_path / "raw.jsonl", LINES)
    measure(study, Args(), store)
    (run,) = store.load()
    assert run.recorded and run.place == ("mine", "names", "pair", 0) and 0 < run.efficiency <= 1
    file.write_text("\n".join([lines[0], lines[1].replace("Took ", "Took 1"), *lines[2:end]]) + "\n")
    with pytest.raises(VerificationError, match="mine"):
        measure(study, Args(), store)
