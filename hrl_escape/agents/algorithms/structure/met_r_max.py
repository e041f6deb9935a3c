"""Met-R-MAX: factored R-MAX that judges sets of parents by a statistical test, for actions that can fail.

Diuk, Li and Leffler (2009), The adaptive k-meteorologists problem. Exploration and plans are as in `factored-r-max`. A
set of parents predicts the probability of an outcome by its counts, once a context has enough samples. If two
predictions differ, a sample supports one of them. Squared errors are summed until the difference exceeds what chance
explains, and the worse set is then dropped, instead of at its first error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.algorithms.factored_r_max import FactoredRMax
from hrl_escape.agents.factored.structure import StructureLearner
from hrl_escape.settings import Range


class Meteorologists(StructureLearner):
    """Hypotheses that no other one has beaten.

    For hypotheses i and j that predict p_i and p_j for a sample y (one-hot), half the squared errors differ by

        d = (|p_i - y|^2 - |p_j - y|^2) / 2,   of range 2 c with c = max over values of |p_i - p_j|

    If i were right, sum d > sqrt(2 sum c^2 log(1/delta)) would have probability at most delta (Hoeffding 1963, for the
    observed ranges); i is then dropped. Among the others, the one with the shortest code predicts: the smallest sum of
    -log of its predictions (Krichevsky and Trofimov 1981), which makes a larger set justify its contexts. An outcome
    counts as an action's effect in a context where it has at least `least_share` of the samples: an action that fails
    half of the time still has its effect.

    Args:
        visits: samples of a context before its predictions count.
        delta: error probability of one comparison.
        least_share: see above.
    """

    def __init__(self, sizes: NDArray[np.int64], actions: int, max_parents: int, all_on: bool = False, visits: int = 3,
                 delta: float = 0.05, least_share: float = 0.25) -> None:
        super().__init__(sizes, actions, max_parents, all_on)
        self._visits, self._log, self._share = visits, float(np.log(1 / delta)), least_share
        self._samples: dict[int, list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]] = {}
        """By action, for each sample: the context of every hypothesis, own values and results of the outcomes."""
        self._tests: dict[tuple[int, int], _Tests] = {}

    def add(self, before: NDArray[np.int64], action: int, after: NDArray[np.int64], over: bool, bonus: int) -> None:
        """Add one transition, and compare it with every prediction of what this action changes."""
        super().add(before, action, after, over, bonus)
        contexts, own, result = self.read_sample(before, after, over, bonus)
        samples = self._samples.setdefault(action, [])
        samples.append((contexts, own, result))
        for outcome in self.list_active(action).tolist():
            key = action, outcome
            if key not in self._tests:  # the first effect: all earlier samples count
                is_binary = outcome == self.over or (outcome < self.over and self.sizes[outcome] == 2)
                values = 2 if is_binary else self._shape[-1]
                self._tests[key] = _Tests(len(self.hypotheses), self._shape, self._visits, values)
                for sample in samples[:-1]:
                    self._tests[key].add(sample[0], int(sample[1][outcome]), int(sample[2][outcome]))
            self._tests[key].add(contexts, int(own[outcome]), int(result[outcome]))

    def get_alive(self, action: int, outcome: int) -> NDArray[np.int64]:
        """Return the hypotheses that no other has beaten, shortest codes first."""
        tests = self._tests.get((action, outcome))
        if tests is None:
            return np.arange(len(self.hypotheses))
        return tests.find_alive(self._log)

    def get_samples(self, action: int, hypotheses: NDArray[np.int64], outcome: int) -> NDArray[np.int32]:
        """Return samples with more weight on changes, which makes the largest number the action's effect."""
        return self._weigh(super().get_samples(action, hypotheses, outcome), outcome)

    def get_counts(self, action: int, hypothesis: int, outcome: int) -> NDArray[np.int32]:
        """Return the same for one hypothesis."""
        return self._weigh(super().get_counts(action, hypothesis, outcome), outcome)

    def _weigh(self, counts: NDArray[np.int32], outcome: int) -> NDArray[np.int32]:
        """Weigh changes to make them the largest number from a fraction of `least_share` of the samples."""
        if outcome < self.over and self.sizes[outcome] != 2:
            return counts
        stays = np.zeros((2, counts.shape[-1]), np.bool_)
        stays[:, 0] = True
        if outcome < self.over:
            stays[1, 0], stays[1, 1] = False, True
        share = self._share
        return np.where(stays, np.rint(1_000 * share * counts), np.rint(1_000 * (1 - share) * counts)).astype(np.int32)


class _Tests:
    """Pairwise comparisons of all hypotheses about one outcome of one action."""

    def __init__(self, hypotheses: int, shape: tuple[int, ...], visits: int, values: int) -> None:
        self._visits, self._values = visits, values
        self._code = np.zeros(hypotheses)
        self._counts = np.zeros((hypotheses, shape[1], 2, shape[-1]))
        self._rows = np.arange(hypotheses)
        self._worse = np.zeros((hypotheses, hypotheses))
        """Sum of d: the difference between the errors of i and of j."""
        self._ranges = np.zeros((hypotheses, hypotheses))
        """Sum of c^2, where c is the largest difference of the two predictions."""

    def add(self, contexts: NDArray[np.int64], own: int, result: int) -> None:
        """Add one sample, after the predictions of hypotheses with a known context."""
        cells = self._counts[self._rows, contexts, own]
        totals = cells.sum(axis=1)
        self._code -= np.log((cells[:, result] + 0.5) / (totals + 0.5 * self._values))
        known = totals >= self._visits
        if known.sum() > 1:
            forecasts = cells[known] / totals[known, None]
            miss = forecasts - np.eye(cells.shape[1])[result]
            errors = (miss * miss).sum(axis=1) / 2
            pairs = np.ix_(known, known)
            self._worse[pairs] += errors[:, None] - errors
            self._ranges[pairs] += np.abs(forecasts[:, None] - forecasts).max(axis=2) ** 2
        self._counts[self._rows, contexts, own, result] += 1

    def find_alive(self, log: float) -> NDArray[np.int64]:
        """Return the hypotheses that none has beaten; if all are beaten, the least beaten ones."""
        beaten = (self._worse - np.sqrt(2 * log * self._ranges)).max(axis=1)
        alive = np.flatnonzero(beaten <= max(float(beaten.min()), 0.0))
        return alive[np.argsort(np.round(self._code[alive], 6), kind="stable")]


@dataclass(frozen=True, kw_only=True)
class MetRMaxSettings(AgentSettings):
    """Settings of `met-r-max`: samples and error probability of its tests, hypotheses and search."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    max_parents: Annotated[int, Range(0, 8)] = 2
    """Most factors that decide an outcome, apart from a bit's own value. The number of hypotheses is the number of
    factors to this power."""
    conditions: Literal["all-on", "any"] = "all-on"
    """Contexts that a set of parents distinguishes. `all-on`: whether all of them are on, as in a graph of
    prerequisites (requires binary factors). `any`: each combination of their values."""
    most_nodes: Annotated[int, Range(1)] = 20_000
    """Most states that a search expands. Goals not found by then count as unreachable."""
    visits: Annotated[int, Range(1)] = 3
    """Samples that make a context known, and its predictions count."""
    delta: Annotated[float, Range(0, 1, open_low=True, open_high=True)] = 0.05
    """Error probability of one comparison between two sets of parents. Smaller values need more samples."""
    least_share: Annotated[float, Range(0, 0.5, open_low=True)] = 0.25
    """Smallest fraction of a context's samples that makes a change the action's effect. Smaller values tolerate more
    failures."""


class MetRMax(FactoredRMax):
    """Believes every set of parents that none has beaten, and explores where two of them differ."""

    settings: MetRMaxSettings

    def make_learner(self, sizes: NDArray[np.int64], actions: int, max_parents: int, all_on: bool) -> Meteorologists:
        """Make a structure learner with one predictor per set of parents."""
        settings = self.settings
        return Meteorologists(sizes, actions, max_parents, all_on, settings.visits, settings.delta,
                              settings.least_share)
