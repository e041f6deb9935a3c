"""An empty room with macro-actions that run to the wall.

McGovern, Sutton and Fagg (1997), Roles of macro-actions in accelerating reinforcement learning.
"""

from __future__ import annotations

import numpy as np

from tests.classic.exact import TabularOption, make_policy_matrix
from tests.classic.goal_grid import GoalGrid
from tests.classic.grid import Grid

SIDE = 11
GRID = Grid([" " * SIDE] * SIDE)
CENTRE, EDGE, CORNER = GRID.numbers[5, 5], GRID.numbers[0, 5], GRID.numbers[0, 0]


class EmptyRoom(GoalGrid):
    """Reach the goal, the centre by default, in a room of 11 x 11 cells."""

    def __init__(self, goal: int | None = CENTRE, horizon: int | None = 1_000) -> None:
        super().__init__(GRID, goal, horizon)


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
