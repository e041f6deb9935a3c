"""A maze of 8 x 8 cells with a barrier round the goal, for hierarchies over quarters of quarters.

Dayan and Hinton (1993), Feudal reinforcement learning, have a maze of 8 x 8 cells with a barrier, which is not
published as data; this barrier is ours.
"""

from __future__ import annotations

from tests.classic.exact import Array
from tests.classic.grid import Grid
from tests.classic.tabular import Outcome, TabularEnv, make_uniform

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


class BarrierMaze(TabularEnv):
    """Reach the goal; moves are north, south, west, east and never fail.

    Args:
        goal: the cell that ends the episode with reward 1.
        horizon: primitives until truncation.
    """

    def __init__(self, goal: int = BEHIND, horizon: int | None = 1_000) -> None:
        self.goal = goal
        super().__init__(len(GRID), 4, horizon)

    def outcomes(self, state: int, action: int) -> list[Outcome]:
        if state == self.goal:
            return [Outcome(1.0, state, 0.0, True)]
        there = GRID.move(state, action)
        return [Outcome(1.0, there, float(there == self.goal), there == self.goal)]

    def make_starts(self) -> Array:
        return make_uniform([cell for cell in range(len(GRID)) if cell != self.goal], len(GRID))
