"""Cameras of a batch of rooms: colours, depth and labels of each pixel, by exact ray casting in tensors.

Everything in a kinematic room is an upright prism on its own axis, or paint on the floor. Rays meet these in closed
form (slabs, Kay and Kajiya 1986). Views, shapes, places and colours equal those of Bullet's cameras, whose pictures
also have shadows and soft edges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.poses import TensorState, compute_rotation
from hrl_escape.env.batched.puzzles.base import unpack_bits
from hrl_escape.env.batched.rules import find_shut
from hrl_escape.env.batched.tables import Layout, Tables, map_tensors, pick, pick_rules
from hrl_escape.env.engine import check_camera, check_picture_size
from hrl_escape.env.geometry import Footprint, make_footprint
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.model import RoomModel, RoomPart
from hrl_escape.env.tensor_geometry import stack_shapes
from hrl_escape.errors import UnsupportedError

LABELS = ("nothing", "floor", "exit", "plate", "wall", "obstacle", "door", "target", "block", "robot")
"""Labels of a segmentation, by their number."""

LABELS_OF_LOOKS = {
    "sky": "nothing", "tile": "floor", "other tile": "floor", "exit": "exit", "open exit": "exit", "plate": "plate",
    "wall": "wall", "obstacle": "obstacle", "door": "door", "thing": "block", "frame": "target", "off": "target",
    "lit": "target", "block": "block", "body": "robot", "arrow": "robot",
}
"""Role of each visible part -> its label."""

LOOK_COLOURS = tuple(tuple(255.0 * part for part in palette.to_rgb(palette.LOOKS[role])) for role in LABELS_OF_LOOKS)
"""Red, green and blue of each look, in [0, 255]."""
LOOK_LABELS = tuple(map(LABELS.index, LABELS_OF_LOOKS.values()))
"""Index in `LABELS` of each look."""

_PAINT = 0.018  # height of a plate, m


def find_look(name: str) -> int:
    """Return the index of a look in `LABELS_OF_LOOKS`."""
    return tuple(LABELS_OF_LOOKS).index(name)


class Scenery(NamedTuple):
    """Prisms of every instance; the last axis is the instance. Absent prisms are placed out of sight.

    Boxes are in this order: solids, frames of targets, their faces, blocks and plates, inner doors, and the leaf of the
    exit door shut and open.
    """

    boxes: Tensor
    """x, y, cosine and sine of the own x axis, half sizes, lowest and highest z, float32 (8, boxes, instances)."""
    looks: Tensor  # looks of the boxes, int64 (boxes, instances)
    cylinders: Tensor  # x, y, lowest and highest z, radius below and above, float32 (6, cylinders, instances)
    floors: Tensor  # x_min, x_max, y_min, y_max of the floors of room and alcove, float32 (4, 2, instances)
    sizes: Tensor  # half sizes of the floor, height of walls, and side of a tile, float32 (4, instances)


class SceneryForm(NamedTuple):
    """Constants of a scenery."""

    faces: int  # index of the box that is the first target's face
    is_straight: tuple[bool, ...]  # whether the sides of each box are parallel to the axes in all instances


def stack_scenery(instances: Sequence[RoomInstance], layout: Layout, device: torch.device
                  ) -> tuple[Scenery, SceneryForm]:
    """Stack the visible prisms of several instances."""
    models = [RoomModel(instance) for instance in instances]
    stacked = [_stack_group(rows) for rows in zip(*(_list_boxes(model, layout) for model in models), strict=True)]
    cylinders = [[part for part in model.solids if part.shape.is_disc] for model in models]
    rounds = np.zeros((6, max(map(len, cylinders)), len(instances)))
    rounds[0], rounds[3] = 1e6, 1.0
    floors = np.full((4, 2, len(instances)), 1e6)
    for k, model in enumerate(models):
        for n, part in enumerate(cylinders[k]):
            rounds[:, n, k] = part.shape.x, part.shape.y, part.low, part.high, part.shape.half_x, part.shape.half_x
        for n, floor in enumerate(model.floors):
            _, x, y, _, _, half_x, half_y = floor.shape
            floors[:, n, k] = x - half_x, x + half_x, y - half_y, y + half_y
    sizes = [(i.reach_x, i.reach_y, i.wall_height, palette.choose_tile(i)) for i in instances]

    def floats(values: NDArray[np.float64]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values, np.float32)).to(device)

    looks = torch.from_numpy(np.concatenate([looks for _, looks in stacked])).to(device)
    scenery = Scenery(floats(np.concatenate([boxes for boxes, _ in stacked], axis=1)), looks, floats(rounds),
                      floats(floors), floats(np.array(sizes).T))
    is_straight = (scenery.boxes[3] == 0.0).all(dim=1)
    return scenery, SceneryForm(sum(len(looks) for _, looks in stacked[:2]), tuple(is_straight.tolist()))


def _stack_group(rows: Sequence[Sequence[RoomPart]]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Numbers (8, boxes, instances) and looks (boxes, instances) of one group."""
    most = max(map(len, rows))
    looks = np.zeros((most, len(rows)), np.int64)
    heights = np.zeros((2, most, len(rows)))
    for k, row in enumerate(rows):
        for n, box in enumerate(row):
            looks[n, k], heights[:, n, k] = find_look(box.role), (box.low, box.high)
    shapes = stack_shapes([[_straighten(box.shape) for box in row] for row in rows])[:6, :most]
    return np.concatenate([shapes, heights]), looks


def _straighten(shape: Footprint) -> Footprint:
    """The same box with its x along the room's, if its sides are parallel to the room's axes."""
    if shape.sin == 0.0:
        return shape._replace(cos=1.0)
    return shape if shape.cos else shape._replace(cos=1.0, sin=0.0, half_x=shape.half_y, half_y=shape.half_x)


def _list_boxes(model: RoomModel, layout: Layout) -> tuple[list[RoomPart], ...]:
    """Boxes of one room, group by group in the order of `Scenery`."""
    away = RoomPart("sky", make_footprint(1e6, 0.0, 0.0, 0.0), 0.0, 1.0)
    absent = [away] * (layout.targets - len(model.panels))
    props = [part._replace(shape=make_footprint(p.x, p.y, part.shape.half_x, part.shape.half_y, p.yaw), low=0.0,
                           high=_PAINT if part.role == "plate" else p.prop.height)
             for part, p in zip(model.props, model.instance.props, strict=True)]
    inner = [*model.inner_doors, *[away] * (layout.inner_doors - len(model.inner_doors))]
    leaves = [away, away] if layout.has_door else []
    if model.leaf is not None:
        leaves = [model.place_leaf(angle) for angle in (0.0, math.pi / 2 * model.instance.door_swing)]
    return ([part for part in model.solids if not part.shape.is_disc], [panel.frame for panel in model.panels] + absent,
            [panel.face for panel in model.panels] + absent, props, inner, leaves)


_CHUNK = 100_000  # pixels per pass on a CPU; small enough for the intermediate values to stay in a core's cache
_FAR = 1e6
_FACES = 5  # of a box: no camera sees the bottom
_SUN = (-0.397, 0.258, 0.894)
_AMBIENT, _DIFFUSE = 0.74, 0.27


class Pictures(NamedTuple):
    """Pictures of all rooms."""

    rgb: Tensor  # uint8 (rooms, height, width, 3)
    depth: Tensor  # distance along the camera's axis, m, float32 (rooms, height, width); infinity for the background
    segmentation: Tensor  # index in `LABELS`, uint8 (rooms, height, width)


class _Form(NamedTuple):
    """Constants of a picture, in addition to the layout."""

    camera: str
    width: int
    height: int
    scenery: SceneryForm


class _View(NamedTuple):
    """Positions of cameras, m, and unit vectors to the right, up and ahead; three tensors (rooms,) each."""

    eye: list[Tensor]
    right: list[Tensor]
    up: list[Tensor]
    ahead: list[Tensor]
    field: float


class BatchedCamera:
    """A camera in every room of a batch.

    Args:
        room: the batch.
        camera: `robot` or `overhead`, as in `CAMERAS`.
        width: pixels, from 8 to 2048.
        height: pixels, from 8 to 2048.

    Raises:
        UnknownNameError: no camera of that name.
        ConfigError: invalid size.
        UnsupportedError: the camera `chase`, a robot with an arm, or targets with cues.
    """

    def __init__(self, room: TensorRoom, camera: str = "robot", width: int = 84, height: int = 84) -> None:
        check_camera(camera)
        check_picture_size(width, height)
        if camera not in _VIEWS:
            raise UnsupportedError(f"camera = {camera!r}: a batch has {' or '.join(map(repr, _VIEWS))}; "
                                   "gymnasium.make makes a room with every camera")
        if room.layout.robot.joints:
            raise UnsupportedError("the batched cameras cannot draw an arm. Use gymnasium.make")
        if room.tables.cues.numel():
            raise UnsupportedError("the batched cameras cannot draw cues. Use gymnasium.make")
        self._room = room
        self._scenery, scenery_form = stack_scenery(room.instances, room.layout, room.device)
        self._form = _Form(camera, width, height, scenery_form)

    def take(self) -> Pictures:
        """Take a picture of the current state of every room."""
        room, state = self._room, self._room.state
        with torch.no_grad():
            many = room.count if room.device.type != "cpu" else max(1, _CHUNK // (self._form.width * self._form.height))
            parts = [_take(room.layout, self._form, room.tables, self._scenery,
                           map_tensors(lambda field, begin=begin: field[..., begin : begin + many], state))
                     for begin in range(0, room.count, many)]
            return Pictures(*(torch.cat(rows) for rows in zip(*parts, strict=True)))


# --- views -----------------------------------------------------------------------------------


def _view_robot(layout: Layout, things: Scenery, form: _Form, state: TensorState, tables: Tables) -> _View:
    """Camera above the front edge of the base, 12 degrees down."""
    cos, sin = (part.to(torch.float32) for part in compute_rotation(layout, tables, state))
    x, y = state.x.to(torch.float32), state.y.to(torch.float32)
    robot = layout.robot
    forward, lift = 0.9 * robot.base.front, 1.15 * robot.body_height + 0.1
    nought, down = torch.zeros_like(x), math.radians(12.0)
    return _View(eye=[x + forward * cos, y + forward * sin, nought + lift], right=[sin, -cos, nought],
                 up=[math.sin(down) * cos, math.sin(down) * sin, nought + math.cos(down)],
                 ahead=[math.cos(down) * cos, math.cos(down) * sin, nought - math.sin(down)], field=70.0)


def _view_overhead(layout: Layout, things: Scenery, form: _Form, state: TensorState, tables: Tables) -> _View:
    """Camera straight above, with the whole floor in view and y upwards."""
    reach_x, reach_y, walls, _ = things.sizes
    half = 1.04 * torch.maximum(reach_y + 0.5, (reach_x + 0.5) * (form.height / form.width))
    nought = torch.zeros_like(state.x, dtype=torch.float32)
    height = half / math.tan(math.radians(15.0)) + walls
    return _View([nought, nought, nought + height], [nought + 1.0, nought, nought], [nought, nought + 1.0, nought],
                 [nought, nought, nought - 1.0], 30.0)


_VIEWS = {"robot": _view_robot, "overhead": _view_overhead}


def _aim(form: _Form, view: _View) -> list[Tensor]:
    """Directions through the centres of the pixels, (rooms, pixels) each, of length 1 along the camera's axis."""
    device = view.eye[0].device
    tall = math.tan(math.radians(view.field / 2))
    columns = (torch.arange(form.width, device=device) + 0.5) * (2.0 / form.width) - 1.0
    rows = 1.0 - (torch.arange(form.height, device=device) + 0.5) * (2.0 / form.height)
    across = (tall * form.width / form.height * columns).repeat(form.height)
    upwards = (tall * rows).repeat_interleave(form.width)
    return [ahead.unsqueeze(1) + across * right.unsqueeze(1) + upwards * up.unsqueeze(1)
            for ahead, right, up in zip(view.ahead, view.right, view.up, strict=True)]


# --- rays ------------------------------------------------------------------------------------


def _take(layout: Layout, form: _Form, tables: Tables, scenery: Scenery, state: TensorState) -> Pictures:
    things: Scenery = _add_box_base(layout, tables, pick(layout, scenery, state.instance), state)
    view = _VIEWS[form.camera](layout, things, form, state, tables)
    ray = _aim(form, view)
    inverse = [1.0 / torch.where(part.abs() < 1e-9, 1e-9, part) for part in ray]
    ground = -view.eye[2].unsqueeze(1) * inverse[2]  # where the ray reaches the level of the floor
    depth = torch.where(ray[2] < 0.0, ground, _FAR)
    floor_look = _find_floor_look(layout, tables, things, view, ray, depth, state)
    depth = torch.where(floor_look == 0, _FAR, depth)
    # The look of each pixel is a row of a table: looks, then the five faces of each box, then the rounds.
    looks = _find_looks(layout, form, tables, things, state)
    which, bright = floor_look, torch.ones_like(depth)
    for number in range(len(looks)):
        is_straight = number < len(form.scenery.is_straight) and form.scenery.is_straight[number]
        met, face = _meet_box(view, ray, inverse, things.boxes[:, number], is_straight)
        is_seen = (met < depth) & (looks[number] > 0).unsqueeze(1)
        which = torch.where(is_seen, len(LABELS_OF_LOOKS) + _FACES * number + face, which)
        depth = torch.where(is_seen, met, depth)
    rounds = _list_rounds(layout, things, state)
    for number in range(rounds.shape[1]):
        met, light = _meet_round(view, ray, inverse[2], rounds[:, number])
        is_seen = met < depth
        which = torch.where(is_seen, len(LABELS_OF_LOOKS) + _FACES * len(looks) + number, which)
        bright, depth = torch.where(is_seen, light, bright), torch.minimum(depth, met)
    place = [eye.unsqueeze(1) + depth * part for eye, part in zip(view.eye, ray, strict=True)]
    which = torch.where(_is_arrow(layout, tables, state, place), find_look("arrow"), which)

    table = _tabulate(things, looks, rounds.shape[1])
    packed = torch.gather(table, 1, which.to(torch.int64))
    red, green, blue, label = ((packed >> shift) & 255 for shift in (0, 8, 16, 24))
    rgb = torch.stack([(part * bright + 0.5).clamp(max=255.0).to(torch.uint8) for part in (red, green, blue)], dim=2)
    shape = (len(state.x), form.height, form.width)
    return Pictures(rgb.view(*shape, 3), torch.where(depth >= _FAR, math.inf, depth).view(shape),
                    label.to(torch.uint8).view(shape))


def _tabulate(things: Scenery, looks: Tensor, rounds: int) -> Tensor:
    """Colour and label of everything visible, packed into words, int32 (rooms, entries)."""
    device, rooms = looks.device, looks.shape[1]
    colours = torch.tensor(LOOK_COLOURS, device=device)
    labels = torch.tensor(LOOK_LABELS, dtype=torch.int32, device=device)
    cos, sin = things.boxes[2].expand(-1, rooms), things.boxes[3].expand(-1, rooms)
    nought = torch.zeros_like(cos)
    light = torch.stack([_shade(x, y, z) for x, y, z in (
        (nought, nought, nought + 1.0), (cos, sin, nought), (-cos, -sin, nought), (-sin, cos, nought),
        (sin, -cos, nought))], dim=1)  # (boxes, faces, rooms), in the order of `_meet_box`
    shines = (looks == find_look("lit")) | (looks == find_look("off"))
    light = torch.where(shines.unsqueeze(1), 1.0, light).flatten(0, 1)
    every = torch.arange(len(LABELS_OF_LOOKS), device=device).unsqueeze(1).expand(-1, rooms)
    bodies = torch.full((rounds, rooms), find_look("body"), device=device)
    bodies[: things.cylinders.shape[1]] = find_look("obstacle")
    entries = torch.cat([every, looks.repeat_interleave(_FACES, dim=0), bodies])
    light = torch.cat([torch.ones_like(every, dtype=light.dtype), light, torch.ones_like(bodies, dtype=light.dtype)])
    rgb = (colours[entries] * light.unsqueeze(2) + 0.5).clamp(max=255.0).to(torch.int32)
    return (rgb[..., 0] | rgb[..., 1] << 8 | rgb[..., 2] << 16 | labels[entries] << 24).T.contiguous()


def _add_box_base(layout: Layout, tables: Tables, things: Scenery, state: TensorState) -> Scenery:
    """Append the robot's base to the boxes, unless it is round."""
    corners = layout.robot.base.corners
    if not corners:
        return things
    half_x, half_y = (max(map(abs, part)) for part in zip(*corners, strict=True))
    cos, sin = compute_rotation(layout, tables, state)
    height = layout.robot.body_height
    base = torch.stack([state.x, state.y, cos, sin, *(torch.full_like(state.x, value) for value in (
        half_x, half_y, 0.15 * height, height))]).to(torch.float32)
    looks = torch.full((1, len(state.x)), find_look("body"), device=base.device)
    return things._replace(
        boxes=torch.cat([things.boxes.expand(-1, -1, len(state.x)), base.unsqueeze(1)], dim=1),
        looks=torch.cat([things.looks.expand(-1, len(state.x)), looks]))


def _find_floor_look(layout: Layout, tables: Tables, things: Scenery, view: _View, ray: list[Tensor], depth: Tensor,
                     state: TensorState) -> Tensor:
    """Look of the floor where each ray hits it, int64 (rooms, pixels); 0 outside the floor."""
    x, y = (eye.unsqueeze(1) + depth * part for eye, part in zip(view.eye[:2], ray[:2], strict=True))
    side = things.sizes[3].unsqueeze(1)
    is_other = torch.remainder(torch.floor(x / side) + torch.floor(y / side), 2.0) >= 1.0
    is_floor = torch.zeros_like(is_other)
    for number in range(2):
        is_floor = is_floor | _is_within(x, y, things.floors[:, number])
    look = torch.where(is_other, find_look("other tile"), find_look("tile")).to(torch.int32)
    exit_ = pick(layout, tables.exits, state.instance).to(torch.float32)
    rules, columns = pick_rules(layout, tables, state.instance)
    solved = rules.is_solved(columns, state.puzzle)
    paint = torch.where(solved, find_look("open exit"), find_look("exit")).to(torch.int32).unsqueeze(1)
    look = torch.where(_is_within(x, y, exit_), paint, look)
    return torch.where(is_floor & (depth < _FAR), look, 0)


def _is_within(x: Tensor, y: Tensor, area: Tensor) -> Tensor:
    """Return whether points (rooms, pixels) are in rectangles (4, rooms)."""
    x_min, x_max, y_min, y_max = area.unsqueeze(2)
    return (x_min <= x) & (x <= x_max) & (y_min <= y) & (y <= y_max)


def _find_looks(layout: Layout, form: _Form, tables: Tables, things: Scenery, state: TensorState) -> Tensor:
    """Current looks of all boxes, int64 (boxes, rooms); 0 for absent boxes."""
    puzzle, columns = pick_rules(layout, tables, state.instance)
    looks = things.looks.expand(-1, len(state.x)).clone()
    leaves, last = 2 if layout.has_door else 0, len(form.scenery.is_straight)
    if leaves:
        is_open = puzzle.is_solved(columns, state.puzzle)
        looks[last - 1] = torch.where(is_open, looks[last - 1], 0)
        looks[last - 2] = torch.where(is_open, 0, looks[last - 2])
    if layout.inner_doors:
        inner = slice(last - leaves - layout.inner_doors, last - leaves)
        looks[inner] = torch.where(find_shut(layout, tables, state), looks[inner], 0)
    lit = unpack_bits(puzzle.get_lit(columns, state.puzzle), layout.targets, torch.bool)
    faces = slice(form.scenery.faces, form.scenery.faces + layout.targets)
    looks[faces] = torch.where(lit & (looks[faces] == find_look("off")), find_look("lit"), looks[faces])
    return looks


def _meet_box(view: _View, ray: list[Tensor], inverse: list[Tensor], box: Tensor, is_straight: bool
              ) -> tuple[Tensor, Tensor]:
    """Depth at which rays (rooms, pixels) meet boxes (8, rooms), `_FAR` for a miss, and the face that they meet.

    Faces: 0 on top, 1 and 2 in front and behind along the box's x, 3 and 4 along its y, int32.
    """
    x, y, cos, sin, half_x, half_y, low, high = box.unsqueeze(2)
    dx, dy = view.eye[0].unsqueeze(1) - x, view.eye[1].unsqueeze(1) - y
    vx, vy, per_x, per_y = *ray[:2], *inverse[:2]
    if not is_straight:
        vx, vy = cos * ray[0] + sin * ray[1], cos * ray[1] - sin * ray[0]
        dx, dy = cos * dx + sin * dy, cos * dy - sin * dx
        per_x, per_y = (1.0 / torch.where(part.abs() < 1e-9, 1e-9, part) for part in (vx, vy))
    eye_z = view.eye[2].unsqueeze(1)
    enters, leaves = [], []
    for at, half, per in ((dx, half_x, per_x), (dy, half_y, per_y),
                          (eye_z - (low + high) / 2, (high - low) / 2, inverse[2])):
        middle, reach = at * per, half * per.abs()
        enters.append(-middle - reach)
        leaves.append(reach - middle)
    enter = torch.maximum(torch.maximum(enters[0], enters[1]), enters[2])
    leave = torch.minimum(torch.minimum(leaves[0], leaves[1]), leaves[2])
    met = torch.where((enter <= leave) & (enter > 0.0), enter, _FAR)
    face = torch.where(enters[0] >= enters[1], 1 + (vx > 0.0).to(torch.int32), 3 + (vy > 0.0).to(torch.int32))
    return met, torch.where(enter == enters[2], 0, face)


def _list_rounds(layout: Layout, things: Scenery, state: TensorState) -> Tensor:
    """Cylinders and the robot's base, if it is round, (6, cylinders and parts, rooms)."""
    x, y = state.x.to(torch.float32), state.y.to(torch.float32)
    if layout.robot.base.corners:
        return things.cylinders.expand(-1, -1, len(x))
    radius, height = layout.robot.outer_radius, layout.robot.body_height
    parts = [torch.stack([x, y, *(torch.full_like(x, value) for value in part)]) for part in (
        (0.15 * height, 0.85 * height, radius, radius), (0.85 * height, height, radius, 0.85 * radius))]
    return torch.cat([things.cylinders.expand(-1, -1, len(x)), torch.stack(parts, dim=1)], dim=1)


def _meet_round(view: _View, ray: list[Tensor], per_z: Tensor, shape: Tensor) -> tuple[Tensor, Tensor]:
    """Depth at which rays (rooms, pixels) meet upright frusta (6, rooms), `_FAR` for a miss, and their brightness."""
    x, y, low, high, below, above = shape.unsqueeze(2)
    px, py, pz = view.eye[0].unsqueeze(1) - x, view.eye[1].unsqueeze(1) - y, view.eye[2].unsqueeze(1)
    slope = (above - below) / (high - low)
    radius = below + slope * (pz - low)  # radius of the extended side at the eye's height
    a = ray[0] * ray[0] + ray[1] * ray[1] - slope * slope * ray[2] * ray[2]
    b = px * ray[0] + py * ray[1] - slope * radius * ray[2]
    c = px * px + py * py - radius * radius
    root = b * b - a * c
    side = (-b - torch.sqrt(root.clamp(min=0.0))) / torch.where(a.abs() < 1e-12, 1e-12, a)
    z = pz + side * ray[2]
    met = torch.where((root >= 0.0) & (side > 0.0) & (low <= z) & (z <= high), side, _FAR)
    lid = (high - pz) * per_z
    at_x, at_y = px + lid * ray[0], py + lid * ray[1]
    lid = torch.where((lid > 0.0) & (at_x * at_x + at_y * at_y <= above * above), lid, _FAR)
    light = _shade((px + side * ray[0]) / below, (py + side * ray[1]) / below, torch.zeros_like(side))
    return torch.minimum(met, lid), torch.where(lid < met, _AMBIENT + _DIFFUSE * _SUN[2], light)


def _shade(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Brightness of surfaces, from their unit normals."""
    return _AMBIENT + _DIFFUSE * (_SUN[0] * x + _SUN[1] * y + _SUN[2] * z).clamp(min=0.0)


def _is_arrow(layout: Layout, tables: Tables, state: TensorState, place: list[Tensor]) -> Tensor:
    """Return whether points are on the arrow on top of the base that shows the heading, bool (rooms, pixels)."""
    radius, height = layout.robot.inner_radius, layout.robot.body_height
    cos, sin = (part.to(torch.float32).unsqueeze(1) for part in compute_rotation(layout, tables, state))
    dx, dy = (at - own.to(torch.float32).unsqueeze(1) for at, own in zip(place, (state.x, state.y), strict=False))
    ahead, aside = (cos * dx + sin * dy) / radius, ((cos * dy - sin * dx) / radius).abs()
    front = (0.72 - ahead) * 0.5 - aside * 1.22  # positive behind the line from the tip to a barb
    back = (ahead + 0.22) * 0.5 + aside * 0.28  # positive in front of the line from the notch to the barb
    return (front >= 0.0) & (back >= 0.0) & ((place[2] - height).abs() < 1e-2)
