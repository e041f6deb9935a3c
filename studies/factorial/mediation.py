"""Mediation: how much of a factor's effect on a response goes through a quantity that the logs hold.

Product of coefficients (Baron and Kenny 1986; MacKinnon, Lockwood and Williams 2004): a is the factor's effect on the
quantity, b the slope of the response on the quantity within a block, all factors held fixed; a b goes through it and
the rest of the effect does not. Quantity and response are observed side by side, so that b may also hold what moves
both: a path that is not there can be ruled out so, and none can be proved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hrl_escape.benchmark.inference import LEVEL
from hrl_escape.benchmark.statistics import Floats
from studies.factorial.effects import Screening, compute_contrasts, mark_gaps
from studies.raw import RawRun

__all__ = ["MEDIATORS", "Path", "compute_paths"]

BOOTSTRAP_DRAWS = 10_000

MEDIATORS: dict[str, Callable[[RawRun], float]] = {
    "entropy of the policy": lambda run: _average(run.entropy),
    "longest repeat": lambda run: _average([None if value is None else np.log2(max(value, 1.0))
                                            for value in run.longest_repeat]),
    "greedy choices": lambda run: _average(run.greedy),
}
"""Quantity -> its mean over the training episodes of a run: entropy in nats, the base-2 logarithm of the most decisions
in a row for one action, the share of choices of highest value."""


def _average(values: Sequence[float | None]) -> float:
    known = mark_gaps(values)
    return float(np.nanmean(known)) if np.isfinite(known).any() else 0.0


@dataclass(frozen=True)
class Path:
    """Part of a factor's effect that goes through a quantity.

    Attributes:
        factor: name.
        mediator: name of the quantity.
        moves: the factor's effect on the quantity.
        slope: of the response on the quantity.
        carries: product of both, in units of the response.
        low: lower end of its interval, corrected over all paths (Bonferroni).
        high: upper end.
    """

    factor: str
    mediator: str
    moves: float
    slope: float
    carries: float
    low: float
    high: float

    @property
    def is_shown(self) -> bool:
        """The interval leaves 0 out."""
        return self.low > 0 or self.high < 0


def compute_paths(screening: Screening, factors: Sequence[str], respond: Callable[[RawRun], float],
                  rng: np.random.Generator, resamples: int = BOOTSTRAP_DRAWS) -> list[Path]:
    """Paths of some factors through every quantity of `MEDIATORS`.

    Intervals are percentiles of a bootstrap that draws rooms, and within a drawn room its seeds.

    Args:
        screening: the runs.
        factors: names, of those whose effect on the response is to be explained.
        respond: the response of a run.
        rng: source of the draws.
        resamples: number of draws.
    """
    chosen = [screening.factors.index(factor) for factor in factors]
    response = _take_factors_out(screening, screening.measure(respond))
    weights = _draw_blocks(len(screening.rooms), len(screening.seeds), resamples, rng)
    tail = (1 - LEVEL) / 2 / max(1, len(chosen) * len(MEDIATORS))
    paths = []
    for name, measure in MEDIATORS.items():
        values = screening.measure(measure)
        moves = compute_contrasts(values, screening.design)[..., chosen]  # (rooms, seeds, factors)
        rest = _take_factors_out(screening, values)
        products, squares = (rest * response).sum(axis=-1), (rest**2).sum(axis=-1)  # (rooms, seeds)
        everything = np.full((1, *products.shape), 1 / products.size)
        means, slopes = _combine(everything, moves, products, squares)
        drawn_means, drawn_slopes = _combine(weights, moves, products, squares)
        low, high = np.quantile(drawn_means * drawn_slopes[:, None], [tail, 1 - tail], axis=0)
        paths += [Path(factor, name, float(means[0, n]), float(slopes[0]), float(means[0, n] * slopes[0]),
                       float(low[n]), float(high[n])) for n, factor in enumerate(factors)]
    return paths


def _take_factors_out(screening: Screening, values: Floats) -> Floats:
    """Rest of numbers (rooms, seeds, rows) beside main effects and the block's mean."""
    design = screening.design
    explained = compute_contrasts(values, design) @ design.T / 2
    return values - explained - values.mean(axis=-1, keepdims=True)


def _draw_blocks(rooms: int, seeds: int, resamples: int, rng: np.random.Generator) -> Floats:
    """Share of each block in a draw of rooms and of seeds within them, (resamples, rooms, seeds)."""
    drawn = rng.multinomial(rooms, np.full(rooms, 1 / rooms), size=resamples)
    return rng.multinomial(drawn * seeds, np.full(seeds, 1 / seeds)) / (rooms * seeds)


def _combine(weights: Floats, moves: Floats, products: Floats, squares: Floats) -> tuple[Floats, Floats]:
    """Effects on a quantity (draws, factors), and slopes of the response on it (draws,)."""
    totals = np.tensordot(weights, squares, 2)
    slopes = np.tensordot(weights, products, 2) / np.where(totals > 1e-12, totals, np.inf)
    return np.tensordot(weights, moves, 2), slopes
