"""Calibration of a ladder: random options fall from rung to rung, and the numbers of buttons hold no order.

Runs in one room are much alike, so tests are over rooms. Only cells of `LEAST_RUNS` runs or more count.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.benchmark.inference import compare_pairs, correct_by_holm
from hrl_escape.benchmark.statistics import LEAST_RUNS
from studies.baseline import BaselineRun

__all__ = ["CHANCE", "IN_ORDER", "KNOWN", "ROUND", "Cells", "Step", "average_rooms", "compare_orders", "compare_steps"]

CHANCE, ROUND = "random-options", "sweep-random"
PERMUTATIONS = 2_000
IN_ORDER, KNOWN = "sweep", "oracle"

Cells = Mapping[tuple[str, str], Sequence[BaselineRun]]
"""Runs by rung and agent."""


class Step(NamedTuple):
    """Difference in what random options reach between two neighbouring rungs."""

    before: str
    after: str
    change: float  # mean efficiency, after less before
    p: float  # two-sided, corrected over all steps (Holm)


def average_rooms(runs: Sequence[BaselineRun]) -> dict[str, float]:
    """Mean efficiency in each room."""
    rooms: dict[str, list[float]] = {}
    for run in runs:
        rooms.setdefault(run.rooms, []).append(run.efficiency)
    return {room: float(np.mean(values)) for room, values in rooms.items()}


def compare_steps(cells: Cells, rungs: Sequence[str]) -> list[Step]:
    """Compare what random options reach in the rooms of each rung and of the next, by permutations of the rooms."""
    chance = [(rung, list(average_rooms(cells[rung, CHANCE]).values())) for rung in rungs
              if len(cells.get((rung, CHANCE), ())) >= LEAST_RUNS]
    steps = list(itertools.pairwise(chance))
    p = correct_by_holm([_compare_rooms(before, after) for (_, before), (_, after) in steps])
    return [Step(before, after, float(np.mean(high) - np.mean(low)), each)
            for ((before, low), (after, high)), each in zip(steps, p, strict=True)]


def _compare_rooms(one: Sequence[float], other: Sequence[float]) -> float:
    """Two-sided p-value of the difference of two means, by permutations of the rooms; the same every time."""
    if min(len(one), len(other)) < 2:
        return 1.0
    test = stats.permutation_test(
        (one, other), lambda x, y, axis: np.mean(x, axis=axis) - np.mean(y, axis=axis), vectorized=True,
        n_resamples=PERMUTATIONS, rng=np.random.default_rng(2019))
    return float(test.pvalue)


def compare_orders(cells: Cells, rungs: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Gain of sweeps in the order of the buttons' numbers over sweeps in a random order, and its corrected p-value."""
    tests = {}
    for rung in rungs:
        if all(len(cells.get((rung, agent), ())) >= LEAST_RUNS for agent in (IN_ORDER, ROUND)):
            ours, theirs = (average_rooms(cells[rung, agent]) for agent in (IN_ORDER, ROUND))
            differences = [ours[place] - theirs[place] for place in ours.keys() & theirs.keys()]
            tests[rung] = compare_pairs([np.array(sorted(differences))])
    adjusted = correct_by_holm([test.p for test in tests.values()])
    return {rung: (test.difference, p) for (rung, test), p in zip(tests.items(), adjusted, strict=True)}
