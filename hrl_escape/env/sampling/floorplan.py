"""Walls: the outer rectangle, interior walls with doorways, and the alcove behind an exit door.

All functions are pure given a random generator. They return solids and the wall faces where panels can hang.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from hrl_escape.env.config import CONTACT_SKIN, RoomConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import Rectangle
from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.env.puzzles.maps import GridMap
from hrl_escape.env.puzzles.mixins import Mapped, get_mixin


class Rejected(Exception):
    """The sample violates a constraint that another sample may satisfy; the message names it."""


class Face(NamedTuple):
    """A stretch of wall seen from inside: from (x, y), `length` along direction `yaw`. The room is on its left."""

    x: float
    y: float
    yaw: float
    length: float


class Doorway(NamedTuple):
    """Gap in an interior wall: the door that would fill it, and the indices of the two rooms that it joins."""

    door: Solid
    rooms: tuple[int, int]


class Floorplan(NamedTuple):
    """Sampled walls, and the rooms between them."""

    solids: tuple[Solid, ...]
    door: Solid | None
    faces: tuple[Face, ...]
    exit: Rectangle
    rooms: tuple[Rectangle, ...]
    doorways: tuple[Doorway, ...]


def sample_floorplan(config: RoomConfig, rng: np.random.Generator, puzzle: Puzzle) -> Floorplan:
    """Sample walls and exit of a room configuration. The map of a puzzle defines the walls and possibly the exit.

    Raises:
        Rejected: interior walls or exit do not fit in this sample.
    """
    half_x, half_y = config.room.width / 2, config.room.depth / 2
    sides = (Face(-half_x, -half_y, 0.0, 2 * half_x), Face(half_x, -half_y, math.pi / 2, 2 * half_y),
             Face(half_x, half_y, math.pi, 2 * half_x), Face(-half_x, half_y, -math.pi / 2, 2 * half_y))
    gates: dict[int, tuple[float, float]] = {}
    alcove: list[Solid] = []
    door = None
    rows = get_mixin(puzzle, Mapped).map_rows
    goal = GridMap(rows).goal if rows else None
    if goal is not None:
        exit_area = _rectangle(*compute_cell(config, goal), config.room.cell / 2, config.room.cell / 2)
    elif config.exit.door:
        side, at = _choose_gate(config, sides, rng)
        gates[side] = (at - config.exit.width / 2, at + config.exit.width / 2)
        exit_area, door, alcove = _make_alcove(config, sides[side], at)
    elif config.exit.place == "fixed":
        exit_area = _rectangle(config.exit.x, config.exit.y, config.exit.width / 2, config.exit.depth / 2)
        if is_whole_floor(config, exit_area):
            exit_area = _rectangle(0.0, 0.0, half_x, half_y)  # an exit on the whole floor ends at the edge of the floor
    else:
        exit_area = _place_exit(config, rng)
    solids: list[Solid] = []
    faces: list[Face] = []
    for number, side in enumerate(sides):
        pieces = _cut(0.0, side.length, gates.get(number))
        for low, high in pieces:
            solids.append(_wall_piece(config, side, low, high))
            faces.append(Face(*_along(side, low), side.yaw, high - low))
    inner, inner_faces, rooms, doors = _sample_interior(config, gates, sides, rng)
    given = (*_build_map(config, get_mixin(puzzle, Mapped).map_rows or config.room.map), *_build_walls(config))
    doorways = tuple(Doorway(gap, _find_joined(gap, rooms)) for gap in doors)
    return Floorplan((*solids, *alcove, *inner, *given), door, (*faces, *inner_faces), exit_area, rooms, doorways)


def is_whole_floor(config: RoomConfig, area: Rectangle) -> bool:
    """Return whether an exit covers the whole floor."""
    half_x, half_y = config.room.width / 2, config.room.depth / 2
    return area.contains(half_x, half_y) and area.contains(-half_x, -half_y)


def _find_joined(door: Solid, rooms: tuple[Rectangle, ...]) -> tuple[int, int]:
    """Indices of the rooms on both sides of a doorway."""
    beyond = door.half_y + 0.05
    x, y = -math.sin(door.yaw) * beyond, math.cos(door.yaw) * beyond
    one, other = (next(n for n, room in enumerate(rooms) if room.contains(door.x + sign * x, door.y + sign * y))
                  for sign in (-1, 1))
    return one, other


def _build_map(config: RoomConfig, rows: tuple[str, ...]) -> list[Solid]:
    """Walls of a map: one box for each run of wall cells in a row."""
    room, solids = config.room, []
    for row, text in enumerate(rows):
        y, column = room.depth / 2 - (row + 0.5) * room.cell, 0
        for is_wall, run in itertools.groupby(text, "#".__eq__):
            count = len(list(run))
            if is_wall:
                x = (column + count / 2) * room.cell - room.width / 2
                solids.append(Solid("box", x, y, count * room.cell / 2, room.cell / 2, 0.0, room.wall_height, "wall"))
            column += count
    return solids


def compute_cell(config: RoomConfig, cell: int) -> tuple[float, float]:
    """Return the centre of a cell of the floor, m; cells are numbered row by row from the top."""
    side = config.room.cell
    row, column = divmod(cell, round(config.room.width / side))
    return (column + 0.5) * side - config.room.width / 2, config.room.depth / 2 - (row + 0.5) * side


def _build_walls(config: RoomConfig) -> list[Solid]:
    half, solids = config.room.wall_thickness / 2, []
    for wall in config.room.walls:
        along = math.hypot(wall.to_x - wall.x, wall.to_y - wall.y) / 2
        yaw = 0.0 if wall.y == wall.to_y else math.pi / 2
        x, y = (wall.x + wall.to_x) / 2, (wall.y + wall.to_y) / 2
        solids.append(Solid("box", x, y, along, half, yaw, config.room.wall_height, "wall"))
    return solids


def _rectangle(x: float, y: float, half_x: float, half_y: float) -> Rectangle:
    return Rectangle(x - half_x, x + half_x, y - half_y, y + half_y)


def _along(side: Face, distance: float, inward: float = 0.0) -> tuple[float, float]:
    cos, sin = round(math.cos(side.yaw), 15), round(math.sin(side.yaw), 15)
    return side.x + cos * distance - sin * inward, side.y + sin * distance + cos * inward


def _cut(low: float, high: float, gap: tuple[float, float] | None) -> list[tuple[float, float]]:
    if gap is None:
        return [(low, high)]
    return [(a, b) for a, b in ((low, gap[0]), (gap[1], high)) if b - a > 1e-9]


def _wall_piece(config: RoomConfig, side: Face, low: float, high: float) -> Solid:
    """A wall box behind the stretch [low, high] of an outer wall; the last ones also fill the corners."""
    thickness = config.room.wall_thickness
    extra_low = thickness if low <= 0.0 else 0.0
    extra_high = thickness if high >= side.length else 0.0
    x, y = _along(side, (low - extra_low + high + extra_high) / 2, -thickness / 2)
    half = (high - low + extra_low + extra_high) / 2
    return Solid("box", x, y, half, thickness / 2, side.yaw, config.room.wall_height, "wall")


def _choose_gate(config: RoomConfig, sides: tuple[Face, ...], rng: np.random.Generator) -> tuple[int, float]:
    """Outer wall of the exit door, and its position along the wall."""
    half = config.exit.width / 2
    if config.exit.place == "fixed":
        x, y = config.exit.x, config.exit.y
        inward = [math.cos(s.yaw) * (y - s.y) - math.sin(s.yaw) * (x - s.x) for s in sides]
        side = int(np.argmin(inward))
        s = sides[side]
        at = math.cos(s.yaw) * (x - s.x) + math.sin(s.yaw) * (y - s.y)
    else:
        side = int(rng.integers(4))
        at = float(rng.uniform(half, max(half, sides[side].length - half)))
    if not half <= at <= sides[side].length - half:
        raise Rejected("the exit door must fit into its wall")
    return side, at


def _make_alcove(config: RoomConfig, side: Face, at: float) -> tuple[Rectangle, Solid, list[Solid]]:
    """Exit rectangle behind the wall, the door in the wall, and the walls of the alcove."""
    half, depth, thick = config.exit.width / 2, config.exit.depth, config.room.wall_thickness
    height = config.room.wall_height
    # The body's axis must fit inside the exit: the alcove is deeper by the radius of the body.
    deep = thick + depth + config.robot.outer_radius + CONTACT_SKIN
    door_x, door_y = _along(side, at, -thick / 2)
    door = Solid("box", door_x, door_y, half, thick / 2, side.yaw, height, "door")
    walls = []
    for sign in (-1, 1):
        x, y = _along(side, at + sign * (half + thick / 2), -(thick + deep) / 2)
        walls.append(Solid("box", x, y, thick / 2, (deep - thick) / 2 + thick, side.yaw, height, "wall"))
    x, y = _along(side, at, -(deep + thick / 2))
    walls.append(Solid("box", x, y, half + thick, thick / 2, side.yaw, height, "wall"))
    corners = [_along(side, at - half, -thick), _along(side, at + half, -(thick + depth))]
    xs, ys = sorted(c[0] for c in corners), sorted(c[1] for c in corners)
    return Rectangle(xs[0], xs[1], ys[0], ys[1]), door, walls


def _place_exit(config: RoomConfig, rng: np.random.Generator) -> Rectangle:
    """A rectangle on the floor against a random outer wall."""
    half_x, half_y = config.room.width / 2, config.room.depth / 2
    wide, deep = config.exit.width / 2, config.exit.depth / 2
    if wide > half_x or deep > half_y:
        raise Rejected("the exit must fit into the room")
    x, y = rng.uniform(-(half_x - wide), half_x - wide), rng.uniform(-(half_y - deep), half_y - deep)
    wall = int(rng.integers(4))
    if wall < 2:
        y = (half_y - deep) * (1 if wall else -1)
    else:
        x = (half_x - wide) * (1 if wall == 3 else -1)
    return _rectangle(float(x), float(y), wide, deep)


def _sample_interior(config: RoomConfig, gates: dict[int, tuple[float, float]], sides: tuple[Face, ...],
                     rng: np.random.Generator
                     ) -> tuple[list[Solid], list[Face], tuple[Rectangle, ...], list[Solid]]:
    """Split the floor repeatedly, the largest room first, each time with one doorway.

    Returns:
        Walls, their faces, the rooms, and a door for each doorway.
    """
    half_x, half_y = config.room.width / 2, config.room.depth / 2
    thick, gap = config.room.wall_thickness, config.room.doorway_width
    smallest = gap + 2 * thick + 0.2
    rooms = [(-half_x, half_x, -half_y, half_y)]
    openings = []  # (x_min, x_max, y_min, y_max) of floor where no wall may end
    clear = config.robot.outer_radius + CONTACT_SKIN + 0.1
    for number, (low, high) in gates.items():
        corners = [_along(sides[number], low, -clear), _along(sides[number], high, 2 * clear)]
        openings.append((*sorted(c[0] for c in corners), *sorted(c[1] for c in corners)))
    solids: list[Solid] = []
    faces: list[Face] = []
    doors: list[Solid] = []
    while len(rooms) < config.room.rooms:
        rooms.sort(key=lambda r: (r[1] - r[0]) * (r[3] - r[2]))
        for number in range(len(rooms) - 1, -1, -1):
            cut = _find_cut(rooms[number], smallest, thick, gap, clear, openings, rng)
            if cut is not None:
                break
        else:
            raise Rejected(f"{config.room.rooms} rooms with doorways of {gap:g} m must fit into the floor")
        x_min, x_max, y_min, y_max = rooms.pop(number)
        along_y, at, door = cut
        if along_y:  # the wall runs along y at x = at
            rooms += [(x_min, at - thick / 2, y_min, y_max), (at + thick / 2, x_max, y_min, y_max)]
            openings.append((at - thick / 2 - 2 * clear, at + thick / 2 + 2 * clear, door - gap / 2, door + gap / 2))
            span, yaw = (y_min, y_max), math.pi / 2
        else:
            rooms += [(x_min, x_max, y_min, at - thick / 2), (x_min, x_max, at + thick / 2, y_max)]
            openings.append((door - gap / 2, door + gap / 2, at - thick / 2 - 2 * clear, at + thick / 2 + 2 * clear))
            span, yaw = (x_min, x_max), 0.0
        x, y = (at, door) if along_y else (door, at)
        doors.append(Solid("box", x, y, gap / 2, thick / 2, yaw, config.room.wall_height, "door"))
        for low, high in _cut(*span, (door - gap / 2, door + gap / 2)):
            middle = (low + high) / 2
            x, y = (at, middle) if along_y else (middle, at)
            solids.append(Solid("box", x, y, (high - low) / 2, thick / 2, yaw, config.room.wall_height, "wall"))
            if along_y:
                faces.append(Face(at - thick / 2, low, math.pi / 2, high - low))
                faces.append(Face(at + thick / 2, high, -math.pi / 2, high - low))
            else:
                faces.append(Face(low, at + thick / 2, 0.0, high - low))
                faces.append(Face(high, at - thick / 2, math.pi, high - low))
    return solids, faces, tuple(Rectangle(*room) for room in rooms), doors


def _find_cut(room: tuple[float, float, float, float], smallest: float, thick: float, gap: float, clear: float,
              openings: list[tuple[float, ...]], rng: np.random.Generator) -> tuple[bool, float, float] | None:
    """(whether the wall runs along y, its coordinate, centre of its doorway), or None if the room is too small."""
    x_min, x_max, y_min, y_max = room
    wide, deep = x_max - x_min, y_max - y_min
    for _ in range(20):
        along_y = wide > deep if rng.random() < 0.8 else wide <= deep
        size, across = (wide, deep) if along_y else (deep, wide)
        if size < 2 * smallest + thick or across < gap + 0.2:
            continue
        low = x_min if along_y else y_min
        at = float(low + size * rng.uniform(max(0.3, smallest / size), min(0.7, 1 - smallest / size)))
        start = y_min if along_y else x_min
        door = float(start + rng.uniform(gap / 2 + 0.1, across - gap / 2 - 0.1))
        ends = [(at, y_min), (at, y_max)] if along_y else [(x_min, at), (x_max, at)]
        reach = thick / 2 + clear
        if not any(a - reach < x < b + reach and c - reach < y < d + reach
                   for x, y in ends for a, b, c, d in openings):
            return along_y, at, door
    return None
