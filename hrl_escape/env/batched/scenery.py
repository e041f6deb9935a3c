"""Scenery of a batch of rooms for its cameras, as tables of upright prisms: walls, panels, doors, blocks, the robot.

Shapes and places are those of Bullet's cameras, without shadows and mats; colours are the palette's. Metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.tables import Layout
from hrl_escape.env.drawing import palette
from hrl_escape.env.geometry import Footprint, Solid, make_footprint
from hrl_escape.env.instance import RoomInstance, Target
from hrl_escape.env.tensor_geometry import stack_shapes

__all__ = ["LOOK_COLOURS", "LABELS", "LOOKS", "LOOK_LABELS", "Scenery", "SceneryForm",
           "find_look", "list_base_parts", "stack_scenery"]

LABELS = ("nothing", "floor", "exit", "plate", "wall", "obstacle", "door", "target", "block", "robot")
"""Labels of a segmentation, by their number."""

LOOKS: dict[str, tuple[str, str]] = {
    "sky": ("nothing", "#dfe7ef"), "tile": ("floor", palette.FLOOR), "other tile": ("floor", "#e4dfd3"),
    "exit": ("exit", palette.EXIT_LOCKED), "open exit": ("exit", palette.EXIT_OPEN), "plate": ("plate", palette.PLATE),
    "wall": ("wall", palette.WALL), "obstacle": ("obstacle", palette.OBSTACLE), "door": ("door", palette.DOOR),
    "thing": ("block", palette.PROP), "frame": ("target", palette.INK), "off": ("target", palette.OFF.fill),
    "lit": ("target", palette.LIT.fill), "block": ("block", palette.PROP), "body": ("robot", palette.BODY),
    "arrow": ("robot", palette.BACKGROUND),
}
"""Name of each look -> its label and colour."""

LOOK_COLOURS = tuple(tuple(255.0 * part for part in palette.to_rgb(colour)) for _, colour in LOOKS.values())
"""Red, green and blue of each look, within [0, 255]."""
LOOK_LABELS = tuple(LABELS.index(label) for label, _ in LOOKS.values())
"""Index in `LABELS` of each look."""

_ABOVE_FLOOR = 0.02  # panels and leaves begin here
_PAINT = 0.018  # height of a plate


def find_look(name: str) -> int:
    """Index of a look in `LOOKS`."""
    return tuple(LOOKS).index(name)


class Scenery(NamedTuple):
    """Prisms of every instance; the last axis is the instance. Absent ones stand out of sight.

    Boxes are in this order: solids, frames of targets, their faces, blocks and plates, inner doors, and the leaf of the
    exit's door shut and open.

    Attributes:
        boxes: x, y, cosine and sine of the own x axis, half sizes, lowest and highest z, float32 (8, boxes, instances).
        looks: their looks, int64 (boxes, instances).
        cylinders: x, y, lowest and highest z, radius below and above, float32 (6, cylinders, instances).
        floors: x_min, x_max, y_min, y_max of the room's floor and of an alcove, float32 (4, 2, instances).
        sizes: half sizes of all, height of walls, and side of a tile, float32 (4, instances).
    """

    boxes: Tensor
    looks: Tensor
    cylinders: Tensor
    floors: Tensor
    sizes: Tensor


class SceneryForm(NamedTuple):
    """Constants of a scenery.

    Attributes:
        faces: number of the box that is the first target's face.
        is_straight: for each box whether its sides are along the axes in all instances.
    """

    faces: int
    is_straight: tuple[bool, ...]


class _Box(NamedTuple):
    shape: Footprint
    low: float
    high: float
    look: str


def list_base_parts(radius: float, height: float) -> tuple[tuple[float, float, float, float], ...]:
    """Parts of the base: lowest and highest z, radius below and above, m."""
    return ((0.15 * height, 0.85 * height, radius, radius), (0.85 * height, height, radius, 0.85 * radius))


def stack_scenery(instances: Sequence[RoomInstance], layout: Layout, device: torch.device
                  ) -> tuple[Scenery, SceneryForm]:
    """Stack the visible prisms of several instances."""
    groups = [_list_boxes(instance, layout) for instance in instances]
    stacked = [_stack_group(rows) for rows in zip(*groups, strict=True)]
    cylinders = [[s for s in instance.solids if s.shape == "cylinder"] for instance in instances]
    rounds = np.zeros((6, max(map(len, cylinders)), len(instances)))
    rounds[0], rounds[3] = 1e6, 1.0
    for k, solids in enumerate(cylinders):
        for n, solid in enumerate(solids):
            rounds[:, n, k] = solid.x, solid.y, 0.0, solid.height, solid.half_x, solid.half_x
    floors = np.full((4, 2, len(instances)), 1e6)
    for k, instance in enumerate(instances):
        for n, area in enumerate(palette.compute_floors(instance)):
            floors[:, n, k] = area.x_min, area.x_max, area.y_min, area.y_max
    sizes = [(i.reach_x, i.reach_y, i.wall_height, palette.choose_tile(i)) for i in instances]

    def floats(values: NDArray[np.float64]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values, np.float32)).to(device)

    looks = torch.from_numpy(np.concatenate([looks for _, looks in stacked])).to(device)
    scenery = Scenery(floats(np.concatenate([boxes for boxes, _ in stacked], axis=1)), looks, floats(rounds),
                      floats(floors), floats(np.array(sizes).T))
    is_straight = (scenery.boxes[3] == 0.0).all(dim=1)
    return scenery, SceneryForm(sum(len(looks) for _, looks in stacked[:2]), tuple(is_straight.tolist()))


def _stack_group(rows: Sequence[Sequence[_Box]]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Numbers (8, boxes, instances) and looks (boxes, instances) of one group."""
    most = max(map(len, rows))
    looks = np.zeros((most, len(rows)), np.int64)
    heights = np.zeros((2, most, len(rows)))
    for k, row in enumerate(rows):
        for n, box in enumerate(row):
            looks[n, k], heights[:, n, k] = find_look(box.look), (box.low, box.high)
    shapes = stack_shapes([[_straighten(box.shape) for box in row] for row in rows])[:6, :most]
    return np.concatenate([shapes, heights]), looks


def _straighten(shape: Footprint) -> Footprint:
    """The same box with its own x along the room's, if its sides are parallel to the room's axes."""
    if shape.sin == 0.0:
        return shape._replace(cos=1.0)
    return shape if shape.cos else shape._replace(cos=1.0, sin=0.0, half_x=shape.half_y, half_y=shape.half_x)


def _list_boxes(instance: RoomInstance, layout: Layout) -> tuple[list[_Box], ...]:
    """Boxes of one instance, group by group in the order of `Scenery`."""
    away = _Box(make_footprint(1e6, 0.0, 0.0, 0.0), 0.0, 1.0, "sky")
    solids = [_Box(s.footprint, 0.0, s.height, "wall" if s.role == "wall" else "obstacle")
              for s in instance.solids if s.shape == "box"]
    pairs = [_list_panel(target) for target in instance.targets]
    pairs += [(away, away)] * (layout.targets - len(pairs))
    props = [_Box(make_footprint(p.x, p.y, p.prop.half_size, p.prop.half_size, p.yaw), 0.0,
                  _PAINT if p.prop.kind == "plate" else p.prop.height, p.prop.kind) for p in instance.props]
    inner = [_Box(_shrink(door, 0.98 if door.role == "door" else 0.5), _ABOVE_FLOOR, door.height,
                  "door" if door.role == "door" else "thing") for door in instance.inner_doors]
    inner += [away] * (layout.inner_doors - len(inner))
    leaves = [away, away] if layout.has_door else []
    if instance.door is not None:
        leaves = [_Box(_swing(instance, instance.door, angle), _ABOVE_FLOOR, instance.door.height, "door")
                  for angle in (0.0, math.pi / 2)]
    return solids, [frame for frame, _ in pairs], [face for _, face in pairs], props, inner, leaves


def _list_panel(target: Target) -> tuple[_Box, _Box]:
    """Frame and face of a target."""
    low, high = max(_ABOVE_FLOOR, target.z - target.half_z), target.z + target.half_z
    rim = min(0.08, 0.2 * min(target.half_x, target.half_z))
    frame = make_footprint(target.x, target.y, target.half_x + rim, 0.7 * target.half_y, target.yaw)
    return _Box(frame, max(0.0, low - rim), high + rim, "frame"), _Box(target.footprint, low, high, "off")


def _shrink(door: Solid, share: float) -> Footprint:
    return make_footprint(door.x, door.y, share * door.half_x, share * door.half_y, door.yaw)


def _swing(instance: RoomInstance, door: Solid, angle: float) -> Footprint:
    """Leaf of the exit's door, turned about its hinge towards the exit."""
    cos, sin, yaw = math.cos(door.yaw), math.sin(door.yaw), door.yaw + angle * instance.door_swing
    return make_footprint(door.x + door.half_x * (math.cos(yaw) - cos), door.y + door.half_x * (math.sin(yaw) - sin),
                          door.half_x, 0.6 * door.half_y, yaw)
