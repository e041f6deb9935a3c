"""Learned options on the dial: places follow from the lines."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError
from studies.learned.dial import DialLine, find_best_option, place_lines, place_on_dial, tabulate_dial
from studies.study import find_study

STUDY = find_study("learned")
ROOM = STUDY.data["dial"]["room"]
WHOLE = 0.5
CURVE = [DialLine(ROOM, "planned", 0, failure, draw, (1 - failure) * WHOLE) for failure in (0.0, 0.5, 1.0)
         for draw in range(4)]
WORTH = {failure: [(1 - failure) * WHOLE] * 10 for failure in (0.0, 0.25, 0.5, 1.0)}


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
    best = find_best_option(lines)
    assert best is not None and (best.option, best.primitives) == ("good", 900)
    turned = find_best_option(make_lines({("good", 900): 0.05, ("bad", 900): 0.5}))
    assert turned is not None and (turned.option, turned.place.failure) == ("bad", 0.0)


def test_the_best_of_many_has_a_wider_interval_than_one_alone():
    alone, many = make_lines({("a", 900): 0.3}), make_lines({(name, 900): 0.3 for name in "abcdefghi"})
    one, best = find_best_option(alone), find_best_option(many)
    assert one is not None and best is not None
    assert best.place.low <= one.place.low < 0.4 < one.place.high < best.place.high, "Bonferroni"
    assert place_lines(many)[0].place == place_lines(alone)[0].place, "intervals of the table are for each alone"


def test_nine_runs_give_no_best_option_and_no_options_no_place():
    assert find_best_option(make_lines({("good", 900): 0.3}, runs=9)) is None
    with pytest.raises(ComparisonError, match="no learned option"):
        find_best_option(CURVE)


def test_the_table_has_every_place():
    table = tabulate_dial(make_lines({("smdp-hrc", 100): 0.1, ("smdp-dac", 900): 0.05}))
    assert "| option of | 100 primitives | 900 primitives |" in table
    assert "| HRC over options | 80% (" in table and "| DAC over options | - | 90% (" in table


def test_the_place_follows_from_the_curve():
    assert place_on_dial(WORTH, [0.6 * WHOLE] * 50).failure == pytest.approx(0.4)
    assert place_on_dial(WORTH, [0.05 * WHOLE] * 50).failure == pytest.approx(0.95)
    detour = place_on_dial(WORTH, [WHOLE * 0.99**20] * 50)
    assert detour.failure == pytest.approx(1 - 0.99**20), "twenty primitives more are as bad"
    assert place_on_dial(WORTH, [1.0] * 10)[:2] == (0.0, 0.0)
    assert place_on_dial(WORTH, [0.0] * 10).failure == 1.0
    wide, narrow = (place_on_dial(WORTH, np.resize([0.0, WHOLE], runs)) for runs in (4, 400))
    assert wide.low < narrow.low < 0.5 < narrow.high < wide.high


def test_a_curve_that_is_bent_by_chance_is_made_monotone():
    bent = {0.0: [0.9], 0.2: [0.7], 0.4: [0.8], 0.6: [0.3]}
    assert place_on_dial(bent, [0.525] * 20).failure == pytest.approx(0.5)


@pytest.mark.parametrize(("curve", "runs", "match"), [
    ({0.0: [1.0]}, [1.0], "needs two points and one run, not 1 and 1"), (WORTH, [], "not 4 and 0")])
def test_errors_say_what_is_missing(curve: dict[float, list[float]], runs: list[float], match: str):
    with pytest.raises(ComparisonError, match=match):
        place_on_dial(curve, runs)
