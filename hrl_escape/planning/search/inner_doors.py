"""Searches of a room for each set of shut inner doors: to a planner, a shut door is a wall of an edited room.

The search of the room with some doors shut is adapted from that with all open: it takes over the grid and the fields,
and repairs what the doors change.
"""

from __future__ import annotations

import dataclasses
import math
from collections import OrderedDict
from collections.abc import Iterator
from functools import cached_property
from typing import TypeAlias

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.puzzles.traits import Mapped, get_trait
from hrl_escape.planning.goals import ExitGoal, Goal, GripGoal, PoseGoal, PressGoal, is_reached
from hrl_escape.planning.search.primitive_search import PrimitiveSearch

MOST_SEARCHES = 16
"""Most sets of shut doors whose searches are kept."""
_MOST_CELLS = 12
"""Most cells tried for putting something down."""
_SIDES = {"east": (1, 0, 0.0), "north": (0, 1, math.pi / 2), "west": (-1, 0, math.pi), "south": (0, -1, -math.pi / 2)}
"""Steps along x and y to each side, and the heading for it."""

DoorKey: TypeAlias = tuple[int, tuple[int, ...]]
"""Bits of the inner doors that are shut, and numbers of those in whose cells a grip or push is possible."""


class DoorSearches:
    """Searches of one room with inner doors, by those that are shut.

    Args:
        opened: search of the room with all of them open.
    """

    def __init__(self, opened: PrimitiveSearch) -> None:
        assert opened.kinematics.inner_doors is not None
        self._opened, self._rules, self._room = opened, opened.kinematics, opened.instance
        self._doors = opened.kinematics.inner_doors
        self._searches: OrderedDict[int, PrimitiveSearch] = OrderedDict()

    def choose(self, state: RoomState) -> PrimitiveSearch:
        """Return the search of the room with its inner doors as in a state."""
        walls = self.find_walls(state)
        if not walls:
            return self._opened
        if walls not in self._searches:
            doors = (door for number, door in enumerate(self._room.inner_doors) if walls >> number & 1)
            room = dataclasses.replace(self._room, solids=(*self._room.solids, *doors))
            self._searches[walls] = self._opened.adapt(room, self._rules)
            if len(self._searches) > MOST_SEARCHES:
                self._searches.popitem(last=False)
        self._searches.move_to_end(walls)
        return self._searches[walls]

    def find_walls(self, state: RoomState) -> int:
        """Bits of the shut inner doors, except those in which the body stands."""
        return self._doors.find_blocking(state.x, state.y, state.puzzle)

    def can_walk(self, state: RoomState, goal: GripGoal) -> bool:
        """Return whether free cells lead to one from which the goal's thing is pushed.

        For goals other than pushes, the puzzle's own model accounts for what blocks the way.
        """
        doors, side = self._doors, goal.action.partition("push-")[2]
        if not side:
            return True
        behind = (list(_SIDES).index(side) + 2) % 4
        cells = list_cells(self._room, state, goal)
        wanted, shut = {self._beside[cell][behind] for cell in cells}, doors.get_shut(state.puzzle)
        queue = [doors.find_at(state.x, state.y)]
        reached = {-1, *queue}
        for number in queue:
            free = [cell for cell in self._beside[number] if cell not in reached and not shut >> cell & 1]
            reached.update(free)
            queue += free
        return bool(wanted.intersection(queue))

    @cached_property
    def _beside(self) -> list[list[int]]:
        """Numbers of the inner doors one move to each side of each, -1 for none."""
        step = self._rules.actions.stride
        return [[self._doors.find_at(cell.x + step * x, cell.y + step * y) for x, y, _ in _SIDES.values()]
                for cell in self._room.inner_doors]

    def make_key(self, state: RoomState, goal: Goal) -> DoorKey:
        """Cache key: everything about the inner doors on which a route to a goal depends."""
        return self.find_walls(state), list_cells(self._room, state, goal) if isinstance(goal, GripGoal) else ()


def list_cells(room: RoomInstance, state: RoomState, goal: GripGoal) -> tuple[int, ...]:
    """Numbers of the inner doors' cells in which a goal's action can be carried out now, on a map."""
    return get_trait(room.puzzle, Mapped).list_cells(state.puzzle, goal.action, goal.target)


def is_way_open(rules: Kinematics, state: RoomState, goal: Goal) -> bool:
    """Return whether the inner doors on the way to a target or the exit are open; true where the ways are unknown."""
    ways, doors = rules.instance.ways, rules.inner_doors
    number = goal.target if isinstance(goal, (PressGoal, GripGoal)) else len(rules.instance.targets)
    if doors is None or number >= len(ways) or not isinstance(goal, (PressGoal, GripGoal, ExitGoal)):
        return True
    shut = doors.get_shut(state.puzzle)
    return not any(shut >> door & 1 for door in ways[number])


def list_places(goal: GripGoal, state: RoomState, rules: Kinematics) -> Iterator[list[PoseGoal]]:
    """List the places from which a grip, release, use or push is possible, cell by cell.

    There are four, or one behind a thing that is pushed. What is held may be put down in several cells: the nearest
    ones come first.
    """
    room, step = rules.instance, rules.actions.stride
    cells = [room.inner_doors[number] for number in list_cells(room, state, goal)]
    cells.sort(key=lambda cell: math.hypot(cell.x - state.x, cell.y - state.y))
    side = goal.action.partition("push-")[2]
    any_heading = bool(side) and rules.headings == rules.actions.symmetry  # a move leads to that side from each place
    for cell in cells[:_MOST_CELLS]:
        yield [PoseGoal(cell.x - step * x, cell.y - step * y, None if any_heading else heading, step / 4,
                        rules.turn_step / 2 - 1e-6)
               for name, (x, y, heading) in _SIDES.items() if side in ("", name)]


def find_move(goal: GripGoal, state: RoomState, rules: Kinematics) -> int | None:
    """Primitive that reaches a goal from its place; None if none does, such as at a wrong heading."""
    if not goal.action.startswith("push-"):
        return rules.actions.find(goal.action)
    moves = (move for move in rules.actions.translations
             if is_reached(goal, state, rules.step(state, move).state, rules))
    return next(moves, None)
