"""Main effects of a screening design, room by room and over rooms, which are a random factor.

A block is one room with one training seed: it holds every row of the design, so that its effects are plain contrasts.
Effects are averaged over the seeds of a room, and tested by Student's t over rooms, whose spread includes seeds and
differences of rooms: effects are claimed for rooms like these. With balanced blocks this is the test of a mixed
model with random effects of rooms (Montgomery, Design and Analysis of Experiments, section 13.3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.inference import PairedTest, compare_pairs, correct_by_holm
from hrl_escape.benchmark.statistics import Floats, compute_area
from hrl_escape.errors import ComparisonError
from studies.factorial.design import get_factors, make_label, make_screening_design
from studies.raw import RawRun
from studies.statistics import choose_holm_levels, compute_slope

__all__ = ["SIGNIFICANT", "MainEffect", "Screening", "compute_contrasts", "compute_effects", "mark_gaps",
           "measure_area", "measure_change", "repeat_effects"]

SIGNIFICANT = 0.05


@dataclass(frozen=True)
class MainEffect:
    """Main effect of a factor: mean at the corrected level less mean at the published one.

    Attributes:
        factor: name.
        test: over rooms; `pairs` counts rooms. Its interval leaves 0 out where the effect is shown.
        p: of the test, corrected over the factors (Holm).
        rooms: effect in each room.
    """

    factor: str
    test: PairedTest
    p: float
    rooms: tuple[float, ...]

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
    return [MainEffect(factor, compare_pairs([column], level), p, tuple(column.tolist()))
            for factor, level, p, column in zip(screening.factors, choose_holm_levels(raw, SIGNIFICANT),
                                                correct_by_holm(raw), by_room.T, strict=True)]


def repeat_effects(fresh: Screening, factors: Sequence[str]) -> list[MainEffect]:
    """Effects on the slope in fresh rooms, of these factors alone and corrected for these alone (Holm)."""
    effects = {effect.factor: effect for effect in compute_effects(fresh, measure_change)}
    chosen = [effects[factor] for factor in factors]
    raw = [effect.test.p for effect in chosen]
    return [replace(effect, p=p, test=compare_pairs([np.array(effect.rooms)], level)) for effect, p, level in
            zip(chosen, correct_by_holm(raw), choose_holm_levels(raw, SIGNIFICANT), strict=True)]
