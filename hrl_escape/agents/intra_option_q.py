"""Intra-option Q-learning: every primitive teaches every option that would have done the same.

Sutton, Precup and Singh (1999), section 6. It needs to see inside options, so the environment must
give traces (see `agent.make_transition`); on a flat environment it is Q-learning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition, StateTree, compute_backup, count_actions, count_steps
from hrl_escape.agents.exploration import (
    ExplorationSettings,
    choose_best,
    compute_epsilon,
    make_rng,
    sample_action,
)
from hrl_escape.agents.settings import LearningSettings
from hrl_escape.agents.tabular import QTable, TabularSettings, make_discretiser
from hrl_escape.errors import StepContractError

__all__ = ["IntraOptionQ", "IntraOptionQSettings"]


@dataclass(frozen=True)
class IntraOptionQSettings(TabularSettings, ExplorationSettings, LearningSettings):
    """Settings of `intra-option-q`."""


class IntraOptionQ:
    """One-step intra-option Q-learning.

    For each primitive (s, a, r, s') in the trace and each option o consistent with it, that is pi_o(s) = a:

        Q(s, o) <- Q(s, o) + alpha [r + gamma U(s', o) - Q(s, o)]
        U(s', o) = (1 - beta_o(s')) Q(s', o) + beta_o(s') max over legal o' of Q(s', o')

    and U = 0 where the episode terminated. beta is that of s', the state reached. Only options whose policy is a
    function of the state are consistent with anything; the executed option, if it is not among them, is learned by
    the SMDP backup of `q-learning`, once a decision. A trace is worked through from its end, so that one pass
    carries a reward all the way back. Where the trace does not say which actions are legal at a state
    inside an option, no maximum over them can be taken, and updates that need it are left out.
    """

    Settings: ClassVar[type] = IntraOptionQSettings
    recipes: ClassVar[Mapping[str, IntraOptionQSettings]] = {"corrected": IntraOptionQSettings()}

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: IntraOptionQSettings | None = None,
    ) -> None:
        self.settings = settings or IntraOptionQSettings()
        self.table = QTable(count_actions(action_space, "intra-option-q"), self.settings)
        self._discretise = make_discretiser(observation_space, self.settings, "intra-option-q")
        self._rng = make_rng(seed, "actions")
        self._steps = 0

    needs_trace: ClassVar[bool] = True

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self.settings.gamma

    def compute_values(self, observation: Any) -> NDArray[np.float64]:
        """Q(s, .) at an observation, float64 (actions,)."""
        return self.table.get_values(self._discretise(observation))

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say."""
        values = self.compute_values(observation)
        return sample_action(values, action_mask, self.settings, self._steps, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The legal action of highest value."""
        return choose_best(self.compute_values(observation), action_mask)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn from the primitives inside the decision, and from the decision where they do not cover it.

        Raises:
            StepContractError: an option ran but the environment gave no trace of it.
        """
        trace = transition.trace
        if transition.duration > 1 and len(trace) != transition.duration:
            raise StepContractError(
                f"intra-option-q needs info['trace'] with one item per primitive; an action of "
                f"{transition.duration} primitives came with {len(trace)}. Ask the environment for traces "
                "(OptionsEnv(env, trace=True)), or use q-learning"
            )
        for index in range(len(trace) - 1, -1, -1):
            self._learn_primitive(trace[index], transition, is_last=index == len(trace) - 1)
        covered = bool(trace) and any(o == transition.action for o, _ in _get_consistent(trace[0]))
        error = 0.0 if covered else self._learn_decision(transition)
        self._steps += count_steps(transition, self.settings)
        epsilon = compute_epsilon(self.settings, self._steps)
        return {"td_error": abs(error), "epsilon": epsilon, "states": len(self.table)}

    def _learn_primitive(self, item: Any, transition: SMDPTransition, is_last: bool) -> None:
        consistent = _get_consistent(item)
        if not consistent:
            return
        observation, _, reward, next_observation = item[:4]
        mask = transition.next_action_mask if is_last else getattr(item, "next_action_mask", None)
        key = self._discretise(observation)
        next_values = self.compute_values(next_observation)
        ended = transition.terminated or (transition.truncated and not self.settings.bootstrap_on_truncation)
        for option, beta in consistent:
            value = 0.0
            if not (is_last and ended):
                if mask is None and beta > 0:
                    continue
                best = 0.0 if mask is None else float(next_values[np.asarray(mask) != 0].max())
                value = (1 - beta) * float(next_values[option]) + beta * best
            self.table.update(key, option, float(reward) + self.gamma * value)

    def _learn_decision(self, transition: SMDPTransition) -> float:
        reward, bootstrap = compute_backup(transition, self.settings)
        target = reward
        if bootstrap:
            next_values = self.compute_values(transition.next_observation)
            target += bootstrap * float(next_values[transition.next_action_mask].max())
        return self.table.update(self._discretise(transition.observation), transition.action, target)

    def state_dict(self) -> StateTree:
        """Table, counter, generator."""
        return {
            "table": self.table.state_dict(),
            "steps": self._steps,
            "rng": self._rng.bit_generator.state,
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore what `state_dict` gave."""
        self.table.load_state_dict(state["table"])
        self._steps = int(state["steps"])
        self._rng.bit_generator.state = state["rng"]


def _get_consistent(item: Any) -> tuple[tuple[int, float], ...]:
    return getattr(item, "consistent", ())
