"""Generators of MiniGrid's levels: maps with doors, keys and balls, after DoorKey, KeyCorridor and MultiRoom.

They draw levels as MiniGrid's generators do (Chevalier-Boisvert et al. 2023), from other random numbers. Maps leave out
MiniGrid's outer walls, which are the room's.
"""

from __future__ import annotations

import itertools

import numpy as np

from hrl_escape.env.puzzles.maps import HEADINGS

__all__ = ["draw_door_key", "draw_key_corridor", "draw_multi_room"]

_SIDES = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""Steps (column, row) out of a room, in MiniGrid's order of its doors: right, down, left, up."""


class _Canvas:
    """A map under construction, outer walls included; places are (column, row)."""

    def __init__(self, columns: int, rows: int, rng: np.random.Generator) -> None:
        self.cells, self.rng = np.full((rows, columns), "#"), rng

    def clear(self, left: int, top: int, right: int, bottom: int) -> None:
        """Turn the cells from one corner up to, but not including, another into floor."""
        self.cells[top:bottom, left:right] = " "

    def put(self, what: str, at: tuple[int, int]) -> None:
        self.cells[at[1], at[0]] = what

    def draw(self, low: int, high: int) -> int:
        """A whole number from `low` up to, but not including, `high`."""
        return int(self.rng.integers(low, high))

    def scatter(self, what: str, left: int, top: int, right: int, bottom: int) -> tuple[int, int]:
        """Put a character into a random free cell of a part of the map."""
        rows, columns = np.nonzero(self.cells[top:bottom, left:right] == " ")
        number = self.draw(0, len(rows))
        at = left + int(columns[number]), top + int(rows[number])
        self.put(what, at)
        return at

    def draw_start(self) -> str:
        return HEADINGS[self.draw(0, 4)]

    def finish(self) -> tuple[str, ...]:
        """Rows without the outer walls."""
        return tuple("".join(row) for row in self.cells[1:-1, 1:-1].tolist())


def draw_door_key(size: int, rng: np.random.Generator) -> tuple[str, ...]:
    """A wall with a locked door, start and key on its left, the goal in the lower right corner."""
    canvas = _Canvas(size, size, rng)
    canvas.clear(1, 1, size - 1, size - 1)
    canvas.put("G", (size - 2, size - 2))
    split = canvas.draw(2, size - 2)
    canvas.cells[:, split] = "#"
    canvas.scatter(canvas.draw_start(), 0, 0, split, size)
    canvas.put("D", (split, canvas.draw(1, size - 2)))
    canvas.scatter("k", 0, 0, split, size)
    return canvas.finish()


def draw_key_corridor(size: int, rows: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Three columns of rooms: a corridor, a key in a room on its left, a ball behind a locked door on its right."""
    step = size - 1
    canvas = _Canvas(3 * step + 1, rows * step + 1, rng)
    boxes = {(i, j): (i * step + 1, j * step + 1, (i + 1) * step, (j + 1) * step)
             for i in range(3) for j in range(rows)}
    for box in boxes.values():
        canvas.clear(*box)
    canvas.clear(step + 1, 1, 2 * step, rows * step)  # the corridor
    links = {frozenset(((1, j), (1, j + 1))) for j in range(rows - 1)}

    def add_door(kind: str, room: tuple[int, int], other: tuple[int, int]) -> None:
        left, top, _, _ = boxes[max(room, other)]
        across, along = canvas.draw(0, step - 1), canvas.draw(0, step - 1)
        canvas.put(kind, (left - 1, top + along) if room[1] == other[1] else (left + across, top - 1))
        links.add(frozenset((room, other)))

    locked = (2, canvas.draw(0, rows))
    add_door("D", locked, (1, locked[1]))
    things = {"b": locked, "k": (0, canvas.draw(0, rows))}
    for what, room in things.items():
        canvas.scatter(what, *boxes[room])
    while True:  # not directly in front of a thing, as in MiniGrid
        heading = canvas.draw_start()
        at = canvas.scatter(heading, *boxes[1, rows // 2])
        quarter = HEADINGS.index(heading)
        ahead = at[0] + (1, 0, -1, 0)[quarter], at[1] + (0, -1, 0, 1)[quarter]
        if canvas.cells[ahead[1], ahead[0]] in " #":
            break
        canvas.put(" ", at)
    while len(_find_connected((1, 0), links)) < len(boxes):
        room = canvas.draw(0, 3), canvas.draw(0, rows)
        across, down = _SIDES[canvas.draw(0, 4)]
        other = room[0] + across, room[1] + down
        if other in boxes and locked not in (room, other) and frozenset((room, other)) not in links:
            add_door("d", room, other)
    return canvas.finish()


def _find_connected(room: tuple[int, int], links: set[frozenset[tuple[int, int]]]) -> set[tuple[int, int]]:
    """Rooms that are connected to a room through links."""
    found = {room}
    while more := set(itertools.chain(*(link for link in links if link & found))) - found:
        found |= more
    return found


def draw_multi_room(size: int, rooms: int, largest: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Rooms of random sizes one after another, a door between each two, the start in the first, the goal in the last.

    A layout that gets stuck with too few rooms is drawn anew.
    """
    boxes: list[tuple[int, int, int, int]] = []
    doors: list[tuple[int, int]] = []
    canvas = _Canvas(size, size, rng)
    while len(boxes) < rooms:
        boxes, doors = [], []
        _place_rooms(canvas, rooms, largest, 2, (canvas.draw(0, size - 2), canvas.draw(0, size - 2)), boxes, doors)
    for left, top, right, bottom in boxes:
        canvas.clear(left + 1, top + 1, right - 1, bottom - 1)
    for door in doors[1:]:
        canvas.put("d", door)
    canvas.scatter(canvas.draw_start(), *boxes[0])
    canvas.scatter("G", *boxes[-1])
    return canvas.finish()


def _place_rooms(canvas: _Canvas, left_over: int, largest: int, wall: int, door: tuple[int, int],
                 boxes: list[tuple[int, int, int, int]], doors: list[tuple[int, int]]) -> bool:
    """Place a room whose entry is a door in one of its walls (right, down, left, up), and the others behind it.

    Boxes are (left, top, right, bottom), walls included, the last two not inclusive.
    """
    wide, high = canvas.draw(4, largest + 1), canvas.draw(4, largest + 1)
    x, y = door
    if not boxes:
        left, top = x, y
    elif wall in (0, 2):
        left, top = (x - wide + 1 if wall == 0 else x), canvas.draw(y - high + 2, y)
    else:
        left, top = canvas.draw(x - wide + 2, x), (y - high + 1 if wall == 1 else y)
    box = left, top, left + wide, top + high
    rows, columns = canvas.cells.shape
    if left < 0 or top < 0 or box[2] > columns or box[3] > rows:
        return False
    if any(not (box[2] <= other[0] or other[2] <= left or box[3] <= other[1] or other[3] <= top)
           for other in boxes[:-1]):
        return False
    boxes.append(box)
    doors.append(door)
    if left_over == 1:
        return True
    for _ in range(8):
        out = [side for side in range(4) if side != wall][canvas.draw(0, 3)]
        exit_ = {0: (box[2] - 1, top + canvas.draw(1, high - 1)), 1: (left + canvas.draw(1, wide - 1), box[3] - 1),
                 2: (left, top + canvas.draw(1, high - 1)), 3: (left + canvas.draw(1, wide - 1), top)}[out]
        if _place_rooms(canvas, left_over - 1, largest, (out + 2) % 4, exit_, boxes, doors):
            break
    return True
