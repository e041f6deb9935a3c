"""Learned policies as data that options can be made of: the door by which an agent gives away what it learned.

`Agent.get_options` returns them. They speak of observations and legal actions alone, as agents do;
`hrl_escape.options.make_learned_options` makes options of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["OptionPolicy", "OptionRun", "PolicyOwner", "make_whole_policy"]


class PolicyOwner(Protocol):
    """As much of an `Agent` as a policy made of it needs."""

    is_markov: Any
    origin: Mapping[str, Any]

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Choose an action for evaluation."""
        ...

    def state_dict(self) -> Mapping[str, Any]:
        """State of a checkpoint of it, arrays and values by name."""
        ...


class OptionRun(Protocol):
    """One run of a learned policy, from its start on."""

    def act(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Choose an action, as evaluation does; random choices are drawn from `rng`."""
        ...

    def compute_termination(self, observation: Any, action_mask: NDArray[np.bool_]) -> float:
        """Probability beta(s') of ending at the state that the latest action led to."""
        ...


@dataclass(frozen=True)
class OptionPolicy:
    """Something that an agent learned to do, with its own beginning and end.

    It acts by what the agent knows when it is asked: an agent that goes on learning changes it.

    Attributes:
        name: unique among the policies of an agent.
        agent: whose it is.
        begin: makes a run.
        can_start: (observation, action mask) -> whether it may start there.
        is_markov: choice and end are functions of the observation and the legal actions alone.
    """

    name: str
    agent: PolicyOwner
    begin: Callable[[], OptionRun]
    can_start: Callable[[Any, NDArray[np.bool_]], bool] = field(default=lambda observation, action_mask: True)
    is_markov: bool = False

    @property
    def origin(self) -> Mapping[str, Any]:
        """Run in which the agent learned, see `Agent.origin`."""
        return self.agent.origin


class _WholeRun:
    """The greedy policy of an agent for as long as it is asked."""

    def __init__(self, agent: PolicyOwner) -> None:
        self._agent = agent
        self._rng: np.random.Generator | None = None

    def act(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        if self._agent.is_markov:
            return self._agent.act_greedy(observation, action_mask, rng)
        # Agents know an episode by its generator, so a run has one of its own.
        self._rng = self._rng or np.random.default_rng(int(rng.integers(2**63)))
        return self._agent.act_greedy(observation, action_mask, self._rng)

    def compute_termination(self, observation: Any, action_mask: NDArray[np.bool_]) -> float:
        return 0.0


def make_whole_policy(agent: PolicyOwner) -> OptionPolicy:
    """An agent's greedy policy, from anywhere and without an end of its own."""
    return OptionPolicy("policy", agent, lambda: _WholeRun(agent), is_markov=agent.is_markov)
