"""The three keys of a room: its content, its layout, and its task up to the numbers of buttons.

Two sets of rooms are disjoint in content if no room of one is in the other, in layout if none looks alike, and in
task if none asks for the same puzzle.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any, NamedTuple

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.ladder.canonical import compute_canonical_form
from hrl_escape.ladder.layouts import LayoutKey, list_points

GRAIN = 0.5
"""Places closer than about this, m, are alike."""
TURN = math.radians(30)
"""Directions closer than about this are alike."""


class RoomKeys(NamedTuple):
    """Keys of one room; hashes are 64 hexadecimal digits of SHA-256.

    Attributes:
        content: everything that can be observed or computed in the room.
        layout: what stands where; of version 1 a hash of places rounded to 0.5 m and directions to 30 degrees, of
            version 2 points that are compared with a margin, see `layouts.py`.
        task: the puzzle up to the numbers of its buttons.
    """

    content: str
    layout: LayoutKey
    task: str


def compute_keys(room: RoomInstance, layouts: int = 1) -> RoomKeys:
    """Compute the keys of a room, its layout in this version."""
    layout = compute_layout_key(room) if layouts == 1 else list_points(room)
    return RoomKeys(room.digest, layout, compute_task_key(room.puzzle))


def compute_layout_key(room: RoomInstance) -> str:
    """Hash of what stands where, without names and in no order."""
    turn = math.radians(room.robot.turn_step_deg)
    things = [(solid.role, *_round(solid.x, solid.y, solid.yaw)) for solid in room.solids]
    things += [("target", *_round(target.x, target.y, target.yaw)) for target in room.targets]
    things += [(placed.prop.kind, *_round(placed.x, placed.y, placed.yaw)) for placed in room.props]
    things += [("start", *_round(start.x, start.y, start.heading_steps * turn + start.heading_offset))
               for start in room.starts]
    return _hash([*sorted(things), ("exit", *_round(*room.exit.centre, 0.0))])


def compute_task_key(puzzle: Puzzle) -> str:
    """Hash of a puzzle's rules; button puzzles that differ in the numbers of their buttons alone have the same."""
    rules = puzzle.to_dict()
    rules.pop("marks", None)  # they change no rule
    if isinstance(puzzle, ButtonsPuzzle):
        colours = [int(button == puzzle.goal) for button in range(puzzle.count)] + [2] * len(puzzle.locks)
        colours += [3] * len(puzzle.doors)
        links = [link for node, (a, b) in enumerate(puzzle.locks, puzzle.count) for link in ((a, node), (node, b))]
        links += [(button, node) for node, button in enumerate(puzzle.doors, puzzle.count + len(puzzle.locks))]
        goals, edges = compute_canonical_form(colours, (*puzzle.edge_list, *links))
        rules |= {"goal": goals.index(1), "edge_list": edges}
        for name, colour in (("locks", 2), ("doors", 3)):  # nodes of colours of their own
            if name in rules:
                rules[name] = [node for node, own in enumerate(goals) if own == colour]
    return _hash(rules)


def _round(x: float, y: float, yaw: float) -> tuple[int, int, int]:
    return round(x / GRAIN), round(y / GRAIN), round(yaw / TURN) % round(math.tau / TURN)


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
