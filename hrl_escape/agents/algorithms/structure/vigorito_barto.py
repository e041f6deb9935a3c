"""Options made as dependencies are learned, one variable after another.

Vigorito and Barto (2010), Intrinsically motivated hierarchical skill learning in structured environments: parents of
every variable are found incrementally, and a variable whose parents are known gives an option that turns it on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.factored.growing_sets import GrowingSets
from hrl_escape.agents.factored.optimistic_planner import OptimisticPlanner, OptimisticSettings
from hrl_escape.agents.option_policy import OptionPolicy
from hrl_escape.settings import Range

__all__ = ["VigoritoBarto", "VigoritoBartoSettings"]


@dataclass(frozen=True)
class VigoritoBartoSettings(OptimisticSettings):
    """Settings of `vigorito-barto`."""

    visits: Annotated[int, Range(1)] = 3
    """Samples of a context after which no more are needed; a variable then gets its option."""


class VigoritoBarto(OptimisticPlanner):
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
        """Sets that grow."""
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
