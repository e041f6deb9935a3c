"""Parts of what options provide: comparisons of known data, and learners that explore and plan by options."""

from __future__ import annotations

import dataclasses

import numpy as np

from studies.price.runs import PriceRun
from studies.study import find_study
from studies.why.analysis import (
    AHEAD,
    EXPLORES,
    RANDOM_AHEAD,
    REPEATS,
    Pair,
    compare,
    count_alike,
    list_families,
)

STUDY = find_study("why")
FLAT, WHOLE = STUDY.data["flat"], STUDY.data["whole"]
OTHERS = [learner["label"] for learner in STUDY.data["learners"]]


def make_lines(escapes: dict[str, float], halves: dict[str, float], sizes=(1, 2)) -> list[PriceRun]:
    """Ten runs of each learner and size around these costs; a learner that is not named has those of the flat one."""
    rng, lines = np.random.default_rng(3), []
    for label in (FLAT, WHOLE, *OTHERS):
        for size in sizes:
            for replicate in range(10):
                escape, half = (int(costs.get(label, costs[FLAT]) * np.exp(0.2 * rng.normal())) + 30
                                for costs in (escapes, halves))
                curve = ((half, 0.6), (half + 5_000, 0.6))
                lines.append(PriceRun(label, size, replicate, 30, 1_000_000, half + 5_000, escape, None, 0.6, 10, 5,
                                      1.0, "key", curve))
    return lines




def find_gains(one: str, other: str, cost: str, escapes: dict[str, float], halves: dict[str, float]) -> set[int]:
    """Numbers of buttons with which one learner is shown to pay more than another."""
    found = compare(STUDY, make_lines(escapes, halves))
    return {ratio.buttons for ratio in found[Pair(one, other), cost] if ratio.middle.low > 1}


def test_each_part_is_compared_with_the_flat_learner_and_its_control():
    escapes = {FLAT: 9_000, EXPLORES: 100, WHOLE: 100, AHEAD: 1_000}
    halves = {FLAT: 50_000, EXPLORES: 20_000, WHOLE: 1_000}
    for one, other, cost, sizes in ((FLAT, EXPLORES, "escape", {1, 2}), (FLAT, EXPLORES, "half", {1, 2}),
                                    (EXPLORES, WHOLE, "escape", set()), (EXPLORES, WHOLE, "half", {1, 2}),
                                    (REPEATS, EXPLORES, "escape", {1, 2}), (FLAT, AHEAD, "escape", {1, 2}),
                                    (FLAT, AHEAD, "half", set()), (RANDOM_AHEAD[0], AHEAD, "escape", {1, 2})):
        assert find_gains(one, other, cost, escapes, halves) == sizes, (one, other, cost)


def test_learners_with_the_same_costs_are_counted():
    lines = make_lines({FLAT: 9_000, EXPLORES: 100, WHOLE: 100}, {FLAT: 50_000})
    first = {(line.buttons, line.replicate): line.first_escape for line in lines if line.agent == EXPLORES}
    same = [dataclasses.replace(line, first_escape=first[line.buttons, line.replicate])
            if line.agent == WHOLE and line.replicate < 6 else line for line in lines]
    assert count_alike(compare(STUDY, same), Pair(EXPLORES, WHOLE), "escape") == (12, 20)


def test_questions_are_corrected_as_families():
    lines = make_lines({FLAT: 9_000}, {FLAT: 20_000, AHEAD: 15_000, EXPLORES: 15_000})
    found = compare(STUDY, lines)
    for pair in (pair for family in list_families(STUDY) for pair in family):
        for ratio in found[pair, "half"]:
            assert (ratio.middle.low > 1 or ratio.middle.high < 1) == (ratio.middle.p < 0.05)
