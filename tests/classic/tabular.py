"""Finite environments written as one rule: the outcomes of an action in a state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray


class Outcome(NamedTuple):
    """One way an action can go."""

    probability: float
    next_state: int
    reward: float
    terminated: bool = False


class State(NamedTuple):
    """All that an environment remembers but its generator."""

    number: int
    elapsed: int = 0


@dataclass(frozen=True)
class Tables:
    """A finite MDP as arrays.

    Attributes:
        probability: (states, actions, states), of each next state.
        ending: the part of `probability` with which the episode ends on arrival.
        rewards: (states, actions), expected.
        starts: (states,), probability of each first state.
    """

    probability: NDArray[np.float64]
    ending: NDArray[np.float64]
    rewards: NDArray[np.float64]
    starts: NDArray[np.float64]

    @property
    def continuing(self) -> NDArray[np.float64]:
        """The part of `probability` with which the episode goes on."""
        return self.probability - self.ending


class TabularEnv(gymnasium.Env, ABC):
    """A Gymnasium environment that samples from its rule.

    Args:
        states: how many there are.
        actions: how many there are, all legal everywhere.
        horizon: primitives until truncation; None never truncates.
    """

    def __init__(self, states: int, actions: int, horizon: int | None = 1_000) -> None:
        self.observation_space: spaces.Space = spaces.Discrete(states)
        self.action_space: spaces.Discrete = spaces.Discrete(actions)
        self.horizon = horizon
        self.states, self.actions = states, actions
        self.state = State(0)
        self._rule = [[self.outcomes(state, action) for action in range(actions)] for state in range(states)]
        self._first = np.cumsum(self.make_starts())

    @abstractmethod
    def outcomes(self, state: int, action: int) -> Sequence[Outcome]:
        """The rule; probabilities sum to 1. A terminal state ends at once, without reward."""

    @abstractmethod
    def make_starts(self) -> NDArray[np.float64]:
        """Probability of each first state."""

    def observe(self, state: int) -> Any:
        """The observation in a state: its number, unless the domain hides some of it."""
        return state

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Draws a first state."""
        super().reset(seed=seed)
        number = int(np.searchsorted(self._first, self.np_random.random() * self._first[-1], side="right"))
        self.state = State(number)
        return self.observe(number), {"state": number}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Draws one of the outcomes."""
        left = self.np_random.random()
        possible = self._rule[self.state.number][action]
        for outcome in possible:
            left -= outcome.probability
            if left < 0:
                break
        else:  # the probabilities sum to a little less than 1
            outcome = possible[-1]
        self.state = State(outcome.next_state, self.state.elapsed + 1)
        truncated = self.state.elapsed == self.horizon and not outcome.terminated
        info = {"state": outcome.next_state, "is_success": outcome.terminated}
        return self.observe(outcome.next_state), outcome.reward, outcome.terminated, truncated, info

    def get_state(self) -> State:
        """The state, to be restored by `set_state`."""
        return self.state

    def set_state(self, state: State) -> None:
        """Continues from a state."""
        self.state = state

    def make_tables(self) -> Tables:
        """The rule as arrays."""
        probability = np.zeros((self.states, self.actions, self.states))
        ending = np.zeros_like(probability)
        rewards = np.zeros((self.states, self.actions))
        for state, row in enumerate(self._rule):
            for action, possible in enumerate(row):
                for outcome in possible:
                    rewards[state, action] += outcome.probability * outcome.reward
                    probability[state, action, outcome.next_state] += outcome.probability
                    if outcome.terminated:
                        ending[state, action, outcome.next_state] += outcome.probability
        return Tables(probability, ending, rewards, self.make_starts())


def make_uniform(states: Sequence[int], count: int) -> NDArray[np.float64]:
    """Equal probability for each of some of `count` states."""
    starts = np.zeros(count)
    starts[list(states)] = 1 / len(states)
    return starts
