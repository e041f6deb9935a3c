"""Base class of agents that learn options end to end: the running option, statistics of options, and their export."""

from __future__ import annotations

import math
import warnings
from abc import abstractmethod
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, MarkovRun, OptionPolicy, RunningCall
from hrl_escape.agents.components.exploration import sample_index
from hrl_escape.agents.state import Kept, Stateful

WINDOW = 500
"""Number of recent runs of options for the measurements."""
SHORTEST, LOWEST_ENTROPY = 1.1, 0.05
"""Mean decisions per run, and fraction of the largest entropy, below which options count as collapsed."""


class OptionAgent(Agent):
    """Base class of agents with a fixed number of options, each with a policy and a termination in every state."""

    def __init__(self, options: int, name: str) -> None:
        self.log = OptionLog(options, name)
        self.options = options
        self._option, self._decisions = -1, 0
        """Running option, or -1 before an episode's first, and its number of decisions."""
        self._shown: tuple[int, int, Any] | None = None
        """Option, its number of decisions, and observation of the latest choice."""

    @abstractmethod
    def compute_policies(self, observation: Any, action_mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return pi_o(a | s) over legal actions, float64 (options, actions)."""

    @abstractmethod
    def compute_terminations(self, observation: Any) -> NDArray[np.float64]:
        """Return the probability that each option ends at the observation, beta_o(s), float64 (options,)."""

    def list_calls(self) -> tuple[RunningCall, ...]:
        """Return the option of the latest choice, in evaluation or in learning."""
        if self._shown is None:
            return ()
        option, decisions, observation = self._shown
        ends = float(self.compute_terminations(observation)[option])
        return (RunningCall(f"option-{option}", None, decisions, ends),)

    def get_options(self) -> tuple[OptionPolicy, ...]:
        """Return each option, which can start anywhere; actions and ends are drawn."""
        return tuple(map(self._export, range(self.options)))

    def _export(self, option: int) -> OptionPolicy:
        def act(observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
            return sample_index(self.compute_policies(observation, action_mask)[option], rng)

        run = MarkovRun(act, lambda observation, mask: self.compute_terminations(observation)[option])
        return OptionPolicy(f"option-{option}", self, lambda: run)


class OptionLog(Stateful):
    """The latest runs of options."""

    STATE = (Kept("_runs", pack=lambda runs: np.array(runs, np.int64).reshape(-1, 2),
                  unpack=lambda saved: deque((int(option), int(decisions)) for option, decisions in saved)),
             "_is_warned")

    def __init__(self, options: int, name: str) -> None:
        self._options, self._name = options, name
        self._runs: deque[tuple[int, int]] = deque()
        self._totals = [0] * options
        """Number of decisions of each option in these runs."""
        self._is_warned = False

    def add(self, option: int, decisions: int) -> None:
        """Record one finished run of an option; warn once if options have collapsed."""
        self._runs.append((option, decisions))
        self._totals[option] += decisions
        if len(self._runs) > WINDOW:
            oldest, lasted = self._runs.popleft()
            self._totals[oldest] -= lasted
        if not self._is_warned and len(self._runs) == WINDOW and (reason := self.find_collapse()) is not None:
            self._is_warned = True
            warnings.warn(f"{self._name}: its options have collapsed: {reason}. Results do not measure options. Try a "
                          "deliberation cost, more entropy or more options", stacklevel=2)

    def compute_duration(self) -> float:
        """Return the mean decisions per run; 0 before the first."""
        return sum(self._totals) / max(len(self._runs), 1)

    def compute_entropy(self) -> float:
        """Return the entropy of the acting option, in nats, with each run weighted by its decisions."""
        everything = sum(self._totals)
        return -sum(made / everything * math.log(made / everything) for made in self._totals if made)

    def find_collapse(self) -> str | None:
        """Return how options have collapsed in the latest runs, or None."""
        if self._options < 2 or not self._runs:
            return None
        if self.compute_entropy() < LOWEST_ENTROPY * math.log(self._options):
            return f"one of {self._options} makes almost every decision"
        if (duration := self.compute_duration()) < SHORTEST:
            return f"they last {duration:.2f} decisions on average"
        return None

    def measure(self) -> dict[str, float]:
        """Return mean duration of options (decisions), entropy of their use (nats), and 1 if they have collapsed."""
        return {"option_duration": self.compute_duration(), "option_entropy": self.compute_entropy(),
                "option_collapse": float(self.find_collapse() is not None)}

    def after_load(self) -> None:
        """Compute the sums of the runs again."""
        self._totals = [sum(made for each, made in self._runs if each == option) for option in range(self._options)]
