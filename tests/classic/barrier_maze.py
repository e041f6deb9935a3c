"""A maze of 8 x 8 cells with a barrier round the goal, for hierarchies over quarters of quarters.

Dayan and Hinton (1993), Feudal reinforcement learning, have a maze of 8 x 8 cells with a barrier, which is not
published as data; this barrier is ours.
"""

from __future__ import annotations

from tests.classic.goal_grid import GoalGrid
from tests.classic.grid import Grid

SIDE = 8
GRID = Grid(
    [
        "        ",
        "  ####  ",
        "     #  ",
        "     #  ",
        "     #  ",
        "  ####  ",
        "        ",
        "        ",
    ]
)
BEHIND, BEYOND = GRID.numbers[3, 4], GRID.numbers[7, 7]
"""Goals: behind the barrier, and in the open."""


class BarrierMaze(GoalGrid):
    """Reach the goal, behind the barrier by default."""

    def __init__(self, goal: int = BEHIND, horizon: int | None = 1_000) -> None:
        super().__init__(GRID, goal, horizon)
