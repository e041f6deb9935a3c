"""Moving maps: an episode seen from above, as a small web page that plays without a network.

The page is `templates/moving_map.html`. A notebook or a site shows it in an HTML frame (`embed_moving_map`). The report
of a comparison plays the same data with the same script. Lengths are in metres and angles in radians, in the room
frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from importlib.resources import files
from typing import Any

from markupsafe import Markup, escape

from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import Rectangle, RoomInstance, compute_floors
from hrl_escape.env.kinematics import Kinematics, RoomState, Rules
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.graph import shorten
from hrl_escape.env.pictures.meshes import compute_extent, outline_capsule
from hrl_escape.env.pictures.model import RoomModel
from hrl_escape.env.poses import get_planar_pose
from hrl_escape.env.puzzles.mixins import Barring, Depicted, get_mixin
from hrl_escape.templates import embed_json, render_template

PLAYER_COLOURS = {
    "floor": palette.FLOOR, "puddle": palette.PUDDLE, "wall": palette.WALL, "obstacle": palette.OBSTACLE,
    "door": palette.DOOR, "exitOpen": palette.EXIT_OPEN, "exitLocked": palette.EXIT_LOCKED, "exitInk": palette.EXIT_INK,
    "body": palette.BODY, "bodyEdge": palette.BODY_EDGE, "arm": palette.ARM, "hand": palette.HAND,
    "prop": palette.PROP, "propEdge": palette.PROP_EDGE, "plate": palette.PLATE, "trail": palette.TRAIL,
    "lit": palette.LIT, "off": palette.OFF, "lines": palette.LINES,
}
"""Colours of the player."""
PLAYER = files("hrl_escape.env.pictures") / "templates"
"""Folder of the player's script and style, `moving_map.js` and `moving_map.css`."""
_PAD, _CONTROLS = 0.35, 76  # m around the room, as in the script; pixels of slider and text below it


def make_moving_map(instance: RoomInstance, states: Sequence[RoomState], decisions: Sequence[tuple[str, int]] = ()
                    ) -> str:
    """Make a web page that plays an episode from above in a loop, with a slider.

    Args:
        instance: the room.
        states: states of the episode, one more than primitives.
        decisions: name and number of primitives of each decision, in order; the numbers add up to all primitives.

    Returns:
        One HTML document of about 15 kB without external resources.
    """
    room = {**describe_room(instance), "options": sorted({name for name, _ in decisions})}
    replay = {"decisions": [[name, int(count), "reached"] for name, count in decisions],
              "frames": make_frames(Kinematics(instance), states)}
    css, script = (Markup((PLAYER / f"moving_map.{kind}").read_text(encoding="utf-8")) for kind in ("css", "js"))
    return render_template("hrl_escape.env.pictures", "moving_map.html", title=instance.name, css=css,
                           script=script, data=embed_json({"room": room, "replay": replay, "looks": PLAYER_COLOURS}))


def embed_moving_map(instance: RoomInstance, page: str, width: int = 480) -> str:
    """Make an HTML frame, at most `width` pixels wide, for the page that `make_moving_map` made for a room."""
    x_min, x_max, y_min, y_max = compute_extent(instance)
    ratio = (y_max - y_min + 2 * _PAD) / (x_max - x_min + 2 * _PAD)
    return (f'<div style="container-type:inline-size;max-width:{width}px"><iframe class="moving-map" '
            f'sandbox="allow-scripts" loading="lazy" title="{escape(instance.name)}" style="width:100%;border:0;'
            f'height:calc({100 * ratio:.2f}cqw + {_CONTROLS}px)" srcdoc="{escape(page)}"></iframe></div>')


def describe_room(instance: RoomInstance) -> dict[str, Any]:
    """Describe the fixed parts of a room as a JSON value for the player; `options` is left for the caller."""
    x_min, x_max, y_min, y_max = compute_extent(instance)
    cues, model = palette.list_cues(instance.puzzle), RoomModel(instance)
    return {
        "extent": {"x_min": x_min, "x_max": x_max, "y_min": y_min, "y_max": y_max},
        "floors": [_describe_rectangle(floor) for floor in compute_floors(instance)],
        "puddles": [[[round(x, 3), round(y, 3)] for x, y in outline_capsule(puddle)]
                    for puddle in get_mixin(instance.puzzle, Depicted).puddles],
        "exit": _describe_rectangle(instance.exit),
        "solids": [_describe_solid(solid) for solid in instance.solids],
        "door": None if instance.door is None else _describe_solid(instance.door),
        "inner_doors": [{**_describe_box(part.shape.x, part.shape.y, part.shape.half_x, part.shape.half_y, door.yaw),
                         "shape": door.shape, "role": door.role}
                        for door, part in zip(instance.inner_doors, model.inner_doors, strict=True)],
        "targets": [
            {**_describe_box(target.x, target.y, target.half_x, target.half_y, target.yaw),
             "short": shorten(target.name), "front": palette.find_front(instance, target),
             "cue": cues[number] if cues else None}
            for number, target in enumerate(instance.targets)
        ],
        "props": [{**_describe_box(p.x, p.y, p.prop.half_size, p.prop.half_size, p.yaw), "kind": p.prop.kind}
                  for p in instance.props],
        "radius": instance.robot.inner_radius,
        "corners": [list(corner) for corner in instance.robot.base.corners],
        "hand": instance.robot.hand_radius,
        "options": [],
    }


def make_frames(rules: Rules, states: Sequence[RoomState]) -> dict[str, Any]:
    """Turn states into compact numbers for drawing.

    Returns:
        `x`, `y` (m) and `heading` (rad) per state. `arm`: positions [x, y] of the arm's joints and hand per state,
        empty without an arm. `lit`, `shut` and `open`: [frame, value] at each change of the lit targets (indices), the
        inner doors that block the way (indices), and the exit (true if open). `props`: [x, y, yaw] of each prop per
        state, empty if none can move.
    """
    puzzle = rules.instance.puzzle
    bars = get_mixin(puzzle, Barring)
    return {
        "x": [round(state.x, 3) for state in states],
        "y": [round(state.y, 3) for state in states],
        "heading": [round(rules.get_heading(state), 4) for state in states],
        "arm": [_trace_arm(rules, state) for state in states] if rules.instance.robot.joints else [],
        "lit": _list_changes(states, lambda state: [n for n, on in enumerate(puzzle.get_lit(state)) if on]),
        "shut": _list_changes(states, lambda state: [
            n for n in range(len(rules.instance.inner_doors)) if bars.get_shut(state) >> n & 1]),
        "open": _list_changes(states, puzzle.is_solved),
        "props": [[[round(x, 3), round(y, 3), round(yaw, 4)] for x, y, yaw in map(get_planar_pose, state.physics.props)]
                  for state in states if state.physics],
    }


def _list_changes(states: Sequence[RoomState], read: Callable[[Hashable], Any]) -> list[list[Any]]:
    """[frame, value] of the first state and of each state whose value differs from the one before."""
    changes: list[list[Any]] = []
    for number, state in enumerate(states):
        if number and state.puzzle == states[number - 1].puzzle:
            continue
        value = read(state.puzzle)
        if not changes or changes[-1][1] != value:
            changes.append([number, value])
    return changes


def _trace_arm(rules: Rules, state: RoomState) -> list[list[float]]:
    """Positions [x, y] of the arm's joints and of the hand, in the room frame."""
    heading = rules.get_heading(state)
    cos, sin = math.cos(heading), math.sin(heading)
    return [[round(float(state.x + cos * x - sin * y), 3), round(float(state.y + sin * x + cos * y), 3)]
            for x, y, _ in rules.robot.trace_links(rules.get_angles(state))]


def _describe_rectangle(area: Rectangle) -> list[float]:
    return [area.x_min, area.y_min, area.x_max - area.x_min, area.y_max - area.y_min]


def _describe_box(x: float, y: float, half_x: float, half_y: float, yaw: float) -> dict[str, Any]:
    return {"x": x, "y": y, "half_x": half_x, "half_y": half_y, "yaw": yaw}


def _describe_solid(solid: Solid) -> dict[str, Any]:
    box = _describe_box(solid.x, solid.y, solid.half_x, solid.half_y, solid.yaw)
    return {**box, "shape": solid.shape, "role": solid.role}
