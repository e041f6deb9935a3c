"""Searches of a room by its inner doors: to a planner, a shut door is a wall of an edited room.

The search of the room with some doors shut is adapted from that with all open: it takes over the grid and the fields,
and repairs what the doors change.
"""

from __future__ import annotations

import dataclasses
import math
from collections import OrderedDict
from collections.abc import Iterator

from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import Target
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.planning.goals import ExitGoal, Goal, GripGoal, PoseGoal, PressGoal
from hrl_escape.planning.primitive_search import PrimitiveSearch

__all__ = ["DoorSearches", "is_way_open", "list_places"]

MOST_SEARCHES = 16
"""Sets of shut doors whose searches are kept."""
_MOST_CELLS = 12
"""Cells that are tried for putting something down."""


class DoorSearches:
    """Searches of one room, by the inner doors that are shut.

    Args:
        opened: search of the room with all of them open.
    """

    def __init__(self, opened: PrimitiveSearch) -> None:
        self._opened, self._rules, self._room = opened, opened.kinematics, opened.instance
        self._searches: OrderedDict[int, PrimitiveSearch] = OrderedDict()

    def choose(self, state: RoomState) -> PrimitiveSearch:
        """The search of the room as its inner doors stand in a state."""
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
        """Bits of the inner doors that are shut, but for those in which the body stands."""
        doors = self._rules.inner_doors
        return 0 if doors is None else doors.find_blocking(state.x, state.y, state.puzzle)


def is_way_open(rules: Kinematics, state: RoomState, goal: Goal) -> bool:
    """Return whether the inner doors on the way to a target or the exit are open; true where nothing is known of it."""
    ways, doors = rules.instance.ways, rules.inner_doors
    number = goal.target if isinstance(goal, (PressGoal, GripGoal)) else len(rules.instance.targets)
    if doors is None or number >= len(ways) or not isinstance(goal, (PressGoal, GripGoal, ExitGoal)):
        return True
    shut = doors.get_shut(state.puzzle)
    return not any(shut >> door & 1 for door in ways[number])


def list_places(goal: GripGoal, state: RoomState, rules: Kinematics) -> Iterator[list[PoseGoal]]:
    """Places from which a grip, release or use is possible: for one cell after the other, the four beside it.

    What is held may be put down in any cell where it bars no way: the nearest of these cells come first.
    """
    room, step = rules.instance, rules.instance.robot.move_step
    cells: list[Target | Solid] = [room.targets[goal.target]]
    if goal.action == "release":
        cells = [room.inner_doors[number] for number in room.puzzle.list_rests(state.puzzle)]
        cells.sort(key=lambda cell: math.hypot(cell.x - state.x, cell.y - state.y))
    sides = ((1, 0, 0.0), (0, 1, math.pi / 2), (-1, 0, math.pi), (0, -1, -math.pi / 2))
    for cell in cells[:_MOST_CELLS]:
        yield [PoseGoal(cell.x - step * x, cell.y - step * y, heading, step / 4, rules.turn_step / 2 - 1e-6)
               for x, y, heading in sides]
