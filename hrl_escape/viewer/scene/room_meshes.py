"""Meshes of a room's fixed parts: floor, walls that are transparent from outside, obstacles, panels.

Pure functions of an instance; every mesh is in the room frame, metres.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hrl_escape.env.drawing import palette
from hrl_escape.env.drawing.meshes import (
    Mesh,
    compute_outline,
    make_badge,
    make_cylinder,
    make_flat,
    make_prism,
    make_puddles,
    make_shadow,
    make_tiles,
    merge,
    rotate_box,
)
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import Rectangle, RoomInstance, Target
from hrl_escape.env.puzzles.traits import Depicted, get_trait

__all__ = ["LAYER", "Painted", "make_exit", "make_fixtures", "make_target"]

LAYER = 0.006
"""Height between two layers painted on the floor, m."""
TILE, OTHER_TILE, SHADE = "#efebe2", "#e4dfd2", "#cfc9bc"
WALL_FACE, WALL_TOP, GLASS = "#c6ccd6", "#5b6475", "#8fa0b8"
OBSTACLE_FACE = "#c2a27c"
PANEL_FRAME = "#39404d"
MAT = "#e0ac9e"
CLEAR, HAZY = 0.12, 0.5
"""Opacity of outer walls seen from outside, and of walls within the room."""


class Painted(NamedTuple):
    """A mesh, its colour, and how opaque it is (None: fully)."""

    name: str
    mesh: Mesh
    colour: str
    opacity: float | None = None


def make_fixtures(instance: RoomInstance) -> list[Painted]:
    """Parts that never change: floor with shadows and puddles, walls, obstacles."""
    floors = palette.compute_floors(instance)
    size = max(instance.half_width, instance.half_depth)
    side = 1.0 if size <= 15 else 2.0 if size <= 30 else 5.0
    walls = [solid for solid in instance.solids if solid.role == "wall"]
    others = [solid for solid in instance.solids if solid.role != "wall"]
    shadows = [make_shadow(compute_outline(solid), solid.height, LAYER, floor) for solid in others for floor in floors]
    faces: dict[str, list[Mesh]] = {"inside": [], "between": [], "outside": []}
    for wall in walls:
        for mesh, kind in _make_faces(wall, floors):
            faces[kind].append(mesh)
    tops = [make_flat(compute_outline(wall), wall.height) for wall in walls]
    puddles = get_trait(instance.puzzle, Depicted).puddles
    found = [
        Painted("floor/even", make_tiles(floors, side, False), TILE),
        Painted("floor/odd", make_tiles(floors, side, True), OTHER_TILE),
        Painted("floor/shadows", merge(shadows), SHADE),
        Painted("floor/puddles", make_puddles(puddles, 1.5 * LAYER), palette.PUDDLE),
        Painted("walls/inside", merge(faces["inside"]), WALL_FACE),
        Painted("walls/between", merge(faces["between"]), WALL_FACE, HAZY),
        Painted("walls/outside", merge(faces["outside"]), GLASS, CLEAR),
        Painted("walls/top", merge(tops), WALL_TOP, 0.55),
        Painted("obstacles", merge([_make_solid(solid) for solid in others]), OBSTACLE_FACE),
    ]
    return [painted for painted in found if len(painted.mesh.triangles)]


def _make_solid(solid: Solid) -> Mesh:
    if solid.shape == "cylinder":
        return make_cylinder(solid.half_x, 0.0, solid.height).moved(solid.x, solid.y)
    return make_prism(compute_outline(solid), 0.0, solid.height)


def _make_faces(wall: Solid, floors: tuple[Rectangle, ...]) -> list[tuple[Mesh, str]]:
    """The upright faces of a wall, visible from their front only, each with its kind.

    A face is `inside` if it looks onto the floor, `between` if the opposite face does so too, else `outside`.
    """
    if wall.shape == "cylinder":
        return [(_make_solid(wall), "between")]
    corners = compute_outline(wall)
    meshes, inside = [], []
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        length = math.hypot(x1 - x0, y1 - y0) or 1.0
        normal = ((y1 - y0) / length, (x0 - x1) / length)
        # the face is thin: a prism of no depth, of which only the side along the edge is kept
        side = make_prism([(x0, y0), (x1, y1), (x1 - 1e-3 * normal[0], y1 - 1e-3 * normal[1]),
                           (x0 - 1e-3 * normal[0], y0 - 1e-3 * normal[1])], 0.0, wall.height)
        meshes.append(Mesh(side.vertices[:4], side.normals[:4], side.triangles[:2]))
        x, y = (x0 + x1) / 2 + 0.05 * normal[0], (y0 + y1) / 2 + 0.05 * normal[1]
        inside.append(any(floor.contains(x, y) for floor in floors))
    kinds = ["outside" if not inside[i] else "between" if inside[i - 2] else "inside" for i in range(4)]
    return list(zip(meshes, kinds, strict=True))


def make_target(instance: RoomInstance, target: Target) -> tuple[Painted, ...]:
    """A panel: its face, which lights up, its frame, the mat on the floor in front of it, and its mark, if any."""
    low, high = max(0.02, target.z - target.half_z), target.z + target.half_z
    rim = min(0.08, 0.2 * min(target.half_x, target.half_z))
    face = rotate_box(target.x, target.y, target.half_x, target.half_y, target.yaw)
    frame = rotate_box(target.x, target.y, target.half_x + rim, 0.7 * target.half_y, target.yaw)
    ahead = palette.find_front(instance, target)
    deep = target.half_y + (min(0.4, 0.5 * instance.robot.inner_radius) if target.kind == "panel" else 0.0)
    middle = (target.x + ahead[0] * deep / 2, target.y + ahead[1] * deep / 2)
    mat = make_flat(rotate_box(*middle, target.half_x, deep / 2, target.yaw), 4 * LAYER)
    return (Painted("face", make_prism(face, low, high), palette.OFF.fill),
            Painted("frame", make_prism(frame, max(0.0, low - rim), high + rim), PANEL_FRAME),
            Painted("mat", mat, MAT),
            *(Painted(f"mark-{number}", make_badge(outline, target, ahead, LAYER * (number + 1)), colour)
              for number, (colour, outline) in enumerate(palette.list_badge(instance.puzzle, target.name))))


def make_exit(instance: RoomInstance) -> tuple[Painted, Painted]:
    """The exit's area on the floor and its edge."""
    area = instance.exit
    half_x, half_y = (area.x_max - area.x_min) / 2, (area.y_max - area.y_min) / 2
    rim = min(0.12, 0.1 * half_x, 0.1 * half_y)
    return (Painted("area", make_flat(rotate_box(*area.centre, half_x - rim, half_y - rim, 0.0), 3 * LAYER),
                    palette.EXIT_LOCKED),
            Painted("edge", make_flat(rotate_box(*area.centre, half_x, half_y, 0.0), 2 * LAYER), palette.EXIT_LOCKED))
