"""Structure learning: the factors that decide each outcome of an action, from (s, a, s') histories.

Each action has one dynamic Bayesian network (Dean and Kanazawa 1989), whose parents are found as in SLF-R-MAX (Strehl,
Diuk and Littman 2007): every set of at most `max_parents` factors is a hypothesis, counted in all its contexts. Two
priors reduce the number of samples. Outcomes are functions of the parents: a set that explains more of the history
beats one that explains less, and among equals the smaller set wins. An action has no effects that it has never shown. A
bit's own value is always among its parents and does not count as one.

`GrowingSets` is the approximation of `vigorito-barto`. Decision trees grow leaf by leaf (`trees.py`); it grows set by
set: a set adds one more parent if the history justifies the additional parameters, by the Bayesian information
criterion (Schwarz 1978). Contexts are therefore tried one variable further, instead of in every set.
"""

from __future__ import annotations

import itertools
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

LEVELS = 8
"""Most levels of the end bonus that are distinguished."""


class StructureLearner:
    """Counts contexts and outcomes for every action, outcome and set of parents.

    Outcomes are numbered: first the factors (their next value), then `over` (1 if the task ended) and `bonus` (a level
    of reward, 0 for the usual one).

    Args:
        sizes: number of values of each factor, (factors,).
        all_on: whether a set has only two contexts, all of its bits on (0) and not all on (1), instead of one for each
            combination of values.

    Attributes:
        hypotheses: sets of parents as sorted tuples of factors, small ones first.
        context_counts: number of contexts of each, int64 (hypotheses,).
        over: number of that outcome.
        bonus: number of that outcome.
    """

    def __init__(self, sizes: NDArray[np.int64], actions: int, max_parents: int, all_on: bool = False) -> None:
        self.sizes, self.actions, self.all_on = sizes, actions, all_on
        factors = len(sizes)
        self.hypotheses: list[tuple[int, ...]] = [
            chosen for size in range(min(max_parents, factors) + 1) for chosen in
            itertools.combinations(range(factors), size)
        ]
        self.over, self.bonus = factors, factors + 1
        self._outcomes = np.arange(factors + 2)
        self._is_bit = sizes == 2
        self._strides = np.zeros((len(self.hypotheses), factors), dtype=np.int64)
        self.context_counts = np.ones(len(self.hypotheses), dtype=np.int64)
        for number, parents in enumerate(self.hypotheses):
            for parent in parents:
                self._strides[number, parent] = self.context_counts[number]
                self.context_counts[number] *= sizes[parent]
        if all_on:
            self._strides = (self._strides > 0).astype(np.int64)
            self.context_counts = np.minimum(self.context_counts, 2)
        self._set_sizes = np.array([len(parents) for parents in self.hypotheses])
        self._rows = np.arange(len(self.hypotheses))[:, None]
        values = max(LEVELS, int(sizes.max(initial=2)))
        self._shape = (len(self.hypotheses), int(self.context_counts.max()), factors + 2, 2, values)
        self._counts: dict[int, NDArray[np.int32]] = {}
        self._errors = np.zeros((actions, len(self.hypotheses), factors + 2), dtype=np.int64)
        self._active = np.zeros((actions, factors + 2), dtype=np.bool_)

    def add(self, before: NDArray[np.int64], action: int, after: NDArray[np.int64], over: bool, bonus: int) -> None:
        """Add one transition between factors, (factors,); `bonus` is a level of reward, below `LEVELS`."""
        if action not in self._counts:
            self._counts[action] = np.zeros(self._shape, dtype=np.int32)
        counts = self._counts[action]
        flat, own, result = self.read_sample(before, after, over, bonus)
        contexts = flat[:, None]
        cells = counts[self._rows, contexts, self._outcomes, own]  # (hypotheses, outcomes, values)
        best = cells.max(axis=2)
        landed = cells[self._rows, self._outcomes, result]
        self._errors[action] += landed < best  # results other than the most frequent of the cell
        counts[self._rows, contexts, self._outcomes, own, result] += 1
        changed = np.concatenate([after != before, [over, bonus != 0]])
        self._active[action] |= changed

    def read_sample(self, before: NDArray[np.int64], after: NDArray[np.int64], over: bool, bonus: int
                    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return context of each hypothesis, (hypotheses,), and own value and result of each outcome, (outcomes,)."""
        own = np.concatenate([np.where(self._is_bit, before, 0), [0, 0]])
        result = np.concatenate([after, [int(over), bonus]])
        sums = self._strides @ before
        return (sums < self._set_sizes).astype(np.int64) if self.all_on else sums, own, result

    def list_active(self, action: int) -> NDArray[np.int64]:
        """Return the outcomes that this action has been seen to change."""
        return self._active[action].nonzero()[0]

    def get_alive(self, action: int, outcome: int) -> NDArray[np.int64]:
        """Return the hypotheses that contradict the history least, small ones first.

        If one set explains everything that the action does to factors as well as separate sets would, only such sets
        are returned, because one outcome of an action usually has the same conditions as the others. The same applies
        to the task's end and the bonus, separately from factors.
        """
        active = self._active[action]
        if active[outcome]:
            errors = self._errors[action][:, active & ((self._outcomes < self.over) == (outcome < self.over))]
            joint = errors.sum(axis=1)
            if joint.min() == errors.min(axis=0).sum():
                return (joint == joint.min()).nonzero()[0]
        errors = self._errors[action, :, outcome]
        return (errors == errors.min()).nonzero()[0]

    def count_samples(self, action: int) -> int:
        """Return the number of samples of an action."""
        return int(self._counts[action][0, 0, self.over].sum()) if action in self._counts else 0

    def get_errors(self, action: int, outcome: int) -> NDArray[np.int64]:
        """Return the number of samples that each hypothesis leaves unexplained, (hypotheses,)."""
        return self._errors[action, :, outcome]

    def get_samples(self, action: int, hypotheses: NDArray[np.int64], outcome: int) -> NDArray[np.int32]:
        """Return `get_counts` of several hypotheses, (hypotheses, contexts, 2, values), for an action with samples."""
        return self._counts[action][hypotheses, :, outcome]

    def get_counts(self, action: int, hypothesis: int, outcome: int) -> NDArray[np.int32]:
        """Return samples by context, own value (0 if the factor is not binary) and result, (contexts, 2, values)."""
        contexts = self.context_counts[hypothesis]
        if action not in self._counts:
            return np.zeros((contexts, *self._shape[3:]), dtype=np.int32)
        return self._counts[action][hypothesis, :contexts, outcome]

    def find_unseen(self, action: int, hypotheses: NDArray[np.int64], visits: int) -> list[tuple[int, int]]:
        """Return pairs (hypothesis, context) with fewer than `visits` samples of this action."""
        if action not in self._counts:
            return [(0, 0)]
        seen = self._counts[action][hypotheses, :, self.over].sum(axis=(2, 3))
        exists = np.arange(self._shape[1]) < self.context_counts[hypotheses][:, None]
        rows, contexts = ((seen < visits) & exists).nonzero()
        return list(zip(hypotheses[rows].tolist(), contexts.tolist(), strict=True))


STRONG = 3.0
"""Logarithm of a likelihood ratio that counts as strong evidence (Kass and Raftery 1995)."""


class GrowingSets(StructureLearner):
    """Believes, for each outcome of an action, the set grown from the empty set.

    In every step the current set h adds or drops the parent whose change raises the criterion the most,

        BIC(h) = sum over contexts, own values and results of n log(n / n of the context) - parameters / 2 x log n

    until no change raises it. Among equal sets the smallest is taken.
    """

    @cached_property
    def _alive(self) -> dict[int, dict[int, NDArray[np.int64]]]:
        """Results of `get_alive` by action and outcome, valid until the action's next sample."""
        return {}

    def add(self, before: NDArray[np.int64], action: int, after: NDArray[np.int64], over: bool, bonus: int) -> None:
        """Add one transition; the beliefs about its action are then computed again."""
        super().add(before, action, after, over, bonus)
        self._alive.pop(action, None)

    @cached_property
    def _neighbours(self) -> tuple[list[NDArray[np.int64]], list[NDArray[np.int64]]]:
        """Hypotheses with one more parent than each, and with one less."""
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
        """Return the maximum log likelihood of hypotheses about an observed outcome, nats, (hypotheses,)."""
        counts = self.get_samples(action, hypotheses, outcome).astype(np.float64)  # (hypotheses, contexts, own, values)
        totals = counts.sum(axis=3, keepdims=True)
        shares = np.divide(counts, totals, out=np.ones_like(counts), where=counts > 0)
        return (counts * np.log(shares)).sum(axis=(1, 2, 3))

    def compute_criteria(self, action: int, outcome: int, hypotheses: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the BIC of hypotheses about an observed outcome, nats, (hypotheses,)."""
        likelihood = self.compute_likelihoods(action, outcome, hypotheses)
        own = 2 if outcome < self.over and self.sizes[outcome] == 2 else 1
        values = self.sizes[outcome] if outcome < self.over else 2
        parameters = self.context_counts[hypotheses] * own * (values - 1)
        return likelihood - parameters / 2 * np.log(max(self.count_samples(action), 1))

    def get_alive(self, action: int, outcome: int) -> NDArray[np.int64]:
        """Return the believed set, then sets with one more parent that explain the history almost as well."""
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
