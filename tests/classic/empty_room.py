"""An empty room with macro-actions that run to the wall.

McGovern, Sutton and Fagg (1997), Roles of macro-actions in accelerating reinforcement learning.
"""

from __future__ import annotations

import numpy as np

from tests.classic.exact import Array, TabularOption, make_policy_matrix
from tests.classic.grid import Grid
from tests.classic.tabular import Outcome, TabularEnv, make_uniform

SIDE = 11
GRID = Grid([" " * SIDE] * SIDE)
CENTRE, EDGE, CORNER = GRID.numbers[5, 5], GRID.numbers[0, 5], GRID.numbers[0, 0]


class EmptyRoom(TabularEnv):
    """Reach the goal in a room of 11 x 11 cells; moves are north, south, west, east and never fail.

    Args:
        goal: the cell that ends the episode with reward 1; None never ends it.
        horizon: primitives until truncation.
    """

    def __init__(self, goal: int | None = CENTRE, horizon: int | None = 1_000) -> None:
        self.goal = goal
        super().__init__(len(GRID), 4, horizon)

    def outcomes(self, state: int, action: int) -> list[Outcome]:
        if state == self.goal:
            return [Outcome(1.0, state, 0.0, True)]
        there = GRID.move(state, action)
        return [Outcome(1.0, there, float(there == self.goal), there == self.goal)]

    def make_starts(self) -> Array:
        return make_uniform([cell for cell in range(len(GRID)) if cell != self.goal], len(GRID))


def make_macros() -> list[TabularOption]:
    """North, south, west and east until the wall; beside that wall a macro is one move that goes nowhere."""
    cells = len(GRID)
    return [
        TabularOption(
            f"to wall {direction}",
            np.ones(cells, bool),
            make_policy_matrix(np.full(cells, direction), 4),
            np.array([float(GRID.move(cell, direction) == cell) for cell in range(cells)]),
        )
        for direction in range(4)
    ]
