"""Base of agents that learn options end to end: the option that runs, what is shown of it, and options for export."""

from __future__ import annotations

from abc import abstractmethod
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, RunningCall
from hrl_escape.agents.components.exploration import sample_index
from hrl_escape.agents.components.options.log import OptionLog
from hrl_escape.agents.option_policy import OptionPolicy

__all__ = ["OptionAgent"]


class OptionAgent(Agent):
    """Base of agents with a fixed number of options, each with a policy and a termination in every state.

    Args:
        options: how many.
        name: of the algorithm, for messages.

    Attributes:
        log: durations and entropy of options.
    """

    def __init__(self, options: int, name: str) -> None:
        self.log = OptionLog(options, name)
        self.options = options
        self._option, self._decisions = -1, 0
        """The option that runs, or -1 before an episode's first; and the decisions that it has made."""
        self._evaluation: tuple[np.random.Generator, int, int] | None = None
        """Generator of an evaluation, the option that runs in it, and the decisions that it has made."""
        self._shown: tuple[int, int, Any] | None = None
        """Option, decisions made and observation of the latest choice."""

    @abstractmethod
    def compute_policies(self, observation: Any, action_mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """pi_o(a | s) over legal actions, float64 (options, actions)."""

    @abstractmethod
    def compute_terminations(self, observation: Any) -> NDArray[np.float64]:
        """beta_o(s), float64 (options,)."""

    def list_calls(self) -> tuple[RunningCall, ...]:
        """The option of the latest choice, in evaluation or in learning."""
        if self._shown is None:
            return ()
        option, decisions, observation = self._shown
        ends = float(self.compute_terminations(observation)[option])
        return (RunningCall(f"option-{option}", None, decisions, ends),)

    def get_options(self) -> tuple[OptionPolicy, ...]:
        """Each option, from anywhere; actions and ends are drawn."""
        return tuple(OptionPolicy(f"option-{option}", self, partial(_Run, self, option))
                     for option in range(self.options))


class _Run:
    """A run of one option; it remembers nothing."""

    def __init__(self, agent: OptionAgent, option: int) -> None:
        self._agent, self._option = agent, option

    def act(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Draw from the option's policy."""
        return sample_index(self._agent.compute_policies(observation, action_mask)[self._option], rng)

    def compute_termination(self, observation: Any, action_mask: NDArray[np.bool_]) -> float:
        """Beta of the option."""
        return float(self._agent.compute_terminations(observation)[self._option])
