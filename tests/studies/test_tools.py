"""Callers of tools: gains by hand, and a recording that becomes a row."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from hrl_escape.errors import ComparisonError, VerificationError
from studies.store import Store
from studies.study import Study, find_study
from studies.tools.analysis import LINES, Args, GameRun, analyse, compute_gain, measure

STUDY = find_study("tools")


def make_runs(caller: str, told, efficiency) -> list[GameRun]:
    return [GameRun(caller, told, rung, room, False, efficiency(rung, room), 5, 50, 0, 9_000)
            for rung in ("pair", "lattice") for room in range(10)]


def test_a_gain_is_the_mean_of_paired_differences_rungs_alike():
    low = make_runs("search-random", "names", lambda rung, room: 0.01 * room)
    high = make_runs("search-nearest", "places", lambda rung, room: 0.01 * room + (0.1 if rung == "pair" else 0.3))
    assert compute_gain(high, low, 500) == pytest.approx([0.2, 0.2, 0.2])
    assert compute_gain(high[:11], low, 500).mean == pytest.approx(0.2)  # one room of lattice counts as ten of pair
    with pytest.raises(ComparisonError):
        compute_gain(high[:10], low[10:], 500)


def test_what_each_level_adds_is_read_off_the_games():
    callers = {"random": 0.1, "search-random": 0.3, "search-nearest": 0.35, "oracle": 0.9}
    runs = [run for caller, value in callers.items()
            for run in make_runs(caller, "names", lambda rung, room, value=value: value)]
    gains = analyse(STUDY, runs).numbers.gains
    assert {what: gain.mean for what, gain in gains.items()} == pytest.approx(
        {"memory": 0.2, "places": 0.05, "model": 0.55})


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
