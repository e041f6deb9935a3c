"""Main effects of a screening design, room by room and over rooms, which are a random factor.

A block is one room with one training seed: it holds every row of the design, so that its effects are plain contrasts.
Effects are averaged over the seeds of a room, and tested by Student's t over rooms, whose spread holds that of seeds
and of how rooms differ: what is shown is claimed of rooms like these. With balanced blocks this is the test of a mixed
model with random effects of rooms (Montgomery, Design and Analysis of Experiments, section 13.3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.inference import PairedTest, compare_pairs, correct_by_holm
from hrl_escape.benchmark.statistics import Floats, compute_area
from hrl_escape.errors import ComparisonError
from studies.factorial.design import get_factors, make_label, make_screening_design
from studies.raw import RawRun
from studies.statistics import choose_holm_levels, compute_slope, find_visible_difference

__all__ = ["SIGNIFICANT", "MainEffect", "Screening", "compute_contrasts", "compute_effects", "mark_gaps",
           "find_sufficient", "measure_area", "measure_change"]

SIGNIFICANT = 0.05
SHARE = 0.75
"""Share of what all shown corrections bring together, from which on one of them is said to suffice alone."""
MOST_TOGETHER = 3
"""Factors that take all their combinations in every such design."""


@dataclass(frozen=True)
class MainEffect:
    """Main effect of a factor: mean at the corrected level less mean at the published one.

    Attributes:
        factor: name.
        test: over rooms; `pairs` counts rooms. Its interval leaves 0 out where the effect is shown.
        p: of the test, corrected over the factors (Holm).
        rooms: effect in each room.
        visible: smallest effect that the test would have seen in 80 % of such studies.
    """

    factor: str
    test: PairedTest
    p: float
    rooms: tuple[float, ...]
    visible: float = 0.0

    @property
    def is_shown(self) -> bool:
        """The effect is not chance."""
        return self.p < SIGNIFICANT


@dataclass(frozen=True)
class Screening:
    """Runs of a screening design, in balanced blocks.

    Attributes:
        algorithm: name.
        rooms: names.
        seeds: of training.
        runs: a run for each row of the design, by (room, seed).
    """

    algorithm: str
    rooms: tuple[str, ...]
    seeds: tuple[int, ...]
    runs: dict[tuple[str, int], tuple[RawRun, ...]]

    @classmethod
    def make(cls, algorithm: str, runs: Sequence[RawRun]) -> Screening:
        """Put runs into blocks.

        Raises:
            ComparisonError: a run is missing.
        """
        rooms, seeds = (tuple(dict.fromkeys(getattr(run, key) for run in runs)) for key in ("room", "seed"))
        found = {(run.agent, run.room, run.seed): run for run in runs}
        labels = [make_label(algorithm, row) for row in make_screening_design(len(get_factors(algorithm))).tolist()]
        try:
            blocks = {(room, seed): tuple(found[label, room, seed] for label in labels)
                      for room in rooms for seed in seeds}
        except KeyError as missing:
            raise ComparisonError(f"the screening of {algorithm} is not balanced: no run of {missing.args[0]}. Are all "
                                  "runs finished?") from None
        return cls(algorithm, rooms, seeds, blocks)

    @property
    def factors(self) -> list[str]:
        """Names of the factors."""
        return get_factors(self.algorithm)

    @property
    def design(self) -> NDArray[np.int64]:
        """Levels, (rows, factors)."""
        return make_screening_design(len(self.factors))

    def measure(self, compute: Callable[[RawRun], float]) -> Floats:
        """A number of each run, (rooms, seeds, rows)."""
        return np.array([[[compute(run) for run in self.runs[room, seed]] for seed in self.seeds]
                         for room in self.rooms], dtype=np.float64)


def mark_gaps(values: Sequence[float | None]) -> Floats:
    """Numbers, NaN where there is none."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def measure_area(run: RawRun) -> float:
    """Area under the efficiency curve of training episodes: their mean efficiency along the budget."""
    values = mark_gaps(run.training_efficiencies)
    known = np.isfinite(values)
    return compute_area(run.training_at[known], values[known], run.budget) if known.any() else 0.0


def measure_change(run: RawRun) -> float:
    """Slope of the efficiency of training episodes, as its change over a whole run."""
    return run.budget * compute_slope(run.training_at, mark_gaps(run.training_efficiencies), 0, run.budget)


def compute_contrasts(values: Floats, design: NDArray[np.int64]) -> Floats:
    """Effects of each block, (rooms, seeds, factors), of numbers (rooms, seeds, rows)."""
    return 2 * values @ design / len(design)


def compute_effects(screening: Screening, compute: Callable[[RawRun], float]) -> list[MainEffect]:
    """Main effects on a number of each run, in the order of the factors, corrected as one family."""
    by_room = compute_contrasts(screening.measure(compute), screening.design).mean(axis=1)
    raw = [compare_pairs([column]).p for column in by_room.T]
    return [MainEffect(factor, compare_pairs([column], level), p, tuple(column.tolist()),
                       find_visible_difference([column], SIGNIFICANT / len(raw)) if len(column) > 1 else np.inf)
            for factor, level, p, column in zip(screening.factors, choose_holm_levels(raw, SIGNIFICANT),
                                                correct_by_holm(raw), by_room.T, strict=True)]


def find_sufficient(screening: Screening, effects: Sequence[MainEffect], compute: Callable[[RawRun], float]
                    ) -> dict[str, bool | None]:
    """Judge each correction that is shown to raise a number, the three largest at most: does it suffice alone?

    One suffices where it brings `SHARE` of what all of them bring together, the others of them being as published, and
    not where it brings less; None where neither is shown. The design holds every combination of three factors; effects
    of the other factors are taken out first.

    Returns:
        Verdict by factor, largest effect first; empty where fewer than two are shown.
    """
    shown = sorted((effect for effect in effects if effect.is_shown and effect.test.difference > 0),
                   key=lambda effect: -effect.test.difference)[:MOST_TOGETHER]
    if len(shown) < 2:
        return {}
    columns = [screening.factors.index(effect.factor) for effect in shown]
    others = [number for number in range(len(effects)) if number not in columns]
    design, values = screening.design, screening.measure(compute)
    values = values - compute_contrasts(values, design)[..., others] @ design[:, others].T / 2
    rows = {tuple(row): np.all(design[:, columns] == row, axis=1)
            for row in np.unique(design[:, columns], axis=0).tolist()}

    def get_mean(raised: Sequence[int]) -> Floats:
        """Mean in each room with these of the shown factors corrected."""
        chosen = rows[tuple(1 if number in raised else -1 for number in range(len(columns)))]
        return values[..., chosen].mean(axis=(1, 2))

    nothing, together = get_mean([]), get_mean(range(len(columns)))
    tests = [compare_pairs([get_mean([number]) - nothing - SHARE * (together - nothing)])
             for number in range(len(columns))]
    corrected = correct_by_holm([test.p for test in tests])
    return {effect.factor: bool(test.difference > 0) if p < SIGNIFICANT else None
            for effect, test, p in zip(shown, tests, corrected, strict=True)}
