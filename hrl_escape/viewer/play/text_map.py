"""The map of a room in coloured letters, for terminals."""

from __future__ import annotations

import math

from rich.text import Text

from hrl_escape.env.drawing import palette
from hrl_escape.env.geometry import compute_distance
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.env.puzzles.traits import Barring, get_trait
from hrl_escape.planning.props import get_prop_poses

__all__ = ["draw_map"]

_ARROWS = "\N{RIGHTWARDS ARROW}\N{NORTH EAST ARROW}\N{UPWARDS ARROW}\N{NORTH WEST ARROW}" \
          "\N{LEFTWARDS ARROW}\N{SOUTH WEST ARROW}\N{DOWNWARDS ARROW}\N{SOUTH EAST ARROW}"
_WALL, _OBSTACLE = ("\N{FULL BLOCK}", "#7b818c"), ("\N{MEDIUM SHADE}", palette.OBSTACLE_EDGE)
_DOOR, _TRAIL = ("\N{DARK SHADE}", palette.DOOR), ("\N{MIDDLE DOT}", palette.TRAIL)
_BLOCK, _PLATE = ("\N{BLACK SQUARE}", palette.PROP), ("\N{WHITE SQUARE}", palette.PROP)


def draw_map(instance: RoomInstance, states: list[RoomState], rules: Rules, columns: int, rows: int) -> Text:
    """Draw the room from above at the last state, with the way there as dots.

    A character counts as half as wide as high.

    Args:
        instance: the room.
        states: the episode so far.
        rules: rules of the room.
        columns: maximum number of characters in a line.
        rows: maximum number of lines.
    """
    state, puzzle = states[-1], instance.puzzle
    wide, high = instance.reach_x + 0.5, instance.reach_y + 0.5
    size = max(2 * wide / (columns / 2), 2 * high / rows)  # m a line
    columns, rows = max(1, round(4 * wide / size)), max(1, round(2 * high / size))
    cells: list[list[tuple[str, str]]] = [[(" ", "")] * columns for _ in range(rows)]

    def put(x: float, y: float, character: str, style: str) -> None:
        column, row = int((x + wide) / (2 * wide) * columns), int((high - y) / (2 * high) * rows)
        if 0 <= column < columns and 0 <= row < rows:
            cells[row][column] = character, style

    is_open = puzzle.is_solved(state.puzzle)
    reach = size / 4
    for row in range(rows):
        for column in range(columns):
            x, y = (column + 0.5) / columns * 2 * wide - wide, high - (row + 0.5) / rows * 2 * high
            if instance.exit.contains(x, y):
                cells[row][column] = ("\N{LIGHT SHADE}", palette.EXIT_OPEN if is_open else palette.EXIT_LOCKED)
            for solid in instance.solids:
                if compute_distance(x, y, solid.footprint) <= reach:
                    cells[row][column] = _WALL if solid.role == "wall" else _OBSTACLE
            if instance.door is not None and not is_open and compute_distance(x, y, instance.door.footprint) <= reach:
                cells[row][column] = _DOOR
    for past in states[:-1]:
        put(past.x, past.y, *_TRAIL)
    for placed, (x, y, _) in zip(instance.props, get_prop_poses(state, instance), strict=True):
        put(x, y, *(_BLOCK if placed.prop.kind == "block" else _PLATE))
    for index, target in enumerate(instance.targets):
        look = palette.get_target_look(puzzle, state.puzzle, index)
        for n in range(-8, 9):
            put(target.x + n / 8 * target.half_x * math.cos(target.yaw),
                target.y + n / 8 * target.half_x * math.sin(target.yaw), " ", f"{look.ink} on {look.fill}")
        for n, character in enumerate(target.name.rpartition("-")[2]):
            put(target.x + n * size / 2, target.y, character, f"bold {look.ink} on {look.fill}")
    shut = get_trait(puzzle, Barring).get_shut(state.puzzle)
    for number, door in enumerate(instance.inner_doors):
        if shut >> number & 1:
            put(door.x, door.y, *(_DOOR if door.role == "door" else _BLOCK))
    ground = palette.EXIT_OPEN if is_open else palette.EXIT_LOCKED
    put(*instance.exit.centre, "E", f"bold {palette.EXIT_INK} on {ground}")
    arrow = _ARROWS[round(rules.get_heading(state) / (math.pi / 4)) % 8]
    put(state.x, state.y, arrow, f"bold white on {palette.BODY}")
    text = Text()
    for line in cells:
        for character, style in line:
            text.append(character, style)
        text.append("\n")
    return text
