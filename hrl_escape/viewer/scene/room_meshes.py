"""Meshes of a room's fixed parts: floor, walls that are transparent from outside, obstacles, panels.

Pure functions of an instance; every mesh is in the room frame, metres.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.drawing import meshes, palette
from hrl_escape.env.drawing.meshes import Mesh, compute_outline, make_flat, make_prism, merge
from hrl_escape.env.geometry import Solid, compute_distance
from hrl_escape.env.instance import Rectangle, RoomInstance, Target

OTHER_TILE, SHADE, GLASS = "#e4dfd2", "#cfc9bc", "#8fa0b8"
SCRAPS = 160
"""Number of scraps of confetti."""
CLEAR, HAZY = 0.12, 0.5
"""Opacity of outer walls seen from outside, and of walls within the room."""


class Painted(NamedTuple):
    """A mesh, its colour, and how opaque it is (None: fully)."""

    name: str
    mesh: Mesh
    colour: str
    opacity: float | None = None


def make_fixtures(instance: RoomInstance) -> list[Painted]:
    """Parts that never change: floor with shadows and puddles, walls. Obstacles are apart, see `make_obstacle`."""
    floors = palette.compute_floors(instance)
    walls = [solid for solid in instance.solids if solid.role == "wall"]
    others = [solid for solid in instance.solids if solid.role != "wall"]
    even, odd, shadows, puddles = meshes.make_floor(instance, others)
    faces: dict[str, list[Mesh]] = {"inside": [], "between": [], "outside": []}
    for wall in walls:
        for mesh, kind in _make_faces(wall, floors):
            faces[kind].append(mesh)
    tops = [make_flat(compute_outline(wall), wall.height) for wall in walls]
    found = [
        Painted("floor/even", even, meshes.TILE),
        Painted("floor/odd", odd, OTHER_TILE),
        Painted("floor/shadows", shadows, SHADE),
        Painted("floor/puddles", puddles, palette.PUDDLE),
        Painted("walls/inside", merge(faces["inside"]), meshes.WALL_FACE),
        Painted("walls/between", merge(faces["between"]), meshes.WALL_FACE, HAZY),
        Painted("walls/outside", merge(faces["outside"]), GLASS, CLEAR),
        Painted("walls/top", merge(tops), meshes.WALL_TOP, 0.55),
    ]
    return [painted for painted in found if len(painted.mesh.triangles)]


def make_obstacle(solid: Solid) -> Painted:
    """One obstacle; the scene shows it as glass while it hides the robot."""
    return Painted("solid", meshes.make_solid(solid), meshes.OBSTACLE_FACE)


def is_hidden_by(solid: Solid, eye: tuple[float, float, float], point: tuple[float, float, float]) -> bool:
    """Return whether an upright solid stands between a camera and a point, tried at 64 places between them, m."""
    shares = np.arange(1, 65) / 65
    xs, ys, zs = (a + shares * (b - a) for a, b in zip(eye, point, strict=True))
    low = zs < solid.height
    return any(compute_distance(x, y, solid.footprint) <= 0.0
               for x, y in zip(xs[low].tolist(), ys[low].tolist(), strict=True))


def make_confetti(centre: tuple[float, float], share: float) -> NDArray[np.float32]:
    """Places (n, 3) of the scraps that fly up over a place and come down again, m; `share` goes from 0 to 1."""
    rng = np.random.default_rng(0)
    side, up = rng.normal(0.0, 1.6, (SCRAPS, 2)), rng.uniform(2.0, 6.0, SCRAPS)
    height = np.maximum(4.0 * up * share * (1.0 - share), meshes.LAYER)
    return np.column_stack([centre + side * share, height]).astype(np.float32)


def _make_faces(wall: Solid, floors: tuple[Rectangle, ...]) -> list[tuple[Mesh, str]]:
    """The upright faces of a wall, visible from their front only, each with its kind.

    A face is `inside` if it looks onto the floor, `between` if the opposite face does so too, else `outside`.
    """
    if wall.shape == "cylinder":
        return [(meshes.make_solid(wall), "between")]
    corners = compute_outline(wall)
    sides, inside = [], []
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        length = math.hypot(x1 - x0, y1 - y0) or 1.0
        normal = ((y1 - y0) / length, (x0 - x1) / length)
        # the face is thin: a prism of no depth, of which only the side along the edge is kept
        side = make_prism([(x0, y0), (x1, y1), (x1 - 1e-3 * normal[0], y1 - 1e-3 * normal[1]),
                           (x0 - 1e-3 * normal[0], y0 - 1e-3 * normal[1])], 0.0, wall.height)
        sides.append(Mesh(side.vertices[:4], side.normals[:4], side.triangles[:2]))
        x, y = (x0 + x1) / 2 + 0.05 * normal[0], (y0 + y1) / 2 + 0.05 * normal[1]
        inside.append(any(floor.contains(x, y) for floor in floors))
    kinds = ["outside" if not inside[i] else "between" if inside[i - 2] else "inside" for i in range(4)]
    return list(zip(sides, kinds, strict=True))


def make_target(instance: RoomInstance, target: Target) -> tuple[Painted, ...]:
    """A panel: its face, which lights up, its frame, the mat on the floor in front of it, and its mark, if any."""
    face, frame = meshes.make_panel(target)
    return (Painted("face", face, palette.OFF.fill), Painted("frame", frame, meshes.PANEL_FRAME),
            Painted("mat", meshes.make_mat(instance, target), meshes.MAT),
            *(Painted(f"mark-{number}", mesh, colour)
              for number, (colour, mesh) in enumerate(meshes.make_badges(instance, target))))


def make_exit(instance: RoomInstance) -> tuple[Painted, Painted]:
    """The exit's area on the floor and its edge."""
    area, edge = meshes.make_exit_area(instance)
    return Painted("area", area, palette.EXIT_LOCKED), Painted("edge", edge, palette.EXIT_LOCKED)
