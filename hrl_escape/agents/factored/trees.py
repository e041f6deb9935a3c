"""Dynamic Bayesian networks whose conditional probabilities are decision trees, split leaf by leaf.

There is one tree per action and outcome, as in Vigorito and Barto (2010), after Jonsson and Barto (2007). A leaf is a
context: some bits on, some off. A bit's own value is the first split of its tree. Further splits must justify their
parameters by the Bayesian information criterion (Schwarz 1978). A sample of an action is worth its expected information
about the leaves that it falls into. All factors must be binary.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma, xlogy

from hrl_escape.agents.factored.search import ActionModel, ChooseHypotheses, Packing, Rule
from hrl_escape.agents.factored.structure import LEVELS, StructureLearner

GROWTH = 1.2
"""Growth of an action's number of samples that makes its trees grow again."""


def compute_information(counts: NDArray[np.int64], values: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the expected information, nats, of the next sample about its distribution, (...).

    For a Dirichlet distribution with parameters a = counts + 1/2 (Jeffreys 1946), of sum A and mean p = a / A,

        H(p) - E[H] = sum_v p_v (psi(a_v + 1) - psi(A + 1)) - sum_v p_v log p_v

    `counts` of each value so far are (..., most values); `values` is the number of possible values, (...).
    """
    weights = np.where(np.arange(counts.shape[-1]) < values[..., None], counts + 0.5, 0.0)
    total = weights.sum(axis=-1, keepdims=True)
    share = weights / total
    return (share * (digamma(weights + 1) - digamma(total + 1)) - xlogy(share, share)).sum(axis=-1)


def find_split(on: NDArray[np.bool_], results: NDArray[np.int64], samples: int, evidence: float) -> int | None:
    """Return the bit that separates the samples of a leaf best, or None if no split is worth its parameters.

    The bits before the action, `on`, are (n, factors); the results are (n,), below `LEVELS`; `samples` is the number of
    samples of the whole tree.

    A split raises the log likelihood of the results by their number times their mutual information with the bit. It
    raises the criterion by that minus parameters / 2 x log(samples), which must be larger than `evidence`.
    """
    found = (results[:, None] == np.arange(LEVELS)).astype(np.float64)
    total = found.sum(axis=0)
    parameters = np.count_nonzero(total) - 1
    if parameters < 1 or not on.shape[1]:
        return None
    both = on.T.astype(np.float64) @ found
    parts = np.stack([both, total - both])  # (on or off, factors, values)
    sizes = parts.sum(axis=-1)
    rise = (xlogy(parts, parts).sum(axis=-1) - xlogy(sizes, sizes)).sum(axis=0) - (
        xlogy(total, total).sum() - xlogy(len(on), len(on)))
    best = int(np.round(rise, 9).argmax())
    return best if rise[best] - parameters / 2 * np.log(samples) > evidence else None


def find_falls(literals: NDArray[np.bool_], paths: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return whether each state, (n, literals), falls into each leaf, (leaves, literals); bool (n, leaves)."""
    return ~literals @ paths.T == 0


@dataclass
class Leaves:
    """Leaves of all trees of an action. Literal f means that factor f is on, literal factors + f that it is off.

    Outcomes that the action has never changed share the first leaf, as if each had a tree with only that leaf.
    """

    outcomes: NDArray[np.int64]  # int64 (leaves,), outcome of the leaf's tree; -1 for the shared leaf
    paths: NDArray[np.float32]  # float32 (leaves, literals), 1 for literals that the leaf requires
    counts: NDArray[np.int64]  # int64 (leaves, literals, LEVELS), samples with the literal true, by result
    totals: NDArray[np.int64]  # int64 (leaves, LEVELS), samples by result
    gains: NDArray[np.float32]
    """Expected information of a sample with the literal true, float32 (leaves, literals); see
    `TreeLearner.compute_gains`."""

    def add(self, literals: NDArray[np.bool_], results: NDArray[np.int64]) -> None:
        """Count samples: literals (n, literals) and results (n, outcomes + 1), the last for the shared leaf."""
        falls, found = find_falls(literals, self.paths), results[:, self.outcomes]
        for value in np.unique(found).tolist():
            hit = (falls & (found == value)).T
            self.counts[:, :, value] += (hit.astype(np.float32) @ literals).astype(np.int64)
            self.totals[:, value] += hit.sum(axis=1)


class TreeLearner(StructureLearner):
    """Grows a decision tree for each action and each outcome that the action was seen to change.

    Args:
        sizes: number of values of each factor, (factors,), all 2.
        evidence: smallest increase of the criterion for a split, nats.
    """

    def __init__(self, sizes: NDArray[np.int64], actions: int, evidence: float) -> None:
        super().__init__(sizes, actions, 0)
        self._evidence, self._factors = evidence, len(sizes)
        self._values = np.r_[np.full(self._factors + 1, 2), LEVELS, 2]  # of each outcome, and of the shared leaf
        self._literals: list[list[NDArray[np.bool_]]] = [[] for _ in range(actions)]
        self._results: list[list[NDArray[np.int64]]] = [[] for _ in range(actions)]
        self._due = [0] * actions
        """Number of samples of each action that makes its trees grow again."""
        self._leaves = [self._grow(action) for action in range(actions)]

    def add(self, before: NDArray[np.int64], action: int, after: NDArray[np.int64], over: bool, bonus: int) -> None:
        """Add one transition. A new effect, or enough new samples, make trees grow again."""
        active = self._active[action].copy()
        super().add(before, action, after, over, bonus)
        on = before.astype(np.bool_)
        literals, results = np.concatenate([on, ~on]), np.concatenate([after, [int(over), bonus, 0]])
        self._literals[action].append(literals)
        self._results[action].append(results)
        if len(self._results[action]) >= self._due[action] or (active != self._active[action]).any():
            self._leaves[action] = self._grow(action)
        else:
            leaves = self._leaves[action]
            leaves.add(literals[None], results[None])
            self._measure(action, leaves, find_falls(literals[None], leaves.paths)[0].nonzero()[0], literals)

    def _grow(self, action: int) -> Leaves:
        count, width = len(self._results[action]), 2 * self._factors
        self._due[action] = int(np.ceil(count * GROWTH)) + 1
        literals = np.array(self._literals[action], np.bool_).reshape(count, width)
        results = np.array(self._results[action], np.int64).reshape(count, self.bonus + 2)
        outcomes, paths = [-1], [np.zeros(width, np.float32)]
        for outcome in self.list_active(action).tolist():
            grown = self._grow_tree(outcome, literals[:, :self._factors], results[:, outcome])
            outcomes += [outcome] * len(grown)
            paths += grown
        size = len(paths), width
        leaves = Leaves(np.array(outcomes), np.array(paths), np.zeros((*size, LEVELS), np.int64),
                        np.zeros((len(paths), LEVELS), np.int64), np.zeros(size, np.float32))
        leaves.add(literals, results)
        self._measure(action, leaves, np.arange(len(paths)), np.ones(width, np.bool_))
        return leaves

    def _grow_tree(self, outcome: int, on: NDArray[np.bool_], results: NDArray[np.int64]) -> list[NDArray[np.float32]]:
        """Paths of the leaves of one tree, (literals,) each."""
        found: list[NDArray[np.float32]] = []
        nodes = [(np.zeros(2 * self._factors, np.float32), np.arange(len(on)), outcome < self.over)]
        while nodes:
            path, rows, is_root = nodes.pop()
            factor = outcome if is_root else find_split(on[rows], results[rows], len(on), self._evidence)
            if factor is None:
                found.append(path)
                continue
            is_on = on[rows, factor]
            for literal, chosen in ((factor, is_on), (self._factors + factor, ~is_on)):
                below = path.copy()
                below[literal] = 1.0
                nodes.append((below, rows[chosen], False))
        return found

    def _measure(self, action: int, leaves: Leaves, rows: NDArray[np.int64], literals: NDArray[np.bool_]) -> None:
        columns = literals.nonzero()[0]
        outcomes = leaves.outcomes[rows]
        values = np.broadcast_to(self._values[outcomes, None], (len(rows), len(columns)))
        information = compute_information(leaves.counts[rows[:, None], columns], values)
        sharing = len(self._outcomes) - len(self.list_active(action))
        information[outcomes < 0] *= sharing
        leaves.gains[rows[:, None], columns] = information

    def compute_gains(self, states: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the expected information, nats, of each action in states, given by factors that are on.

        The result is (states, actions), summed over outcomes. Any factor could be the next split of the leaf that a
        state falls into. The sample would then carry information about the distribution among the leaf's samples that
        agree with the state in that factor. The factor with the most information counts: usually the one with the
        rarest value in the leaf.
        """
        paths = np.concatenate([leaves.paths for leaves in self._leaves])
        gains = np.concatenate([leaves.gains for leaves in self._leaves])
        actions = np.repeat(np.arange(self.actions), [len(leaves.outcomes) for leaves in self._leaves])
        state, leaf = find_falls(np.concatenate([states, ~states], axis=1), paths).nonzero()
        on, off = gains[leaf, :self._factors], gains[leaf, self._factors:]
        most = np.where(states[state], on, off).max(axis=1, initial=0.0)
        cells = state * self.actions + actions[leaf]
        summed = np.bincount(cells, most, len(states) * self.actions).astype(np.float64)
        return summed.reshape(len(states), self.actions)

    def get_leaves(self, action: int) -> Leaves:
        """Return the leaves of all trees of an action."""
        return self._leaves[action]

    def list_changes(self, action: int) -> NDArray[np.int64]:
        """Return the leaves where an action most often turns the tree's bit on or off."""
        leaves = self._leaves[action]
        rows = np.flatnonzero((leaves.outcomes >= 0) & (leaves.outcomes < self.over) & leaves.totals.any(axis=1))
        return rows[leaves.paths[rows, leaves.outcomes[rows]] != leaves.totals[rows].argmax(axis=1)]

    def find_parents(self, action: int, outcome: int, own: int | None = None) -> frozenset[int]:
        """Return the factors that an outcome's tree splits by, without its own value; for an off (0) or on (1) bit."""
        leaves = self._leaves[action]
        rows = leaves.outcomes == outcome
        if own is not None:
            rows &= leaves.paths[:, outcome if own else self._factors + outcome] > 0
        asked = leaves.paths[rows].any(axis=0).reshape(2, -1).any(axis=0)
        return frozenset(asked.nonzero()[0].tolist()) - {outcome}


def compile_trees(learner: TreeLearner, packing: Packing, action: int, choose: ChooseHypotheses,
                  bonuses: Sequence[float], visits: int) -> ActionModel:
    """Return rules of the leaves where an action most often changes something, known from `visits` samples.

    Arguments as in `compile_action`; without hypotheses and gaps.
    """
    leaves = learner.get_leaves(action)
    on, off = np.hsplit(leaves.paths.astype(np.int64), 2)
    values, cares = on @ (1 << packing.shifts), (on + off) @ (1 << packing.shifts)
    rules = []
    for leaf in np.flatnonzero((leaves.outcomes >= 0) & (leaves.totals.sum(axis=1) >= visits)).tolist():
        outcome, result = int(leaves.outcomes[leaf]), int(leaves.totals[leaf].argmax())
        clear = put = 0
        if outcome < learner.over and result != on[leaf, outcome]:
            clear, put = (0, packing.masks[outcome]) if result else (packing.masks[outcome], 0)
        is_over = outcome == learner.over and result == 1
        bonus = bonuses[result] if outcome == learner.bonus else 0.0
        if clear or put or is_over or bonus:
            rules.append(Rule(int(cares[leaf]), int(values[leaf]), clear, put, 0, is_over, bonus))
    return ActionModel(tuple(rules), np.zeros((0, 2), np.uint64))
