"""Triangle meshes of what there is to see in a room, for Bullet's cameras and the viewer.

Shapes first, then the parts of a room made of them. Fixed parts are in the room frame; the leaf of the exit's door,
props and the robot's base in their own. Pure functions; every face has its own vertices, so that edges look like edges.
Faces are counter-clockwise seen from outside, metres. Nothing here collides.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.drawing import palette
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import Rectangle, RoomInstance, Target, compute_floors
from hrl_escape.env.puzzles.mixins import Depicted, get_mixin
from hrl_escape.env.puzzles.places import Capsule, Prop

Point = tuple[float, float]

FACETS = 32
LAYER = 0.006
"""Height between two layers of paint on the floor, m."""
WALL_FACE, WALL_TOP, OBSTACLE_FACE = "#c6ccd6", "#5b6475", "#c2a27c"
TILE, PANEL_FRAME, MAT = "#efebe2", "#39404d", "#e0ac9e"
_TRIM, _TOP = "#1f2733", "#e9eef5"
_ABOVE_FLOOR = 0.02  # panels and leaves begin here
SHADOW = (0.34, -0.22)
"""Offset of a point's shadow, per metre of its height, m."""
_LONGEST_SHADOW = 1.3


class Mesh(NamedTuple):
    """Triangles that share vertices, each vertex with its normal, in metres."""

    vertices: NDArray[np.float64]  # (n, 3), float64, m
    normals: NDArray[np.float64]  # (n, 3), float64, unit
    triangles: NDArray[np.int64]  # (m, 3), int64, numbers of vertices

    def moved(self, x: float, y: float) -> Mesh:
        """The same mesh elsewhere on the floor."""
        return self._replace(vertices=self.vertices + (x, y, 0.0))

    def facing(self, direction: tuple[float, float, float]) -> Mesh:
        """The same mesh, shaded as if all of it faced one direction."""
        unit = np.array(direction) / math.hypot(*direction)
        return self._replace(normals=np.tile(unit, (len(self.vertices), 1)))


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Put meshes together as one."""
    if not meshes:
        return make_flat((), 0.0)
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate([mesh.normals for mesh in meshes]),
                np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]))


def outline_capsule(capsule: Capsule) -> list[Point]:
    """Corners of a capsule, counter-clockwise: two half circles, joined by its straight sides."""
    along = math.atan2(capsule.y2 - capsule.y1, capsule.x2 - capsule.x1)
    ends = ((capsule.x2, capsule.y2, along - math.pi / 2), (capsule.x1, capsule.y1, along + math.pi / 2))
    return [(x + capsule.radius * math.cos(angle), y + capsule.radius * math.sin(angle)) for x, y, first in ends
            for angle in np.linspace(first, first + math.pi, FACETS).tolist()]


def make_flat(outline: Sequence[Point], z: float, up: bool = True) -> Mesh:
    """A horizontal convex polygon, given counter-clockwise; seen from above, or from below."""
    n = len(outline)
    if n < 3:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    vertices = np.column_stack([np.array(outline, dtype=np.float64), np.full(n, z)])
    fan = np.array([(0, i, i + 1) for i in range(1, n - 1)], dtype=np.int64).reshape(-1, 3)
    return Mesh(vertices, np.tile((0.0, 0.0, 1.0 if up else -1.0), (n, 1)), fan if up else fan[:, ::-1])


def _make_badge(outline: Sequence[Point], target: Target, front: Point, lift: float) -> Mesh:
    """A flat polygon on the front of a panel, star-shaped about (0, 0), lifted from its face by so many metres.

    Its corners are counter-clockwise, in halves of the panel's smaller side.
    """
    scale, (x, y) = 0.8 * min(target.half_x, target.half_z), front
    centre = np.array([target.x + (target.half_y + lift) * x, target.y + (target.half_y + lift) * y, target.z])
    corners = np.array([(0.0, 0.0), *outline]) * scale
    vertices = centre + corners[:, :1] * (-y, x, 0.0) + corners[:, 1:] * (0.0, 0.0, 1.0)
    fan = [(0, number, number % len(outline) + 1) for number in range(1, len(outline) + 1)]
    return Mesh(vertices, np.tile((x, y, 0.0), (len(vertices), 1)), np.array(fan, dtype=np.int64))


def make_prism(outline: Sequence[Point], low: float, high: float) -> Mesh:
    """An upright prism over a convex counter-clockwise polygon, from height `low` to `high`, with flat sides."""
    sides = []
    for (x0, y0), (x1, y1) in zip(outline, [*outline[1:], outline[0]], strict=True):
        length = math.hypot(x1 - x0, y1 - y0) or 1.0
        normal = ((y1 - y0) / length, (x0 - x1) / length, 0.0)
        corners = np.array([(x0, y0, low), (x1, y1, low), (x1, y1, high), (x0, y0, high)])
        sides.append(Mesh(corners, np.tile(normal, (4, 1)), np.array([(0, 1, 2), (0, 2, 3)])))
    return merge([*sides, make_flat(outline, high), make_flat(outline, low, up=False)])


def make_cylinder(radius: float, low: float, high: float, top_radius: float | None = None) -> Mesh:
    """An upright cylinder (or cone frustum) about the z axis, round sides shaded smoothly."""
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
    """A slice of the robot's base from height `low` to `high`, its outline scaled, and a round one's top."""
    if robot.base.corners:
        return make_prism([(share * x, share * y) for x, y in robot.base.corners], low, high)
    top = None if top_share is None else top_share * robot.outer_radius
    return make_cylinder(share * robot.outer_radius, low, high, top)


def compute_base_outline(robot: RobotConfig) -> list[Point]:
    """Corners of the robot's base, counter-clockwise, in its own frame."""
    radius = robot.outer_radius
    return list(robot.base.corners) or compute_outline(Solid("cylinder", 0.0, 0.0, radius, radius))


def compute_outline(solid: Solid) -> list[Point]:
    """Corners of a solid's footprint, counter-clockwise, in the room frame."""
    if solid.shape == "cylinder":
        angles = [n * math.tau / FACETS for n in range(FACETS)]
        return [(solid.x + solid.half_x * math.cos(a), solid.y + solid.half_x * math.sin(a)) for a in angles]
    return rotate_box(solid.x, solid.y, solid.half_x, solid.half_y, solid.yaw)


def compute_extent(instance: RoomInstance) -> tuple[float, float, float, float]:
    """x_min, x_max, y_min, y_max of everything solid, and of the exit."""
    xs = [-instance.half_width, instance.half_width, instance.exit.x_min, instance.exit.x_max]
    ys = [-instance.half_depth, instance.half_depth, instance.exit.y_min, instance.exit.y_max]
    for solid in instance.solids:
        corners = rotate_box(solid.x, solid.y, solid.half_x, solid.half_y, solid.yaw)
        xs += [x for x, _ in corners]
        ys += [y for _, y in corners]
    return min(xs), max(xs), min(ys), max(ys)


def rotate_box(x: float, y: float, half_x: float, half_y: float, yaw: float) -> list[Point]:
    """Corners of a turned rectangle, counter-clockwise."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    corners = ((-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y))
    return [(x + cos * a - sin * b, y + sin * a + cos * b) for a, b in corners]


def make_shadow(outline: Sequence[Point], height: float, z: float, floor: Rectangle | None = None) -> Mesh:
    """The shadow that an upright prism casts on the floor, as a flat polygon at height `z`.

    With `floor`, only the part on that rectangle, which may be empty (no triangles).
    """
    reach = min(height, _LONGEST_SHADOW / math.hypot(*SHADOW))
    points = [*outline, *((x + SHADOW[0] * reach, y + SHADOW[1] * reach) for x, y in outline)]
    shape = [points[number] for number in ConvexHull(points).vertices]  # counter-clockwise
    if floor is not None:
        for axis, sign, limit in ((0, 1, floor.x_min), (0, -1, floor.x_max), (1, 1, floor.y_min), (1, -1, floor.y_max)):
            shape = _clip(shape, axis, sign, limit)
    return make_flat(shape, z)


def _clip(shape: Sequence[Point], axis: int, sign: int, limit: float) -> list[Point]:
    """Keep the part of a convex polygon on one side of a line (Sutherland and Hodgman, 1974)."""
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
    """The odd or the even squares of a chequered floor; squares are anchored at the origin."""
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
    """The mesh as a Wavefront OBJ file, for URDFs."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.normals.tolist()]
    lines += [f"f {a + 1}//{a + 1} {b + 1}//{b + 1} {c + 1}//{c + 1}" for a, b, c in mesh.triangles.tolist()]
    return "\n".join(lines) + "\n"


# --- parts of a room -------------------------------------------------------------------------


def make_floor(instance: RoomInstance, casting: Iterable[Solid]) -> tuple[Mesh, Mesh, Mesh, Mesh]:
    """The even and the odd tiles, the shadows that solids cast on them, and puddles; each may be empty."""
    floors, side = compute_floors(instance), palette.choose_tile(instance)
    shadows = [make_shadow(compute_outline(solid), solid.height, LAYER, floor) for solid in casting for floor in floors]
    puddles = [make_flat(outline_capsule(puddle), 1.5 * LAYER)
               for puddle in get_mixin(instance.puzzle, Depicted).puddles]
    return _make_tiles(floors, side, False), _make_tiles(floors, side, True), merge(shadows), merge(puddles)


def make_solid(solid: Solid, height: float = math.inf) -> Mesh:
    """A wall or an obstacle, up to a height."""
    height = min(height, solid.height)
    if solid.shape == "cylinder":
        return make_cylinder(solid.half_x, 0.0, height).moved(solid.x, solid.y)
    return make_prism(compute_outline(solid), 0.0, height)


def make_panel(target: Target, height: float = math.inf) -> tuple[Mesh, Mesh]:
    """A target's face, which lights up, and its frame, up to a height above its lower edge."""
    low = max(_ABOVE_FLOOR, target.z - target.half_z)
    top, rim = min(target.z + target.half_z, low + height), min(0.08, 0.2 * min(target.half_x, target.half_z))
    face = rotate_box(target.x, target.y, target.half_x, target.half_y, target.yaw)
    frame = rotate_box(target.x, target.y, target.half_x + rim, 0.7 * target.half_y, target.yaw)
    return make_prism(face, low, top), make_prism(frame, max(0.0, low - rim), top + rim)


def make_mat(instance: RoomInstance, target: Target) -> Mesh:
    """The mat on the floor in front of a target."""
    ahead = palette.find_front(instance, target)
    deep = target.half_y + (min(0.4, 0.5 * instance.robot.inner_radius) if target.kind == "panel" else 0.0)
    middle = (target.x + ahead[0] * deep / 2, target.y + ahead[1] * deep / 2)
    return make_flat(rotate_box(*middle, target.half_x, deep / 2, target.yaw), 4 * LAYER)


def make_badges(instance: RoomInstance, target: Target) -> list[tuple[str, Mesh]]:
    """Colours and meshes of a panel's front: a white disc and the target's mark on it; empty without marks."""
    marks, front = palette.list_marks(instance.puzzle), palette.find_front(instance, target)
    if not marks:
        return []
    disc = [(math.cos(turn), math.sin(turn)) for turn in (math.tau * number / 24 for number in range(24))]
    layers = (palette.BACKGROUND, disc), marks[instance.puzzle.target_names.index(target.name)]
    return [(colour, _make_badge(outline, target, front, LAYER * number))
            for number, (colour, outline) in enumerate(layers, 1)]


def make_exit_area(instance: RoomInstance) -> tuple[Mesh, Mesh]:
    """The exit's area on the floor, and its edge below."""
    area = instance.exit
    half_x, half_y = (area.x_max - area.x_min) / 2, (area.y_max - area.y_min) / 2
    rim = min(0.12, 0.1 * half_x, 0.1 * half_y)
    return (make_flat(rotate_box(*area.centre, half_x - rim, half_y - rim, 0.0), 3 * LAYER),
            make_flat(rotate_box(*area.centre, half_x, half_y, 0.0), 2 * LAYER))


def find_hinge(door: Solid) -> tuple[float, float, float]:
    """Foot of the hinge of the exit's door, on the floor."""
    return door.x - math.cos(door.yaw) * door.half_x, door.y - math.sin(door.yaw) * door.half_x, 0.0


def make_leaf(door: Solid, height: float = math.inf) -> Mesh:
    """The leaf of the exit's door in the frame of its hinge, up to a height."""
    return make_prism(rotate_box(door.half_x, 0.0, door.half_x, 0.6 * door.half_y, 0.0), _ABOVE_FLOOR,
                      min(height, door.height))


def make_inner_door(door: Solid, height: float = math.inf) -> Mesh:
    """A door that fills its cell, or a thing that fills half of it, up to a height."""
    share = 0.98 if door.role == "door" else 0.5
    return make_prism(rotate_box(door.x, door.y, share * door.half_x, share * door.half_y, door.yaw), _ABOVE_FLOOR,
                      min(height, door.height))


def make_prop(prop: Prop) -> Mesh:
    """A plate painted on the floor, or a block about its own centre."""
    outline = rotate_box(0.0, 0.0, prop.half_size, prop.half_size, 0.0)
    return (make_flat(outline, 3 * LAYER) if prop.kind == "plate" else
            make_prism(outline, -prop.height / 2, prop.height / 2))


def make_base(robot: RobotConfig) -> dict[str, Mesh]:
    """The wheeled base, with an arrow on top that shows the heading: colour -> all that has it."""
    radius, height = robot.inner_radius, robot.body_height
    top = height + LAYER
    parts = {
        _TRIM: [make_base_column(robot, 0.02 * height, 0.15 * height, 0.9),
                make_base_column(robot, 0.55 * height, 0.7 * height, 1.01)],
        palette.BODY: [make_base_column(robot, 0.15 * height, 0.85 * height),
                       make_base_column(robot, 0.85 * height, height, 1.0, 0.85)],
        _TOP: [make_flat([(0.72 * radius, 0.0), (-0.5 * radius, 0.5 * radius), (-0.22 * radius, 0.0)], top),
               make_flat([(0.72 * radius, 0.0), (-0.22 * radius, 0.0), (-0.5 * radius, -0.5 * radius)], top)],
    }
    return {colour: merge(found) for colour, found in parts.items()}
