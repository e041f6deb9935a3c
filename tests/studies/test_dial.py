"""Learned options on the dial: what the section says follows from the lines, and the lines from calls."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hrl_escape.errors import ComparisonError
from hrl_escape.settings import read_record
from studies.learned.dial import DialLine, DialSettings, conclude_dial, describe_dial, measure_dial, place_lines
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


def test_another_truth_is_another_place_and_another_sentence():
    lines = make_lines({("good", 100): 0.1, ("bad", 100): 0.0, ("good", 900): 0.3, ("bad", 900): 0.05})
    placed = place_lines(lines)
    assert [(option.option, option.primitives) for option in placed] == [
        ("good", 100), ("bad", 100), ("good", 900), ("bad", 900)]
    assert [option.place.failure for option in placed] == pytest.approx([0.8, 1.0, 0.4, 0.9])
    said = conclude_dial(lines)
    assert said.startswith("After 900 primitives the best learned option, of `good`, is worth a planned one that "
                           "fails 40% (")
    assert "after 100 it was worth one that fails 80% (" in said
    turned = conclude_dial(make_lines({("good", 900): 0.05, ("bad", 900): 0.5}))
    assert "of `bad`, is worth a planned one that fails 0% (" in turned


def test_an_option_is_called_useless_only_where_its_interval_says_so():
    lines = make_lines({("good", 900): 0.5, ("bad", 900): 0.0}, runs=40)
    assert conclude_dial(lines).endswith("Worth less than one that fails every other time: `bad`.")
    unsure = make_lines({("good", 900): 0.5, ("bad", 900): 0.24})
    assert "every other time" not in conclude_dial(unsure)


def test_the_best_of_many_has_a_wider_interval_than_one_alone():
    alone = make_lines({("a", 900): 0.3})
    many = make_lines({(name, 900): 0.3 for name in "abcdefghi"})
    (low, high), (lowest, highest) = (map(int, re.findall(r"\((\d+)% to (\d+)%\)", conclude_dial(lines))[0])
                                      for lines in (alone, many))
    assert lowest <= low < 40 < high < highest, "Bonferroni"
    assert place_lines(many)[0].place == place_lines(alone)[0].place, "the table's are for each alone"


def test_nothing_is_concluded_from_nine_runs_and_nothing_placed_without_options():
    assert "Nothing is concluded" in conclude_dial(make_lines({("good", 900): 0.3}, runs=9))
    with pytest.raises(ComparisonError, match="no learned option"):
        describe_dial(CURVE)


def test_the_section_shows_every_place():
    found = describe_dial(make_lines({("good", 100): 0.1, ("bad", 900): 0.05}))
    assert found["header"] == ["option of", "100", "900"] and found["whole"] == WHOLE
    bad, good = sorted(found["rows"])
    assert good[0] == "`good`" and good[1].startswith("80% (") and bad[1] == "-" and bad[2].startswith("90% (")


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
