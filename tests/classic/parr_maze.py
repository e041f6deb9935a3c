"""A maze of intersections and hallways with obstacles, after Parr and Russell (1998).

Reinforcement learning with hierarchies of machines, NIPS 10, has a maze of about 3,600 cells, which is not published
as data. This one repeats its elements at any size: intersections, hallways between neighbouring ones, and in every
hallway an obstacle with a pocket, out of which a machine must back off.
"""

from __future__ import annotations

import numpy as np

from tests.classic.exact import Array, Mask, TabularOption, make_subgoal_option
from tests.classic.grid import MOVES, SIDES, Grid
from tests.classic.tabular import Outcome, TabularEnv, make_uniform

WIDTH, LENGTH = 3, 7
"""Cells across and along a hallway; an intersection is `WIDTH` x `WIDTH`."""

PITCH = WIDTH + LENGTH

OBSTACLE = (
    "       ",
    "   ##  ",
    "    #  ",
)
"""A hallway from above, with its pocket."""

NOISE = 0.2


def draw_maze(blocks: int) -> Grid:
    """The cells of `blocks` x `blocks` intersections; obstacles are mirrored in every second hallway."""
    side = blocks * PITCH - LENGTH + 2
    cells = np.full((side, side), "#")
    obstacle = np.array([list(row) for row in OBSTACLE])
    for row in range(blocks):
        for column in range(blocks):
            top, left = 1 + row * PITCH, 1 + column * PITCH
            cells[top : top + WIDTH, left : left + WIDTH] = " "
            turned = obstacle[::-1, ::-1] if (row + column) % 2 else obstacle
            if column + 1 < blocks:
                cells[top : top + WIDTH, left + WIDTH : left + PITCH] = turned
            if row + 1 < blocks:
                cells[top + WIDTH : top + PITCH, left : left + WIDTH] = turned.T
    return Grid(["".join(row) for row in cells])


class ParrMaze(TabularEnv):
    """From the centre of the north-west intersection into the south-east one; every move costs 1.

    Args:
        blocks: intersections along a side; 9 come near the size of the published maze, far beyond what `exact` solves.
        noise: probability that a move goes to one of its sides instead.
        horizon: primitives until truncation.
    """

    def __init__(self, blocks: int = 3, noise: float = NOISE, horizon: int | None = 10_000) -> None:
        self.blocks, self.noise = blocks, noise
        self.grid = draw_maze(blocks)
        self.start, self.goal = self.grid.numbers[self._find_centre(0)], blocks**2 - 1
        super().__init__(len(self.grid), 4, horizon)

    def _find_centre(self, number: int) -> tuple[int, int]:
        row, column = divmod(number, self.blocks)
        return 2 + row * PITCH, 2 + column * PITCH

    def find_intersection(self, cell: int) -> int | None:
        """Number of the intersection that a cell lies in, row by row; None in a hallway."""
        (row, down), (column, right) = (divmod(place - 1, PITCH) for place in self.grid.cells[cell])
        return row * self.blocks + column if down < WIDTH and right < WIDTH else None

    def outcomes(self, state: int, action: int) -> list[Outcome]:
        if self.find_intersection(state) == self.goal:
            return [Outcome(1.0, state, 0.0, True)]
        directions = [(action, 1 - self.noise), *((side, self.noise / 2) for side in SIDES[action])]
        arrived = [(self.grid.move(state, direction), probability) for direction, probability in directions]
        return [
            Outcome(probability, cell, -1.0, self.find_intersection(cell) == self.goal)
            for cell, probability in arrived
            if probability
        ]

    def make_starts(self) -> Array:
        return make_uniform([self.start], len(self.grid))

    def find_next(self, number: int, direction: int) -> int | None:
        """The next intersection in a direction; None at the border."""
        row, column = (place + step for place, step in zip(divmod(number, self.blocks), MOVES[direction], strict=True))
        return row * self.blocks + column if 0 <= row < self.blocks and 0 <= column < self.blocks else None

    def make_hallway_options(self, gamma: float = 0.99) -> list[TabularOption]:
        """From each intersection through each of its hallways into the next intersection, as soon as possible.

        An option may start in its intersection and in its hallway. It stops wherever it may not start.
        """
        tables = self.make_tables()
        where = [self.find_intersection(cell) for cell in range(len(self.grid))]
        options = []
        for number in range(self.blocks**2):
            for direction in range(4):
                target = self.find_next(number, direction)
                if target is not None:
                    inside = self._make_passage_mask(number, target) & np.array([place != target for place in where])
                    targets = np.array([place == target for place in where])
                    name = f"{number} to {target}"
                    options.append(make_subgoal_option(name, tables, inside, targets, gamma))
        return options

    def _make_passage_mask(self, number: int, other: int) -> Mask:
        """The cells of two neighbouring intersections and of the hallway between them."""
        (top, left), (bottom, right) = (self._find_centre(end) for end in sorted((number, other)))
        return np.array([top - 1 <= y <= bottom + 1 and left - 1 <= x <= right + 1 for y, x in self.grid.cells])
