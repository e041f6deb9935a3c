"""Pictures of a room through Bullet's software renderer (TinyRenderer), which needs no display or GPU.

`env/engine.py` lists the cameras. They show a decorated copy of the room, the `Stage`, in its own physics client. Walls
can therefore be cut open, buttons have frames and objects cast shadows without any effect on the robot or a saved
state. Metres, radians, the room frame.

FXAA (Lottes, NVIDIA 2009), vectorised over the edge pixels, softens edges: it follows steps of brightness along the
edge to both ends, and mixes a pixel with its neighbour across the edge. Four samples per pixel would take four times
the renderer's time.
"""

from __future__ import annotations

import math
import threading
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from hrl_escape.env.bullet import connect, disconnect, pybullet
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.engine import check_camera, check_picture_size
from hrl_escape.env.geometry import Footprint, make_footprint
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.mesh_files import write_meshes
from hrl_escape.env.pictures import meshes, palette
from hrl_escape.env.pictures.meshes import Mesh, make_cylinder, make_shadow
from hrl_escape.env.pictures.model import LAYER, RoomModel, RoomPart
from hrl_escape.env.robot import BASE_LINK, Robot
from hrl_escape.env.urdf import drop_shapes
from hrl_escape.files import temporary_folder

SUN = (-4.0, 2.6, 9.0)
"""Direction of the light, the same as for the shadows of `meshes.py`."""
CURB = 0.3
"""Remaining height of a wall that is cut open, m."""

_FINE = 3  # scale at which the trail is drawn, for soft edges
_GROUND = "#f7f8fa"
_AWAY = (0.0, 0.0, 1e6)  # far above, where no camera looks
_STILL = (0.0, 0.0, 0.0, 1.0)


class _View(NamedTuple):
    """A camera's position and lens; distances in m, `field` is the vertical angle of view in degrees."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float]
    field: float
    near: float
    far: float


class BulletRenderer:
    """Renderer of one room. Its `Stage` is built for the first picture and freed with the renderer."""

    def __init__(self, instance: RoomInstance) -> None:
        self._instance = instance
        self._stage: Stage | None = None

    def render(self, state: RoomState, camera: str, width: int, height: int, *,
               trail: Sequence[tuple[float, float]] = ()) -> NDArray[np.uint8]:
        """Take a picture, as `env.engine.Renderer` describes."""
        check_camera(camera)
        check_picture_size(width, height)
        stage = self._stage = self._stage or Stage(self._instance)
        stage.follow(state)
        view = _VIEWS[camera](stage.model.rules, state, width / height)
        for standing in stage.standing:
            stage.set_cut(standing, camera == "chase" and _hides(standing, stage.model.rules, state, view.eye))
        return _take(stage.client, view, width, height, trail, 0.2 * self._instance.robot.inner_radius)


# --- cameras -------------------------------------------------------------------------------


def _view_chase(rules: Kinematics, state: RoomState, aspect: float) -> _View:
    heading = rules.get_heading(state)
    size = min(max(rules.instance.robot.outer_radius / 0.75, 0.5), 4.0)
    cos, sin = math.cos(heading), math.sin(heading)
    back, ahead, lift = 6.0 * size, 1.6 * size, 4.6 * size
    eye = (state.x - back * cos, state.y - back * sin, state.z + lift)
    target = (state.x + ahead * cos, state.y + ahead * sin, state.z + 0.4 * size)
    return _View(eye, target, (0.0, 0.0, 1.0), 52.0, 0.3 * size, _reach(rules.instance) + back)


def _view_overhead(rules: Kinematics, state: RoomState, aspect: float) -> _View:
    instance, field = rules.instance, 30.0
    margin = 1.04
    half = margin * max(instance.reach_y + 0.5, (instance.reach_x + 0.5) / aspect)
    height = half / math.tan(math.radians(field / 2)) + instance.wall_height
    return _View((0.0, 0.0, height), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), field, 0.2 * height, 1.2 * height)


def _view_robot(rules: Kinematics, state: RoomState, aspect: float) -> _View:
    """Camera above the front edge of the base, 12 degrees down."""
    heading, robot = rules.get_heading(state), rules.instance.robot
    cos, sin = math.cos(heading), math.sin(heading)
    forward = 0.9 * robot.base.front
    eye = (state.x + forward * cos, state.y + forward * sin, state.z + 1.15 * robot.body_height + 0.1)
    drop = math.tan(math.radians(12.0))
    target = (eye[0] + cos, eye[1] + sin, eye[2] - drop)
    return _View(eye, target, (0.0, 0.0, 1.0), 70.0, 0.05, _reach(rules.instance))


_VIEWS = {"chase": _view_chase, "overhead": _view_overhead, "robot": _view_robot}


def _reach(instance: RoomInstance) -> float:
    return 2.2 * math.hypot(instance.reach_x + 1.0, instance.reach_y + 1.0, instance.wall_height)


def _hides(standing: Standing, rules: Kinematics, state: RoomState, eye: tuple[float, float, float]) -> bool:
    """Return whether something is between the eye and the near side of the robot."""
    shape, radius = standing.shape, rules.instance.robot.outer_radius
    (ex, ey, ez), x, y = eye, state.x, state.y
    near = 1.0 - 1.2 * radius / math.dist((ex, ey), (x, y))
    dx, dy, drop = near * (x - ex), near * (y - ey), ez - state.z
    enter, leave = 0.0, 1.0
    for axis_x, axis_y, half in ((shape.cos, shape.sin, shape.half_x), (-shape.sin, shape.cos, shape.half_y)):
        at = axis_x * (ex - shape.x) + axis_y * (ey - shape.y)
        move = axis_x * dx + axis_y * dy
        wide = half + 0.7 * radius
        if abs(move) < 1e-12:
            if abs(at) > wide:
                return False
            continue
        low, high = sorted(((-wide - at) / move, (wide - at) / move))
        enter, leave = max(enter, low), min(leave, high)
    return enter <= leave and standing.high > ez - leave * near * drop


# --- pixels --------------------------------------------------------------------------------


def _take(client: int, view: _View, width: int, height: int, trail: Sequence[tuple[float, float]],
          ribbon: float) -> NDArray[np.uint8]:
    looking = pybullet.computeViewMatrix(view.eye, view.target, view.up)
    lens = pybullet.computeProjectionMatrixFOV(view.field, width / height, view.near, view.far)
    _, _, colours, depths, bodies = pybullet.getCameraImage(
        width, height, looking, lens, shadow=0, renderer=pybullet.ER_TINY_RENDERER, lightDirection=SUN,
        lightAmbientCoeff=0.74, lightDiffuseCoeff=0.27, lightSpecularCoeff=0.0, physicsClientId=client,
    )
    picture = np.reshape(colours, (height, width, 4))[..., :3].astype(np.uint8)
    empty = np.reshape(bodies, (height, width)) < 0
    picture[empty] = _make_backdrop(view, height)[np.nonzero(empty)[0]]
    picture = soften_edges(picture)
    if len(trail) > 1:
        matrix = np.reshape(lens, (4, 4)).T @ np.reshape(looking, (4, 4)).T
        picture = _draw_trail(picture, np.reshape(depths, (height, width)), view, matrix, trail, ribbon)
    return picture


def _make_backdrop(view: _View, height: int) -> NDArray[np.uint8]:
    """One colour per row: sky above the horizon, plain ground below."""
    down = math.atan2(view.eye[2] - view.target[2], math.dist(view.eye[:2], view.target[:2]))
    rows = (0.5 - (np.arange(height) + 0.5) / height) * 2 * math.tan(math.radians(view.field / 2))
    elevation = np.arctan(rows) - down
    share = np.clip(elevation / 0.5 + 0.5, 0.0, 1.0)[:, None]
    low, high = np.array(palette.to_rgb(_GROUND)), np.array(palette.to_rgb(palette.LOOKS["sky"]))
    return (255 * (low + share * (high - low)) + 0.5).astype(np.uint8)


def _draw_trail(picture: NDArray[np.uint8], depths: NDArray[np.float32], view: _View, matrix: NDArray[np.float64],
                trail: Sequence[tuple[float, float]], width: float) -> NDArray[np.uint8]:
    """Paint a ribbon (width in m) along the visible parts of a trail; the matrix is projection times view."""
    corners, middles = _make_ribbon(np.array(trail, dtype=np.float64), width)
    if not len(corners):
        return picture
    rows, columns = depths.shape
    pixels, distance = _project(corners.reshape(-1, 3), matrix, columns, rows)
    pixels, nearest = pixels.reshape(-1, 4, 2), distance.reshape(-1, 4).min(axis=1)
    middle, distance = _project(middles, matrix, columns, rows)
    inside = (nearest > view.near) & (middle >= 0).all(axis=1) & (middle < (columns, rows)).all(axis=1)
    at = middle[inside].astype(int)
    seen = view.near * view.far / (view.far - depths[at[:, 1], at[:, 0]] * (view.far - view.near))
    clear = distance[inside] <= seen + 0.1 + 0.01 * distance[inside]
    mask = Image.new("L", (_FINE * columns, _FINE * rows))
    draw = ImageDraw.Draw(mask)
    for quad in (_FINE * pixels[inside][clear]).tolist():
        draw.polygon([tuple(corner) for corner in quad], fill=255)
    image = Image.fromarray(picture)
    image.paste(palette.TRAIL, mask=mask.reduce(_FINE))
    return np.asarray(image)


def _make_ribbon(points: NDArray[np.float64], width: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Cut a path on the floor into short quads: corners (n, 4, 3) and centres (n, 3)."""
    moves = np.diff(points, axis=0)
    lengths = np.hypot(*moves.T)
    counts = np.ceil(lengths / (2 * width)).astype(int)
    owner = np.repeat(np.arange(len(moves)), counts)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    share = (np.arange(len(owner)) - first) / counts[owner]
    step = moves[owner] / counts[owner, None]
    low = points[owner] + share[:, None] * moves[owner]
    along = step / np.maximum(np.hypot(*step.T), 1e-12)[:, None]
    aside = 0.5 * width * np.stack([-along[:, 1], along[:, 0]], axis=1)
    low, high = low - 0.25 * width * along, low + step + 0.25 * width * along
    quads = np.stack([low - aside, high - aside, high + aside, low + aside], axis=1)
    height = np.full((*quads.shape[:2], 1), 0.03)
    corners = np.concatenate([quads, height], axis=2)
    return corners, corners.mean(axis=1)


def _project(points: NDArray[np.float64], matrix: NDArray[np.float64], columns: int, rows: int
             ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixels (n, 2) of points (n, 3), and their distance along the line of sight (n,)."""
    clip = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    distance = clip[:, 3]
    ahead = np.maximum(distance, 1e-9)
    return np.stack([(clip[:, 0] / ahead + 1) * columns / 2, (1 - clip[:, 1] / ahead) * rows / 2], axis=1), distance


Values = NDArray[np.floating]
Places = NDArray[np.integer]

_LUMA = np.array((0.299, 0.587, 0.114), dtype=np.float32) / 255
_LEAST_CONTRAST, _RELATIVE_CONTRAST = 0.03, 0.1
_SEARCH = (1, 2, 3, 4, 5, 6, 8, 10, 14)  # pixels along the edge
_SUBPIXEL = 0.75


def soften_edges(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the picture, (height, width, 3) uint8 RGB, with softened edges."""
    height, width = picture.shape[:2]
    margin = _SEARCH[-1] + 1  # edges are extended straight beyond the border
    luma = np.pad(picture @ _LUMA, margin, mode="edge")
    stride = width + 2 * margin

    def shift_by(down: int, right: int) -> NDArray[np.floating]:
        return luma[margin + down : margin + down + height, margin + right : margin + right + width]

    middle, north, south, west, east = (shift_by(*by) for by in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)))
    high = np.maximum.reduce((middle, north, south, west, east))
    contrast = high - np.minimum.reduce((middle, north, south, west, east))
    rows, columns = np.nonzero(contrast > np.maximum(_LEAST_CONTRAST, _RELATIVE_CONTRAST * high))
    if not len(rows):
        return picture
    flat, at = luma.ravel(), (rows + margin) * stride + columns + margin
    n, s, w, e = flat[at - stride], flat[at + stride], flat[at - 1], flat[at + 1]
    nw, ne, sw, se = flat[at - stride - 1], flat[at - stride + 1], flat[at + stride - 1], flat[at + stride + 1]
    own = flat[at]

    level = 2 * abs(n + s - 2 * own) + abs(ne + se - 2 * e) + abs(nw + sw - 2 * w)
    upright = 2 * abs(w + e - 2 * own) + abs(nw + ne - 2 * n) + abs(sw + se - 2 * s)
    is_level = level >= upright
    across = np.where(is_level, stride, 1)  # step across the edge, which runs along the other axis
    along = np.where(is_level, 1, stride)
    before, after = np.where(is_level, n, w), np.where(is_level, s, e)
    is_before = abs(before - own) >= abs(after - own)
    across = np.where(is_before, -across, across)
    edge = (own + np.where(is_before, before, after)) / 2
    gradient = np.maximum(abs(before - own), abs(after - own)) / 4

    first, first_end = _follow(flat, at, across, -along, edge, gradient)
    second, second_end = _follow(flat, at, across, along, edge, gradient)
    near_end = np.where(first < second, first_end, second_end)
    shift = 0.5 - np.minimum(first, second) / (first + second)
    shift = np.where((near_end < 0.0) != (own < edge), shift, 0.0)  # pixels on the far side stay as they are
    blend = (2 * (n + s + w + e) + nw + ne + sw + se) / 12
    rough = np.clip(abs(blend - own) / contrast[rows, columns], 0.0, 1.0)
    shift = np.maximum(shift, _SUBPIXEL * (rough * rough * (3 - 2 * rough)) ** 2)[:, None]

    other_row = np.clip(rows + np.where(is_level, np.sign(across), 0), 0, height - 1)
    other_column = np.clip(columns + np.where(is_level, 0, np.sign(across)), 0, width - 1)
    mixed = (1 - shift) * picture[rows, columns] + shift * picture[other_row, other_column]
    soft = picture.copy()
    soft[rows, columns] = (mixed + 0.5).astype(np.uint8)
    return soft


def _follow(luma: Values, at: Places, across: Places, along: Places, edge: Values, gradient: Values
            ) -> tuple[Values, Values]:
    """Follow an edge until its brightness changes.

    Returns:
        Distance to its end, in pixels, and the difference of brightness there.
    """
    distance = np.full(len(at), _SEARCH[-1], dtype=np.float32)
    found = np.zeros(len(at), dtype=np.float32)
    going = np.arange(len(at))
    for step in _SEARCH:
        place = at[going] + step * along[going]
        change = (luma[place] + luma[place + across[going]]) / 2 - edge[going]
        found[going] = change
        ended = abs(change) >= gradient[going]
        distance[going[ended]] = step
        going = going[~ended]
    return distance, found


# --- the stage -----------------------------------------------------------------------------


@dataclass
class Standing:
    """Something upright that can hide the robot from a camera."""

    shape: Footprint  # outline in the room
    high: float  # largest height, m
    whole: list[int]  # bodies that show it whole
    cut: list[int]  # bodies that show only its lowest part
    is_cut: bool = False  # whether the cut form is shown
    pose: tuple[tuple[float, float, float], tuple[float, float, float, float]] = ((0.0, 0.0, 0.0), _STILL)
    """Position and quaternion of the bodies."""


class Stage:
    """A copy of one room for cameras, or for Bullet's window; `client` is pybullet's number of its client.

    Attributes:
        model: parts and poses of the room.
        roles: role of each body's part, by the id of the body; the arm is "arm".
        standing: everything that can be cut open for a better view.

    Raises:
        UnsupportedError: a window without a display, or too many clients in this process.
    """

    def __init__(self, instance: RoomInstance, window: bool = False) -> None:
        self.model = model = RoomModel(instance)
        self.client = connect(window)
        self.close = weakref.finalize(self, disconnect, self.client)
        if window:
            for flag in (pybullet.COV_ENABLE_GUI, pybullet.COV_ENABLE_RENDERING):
                pybullet.configureDebugVisualizer(flag, 0, physicsClientId=self.client)
        self.roles: dict[int, str] = {}
        self._colours: dict[int, str] = {}
        self.standing: list[Standing] = []
        for part in model.solids:
            self._add_standing(part)
        self._panels = [self._add_standing(panel.face, panel.frame) for panel in model.panels]
        self._mats = [self._add_part(panel.mat) for panel in model.panels]
        for target in instance.targets:
            for colour, mesh in meshes.make_badges(instance, target):
                self._add(mesh.facing(SUN), "face", colour)
        robot = instance.robot
        self._base = [self._add(mesh, "body", colour) for colour, mesh in meshes.make_base(robot).items()]
        self._shadow = self._add(
            make_shadow(meshes.compute_base_outline(robot), robot.body_height, 5 * LAYER), "shadow")
        self._arm, self._joints = self._add_arm(model.rules.robot) if robot.joints else (None, {})
        self._props = [self._add_part(part) for part in model.props]
        self._prop_shadows = [None if part.role == "plate" else self._add_prop_shadow(part) for part in model.props]
        self._leaf = None if model.leaf is None else self._add_standing(model.leaf)
        self._inner_doors = [self._add_standing(part) for part in model.inner_doors]
        self._exit, self._exit_edge = map(self._add_part, model.exit)
        for role, mesh in meshes.make_floor(instance, model.solids).items():
            self._add(mesh, role)
        if window:
            pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, 1, physicsClientId=self.client)

    # --- following the room ------------------------------------------------------------

    def follow(self, state: RoomState) -> None:
        """Update the copy to a state."""
        pose, look, model = self.model.make_pose(state), self.model.make_look(state), self.model
        turn = pybullet.getQuaternionFromEuler((pose.roll, pose.pitch, pose.heading))
        at = (pose.x, pose.y, pose.z)
        for body in self._base:
            self._place(body, at, turn)
        self._place(self._shadow, (pose.x, pose.y, 0.0), _STILL)
        if self._arm is not None:
            self._place(self._arm, at, turn)
            for joint, angle in self.model.rules.robot.compute_values(pose.angles).items():
                pybullet.resetJointState(self._arm, self._joints[joint], angle, physicsClientId=self.client)
        for body, shadow, (x, y, z, *turn) in zip(self._props, self._prop_shadows, pose.props, strict=True):
            self._place(body, (x, y, z), turn)
            if shadow is not None:
                self._place(shadow, (x, y, 0.0), _STILL)
        if self._leaf is not None and model.instance.door is not None:
            yaw = model.instance.door.yaw + pose.door
            self._leaf.shape = model.place_leaf(0.0).shape  # the shut door decides whether the view is cut
            self._move(self._leaf, (*model.hinge, 0.0), pybullet.getQuaternionFromEuler((0.0, 0.0, yaw)))
        for standing, is_shut in zip(self._inner_doors, look.shut, strict=True):
            self._move(standing, (0.0, 0.0, 0.0) if is_shut else _AWAY, _STILL)
        for standing, mat, is_lit in zip(self._panels, self._mats, look.lit, strict=True):
            for body in (standing.whole[0], standing.cut[0]):
                self._paint(body, "lit" if is_lit else "off")
            self._paint(mat, "lit mat" if is_lit else "mat")
        self._paint(self._exit, "open exit" if look.is_open else "exit")
        self._paint(self._exit_edge, "open exit edge" if look.is_open else "exit edge")

    def _move(self, standing: Standing, at: tuple[float, float, float],
              turn: tuple[float, float, float, float]) -> None:
        if (at, turn) != standing.pose:
            standing.pose = at, turn
            self._show(standing)

    def set_cut(self, standing: Standing, is_cut: bool) -> None:
        """Show something whole, or only its lowest part."""
        if is_cut != standing.is_cut:
            standing.is_cut = is_cut
            self._show(standing)

    def _show(self, standing: Standing) -> None:
        for body in standing.whole:
            self._place(body, *(standing.pose if not standing.is_cut else (_AWAY, _STILL)))
        for body in standing.cut:
            self._place(body, *(standing.pose if standing.is_cut else (_AWAY, _STILL)))

    def _place(self, body: int, at: Sequence[float], turn: Sequence[float]) -> None:
        pybullet.resetBasePositionAndOrientation(body, at, turn, physicsClientId=self.client)

    def _paint(self, body: int, role: str) -> None:
        colour = palette.LOOKS[role]
        if colour == self._colours[body]:
            return
        self._colours[body] = colour
        pybullet.changeVisualShape(body, -1, rgbaColor=(*palette.to_rgb(colour), 1.0), physicsClientId=self.client)

    # --- building ----------------------------------------------------------------------

    def _add(self, mesh: Mesh, role: str, colour: str | None = None, shown: bool = True) -> int:
        colour = colour or palette.LOOKS[role]
        shape = create_mesh_shape(self.client, mesh, (*palette.to_rgb(colour), 1.0))
        at = (0.0, 0.0, 0.0) if shown else _AWAY
        body = pybullet.createMultiBody(0.0, -1, shape, at, physicsClientId=self.client)
        self.roles[body], self._colours[body] = role, colour
        return body

    def _add_part(self, part: RoomPart, most: float = math.inf, shown: bool = True) -> int:
        mesh = meshes.make_part(part, most)
        # Faces are lit as if they faced the sun, which makes panels bright on every wall.
        return self._add(mesh.facing(SUN) if part.role == "off" else mesh, part.role, shown=shown)

    def _add_standing(self, *parts: RoomPart) -> Standing:
        """Add upright parts that are cut open together, each in its whole and its cut form."""
        forms: list[list[int]] = []
        for most, shown in ((math.inf, True), (CURB, False)):
            bodies = [self._add_part(part, most, shown) for part in parts]
            for part in parts:
                if part.role == "wall":  # a darker top shows the floor plan from above
                    height = min(part.high, most)
                    top = RoomPart("wall top", part.shape, height, height + 2 * LAYER)
                    bodies.append(self._add_part(top, shown=shown))
            forms.append(bodies)
        whole, cut = forms
        self.standing.append(Standing(parts[0].shape, parts[0].high, whole, cut))
        return self.standing[-1]

    def _add_prop_shadow(self, part: RoomPart) -> int:
        """Add a block's shadow: a disc, because that is the same at every yaw."""
        radius = 1.1 * part.shape.half_x
        disc = meshes.outline_footprint(make_footprint(0.0, 0.0, radius, radius, is_disc=True))
        return self._add(make_shadow(disc, part.high - part.low, 4 * LAYER), "shadow")

    def _add_arm(self, robot: Robot) -> tuple[int, dict[str, int]]:
        """Add the robot's URDF without its base; round parts become meshes that Bullet shades smoothly."""
        with temporary_folder() as folder:
            cylinder = folder / "cylinder.obj"
            cylinder.write_text(meshes.format_obj(make_cylinder(1.0, -0.5, 0.5)))
            urdf = folder / "arm.urdf"
            urdf.write_text(_adapt_urdf(robot, self.model.instance.robot, str(cylinder), folder))
            body = pybullet.loadURDF(str(urdf), physicsClientId=self.client)
        numbers = {}
        for index in range(pybullet.getNumJoints(body, physicsClientId=self.client)):
            numbers[pybullet.getJointInfo(body, index, physicsClientId=self.client)[1].decode()] = index
        self.roles[body] = "arm"
        return body, numbers


def _adapt_urdf(robot: Robot, config: RobotConfig, cylinder: str, folder: Path) -> str:
    """Keep only the visual shapes of the arm, with slimmer cylinders, which makes the hand visible."""
    root = ElementTree.fromstring(robot.urdf)
    drop_shapes(root, "collision")
    if config.kind == "urdf":
        write_meshes(root, folder)
    for link in root.findall("link"):
        for part in ("inertial", *(("visual",) if link.get("name") == BASE_LINK else ())):
            for element in link.findall(part):
                link.remove(element)
        link.append(ElementTree.fromstring(
            '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        ))
        for visual in link.findall("visual"):
            round_part = visual.find("geometry/cylinder")
            geometry = visual.find("geometry")
            if geometry is not None and round_part is not None:
                radius, length = 0.7 * float(round_part.get("radius", "0")), round_part.get("length")
                geometry.remove(round_part)
                ElementTree.SubElement(geometry, "mesh", filename=cylinder, scale=f"{radius} {radius} {length}")
            if config.kind == "arm":
                visual.append(_make_material(palette.ARM))
        if link.get("name") == robot.hand_link:
            ball = f'<visual><geometry><sphere radius="{config.hand_radius!r}"/></geometry></visual>'
            hand = ElementTree.fromstring(ball)
            hand.append(_make_material(palette.HAND))
            link.append(hand)
    return ElementTree.tostring(root, encoding="unicode")


def _make_material(colour: str) -> ElementTree.Element:
    red, green, blue = palette.to_rgb(colour)
    return ElementTree.fromstring(f'<material name="{colour}"><color rgba="{red} {green} {blue} 1"/></material>')


# --- visual shapes from meshes, made without a memory leak -----------------------------------


class _Rows:
    """A list of [x, y, z] that reuses the same list objects for every mesh.

    pybullet never releases its references to the lists that `createVisualShape` reads, outer lists and vertices. Every
    shape is therefore read from the same lists, with new values.
    """

    def __init__(self) -> None:
        self._made: list[list[float]] = []
        self._shown: list[list[float]] = []

    def fill(self, rows: NDArray[Any]) -> list[list[float]]:
        """Return the rows in lists that the next call overwrites."""
        self._made.extend([0.0, 0.0, 0.0] for _ in range(len(rows) - len(self._made)))
        for made, row in zip(self._made, rows.tolist(), strict=False):
            made[:] = row
        self._shown[:] = self._made[: len(rows)]
        return self._shown


_LOCK = threading.Lock()
_VERTICES, _NORMALS = _Rows(), _Rows()
_INDICES: list[int] = []


def create_mesh_shape(client: int, mesh: Mesh, colour: tuple[float, ...]) -> int:
    """Make a matt visual shape of a colour (red, green, blue and opacity, 0 to 1) in a client; return its id."""
    with _LOCK:
        _INDICES[:] = mesh.triangles.ravel().tolist()
        return pybullet.createVisualShape(pybullet.GEOM_MESH, vertices=_VERTICES.fill(mesh.vertices),
                                          normals=_NORMALS.fill(mesh.normals), indices=_INDICES, rgbaColor=colour,
                                          specularColor=(0, 0, 0), physicsClientId=client)
