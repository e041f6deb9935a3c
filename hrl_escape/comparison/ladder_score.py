"""Ladder score: one number an agent, the mean over rungs of the interquartile mean of efficiency; and learned share.

Rungs are strata of equal weight, as tasks are in Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the
Statistical Precipice". Within a rung whole rooms are drawn, since runs in one room are much alike: ten seeds in one
room say nothing of the next room. Draws are those of `inference.py`: flat Dirichlet weights with the lowest or highest
possible efficiency added, where a bootstrap of ten equal rooms would have no width.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hrl_escape.comparison.inference import LEVEL, RESAMPLES, Estimate, draw_weights
from hrl_escape.comparison.statistics import Floats, Scores, compute_iqm

LEAST_HEADROOM = 0.05
"""Efficiency between searcher and ceiling below which nothing is said of the share of it that was learned."""


def compute_learned_share(efficiency: float, searcher: float, ceiling: float) -> float | None:
    """Place on the scale from who learns nothing (0) to the most that could be learned from other rooms (1).

    Args:
        efficiency: of an agent.
        searcher: of the best searcher that learns nothing and does not know the schematic.
        ceiling: of who knows how rooms are drawn and what marks mean, and discovers the graph: `smdp-bayes`.

    Returns:
        Below 0 for who is worse than the searcher; None where less than `LEAST_HEADROOM` lies between the two.
    """
    return (efficiency - searcher) / (ceiling - searcher) if ceiling - searcher >= LEAST_HEADROOM else None


def compute_ladder_score(rungs: Sequence[Scores], rng: np.random.Generator, resamples: int = RESAMPLES) -> Estimate:
    """Mean over rungs of the interquartile mean over a rung's runs, with its 95 % interval.

    Args:
        rungs: for each rung one array (runs,) of efficiencies from 0 to 1 for each unit that is drawn as a whole: a
            room that was learned in, or a run that was tested in unseen rooms.
        rng: source of the draws.
        resamples: number of draws.
    """
    value = float(np.mean([compute_iqm(units) for units in rungs]))
    lower, upper = (np.mean(ends, axis=0)
                    for ends in zip(*(_draw_ends(units, rng, resamples) for units in rungs), strict=True))
    return Estimate(value, float(np.quantile(lower, (1 - LEVEL) / 2)), float(np.quantile(upper, (1 + LEVEL) / 2)))


def _draw_ends(units: Scores, rng: np.random.Generator, resamples: int) -> tuple[Floats, Floats]:
    """Draws (resamples,) of a rung's interquartile mean with the lowest efficiency added, and with the highest."""
    drawn = draw_weights(len(units), resamples, rng)
    shares = [np.repeat(drawn[:, [number]] / len(unit), len(unit), axis=-1) for number, unit in enumerate(units)]
    weights = np.concatenate([*shares, drawn[:, -1:]], axis=-1)
    lower, upper = (compute_iqm([np.concatenate([*units, [bound]])], [weights]) for bound in (0.0, 1.0))
    return lower, upper
