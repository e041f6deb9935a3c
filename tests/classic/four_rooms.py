"""Four Rooms: Sutton, Precup and Singh (1999), Between MDPs and semi-MDPs, Artificial Intelligence 112.

Three slips go by the same name: the one of the paper, and the two of Bacon, Harb and Precup (2017), The option-critic
architecture, whose text and published program differ. Their optima differ too, so every result must name its slip.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Literal

import numpy as np

from tests.classic.exact import Array, Mask, TabularOption, find_fewest_primitives, make_subgoal_option
from tests.classic.grid import Grid
from tests.classic.tabular import Outcome, State, Tables, TabularEnv, make_uniform

GRID = Grid(
    [
        "#############",
        "#     #     #",
        "#     #     #",
        "#           #",
        "#     #     #",
        "#     #     #",
        "## ####     #",
        "#     ### ###",
        "#     #     #",
        "#     #     #",
        "#           #",
        "#     #     #",
        "#############",
    ]
)

HALLWAYS = tuple(GRID.numbers[cell] for cell in ((3, 6), (6, 2), (7, 9), (10, 6)))
NORTH_HALLWAY, WEST_HALLWAY, EAST_HALLWAY, SOUTH_HALLWAY = HALLWAYS

ROOMS = {
    "north-west": (range(1, 6), range(1, 6), (NORTH_HALLWAY, WEST_HALLWAY)),
    "north-east": (range(1, 7), range(7, 12), (NORTH_HALLWAY, EAST_HALLWAY)),
    "south-west": (range(7, 12), range(1, 6), (WEST_HALLWAY, SOUTH_HALLWAY)),
    "south-east": (range(8, 12), range(7, 12), (EAST_HALLWAY, SOUTH_HALLWAY)),
}
"""Rows, columns and hallways of each room."""

SOUTH_EAST_GOALS = (*range(68, 73), *range(78, 83), *range(88, 94), *range(99, 104))
"""Goals that the program of 2017 draws from after the move: the south-east room and its west doorway."""

Slip = Literal["none", "extra", "neighbour", "direction"]
"""
- none: moves succeed.
- extra: after a move that succeeded, with probability 1/3 one more, to a random free neighbour (program of 2017).
- neighbour: with probability 1/3 the move is one to a random free neighbour instead (text of 2017).
- direction: with probability 1/9 each, one of the three other directions is taken instead (1999).
"""


def move_in_four_rooms(cell: int, direction: int, slip: Slip) -> dict[int, float]:
    """Probability of each cell after a move."""
    intended = GRID.move(cell, direction)
    cells: dict[int, float] = {}

    def add(there: int, probability: float) -> None:
        cells[there] = cells.get(there, 0.0) + probability

    if slip == "none" or (slip == "extra" and intended == cell):
        add(intended, 1.0)
    elif slip == "direction":
        for taken in range(4):
            add(GRID.move(cell, taken), 2 / 3 if taken == direction else 1 / 9)
    else:
        add(intended, 2 / 3)
        neighbours = GRID.list_neighbours(intended if slip == "extra" else cell)
        for there in neighbours:
            add(there, 1 / 3 / len(neighbours))
    return cells


class FourRooms(TabularEnv):
    """Reach the goal; cells are numbered row by row, moves are north, south, west, east.

    Args:
        goal: the cell that ends the episode; None never ends it.
        slip: what a move may become.
        starts: cells to start in, equally likely; None is every cell but the goal.
        reward: on arrival at the goal; every other move gives 0.
        horizon: primitives until truncation.
    """

    def __init__(
        self,
        goal: int | None = EAST_HALLWAY,
        slip: Slip = "direction",
        starts: Sequence[int] | None = None,
        reward: float = 1.0,
        horizon: int | None = 1_000,
    ) -> None:
        self.goal, self.reward = goal, reward
        self.slip: Slip = slip
        self.first = [cell for cell in range(len(GRID)) if cell != goal] if starts is None else list(starts)
        super().__init__(len(GRID), 4, horizon)

    def outcomes(self, state: int, action: int) -> list[Outcome]:
        if state == self.goal:
            return [Outcome(1.0, state, 0.0, True)]
        return [
            Outcome(probability, cell, self.reward * (cell == self.goal), cell == self.goal)
            for cell, probability in move_in_four_rooms(state, action, self.slip).items()
        ]

    def make_starts(self) -> Array:
        return make_uniform(self.first, len(GRID))


@cache
def _count_primitives() -> dict[tuple[float, ...], float]:
    """(row, column, row, column) -> fewest primitives from the first cell to the second, without slips."""
    return {(*GRID.cells[start], *GRID.cells[end]): steps for end in range(len(GRID))
            for start, steps in enumerate(find_fewest_primitives(FourRooms(end, "none").make_tables()))}


def count_primitives_between(start: Array, ends: Array) -> Array:
    """Fewest primitives from a cell (row, column) to others (cells, 2), without slips; inf to walls."""
    return np.array([_count_primitives().get((*start.tolist(), *end), np.inf) for end in np.asarray(ends).tolist()])


def walk_greedily(agent: Any, env: FourRooms, start: int) -> tuple[int, bool]:
    """Primitives of an agent's greedy policy from a cell, and whether it arrived within the horizon."""
    env.reset(seed=0)
    env.set_state(State(start))
    cell, rng, over, arrived = start, np.random.default_rng(start), False, False
    while not over:
        cell, _, arrived, truncated, _ = env.step(agent.act_greedy(cell, np.ones(4, np.bool_), rng))
        over = arrived or truncated
    return env.state.elapsed, arrived


def make_room_mask(room: str) -> Mask:
    """The cells of a room, without its hallways."""
    rows, columns, _ = ROOMS[room]
    return np.array([row in rows and column in columns for row, column in GRID.cells])


def make_hallway_options(slip: Slip = "direction", gamma: float = 0.9) -> list[TabularOption]:
    """The eight options of 1999: out of each room by each of its two hallways.

    An option may start in its room and in the other hallway of that room. It stops wherever it may not start.
    """
    tables: Tables = FourRooms(None, slip).make_tables()
    options = []
    for room, (_, _, hallways) in ROOMS.items():
        for target, other in (hallways, hallways[::-1]):
            inside = make_room_mask(room)
            inside[other] = True
            targets = np.arange(len(GRID)) == target
            options.append(make_subgoal_option(f"{room} to {GRID.cells[target]}", tables, inside, targets, gamma))
    return options
