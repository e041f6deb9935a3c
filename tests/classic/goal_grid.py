"""Grids with one goal: the rule that the empty room and the barrier maze share."""

from __future__ import annotations

from tests.classic.exact import Array
from tests.classic.grid import Grid
from tests.classic.tabular import Outcome, TabularEnv, make_uniform


class GoalGrid(TabularEnv):
    """Reach the goal from anywhere; moves are north, south, west, east and never fail.

    Args:
        grid: its cells.
        goal: the cell that ends the episode with reward 1; None never ends it.
        horizon: primitives until truncation.
    """

    def __init__(self, grid: Grid, goal: int | None, horizon: int | None) -> None:
        self.grid, self.goal = grid, goal
        super().__init__(len(grid), 4, horizon)

    def outcomes(self, state: int, action: int) -> list[Outcome]:
        if state == self.goal:
            return [Outcome(1.0, state, 0.0, True)]
        there = self.grid.move(state, action)
        return [Outcome(1.0, there, float(there == self.goal), there == self.goal)]

    def make_starts(self) -> Array:
        return make_uniform([cell for cell in range(len(self.grid)) if cell != self.goal], len(self.grid))
