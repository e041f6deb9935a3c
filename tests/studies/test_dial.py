"""Learned options on the dial: places follow from the lines, and the lines from calls."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_escape.errors import ComparisonError
from hrl_escape.settings import read_record
from studies.learned.dial import (
    DialLine,
    DialSettings,
    find_best_option,
    measure_dial,
    place_lines,
    tabulate_dial,
)
from studies.store import Store
from studies.study import find_study

STUDY = find_study("learned")
ROOM = STUDY.data["dial"]["room"]
WHOLE = 0.5
CURVE = [DialLine(ROOM, "planned", 0, failure, draw, (1 - failure) * WHOLE) for failure in (0.0, 0.5, 1.0)
         for draw in range(4)]


def make_lines(worth: dict[tuple[str, int], float], runs: int = 10) -> list[DialLine]:
    """Lines of agents after so many primitives, equally good in all runs."""
    return CURVE + [DialLine(ROOM, name, primitives, None, seed, value)
                    for (name, primitives), value in worth.items() for seed in range(runs)]


def test_another_truth_is_another_place():
    lines = make_lines({("good", 100): 0.1, ("bad", 100): 0.0, ("good", 900): 0.3, ("bad", 900): 0.05})
    placed = place_lines(lines)
    assert [(option.option, option.primitives) for option in placed] == [
        ("good", 100), ("bad", 100), ("good", 900), ("bad", 900)]
    assert [option.place.failure for option in placed] == pytest.approx([0.8, 1.0, 0.4, 0.9])
    best, _ = find_best_option(lines)
    assert best is not None and (best.option, best.primitives) == ("good", 900)
    turned, _ = find_best_option(make_lines({("good", 900): 0.05, ("bad", 900): 0.5}))
    assert turned is not None and (turned.option, turned.place.failure) == ("bad", 0.0)


def test_an_option_is_worse_than_one_in_two_only_where_its_interval_shows_it():
    assert find_best_option(make_lines({("good", 900): 0.5, ("bad", 900): 0.0}, runs=40))[1] == ["bad"]
    assert find_best_option(make_lines({("good", 900): 0.5, ("bad", 900): 0.24}))[1] == []


def test_the_best_of_many_has_a_wider_interval_than_one_alone():
    alone, many = make_lines({("a", 900): 0.3}), make_lines({(name, 900): 0.3 for name in "abcdefghi"})
    (one, _), (best, _) = find_best_option(alone), find_best_option(many)
    assert one is not None and best is not None
    assert best.place.low <= one.place.low < 0.4 < one.place.high < best.place.high, "Bonferroni"
    assert place_lines(many)[0].place == place_lines(alone)[0].place, "intervals of the table are for each alone"


def test_nine_runs_give_no_best_option_and_no_options_no_place():
    assert find_best_option(make_lines({("good", 900): 0.3}, runs=9)) == (None, [])
    with pytest.raises(ComparisonError, match="no learned option"):
        find_best_option(CURVE)


def test_the_table_has_every_place():
    table = tabulate_dial(make_lines({("smdp-hrc", 100): 0.1, ("smdp-dac", 900): 0.05}))
    assert "| option of | 100 primitives | 900 primitives |" in table
    assert "| HRC over options | 80% (" in table and "| DAC over options | - | 90% (" in table


def test_lines_are_measured_once(tmp_path: Path, monkeypatch):
    """Who has found the way is worth as much as the planner that knew it."""
    store, (grid,) = Store(tmp_path / "dial.jsonl", (DialLine,)), STUDY.grids
    settings = read_record(DialSettings, {
        **STUDY.data["dial"], "room": "layered-2-ignore#1", "algorithms": ["hrc", "q-learning"], "shares": [0.02, 1.0],
        "failures": [0.0, 1.0], "draws": 1, "calls": 2})
    measure_dial(settings, grid, store, range(1), 400)
    lines = {(line.option, line.primitives, line.failure): line.worth for line in store.load()}
    planned, hrc = lines["planned", 0, 0.0], "smdp-hrc"
    assert len(lines) == 6 and lines["planned", 0, 1.0] == 0 < planned < 1
    assert lines[hrc, 400, None] == pytest.approx(planned, abs=0.02)
    assert max(lines.values()) <= planned, "nothing is better, and no call is longer than its primitives"
    whole = store.path.read_bytes()
    monkeypatch.setattr("studies.learned.dial.train", None)
    measure_dial(settings, grid, store, range(1), 400)
    assert store.path.read_bytes() == whole
