"""The chain of six states of Kulkarni, Narasimhan, Saeedi and Tenenbaum (2016), Hierarchical deep RL (h-DQN)."""

from __future__ import annotations

from gymnasium import spaces

from tests.classic.exact import Array
from tests.classic.tabular import Outcome, TabularEnv, make_uniform

LEFT, RIGHT = range(2)
LENGTH = 6
FIRST, LAST, START = 0, LENGTH - 1, 1
"""Positions; the paper numbers them from 1."""


class Chain(TabularEnv):
    """Go to the last position before ending at the first: 1 if it was visited, else 0.01.

    `LEFT` moves left; `RIGHT` moves right with probability 1/2, else left, and always left from the last position.
    The state is `position + 6 * visited`.

    Args:
        visited: observe the state; False observes the position alone, as the paper does.
        horizon: primitives until truncation.
    """

    def __init__(self, visited: bool = True, horizon: int | None = 1_000) -> None:
        super().__init__(2 * LENGTH, 2, horizon)
        self.visited = visited
        self.observation_space = spaces.Discrete(2 * LENGTH if visited else LENGTH)

    def observe(self, state: int) -> int:
        return state if self.visited else state % LENGTH

    def outcomes(self, state: int, action: int) -> list[Outcome]:
        visited, position = divmod(state, LENGTH)
        if position == FIRST:
            return [Outcome(1.0, state, 0.0, True)]
        if action == LEFT or position == LAST:
            return [self._arrive(1.0, position - 1, visited)]
        return [self._arrive(0.5, position - 1, visited), self._arrive(0.5, position + 1, visited)]

    def _arrive(self, probability: float, position: int, visited: int) -> Outcome:
        visited = max(visited, int(position == LAST))
        ends = position == FIRST
        return Outcome(probability, position + LENGTH * visited, (1.0 if visited else 0.01) * ends, ends)

    def make_starts(self) -> Array:
        return make_uniform([START], 2 * LENGTH)
