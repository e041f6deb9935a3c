"""Triangle meshes of the parts of a room, for Bullet's cameras and the viewer.

Shapes come first, then the parts of a room, each in the frame of its `RoomPart`. Every face has its own vertices, which
keeps edges sharp. Faces are counter-clockwise seen from outside; metres. Meshes take no part in collisions.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.geometry import Footprint, make_footprint
from hrl_escape.env.instance import Rectangle, RoomInstance, Target, compute_floors
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.model import LAYER, RoomPart
from hrl_escape.env.puzzles.mixins import Depicted, get_mixin
from hrl_escape.env.puzzles.places import Capsule

Point = tuple[float, float]

FACETS = 32
SHADOW = (0.34, -0.22)
"""Offset of a point's shadow, per metre of its height, m."""
_LONGEST_SHADOW = 1.3


class Mesh(NamedTuple):
    """Triangles with shared vertices; each vertex has a normal. Metres."""

    vertices: NDArray[np.float64]  # (n, 3), float64, m
    normals: NDArray[np.float64]  # (n, 3), float64, unit
    triangles: NDArray[np.int64]  # (m, 3), int64, indices of vertices

    def moved(self, x: float, y: float) -> Mesh:
        """Return the mesh moved on the floor."""
        return self._replace(vertices=self.vertices + (x, y, 0.0))

    def facing(self, direction: tuple[float, float, float]) -> Mesh:
        """Return the mesh shaded as if all of it faced one direction."""
        unit = np.array(direction) / math.hypot(*direction)
        return self._replace(normals=np.tile(unit, (len(self.vertices), 1)))


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Combine meshes into one."""
    if not meshes:
        return make_flat((), 0.0)
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate([mesh.normals for mesh in meshes]),
                np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]))


def outline_capsule(capsule: Capsule) -> list[Point]:
    """Return the corners of a capsule, counter-clockwise: two half circles joined by straight sides."""
    along = math.atan2(capsule.y2 - capsule.y1, capsule.x2 - capsule.x1)
    ends = ((capsule.x2, capsule.y2, along - math.pi / 2), (capsule.x1, capsule.y1, along + math.pi / 2))
    return [(x + capsule.radius * math.cos(angle), y + capsule.radius * math.sin(angle)) for x, y, first in ends
            for angle in np.linspace(first, first + math.pi, FACETS).tolist()]


def make_flat(outline: Sequence[Point], z: float, up: bool = True) -> Mesh:
    """Make a horizontal convex polygon from counter-clockwise corners, visible from above or from below."""
    n = len(outline)
    if n < 3:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    vertices = np.column_stack([np.array(outline, dtype=np.float64), np.full(n, z)])
    fan = np.array([(0, i, i + 1) for i in range(1, n - 1)], dtype=np.int64).reshape(-1, 3)
    return Mesh(vertices, np.tile((0.0, 0.0, 1.0 if up else -1.0), (n, 1)), fan if up else fan[:, ::-1])


def _make_badge(outline: Sequence[Point], target: Target, front: Point, lift: float) -> Mesh:
    """A flat polygon on the front of a panel, star-shaped about (0, 0), `lift` m above its face.

    Its corners are counter-clockwise, in units of half the panel's smaller side.
    """
    scale, (x, y) = 0.8 * min(target.half_x, target.half_z), front
    centre = np.array([target.x + (target.half_y + lift) * x, target.y + (target.half_y + lift) * y, target.z])
    corners = np.array([(0.0, 0.0), *outline]) * scale
    vertices = centre + corners[:, :1] * (-y, x, 0.0) + corners[:, 1:] * (0.0, 0.0, 1.0)
    fan = [(0, number, number % len(outline) + 1) for number in range(1, len(outline) + 1)]
    return Mesh(vertices, np.tile((x, y, 0.0), (len(vertices), 1)), np.array(fan, dtype=np.int64))


def make_prism(outline: Sequence[Point], low: float, high: float) -> Mesh:
    """Make an upright prism over a convex counter-clockwise polygon, from height `low` to `high`, with flat sides."""
    sides = []
    for (x0, y0), (x1, y1) in zip(outline, [*outline[1:], outline[0]], strict=True):
        length = math.hypot(x1 - x0, y1 - y0) or 1.0
        normal = ((y1 - y0) / length, (x0 - x1) / length, 0.0)
        corners = np.array([(x0, y0, low), (x1, y1, low), (x1, y1, high), (x0, y0, high)])
        sides.append(Mesh(corners, np.tile(normal, (4, 1)), np.array([(0, 1, 2), (0, 2, 3)])))
    return merge([*sides, make_flat(outline, high), make_flat(outline, low, up=False)])


def make_cylinder(radius: float, low: float, high: float, top_radius: float | None = None) -> Mesh:
    """Make an upright cylinder (or cone frustum) about the z axis, with smoothly shaded sides."""
    top = radius if top_radius is None else top_radius
    angles = np.arange(FACETS) * (math.tau / FACETS)
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    slope = (radius - top) / math.hypot(high - low, radius - top)
    normals = np.column_stack([around * math.sqrt(1 - slope**2), np.full(FACETS, slope)])
    ring = [np.column_stack([around * r, np.full(FACETS, z)]) for r, z in ((radius, low), (top, high))]
    i = np.arange(FACETS)
    j = (i + 1) % FACETS
    triangles = np.concatenate([np.column_stack([i, j, j + FACETS]), np.column_stack([i, j + FACETS, i + FACETS])])
    side = Mesh(np.concatenate(ring), np.tile(normals, (2, 1)), triangles)
    outline = [(x, y) for x, y in around.tolist()]
    lid = make_flat([(top * x, top * y) for x, y in outline], high)
    bottom = make_flat([(radius * x, radius * y) for x, y in outline], low, up=False)
    return merge([side, lid, bottom])


def make_base_column(robot: RobotConfig, low: float, high: float, share: float = 1.0, top_share: float | None = None
                     ) -> Mesh:
    """Make a slice of the robot's base from height `low` to `high`, with scaled outline, and top if round."""
    if robot.base.corners:
        return make_prism([(share * x, share * y) for x, y in robot.base.corners], low, high)
    top = None if top_share is None else top_share * robot.outer_radius
    return make_cylinder(share * robot.outer_radius, low, high, top)


def compute_base_outline(robot: RobotConfig) -> list[Point]:
    """Return the corners of the robot's base, counter-clockwise, in its frame."""
    radius = robot.outer_radius
    return list(robot.base.corners) or outline_footprint(make_footprint(0.0, 0.0, radius, radius, is_disc=True))


def outline_footprint(shape: Footprint) -> list[Point]:
    """Return the corners of a footprint, counter-clockwise; a disc has `FACETS` corners."""
    if shape.is_disc:
        angles = [n * math.tau / FACETS for n in range(FACETS)]
        return [(shape.x + shape.half_x * math.cos(a), shape.y + shape.half_x * math.sin(a)) for a in angles]
    return [(shape.x + shape.cos * a - shape.sin * b, shape.y + shape.sin * a + shape.cos * b)
            for a, b in _list_corners(shape.half_x, shape.half_y)]


def compute_extent(instance: RoomInstance) -> tuple[float, float, float, float]:
    """Return x_min, x_max, y_min, y_max of all solids and the exit."""
    xs = [-instance.half_width, instance.half_width, instance.exit.x_min, instance.exit.x_max]
    ys = [-instance.half_depth, instance.half_depth, instance.exit.y_min, instance.exit.y_max]
    for solid in instance.solids:
        corners = outline_footprint(solid.footprint._replace(is_disc=False))
        xs += [x for x, _ in corners]
        ys += [y for _, y in corners]
    return min(xs), max(xs), min(ys), max(ys)


def _list_corners(half_x: float, half_y: float) -> tuple[Point, ...]:
    return (-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)


def make_shadow(outline: Sequence[Point], height: float, z: float, floor: Rectangle | None = None) -> Mesh:
    """Make the shadow of an upright prism on the floor, as a flat polygon at height `z`.

    With `floor`, only the part on that rectangle, which can be empty (no triangles).
    """
    reach = min(height, _LONGEST_SHADOW / math.hypot(*SHADOW))
    points = [*outline, *((x + SHADOW[0] * reach, y + SHADOW[1] * reach) for x, y in outline)]
    shape = [points[number] for number in ConvexHull(points).vertices]  # counter-clockwise
    if floor is not None:
        for axis, sign, limit in ((0, 1, floor.x_min), (0, -1, floor.x_max), (1, 1, floor.y_min), (1, -1, floor.y_max)):
            shape = _clip(shape, axis, sign, limit)
    return make_flat(shape, z)


def _clip(shape: Sequence[Point], axis: int, sign: int, limit: float) -> list[Point]:
    """Clip a convex polygon to one side of a line (Sutherland and Hodgman, 1974)."""
    kept: list[Point] = []
    for before, point in zip([*shape[-1:], *shape[:-1]], shape, strict=True):
        was, now = sign * (before[axis] - limit), sign * (point[axis] - limit)
        if (was < 0.0) != (now < 0.0):
            share = was / (was - now)
            kept.append((before[0] + share * (point[0] - before[0]), before[1] + share * (point[1] - before[1])))
        if now >= 0.0:
            kept.append(point)
    return kept


def _make_tiles(areas: Sequence[Rectangle], side: float, odd: bool) -> Mesh:
    """The odd or the even squares of a chequered floor, aligned with the origin."""
    tiles = []
    for area in areas:
        xs, ys = _cut(area.x_min, area.x_max, side), _cut(area.y_min, area.y_max, side)
        for x0, x1 in zip(xs, xs[1:], strict=False):
            for y0, y1 in zip(ys, ys[1:], strict=False):
                if (math.floor((x0 + x1) / 2 / side) + math.floor((y0 + y1) / 2 / side)) % 2 == odd:
                    tiles.append(make_flat([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], 0.0))
    return merge(tiles)


def _cut(low: float, high: float, side: float) -> list[float]:
    inner = [n * side for n in range(math.floor(low / side) + 1, math.ceil(high / side))]
    return [low, *inner, high]


def format_obj(mesh: Mesh) -> str:
    """Return the mesh as a Wavefront OBJ file, for URDFs."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.normals.tolist()]
    lines += [f"f {a + 1}//{a + 1} {b + 1}//{b + 1} {c + 1}//{c + 1}" for a, b, c in mesh.triangles.tolist()]
    return "\n".join(lines) + "\n"


# --- parts of a room -------------------------------------------------------------------------


def make_floor(instance: RoomInstance, casting: Iterable[RoomPart]) -> dict[str, Mesh]:
    """Make tiles, shadows of parts, and puddles, by role; roles without triangles are left out."""
    floors, side = compute_floors(instance), palette.choose_tile(instance)
    shadows = [make_shadow(outline_footprint(part.shape), part.high, LAYER, floor)
               for part in casting for floor in floors]
    puddles = [make_flat(outline_capsule(puddle), 1.5 * LAYER)
               for puddle in get_mixin(instance.puzzle, Depicted).puddles]
    found = {"shadow": merge(shadows), "puddle": merge(puddles), "tile": _make_tiles(floors, side, False),
             "other tile": _make_tiles(floors, side, True)}
    return {role: mesh for role, mesh in found.items() if len(mesh.triangles)}


def make_part(part: RoomPart, most: float = math.inf) -> Mesh:
    """Make a part in its own frame, cut at a height above its lowest point."""
    shape = part.shape
    if part.low == part.high:
        return make_flat(outline_footprint(shape), part.low)
    high = min(part.high, part.low + most)
    if shape.is_disc:
        return make_cylinder(shape.half_x, part.low, high).moved(shape.x, shape.y)
    return make_prism(outline_footprint(shape), part.low, high)


def make_badges(instance: RoomInstance, target: Target) -> list[tuple[str, Mesh]]:
    """Return colours and meshes of a panel's front: a white disc with the target's cue; empty without cues."""
    cues, front = palette.list_cues(instance.puzzle), palette.find_front(instance, target)
    if not cues:
        return []
    disc = [(math.cos(turn), math.sin(turn)) for turn in (math.tau * number / 24 for number in range(24))]
    layers = (palette.BACKGROUND, disc), cues[instance.puzzle.target_names.index(target.name)]
    return [(colour, _make_badge(outline, target, front, LAYER * number))
            for number, (colour, outline) in enumerate(layers, 1)]


def make_base(robot: RobotConfig) -> dict[str, Mesh]:
    """Make the wheeled base with an arrow on top that shows the heading, as one mesh per colour."""
    radius, height = robot.inner_radius, robot.body_height
    top = height + LAYER
    tip, notch, barb = (0.72 * radius, 0.0), (-0.22 * radius, 0.0), (-0.5 * radius, 0.5 * radius)
    parts = {
        "trim": [make_base_column(robot, 0.02 * height, 0.15 * height, 0.9),
                 make_base_column(robot, 0.55 * height, 0.7 * height, 1.01)],
        "body": [make_base_column(robot, 0.15 * height, 0.85 * height),
                 make_base_column(robot, 0.85 * height, height, 1.0, 0.85)],
        "arrow": [make_flat([tip, barb, notch], top), make_flat([tip, notch, (barb[0], -barb[1])], top)],
    }
    return {palette.LOOKS[role]: merge(found) for role, found in parts.items()}
