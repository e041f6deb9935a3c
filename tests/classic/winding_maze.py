"""A corridor that turns back on itself, seen through its walls alone: where to go depends on what went before.

After the mazes of Wiering and Schmidhuber (1997), HQ-learning, whose layouts are published as pictures only.
"""

from __future__ import annotations

from gymnasium import spaces

from tests.classic.exact import Array
from tests.classic.grid import Grid
from tests.classic.tabular import Outcome, TabularEnv, make_uniform

GRIDS = {
    1: Grid(["#######", "#S    #", "##### #", "#G    #", "#######"]),
    2: Grid(["#######", "#S    #", "##### #", "#     #", "# #####", "#    G#", "#######"]),
}
"""By how often the corridor turns back."""

REWARD = 100.0


class WindingMaze(TabularEnv):
    """From the start to the goal, which is paid 100; moves are north, south, west, east and never fail.

    East, then west, then at two turns east again, in corridors that look alike: it takes one reactive policy more than
    there are turns.

    Args:
        turns: 1 or 2.
        aliased: observe only which of the four neighbours are blocked, one of 16.
        horizon: primitives until truncation.
    """

    def __init__(self, turns: int = 1, aliased: bool = True, horizon: int | None = 1_000) -> None:
        self.grid, self.aliased = GRIDS[turns], aliased
        self.goal = self.grid.find("G")
        super().__init__(len(self.grid), 4, horizon)
        if aliased:
            self.observation_space = spaces.Discrete(16)

    def observe(self, state: int) -> int:
        if not self.aliased:
            return state
        return sum(1 << direction for direction in range(4) if self.grid.move(state, direction) == state)

    def outcomes(self, state: int, action: int) -> list[Outcome]:
        if state == self.goal:
            return [Outcome(1.0, state, 0.0, True)]
        there = self.grid.move(state, action)
        return [Outcome(1.0, there, REWARD * (there == self.goal), there == self.goal)]

    def make_starts(self) -> Array:
        return make_uniform([self.grid.find("S")], len(self.grid))
