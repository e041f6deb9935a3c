"""Taxi: Dietterich (2000), Hierarchical reinforcement learning with the MAXQ value function decomposition, JAIR 13.

The rules are those of the paper, which `gymnasium.make("Taxi-v4")` shares but for three: an illegal put-down costs 10
also at another depot and leaves the passenger in the taxi; a noisy move slips to its sides also where the intended way
is blocked; and the state says whether a fickle passenger may still change his mind.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tests.classic.exact import Array, Mask, NestedTask
from tests.classic.tabular import Outcome, TabularEnv, make_uniform

MAP = (
    "|R: | : :G|",
    "| : | : : |",
    "| : : : : |",
    "| | : | : |",
    "|Y| : |B: |",
)
DEPOTS = ((0, 0), (0, 4), (4, 0), (4, 3))
"""Red, green, yellow, blue."""

SOUTH, NORTH, EAST, WEST, PICK_UP, PUT_DOWN = range(6)
SIDES = ((EAST, WEST), (EAST, WEST), (NORTH, SOUTH), (NORTH, SOUTH))

IN_TAXI, JUST_PICKED_UP = 4, 5
"""Places of the passenger beyond the depots; a fickle one who was just picked up may change the destination."""

NOISE = 0.2
FICKLENESS = 0.3


class Ride(NamedTuple):
    """A state of Taxi."""

    row: int
    column: int
    passenger: int
    destination: int

    @property
    def riding(self) -> bool:
        """The passenger sits in the taxi."""
        return self.passenger >= IN_TAXI


def encode(ride: Ride) -> int:
    """Number of a state; below 500 that of Gymnasium."""
    if ride.passenger == JUST_PICKED_UP:
        return 500 + (ride.row * 5 + ride.column) * 4 + ride.destination
    return ((ride.row * 5 + ride.column) * 5 + ride.passenger) * 4 + ride.destination


def decode(number: int) -> Ride:
    """State of a number."""
    if number >= 500:
        cell, destination = divmod(number - 500, 4)
        return Ride(*divmod(cell, 5), JUST_PICKED_UP, destination)
    rest, destination = divmod(number, 4)
    cell, passenger = divmod(rest, 5)
    return Ride(*divmod(cell, 5), passenger, destination)


def move(row: int, column: int, direction: int) -> tuple[int, int]:
    """The cell that a direction leads to."""
    if direction == SOUTH:
        return min(row + 1, 4), column
    if direction == NORTH:
        return max(row - 1, 0), column
    step = 1 if direction == EAST else -1
    free = MAP[row][2 * column + 1 + step] == ":"
    return row, column + step if free else column


class Taxi(TabularEnv):
    """Fetch the passenger and bring him to his destination.

    A move costs 1, an illegal pick-up or put-down 10, a delivery gives 20.

    Args:
        noisy: a move goes to each of its two sides with probability 0.1.
        fickle: on the first step away from where he was picked up, the passenger changes his destination with
            probability 0.3, to any of the other three.
        anywhere: the passenger may wait at his destination.
        horizon: primitives until truncation.
    """

    def __init__(
        self, noisy: bool = False, fickle: bool = False, anywhere: bool = False, horizon: int | None = 1_000
    ) -> None:
        self.noisy, self.fickle, self.anywhere = noisy, fickle, anywhere
        super().__init__(600 if fickle else 500, 6, horizon)

    def outcomes(self, state: int, action: int) -> list[Outcome]:
        ride = decode(state)
        depot = DEPOTS.index((ride.row, ride.column)) if (ride.row, ride.column) in DEPOTS else None
        if action == PICK_UP:
            if ride.riding or ride.passenger != depot:
                return [Outcome(1.0, state, -10.0)]
            return [Outcome(1.0, encode(ride._replace(passenger=JUST_PICKED_UP if self.fickle else IN_TAXI)), -1.0)]
        if action == PUT_DOWN:
            if not ride.riding or ride.destination != depot:
                return [Outcome(1.0, state, -10.0)]
            return [Outcome(1.0, encode(ride._replace(passenger=ride.destination)), 20.0, True)]
        directions = [(action, 1.0)]
        if self.noisy:
            directions = [(action, 1 - NOISE), *((side, NOISE / 2) for side in SIDES[action])]
        return [
            Outcome(probability * share, encode(arrived), -1.0)
            for direction, probability in directions
            for arrived, share in self._arrive(ride, *move(ride.row, ride.column, direction))
        ]

    def _arrive(self, ride: Ride, row: int, column: int) -> list[tuple[Ride, float]]:
        """States after a move, with their probabilities."""
        arrived = ride._replace(row=row, column=column)
        if ride.passenger != JUST_PICKED_UP or (row, column) == (ride.row, ride.column):
            return [(arrived, 1.0)]
        settled = arrived._replace(passenger=IN_TAXI)
        others = [depot for depot in range(4) if depot != ride.destination]
        changed = [(settled._replace(destination=depot), FICKLENESS / len(others)) for depot in others]
        return [(settled, 1 - FICKLENESS), *changed]

    def make_starts(self) -> Array:
        rides = [decode(number) for number in range(500)]
        waiting = [ride for ride in rides if not ride.riding]
        first = [ride for ride in waiting if self.anywhere or ride.passenger != ride.destination]
        return make_uniform([encode(ride) for ride in first], self.states)


def make_task_graph(states: int) -> NestedTask:
    """The graph of the paper: root -> get, put -> navigate to each depot -> moves.

    Args:
        states: 500, or 600 for a fickle passenger.
    """
    rides = [decode(number) for number in range(states)]

    def select(rule: Callable[[Ride], bool]) -> Mask:
        return np.array([rule(ride) for ride in rides])

    navigate = [
        NestedTask(f"navigate {depot}", range(4), select(lambda ride, cell=cell: (ride.row, ride.column) == cell))
        for depot, cell in enumerate(DEPOTS)
    ]
    riding = select(lambda ride: ride.riding)
    get = NestedTask("get", [PICK_UP, *navigate], riding)
    put = NestedTask("put", [PUT_DOWN, *navigate], ~riding)
    return NestedTask("root", [get, put], np.zeros(states, bool))
