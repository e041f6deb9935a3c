"""Colours of a room in every picture, of a target in each of its states, and of its cue.

Colours are hexadecimal sRGB text, shared by maps, cameras, the viewer and reports. This module draws nothing.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import NamedTuple

from hrl_escape.env.geometry import compute_distance, make_footprint
from hrl_escape.env.instance import RoomInstance, Target
from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.env.puzzles.cues import split_cue
from hrl_escape.env.puzzles.mixins import Cued, Depicted, Graphed, get_mixin
from hrl_escape.figures import LINES as LINES

BACKGROUND = "#ffffff"
FLOOR = "#f4f1ea"
PUDDLE = "#8db4d6"
WALL = "#444c5c"
OBSTACLE, OBSTACLE_EDGE = "#b3a694", "#8d8172"
EXIT_LOCKED, EXIT_OPEN, EXIT_INK = "#9fb8a8", "#3fae6a", "#1d5c3a"
DOOR = "#8a5a3c"
BODY, BODY_EDGE = "#2f6db5", "#1d4474"
ARM, HAND = "#1c3f6b", "#f08c2e"
PROP, PROP_EDGE, PLATE = "#8e6bb0", "#5d4380", "#cdbfe0"
INK, MUTED = "#22262e", "#7b818c"
LOCK = "#d55e00"
TRAIL = "#0072b2"
CUE_COLOURS = ("#d62728", "#2f6db5", "#2ca02c", "#f0d000", "#8e44ad", "#17becf", "#f08c2e", "#22262e")
"""Colours of cues, in the order of their numbers."""


class TargetLook(NamedTuple):
    """Colours of a target: its face, its edge, and text on it."""

    fill: str
    edge: str
    ink: str


LIT = TargetLook("#ffc52e", "#b07d00", INK)
OFF = TargetLook("#c8553d", "#8c3424", "#ffffff")
WAITING = TargetLook("#edcabf", "#c8553d", INK)


LOOKS = {
    "sky": "#dfe7ef", "tile": "#efebe2", "other tile": "#e6e1d6", "shadow": "#c9c3b6", "puddle": PUDDLE,
    "exit": "#b3cfbd", "open exit": "#7fd49b", "exit edge": "#7d9a87", "open exit edge": EXIT_OPEN, "plate": PLATE,
    "wall": "#c6ccd6", "wall top": "#5b6475", "obstacle": "#c2a27c", "door": DOOR, "thing": PROP, "block": PROP,
    "frame": "#39404d", "off": OFF.fill, "lit": LIT.fill, "mat": "#e0ac9e", "lit mat": "#ffdf7e",
    "trim": "#1f2733", "body": BODY, "arrow": "#e9eef5",
}
"""Colour of each role of a part in 3-D pictures."""


def name_target(puzzle: Puzzle, state: Hashable, target: int, is_hidden: bool = False) -> str:
    """Return the name of a target in drawings, with its sign, and a star for a goal that is not hidden."""
    sign = get_mixin(puzzle, Depicted).get_sign(state, target)
    star = " \N{BLACK STAR}" if not is_hidden and target in get_mixin(puzzle, Graphed).goal_targets else ""
    return puzzle.target_names[target] + (f": {sign}" if sign else "") + star


def get_target_look(puzzle: Puzzle, state: Hashable, target: int, is_hidden: bool = False) -> TargetLook:
    """Return the look of a target: on, off, or waiting (no operator on it is applicable yet) unless that is hidden."""
    if puzzle.get_lit(state)[target]:
        return LIT
    if is_hidden:
        return OFF
    name, facts = puzzle.target_names[target], puzzle.symbolic.get_facts(state)
    operators = [o for o in puzzle.symbolic.make_symbolic_model().operators if o.target == name]
    return OFF if not operators or any(operator.is_applicable(facts) for operator in operators) else WAITING


def list_cues(puzzle: Puzzle) -> list[tuple[str, list[tuple[float, float]]]]:
    """Return colour and outline, within a unit circle, of the cue on each target; empty if targets have no cues."""
    corners = (24, 4, 3, 10)  # of a disc, a square, a triangle and a star, whose odd corners are further inside
    found = []
    for cue in get_mixin(puzzle, Cued).cues:
        colour, shape, size = split_cue(cue)
        turns = [math.tau * (number / corners[shape] + 0.25) for number in range(corners[shape])]
        radii = [(0.4, 0.7, 1.0)[size] * (0.42 if shape == 3 and number % 2 else 1.0) for number in range(len(turns))]
        found.append((CUE_COLOURS[colour], [(radius * math.cos(turn), radius * math.sin(turn))
                                            for radius, turn in zip(radii, turns, strict=True)]))
    return found


def choose_tile(instance: RoomInstance) -> float:
    """Return the side of the floor's tiles in pictures, m."""
    size = max(instance.half_width, instance.half_depth)
    return 1.0 if size <= 15 else 2.0 if size <= 30 else 5.0


def find_front(instance: RoomInstance, target: Target) -> tuple[float, float]:
    """Return the unit vector from a target to the side where it is pressed: the one further from walls."""
    normal = (-math.sin(target.yaw), math.cos(target.yaw))
    walls = [make_footprint(s.x, s.y, s.half_x, s.half_y, s.yaw) for s in instance.solids if s.role == "wall"]

    def compute_room(sign: int) -> float:
        x, y = target.x + 0.5 * sign * normal[0], target.y + 0.5 * sign * normal[1]
        inside = abs(x) <= instance.half_width and abs(y) <= instance.half_depth
        return inside * min((compute_distance(x, y, wall) for wall in walls), default=1.0)

    sign = 1 if compute_room(1) >= compute_room(-1) else -1
    return sign * normal[0], sign * normal[1]


def to_rgb(colour: str) -> tuple[float, float, float]:
    """Convert `#rrggbb` to red, green and blue in [0, 1]."""
    red, green, blue = (byte / 255 for byte in bytes.fromhex(colour.removeprefix("#")))
    return red, green, blue
