"""Two-level factorial experiments: fractional designs, and the analysis of variance of their contrasts.

Every term of an orthogonal two-level design has one degree of freedom, so its sum of squares is n (effect / 2)^2
and the analysis is exact and short: Montgomery, Design and Analysis of Experiments, sections 6.5 and 8.2. Blocks, such
as rooms, are taken out first. It is no general linear model: unbalanced data are refused.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from hrl_escape.errors import ComparisonError

__all__ = ["Analysis", "Term", "analyse", "make_half_fraction"]


@dataclass(frozen=True)
class Term:
    """A main effect or an interaction of two factors.

    Attributes:
        factors: names of its one or two factors.
        effect: mean response at the high level (of the product) less that at the low level.
        low: lower end of the effect's 95 % interval.
        high: its upper end.
        share: of the total sum of squares about the mean.
        f: ratio of its mean square to the residual one.
        p: chance of such a ratio or more without an effect.
    """

    factors: tuple[str, ...]
    effect: float
    low: float
    high: float
    share: float
    f: float
    p: float


@dataclass(frozen=True)
class Analysis:
    """An analysis of variance.

    Attributes:
        terms: main effects in the order of the factors, then interactions of two.
        block_share: share of the total sum of squares that lies between blocks.
        residual_share: share that nothing explains.
        residual_freedom: degrees of freedom of the residual.
        runs: observations.
    """

    terms: tuple[Term, ...]
    block_share: float
    residual_share: float
    residual_freedom: int
    runs: int

    def get_term(self, *factors: str) -> Term:
        """The term of these factors."""
        return next(term for term in self.terms if term.factors == factors)


def make_half_fraction(factors: int) -> NDArray[np.int64]:
    """Levels of the 2^(k-1) design in which the last factor is the product of all others.

    Its sign is such that the combination of all low levels is in. With six factors it has resolution VI: main effects
    and interactions of two are confused with none of each other, only with interactions of four and more.

    Args:
        factors: k; an even number for all high levels to be in too.

    Returns:
        (2^(k-1), k) of -1 and 1.
    """
    base = np.array(list(itertools.product((-1, 1), repeat=factors - 1)), dtype=np.int64)
    return np.concatenate([base, base.prod(axis=1, keepdims=True) * (-1) ** factors], axis=1)


def analyse(names: Sequence[str], levels: ArrayLike, blocks: Sequence[str], response: ArrayLike) -> Analysis:
    """Split the variance of a response into main effects, interactions of two, blocks and the rest.

    Args:
        names: of the k factors.
        levels: (n, k), -1 or 1.
        blocks: (n,) names; all the same where there are none.
        response: (n,).

    Raises:
        ComparisonError: terms are not orthogonal to each other and to the blocks (a run is missing), or no degree of
            freedom is left for the residual.
    """
    x, y = np.asarray(levels, dtype=np.float64), np.asarray(response, dtype=np.float64)
    n, labels = len(y), np.array(blocks)
    kinds = sorted(set(blocks))
    terms = [(i,) for i in range(len(names))] + list(itertools.combinations(range(len(names)), 2))
    columns = np.stack([x[:, list(term)].prod(axis=1) for term in terms], axis=1)
    indicators = np.stack([(labels == kind).astype(np.float64) for kind in kinds], axis=1)
    if not np.allclose(columns.T @ columns, n * np.eye(len(terms))) or np.abs(indicators.T @ columns).max() > 1e-9:
        raise ComparisonError("the factorial is not balanced, so its variance cannot be split: are all runs finished?")
    freedom = n - len(kinds) - len(terms)
    if freedom < 1:
        raise ComparisonError(f"{n} runs are too few to estimate {len(terms)} terms and an error: give more runs")
    means = np.array([y[labels == kind].mean() for kind in kinds])
    total = float(np.sum((y - y.mean()) ** 2)) or 1.0
    between = float(np.sum(indicators.sum(axis=0) * (means - y.mean()) ** 2))
    effects = 2 * columns.T @ y / n
    squares = n * (effects / 2) ** 2
    residual = max(total - between - float(squares.sum()), 0.0)
    mean_square = max(residual / freedom, 1e-300)
    reach = float(stats.t.ppf(0.975, freedom)) * 2 * np.sqrt(mean_square / n)
    found = [
        Term(tuple(names[i] for i in term), float(effect), float(effect - reach), float(effect + reach),
             float(square / total), float(square / mean_square), float(stats.f.sf(square / mean_square, 1, freedom)))
        for term, effect, square in zip(terms, effects, squares, strict=True)
    ]
    return Analysis(tuple(found), between / total, residual / total, freedom, n)
