"""A key-and-door maze, small enough to be enumerated.

The rewards, the key and the door are those of Wiering and Schmidhuber (1997), HQ-learning; their maze of 26 x 23 cells
is larger.
"""

from __future__ import annotations

from gymnasium import spaces

from tests.classic.exact import Array
from tests.classic.grid import Grid
from tests.classic.tabular import Outcome, TabularEnv, make_uniform

GRID = Grid(
    [
        "###########",
        "#S    #   #",
        "#     #   #",
        "#     D   #",
        "### ###   #",
        "#     #   #",
        "# ### #   #",
        "#  K# #  G#",
        "###########",
    ]
)
START, KEY, DOOR, GOAL = (GRID.find(mark) for mark in "SKDG")


class KeyDoor(TabularEnv):
    """Fetch the key, pass the door, reach the goal: 500 at the goal, -0.1 for every other move.

    The key is taken on arrival; the door is a wall without it. The state is `cell + cells * has_key`.

    Args:
        aliased: observe only which of the four neighbours are blocked, one of 16.
        horizon: primitives until truncation.
    """

    def __init__(self, aliased: bool = False, horizon: int | None = 1_000) -> None:
        super().__init__(2 * len(GRID), 4, horizon)
        self.aliased = aliased
        if aliased:
            self.observation_space = spaces.Discrete(16)

    def observe(self, state: int) -> int:
        if not self.aliased:
            return state
        has_key, cell = divmod(state, len(GRID))
        return sum(1 << direction for direction in range(4) if self._move(cell, direction, has_key) == cell)

    def outcomes(self, state: int, action: int) -> list[Outcome]:
        has_key, cell = divmod(state, len(GRID))
        if cell == GOAL:
            return [Outcome(1.0, state, 0.0, True)]
        there = self._move(cell, action, has_key)
        found = max(has_key, int(there == KEY))
        return [Outcome(1.0, there + len(GRID) * found, 500.0 if there == GOAL else -0.1, there == GOAL)]

    def _move(self, cell: int, direction: int, has_key: int) -> int:
        there = GRID.move(cell, direction)
        return cell if there == DOOR and not has_key else there

    def make_starts(self) -> Array:
        return make_uniform([START], 2 * len(GRID))
