"""Options made as dependencies are learned, one variable after another.

Vigorito and Barto (2010), Intrinsically motivated hierarchical skill learning in structured environments: parents of
every variable are found incrementally, and a variable whose parents are known gives an option that turns it on. What
their decision trees do leaf by leaf, this does set by set: a set takes in one more parent where the history justifies
the parameters it adds, by the Bayesian information criterion (Schwarz 1978). So contexts are tried one variable
further, where SLF-R-MAX and Met-R-MAX try every set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import OptionPolicy, SMDPTransition
from hrl_escape.agents.algorithms.factored_r_max import FactoredRMax, FactoredRMaxSettings
from hrl_escape.agents.factored.structure import StructureLearner
from hrl_escape.settings import Range

__all__ = ["GrowingSets", "VigoritoBarto", "VigoritoBartoSettings"]


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


@dataclass(frozen=True)
class VigoritoBartoSettings(FactoredRMaxSettings):
    """Samples of a context after which `vigorito-barto` makes options, beside hypotheses and search."""

    visits: Annotated[int, Range(1)] = 3
    """Samples of a context after which no more are needed; a variable then gets its option."""


class VigoritoBarto(FactoredRMax):
    """Grow each outcome's set of parents, go where one more parent is untried, and keep an option for each bit.

    The option of a bit does the action that turns it on, once its parents are on; a parent that is off is turned on
    first, by that parent's option.
    """

    name: ClassVar[str] = "vigorito-barto"
    Settings: ClassVar[type] = VigoritoBartoSettings
    settings: VigoritoBartoSettings

    def make_learner(
        self, sizes: NDArray[np.int64], actions: int, max_parents: int, all_on: bool
    ) -> GrowingSets:
        """New sets of parents, each empty at first."""
        return GrowingSets(sizes, actions, max_parents, all_on)

    def find_skills(self) -> dict[int, tuple[int, tuple[int, ...]]]:
        """Bits that have an option: component -> the action that turns it on, and the components of its parents."""
        learner, found = self.model.learner, {}
        for action in range(learner.actions):
            for outcome in learner.list_active(action).tolist():
                if outcome >= learner.over or learner.sizes[outcome] != 2:
                    continue
                believed = int(learner.get_alive(action, outcome)[0])
                parents = learner.hypotheses[believed]
                on = learner.get_counts(action, believed, outcome)[self._find_context(believed), 0]
                bit = int(self.model.components[outcome])
                if on.sum() >= self.settings.visits and on.argmax() == 1 and bit not in found:
                    found[bit] = action, tuple(int(self.model.components[parent]) for parent in parents)
        return found

    def _find_context(self, hypothesis: int) -> int:
        """Context of a hypothesis in which all of its parents are on."""
        learner = self.model.learner
        return 0 if learner.all_on else int(learner.context_counts[hypothesis]) - 1

    def choose_towards(self, bit: int, observation: Any) -> int | None:
        """The next action on the way to a bit; None if it is on, or has no option."""
        on, skills = np.asarray(observation).reshape(-1) == 1, self.find_skills()
        if on[bit] or bit not in skills:
            return None
        for _ in range(len(skills)):
            action, parents = skills[bit]
            missing = [parent for parent in parents if not on[parent] and parent in skills]
            if not missing:
                return action
            bit = missing[0]
        return None  # they need each other

    def get_options(self) -> tuple[OptionPolicy, ...]:
        """An option for each bit whose parents are known, from where it is off; the whole policy where none is."""
        return tuple(map(self._export, sorted(self.find_skills()))) or super().get_options()

    def _export(self, bit: int) -> OptionPolicy:
        def can_start(observation: Any, action_mask: NDArray[np.bool_]) -> bool:
            action = self.choose_towards(bit, observation)
            return action is not None and bool(action_mask[action])

        return OptionPolicy(f"bit-{bit}", self, partial(_Run, self, bit), can_start, is_markov=True)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Add to the history; the end of an episode drops the plan."""
        return {**super().observe(transition), "skills": len(self.find_skills())}


class _Run:
    """A run of a bit's option; it remembers nothing."""

    def __init__(self, agent: VigoritoBarto, bit: int) -> None:
        self._agent, self._bit = agent, bit

    def act(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The next action on the way to the bit."""
        action = self._agent.choose_towards(self._bit, observation)
        assert action is not None, "the option may not start here"
        return action

    def compute_termination(self, observation: Any, action_mask: NDArray[np.bool_]) -> float:
        """1 where the bit is on, or the way goes on by an illegal action."""
        action = self._agent.choose_towards(self._bit, observation)
        return float(action is None or not action_mask[action])
