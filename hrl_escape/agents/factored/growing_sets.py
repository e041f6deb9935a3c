"""Sets of parents that grow one parent at a time: the short cut of `vigorito-barto`.

What decision trees do leaf by leaf (`trees.py`), this does set by set: a set takes in one more parent where the history
justifies the parameters it adds, by the Bayesian information criterion (Schwarz 1978). So contexts are tried one
variable further, where SLF-R-MAX and Met-R-MAX try every set.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.factored.structure import StructureLearner

STRONG = 3.0
"""Logarithm of a likelihood ratio that is strong evidence (Kass and Raftery 1995)."""


class GrowingSets(StructureLearner):
    """Believes, for each outcome of an action, the set that grew from the empty one.

    In every step the present set h takes in or drops the parent whose change raises the most

        BIC(h) = sum over contexts, own values and results of n log(n / n of the context) - parameters / 2 x log n

    until none raises it; of equals the smallest set is taken.
    """

    @cached_property
    def _alive(self) -> dict[int, dict[int, NDArray[np.int64]]]:
        """Results of `get_alive` by action and outcome, until the action's next sample."""
        return {}

    def add(self, before: NDArray[np.int64], action: int, after: NDArray[np.int64], over: bool, bonus: int) -> None:
        """Take in one transition; what is believed of its action is then found anew."""
        super().add(before, action, after, over, bonus)
        self._alive.pop(action, None)

    @cached_property
    def _neighbours(self) -> tuple[list[NDArray[np.int64]], list[NDArray[np.int64]]]:
        """Of each hypothesis, those that have one parent more, and those that have one less."""
        numbers = {parents: number for number, parents in enumerate(self.hypotheses)}
        larger: list[list[int]] = [[] for _ in numbers]
        smaller: list[list[int]] = [[] for _ in numbers]
        for parents, number in numbers.items():
            for parent in parents:
                less = numbers[tuple(p for p in parents if p != parent)]
                larger[less].append(number)
                smaller[number].append(less)
        return [np.array(each, np.int64) for each in larger], [np.array(each, np.int64) for each in smaller]

    def compute_likelihoods(self, action: int, outcome: int, hypotheses: NDArray[np.int64]) -> NDArray[np.float64]:
        """Maximum log likelihood of hypotheses about an outcome of an action that was seen, nats, (hypotheses,)."""
        counts = self.get_samples(action, hypotheses, outcome).astype(np.float64)  # (hypotheses, contexts, own, values)
        totals = counts.sum(axis=3, keepdims=True)
        shares = np.divide(counts, totals, out=np.ones_like(counts), where=counts > 0)
        return (counts * np.log(shares)).sum(axis=(1, 2, 3))

    def compute_criteria(self, action: int, outcome: int, hypotheses: NDArray[np.int64]) -> NDArray[np.float64]:
        """BIC of some hypotheses about an outcome of an action that was seen, nats, (hypotheses,)."""
        likelihood = self.compute_likelihoods(action, outcome, hypotheses)
        own = 2 if outcome < self.over and self.sizes[outcome] == 2 else 1
        values = self.sizes[outcome] if outcome < self.over else 2
        parameters = self.context_counts[hypotheses] * own * (values - 1)
        return likelihood - parameters / 2 * np.log(max(self.count_samples(action), 1))

    def get_alive(self, action: int, outcome: int) -> NDArray[np.int64]:
        """The set that is believed, then those with one parent more that do not explain the history much worse."""
        alive = self._alive.setdefault(action, {})
        if outcome not in alive:
            alive[outcome] = self._grow(action, outcome)
        return alive[outcome]

    def _grow(self, action: int, outcome: int) -> NDArray[np.int64]:
        larger, smaller = self._neighbours
        believed = 0
        while self.count_samples(action):
            near = np.r_[smaller[believed], believed, larger[believed]]
            criteria = self.compute_criteria(action, outcome, near)
            best = int(near[np.lexsort((near, self._set_sizes[near], -np.round(criteria, 9)))[0]])
            if best == believed:
                break
            believed = best
        tried = np.r_[believed, larger[believed]]
        if not self.count_samples(action):
            return tried
        likelihoods = self.compute_likelihoods(action, outcome, tried)
        return tried[likelihoods >= likelihoods[0] - STRONG]
