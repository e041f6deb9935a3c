"""Measurements by which a learner of options shows what became of them: durations, entropy, collapse."""

from __future__ import annotations

import math
import warnings
from collections import deque

import numpy as np

from hrl_escape.agents.state import StateTree

__all__ = ["OptionLog"]

WINDOW = 500
"""Runs of options that the measurements cover."""
SHORTEST, LOWEST_ENTROPY = 1.1, 0.05
"""Mean decisions of a run, and share of the largest entropy, below which options have collapsed."""


class OptionLog:
    """The latest runs of options.

    Args:
        options: how many there are.
        name: of the agent, for the warning.
    """

    def __init__(self, options: int, name: str) -> None:
        self._options, self._name = options, name
        self._runs: deque[tuple[int, int]] = deque()
        self._totals = [0] * options
        """Decisions of each option in these runs."""
        self._is_warned = False

    def add(self, option: int, decisions: int) -> None:
        """Take in one run of an option that is over; warns, once, when options have collapsed."""
        self._runs.append((option, decisions))
        self._totals[option] += decisions
        if len(self._runs) > WINDOW:
            oldest, lasted = self._runs.popleft()
            self._totals[oldest] -= lasted
        if not self._is_warned and len(self._runs) == WINDOW and (reason := self.find_collapse()) is not None:
            self._is_warned = True
            warnings.warn(f"{self._name}: its options have collapsed: {reason}. Results say nothing of options; try a "
                          "deliberation cost, more entropy or more options", stacklevel=2)

    def compute_duration(self) -> float:
        """Mean decisions of a run; 0 before the first."""
        return sum(self._totals) / max(len(self._runs), 1)

    def compute_entropy(self) -> float:
        """Entropy of the option that acts, in nats, each run weighted by its decisions."""
        everything = sum(self._totals)
        return -sum(made / everything * math.log(made / everything) for made in self._totals if made)

    def find_collapse(self) -> str | None:
        """Say in which way options have collapsed, by the latest runs; None where they have not."""
        if self._options < 2 or not self._runs:
            return None
        if self.compute_entropy() < LOWEST_ENTROPY * math.log(self._options):
            return f"one of {self._options} makes almost every decision"
        if (duration := self.compute_duration()) < SHORTEST:
            return f"they last {duration:.2f} decisions on average"
        return None

    def measure(self) -> dict[str, float]:
        """Numbers to log."""
        return {"option_duration": self.compute_duration(), "option_entropy": self.compute_entropy(),
                "option_collapse": float(self.find_collapse() is not None)}

    def state_dict(self) -> StateTree:
        """Runs, and whether the warning was given."""
        return {"runs": np.array(self._runs, np.int64).reshape(-1, 2), "is_warned": self._is_warned}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        self._runs = deque((int(option), int(decisions)) for option, decisions in state["runs"])
        self._totals = [sum(made for each, made in self._runs if each == option) for option in range(self._options)]
        self._is_warned = bool(state["is_warned"])
