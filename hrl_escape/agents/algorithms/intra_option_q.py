"""Intra-option Q-learning: every primitive teaches every option that would have done the same.

Sutton, Precup and Singh (1999), section 6. It needs to see inside options, so the environment must
give traces (see `agent.make_transition`); on a flat environment it is Q-learning.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.components.tables import TabularAgent, TabularAgentSettings
from hrl_escape.errors import StepContractError


@dataclass(frozen=True)
class IntraOptionQSettings(TabularAgentSettings):
    """Those of every agent with a table, for `intra-option-q`."""


class IntraOptionQ(TabularAgent):
    """One-step intra-option Q-learning.

    For each primitive (s, a, r, s') in the trace and each option o consistent with it, that is pi_o(s) = a:

        Q(s, o) <- Q(s, o) + alpha [r + gamma U(s', o) - Q(s, o)]
        U(s', o) = (1 - beta_o(s')) Q(s', o) + beta_o(s') max over legal o' of Q(s', o')

    and U = 0 where the episode terminated. Where the item is a decision of a level below, of k primitives, r is its
    discounted reward and gamma^k stands for gamma. beta is that of s', the state reached. Only options whose policy is
    a function of the state are consistent with anything; the executed option, if it is not among them, is learned by
    the SMDP backup of `q-learning`, once a decision. A trace is worked through from its end, so that one pass
    carries a reward all the way back. Where the trace does not say which actions are legal at a state
    inside an option, no maximum over them can be taken, and updates that need it are left out.
    """

    name: ClassVar[str] = "intra-option-q"
    Settings: ClassVar[type] = IntraOptionQSettings
    needs_trace: ClassVar[bool] = True
    settings: IntraOptionQSettings

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn from the primitives inside the decision, and from the decision where they do not cover it.

        Raises:
            StepContractError: an option ran but the environment gave no trace of it.
        """
        trace = transition.trace
        covers = sum(len(_get_rewards(item)) for item in trace)
        if transition.duration > 1 and covers != transition.duration:
            raise StepContractError(
                f"intra-option-q needs info['trace'] with one item per primitive; an action of "
                f"{transition.duration} primitives came with {covers}. Ask the environment for traces "
                "(OptionsEnv(env, trace=True)), or use q-learning"
            )
        for index in range(len(trace) - 1, -1, -1):
            self._learn_primitive(trace[index], transition, is_last=index == len(trace) - 1)
        covered = bool(trace) and any(o == transition.action for o, _ in _get_consistent(trace[0]))
        return self.finish_decision(transition, 0.0 if covered else self.back_up(transition))

    def _learn_primitive(self, item: Any, transition: SMDPTransition, is_last: bool) -> None:
        consistent = _get_consistent(item)
        if not consistent:
            return
        observation, _, _, next_observation = item[:4]
        reward, discount = 0.0, 1.0
        for primitive_reward in _get_rewards(item):
            reward, discount = reward + discount * float(primitive_reward), discount * self.gamma
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
            self.table.update(key, option, reward + discount * value)


def _get_consistent(item: Any) -> tuple[tuple[int, float], ...]:
    return getattr(item, "consistent", ())


def _get_rewards(item: Any) -> Sequence[float]:
    """Rewards of the primitives of an item: one, unless it is a decision of a level below."""
    return getattr(item, "rewards", ()) or (item[2],)
