"""A room as a viser scene: built once from an instance, then posed, lit and annotated.

The scene only displays; it steps nothing and has no controls. Fixed parts and poses come from the `RoomModel`, the
robot's shapes from the URDF that every engine loads. `blend` interpolates poses. Metres and radians, in the room frame
or a link's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Literal, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.geometry import compute_distance
from hrl_escape.env.instance import Rectangle, RoomInstance, compute_floors
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.mesh_files import load_mesh
from hrl_escape.env.pictures import meshes, palette
from hrl_escape.env.pictures.model import LAYER, RoomModel, RoomPart, RoomPose
from hrl_escape.env.robot import BASE_LINK, Robot
from hrl_escape.viewer.extra import SO3, trimesh, viser

_GREY = "#9aa3b2"
_SLIMMER = 0.7
"""Scale of the thickness of generated arms in drawings; slimmer links make the hand visible."""


class Shape(NamedTuple):
    """One coloured mesh in the frame of a link."""

    link: str  # name of the link
    vertices: NDArray[np.float64]  # (n, 3), m
    faces: NDArray[np.int64]  # (m, 3), indices of vertices
    colour: str  # `#rrggbb`


def make_base_shapes(config: RobotConfig) -> list[Shape]:
    """Return shapes of the wheeled base, with an arrow on top that shows the heading."""
    parts = meshes.make_base(config).items()
    return [Shape(BASE_LINK, mesh.vertices, mesh.triangles, colour) for colour, mesh in parts]


def make_arm_shapes(robot: Robot, config: RobotConfig) -> list[Shape]:
    """Return the shapes of the URDF without the base, and a ball for the hand."""
    root = ElementTree.fromstring(robot.urdf)
    named = {m.get("name", ""): m for m in root.findall("material")}
    shapes: list[Shape] = []
    for link in root.findall("link"):
        name = link.get("name", "")
        if name != BASE_LINK:
            shapes += [_make_shape(name, visual, named, config) for visual in link.findall("visual")]
    ball = trimesh.creation.icosphere(subdivisions=2, radius=config.hand_radius)
    if config.joints:
        shapes.append(Shape(robot.hand_link, ball.vertices, ball.faces, palette.HAND))
    return shapes


def _make_shape(link: str, visual: ElementTree.Element, named: dict[str, ElementTree.Element],
                config: RobotConfig) -> Shape:
    geometry = visual.find("geometry")
    kind = geometry[0] if geometry is not None and len(geometry) else ElementTree.Element("none")
    generated = config.kind == "arm"
    if kind.tag == "cylinder":
        slim = _SLIMMER if generated else 1.0
        mesh: Any = trimesh.creation.cylinder(slim * float(kind.get("radius", 0)), float(kind.get("length", 0)))
    elif kind.tag == "box":
        mesh = trimesh.creation.box(_read(kind, "size", "1 1 1"))
    elif kind.tag == "sphere":
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=float(kind.get("radius", 0)))
    elif kind.tag == "mesh":
        read = load_mesh(kind.get("filename", ""))
        mesh = trimesh.Trimesh(read.vertices, read.triangles)  # merges equal vertices, so that it is shaded smoothly
        mesh.apply_scale(_read(kind, "scale", "1 1 1"))
    else:
        mesh = trimesh.Trimesh()
    mesh.apply_transform(_read_origin(visual))
    return Shape(link, np.asarray(mesh.vertices), np.asarray(mesh.faces),
                 palette.ARM if generated else _read_colour(visual, named))


def _read_colour(visual: ElementTree.Element, named: dict[str, ElementTree.Element]) -> str:
    material = visual.find("material")
    if material is None:
        return _GREY
    colour = material.find("color")
    if colour is None:
        colour = named.get(material.get("name", ""), material).find("color")
    if colour is None:
        return _GREY
    red, green, blue = (round(255 * float(v)) for v in colour.get("rgba", "0.6 0.6 0.7 1").split()[:3])
    return f"#{red:02x}{green:02x}{blue:02x}"


class ArmPose:
    """Forward kinematics over all joints of a robot, gripper fingers included."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        joints = ElementTree.fromstring(robot.urdf).findall("joint")
        self._joints = []
        placed = {BASE_LINK}
        while joints:  # parents first
            ready = [joint for joint in joints if _get_link(joint, "parent") in placed]
            if not ready:
                break
            for joint in ready:
                joints.remove(joint)
                placed.add(_get_link(joint, "child"))
                self._joints.append((joint.get("name", ""), joint.get("type", "fixed"), _get_link(joint, "parent"),
                                     _get_link(joint, "child"), _read_origin(joint),
                                     _read(joint.find("axis"), "xyz", "1 0 0")))

    def compute(self, angles: Sequence[float]) -> dict[str, NDArray[np.float64]]:
        """Return the placement (4, 4) of every link in the base frame, for angles, rad, of the actuated joints."""
        values = self._robot.compute_values(angles)
        found = {BASE_LINK: np.eye(4)}
        for name, kind, parent, child, origin, axis in self._joints:
            motion = np.eye(4)
            if kind == "prismatic":
                motion[:3, 3] = values[name] * axis / np.linalg.norm(axis)
            elif kind != "fixed":
                motion = trimesh.transformations.rotation_matrix(values[name], axis)
            found[child] = found[parent] @ origin @ motion
        return found


def _get_link(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _read_origin(element: ElementTree.Element) -> NDArray[np.float64]:
    origin = element.find("origin")
    placement = trimesh.transformations.euler_matrix(*_read(origin, "rpy", "0 0 0"), axes="sxyz")
    placement[:3, 3] = _read(origin, "xyz", "0 0 0")
    return placement


def _read(element: ElementTree.Element | None, key: str, default: str) -> NDArray[np.float64]:
    text = default if element is None else element.get(key, default)
    return np.array([float(word) for word in text.split()])


def to_quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion w, x, y, z of roll, pitch and yaw about fixed axes, rad."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2), math.sin(a / 2)) for a in (roll, pitch, yaw))
    return (cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy)


OUTSIDE = "#8fa0b8"
SCRAPS = 160
"""Number of scraps of confetti."""
CLEAR, HAZY = 0.12, 0.5
"""Opacity of outer walls seen from outside, and of interior walls."""


class Painted(NamedTuple):
    """A mesh with its colour and opacity (None: opaque)."""

    name: str
    mesh: meshes.Mesh
    colour: str
    opacity: float | None = None


def make_fixtures(model: RoomModel) -> list[Painted]:
    """Make the parts that never change: floor with shadows and puddles, and walls.

    Obstacles are separate, because the scene shows one as glass while it hides the robot.
    """
    walls = [part for part in model.solids if part.role == "wall"]
    faces: dict[str, list[meshes.Mesh]] = {"inside": [], "between": [], "outside": []}
    for wall in walls:
        for mesh, kind in _make_faces(wall, compute_floors(model.instance)):
            faces[kind].append(mesh)
    tops = [meshes.make_flat(meshes.outline_footprint(wall.shape), wall.high) for wall in walls]
    floor = meshes.make_floor(model.instance, [part for part in model.solids if part.role != "wall"])
    found = [
        *(Painted(f"floor/{role}".replace(" ", "-"), mesh, palette.LOOKS[role]) for role, mesh in floor.items()),
        Painted("walls/inside", meshes.merge(faces["inside"]), palette.LOOKS["wall"]),
        Painted("walls/between", meshes.merge(faces["between"]), palette.LOOKS["wall"], HAZY),
        Painted("walls/outside", meshes.merge(faces["outside"]), OUTSIDE, CLEAR),
        Painted("walls/top", meshes.merge(tops), palette.LOOKS["wall top"], 0.55),
    ]
    return [painted for painted in found if len(painted.mesh.triangles)]


def is_hidden_by(part: RoomPart, eye: tuple[float, float, float], point: tuple[float, float, float]) -> bool:
    """Return whether an upright part is between a camera and a point, tested at 64 positions between them, m."""
    shares = np.arange(1, 65) / 65
    xs, ys, zs = (a + shares * (b - a) for a, b in zip(eye, point, strict=True))
    low = zs < part.high
    return any(compute_distance(x, y, part.shape) <= 0.0
               for x, y in zip(xs[low].tolist(), ys[low].tolist(), strict=True))


def make_confetti(centre: tuple[float, float], share: float) -> NDArray[np.float32]:
    """Return positions (n, 3) of confetti over a place, m, as `share` runs from 0 to 1."""
    rng = np.random.default_rng(0)
    side, up = rng.normal(0.0, 1.6, (SCRAPS, 2)), rng.uniform(2.0, 6.0, SCRAPS)
    height = np.maximum(4.0 * up * share * (1.0 - share), LAYER)
    return np.column_stack([centre + side * share, height]).astype(np.float32)


def _make_faces(wall: RoomPart, floors: tuple[Rectangle, ...]) -> list[tuple[meshes.Mesh, str]]:
    """Upright faces of a wall, visible from their front only, each with its kind.

    A face is `inside` if it faces the floor, `between` if the opposite face does so too, otherwise `outside`.
    """
    if wall.shape.is_disc:
        return [(meshes.make_part(wall), "between")]
    corners = meshes.outline_footprint(wall.shape)
    sides, inside = [], []
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        length = math.hypot(x1 - x0, y1 - y0) or 1.0
        normal = ((y1 - y0) / length, (x0 - x1) / length)
        # The face is a prism without depth, reduced to the side along the edge.
        side = meshes.make_prism([(x0, y0), (x1, y1), (x1 - 1e-3 * normal[0], y1 - 1e-3 * normal[1]),
                           (x0 - 1e-3 * normal[0], y0 - 1e-3 * normal[1])], wall.low, wall.high)
        sides.append(meshes.Mesh(side.vertices[:4], side.normals[:4], side.triangles[:2]))
        x, y = (x0 + x1) / 2 + 0.05 * normal[0], (y0 + y1) / 2 + 0.05 * normal[1]
        inside.append(any(floor.contains(x, y) for floor in floors))
    kinds = ["outside" if not inside[i] else "between" if inside[i - 2] else "inside" for i in range(4)]
    return list(zip(sides, kinds, strict=True))


def blend(a: RoomPose, b: RoomPose, share: float) -> RoomPose:
    """Interpolate from `a` (share 0) to `b` (share 1); headings turn the short way."""

    def mix(one: tuple[float, ...], other: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(u + share * (v - u) for u, v in zip(one, other, strict=True))

    turn = (b.heading - a.heading + math.pi) % math.tau - math.pi
    x, y, z, pitch, roll, door = mix((a.x, a.y, a.z, a.pitch, a.roll, a.door), (b.x, b.y, b.z, b.pitch, b.roll, b.door))
    props = tuple(_mix_prop(one, mix(one, other), other) for one, other in zip(a.props, b.props, strict=True))
    return RoomPose(x, y, z, a.heading + share * turn, pitch, roll, mix(a.angles, b.angles), door, props)


def _mix_prop(one: tuple[float, ...], mixed: tuple[float, ...], other: tuple[float, ...]) -> tuple[float, ...]:
    """Normalise the quaternion of a mixed pose. A quaternion and its negative are the same rotation."""
    if sum(u * v for u, v in zip(one[3:], other[3:], strict=True)) < 0.0:
        return other
    length = math.hypot(*mixed[3:])
    return (*mixed[:3], *(v / length for v in mixed[3:]))


ROOT = "/room"
PLAN = "#d55e00"
FUTURES = {"plan": (PLAN, 12), "preview": ("#cc79a7", 16)}
"""Colour of each predicted path, and its height over the floor, layers."""
GLASS = 0.25
"""Opacity of an obstacle that hides the robot."""
LONGEST_TRAIL = 600
LINE_WIDTH = 3.0
OVERVIEW_FIELD = 50.0
"""Vertical field of view of the overview camera, degrees."""
SUN_POSITION = (-4.0, -6.0, 9.0)
"""Direction of the light, consistent with the shadows that `meshes.py` draws on the floor."""
_Point = tuple[float, float, float]


class RoomScene:
    """One room on a viser server. If `is_hidden`, panels do not reveal which wait for others or which opens the exit.

    Attributes:
        instance: the room.
        model: parts and poses of the room.
        rules: rules that compute poses.
    """

    def __init__(self, server: viser.ViserServer, instance: RoomInstance, is_hidden: bool = False) -> None:
        self.instance, self.is_hidden = instance, is_hidden
        self.model = model = RoomModel(instance)
        self.rules = model.rules
        self._server, self._scene = server, server.scene
        with server.atomic():
            _add_lights(self._scene)
            self._root = self._scene.add_frame(ROOT, show_axes=False)
            for painted in make_fixtures(model):
                self._add(painted)
            self._obstacles = [(part, self._add_part(f"obstacles/{number}", part))
                               for number, part in enumerate(model.solids) if part.role != "wall"]
            self._names: list[viser.LabelHandle] = []
            self._lamps = [self._add_target(i) for i in range(len(instance.targets))]
            self._exit = [self._add_part(f"exit/{name}", part)
                          for name, part in zip(("area", "edge"), model.exit, strict=True)]
            if not instance.exit.is_flat:
                self._scene.add_label(f"{ROOT}/exit/name", "exit", position=(*instance.exit.centre, 0.05),
                                      anchor="center-center", font_screen_scale=0.9)
            self._door = self._add_door()
            self._inner_doors = [self._add_inner_door(i) for i in range(len(instance.inner_doors))]
            self._props = [self._add_prop(i) for i in range(len(instance.props))]
            self._robot = _RobotModel(self._scene, f"{ROOT}/robot", self.rules.robot, instance.robot)
            self._ghosts: dict[str, _RobotModel] = {}
            self._goals: dict[_Point, tuple[str, viser.LabelHandle]] = {}
            self._confetti: viser.PointCloudHandle | None = None
        self._lit: Any = None
        camera = server.initial_camera  # overview of the whole room, from the south and well above
        camera.position, camera.look_at = compute_overview(instance)
        camera.up, camera.fov = (0.0, 0.0, 1.0), math.radians(OVERVIEW_FIELD)

    def remove(self) -> None:
        """Remove the room, its robot and its labels from the scene."""
        self._root.remove()

    # --- what moves ----------------------------------------------------------------------

    def show(self, state: RoomState) -> None:
        """Pose and light everything for a state."""
        with self._server.atomic():
            self.pose(self.model.make_pose(state))
            self.light(state)

    def pose(self, pose: RoomPose) -> None:
        """Place robot, arm, door and props."""
        with self._server.atomic():
            self._robot.place(pose)
            if self._door is not None and self.instance.door is not None:
                self._door.wxyz = to_quaternion(0.0, 0.0, self.instance.door.yaw + pose.door)
            for node, placed in zip(self._props, pose.props, strict=True):
                x, y, z, qx, qy, qz, qw = placed
                node.position, node.wxyz = (x, y, z), (qw, qx, qy, qz)

    def light(self, state: RoomState) -> None:
        """Update the colours of panels and exit, the signs of targets, and inner doors to a state."""
        if state.puzzle == self._lit:
            return
        self._lit = state.puzzle
        puzzle = self.instance.puzzle
        for i, (lamp, name) in enumerate(zip(self._lamps, self._names, strict=True)):
            lamp.color = _to_bytes(palette.get_target_look(puzzle, state.puzzle, i, self.is_hidden).fill)
            if name.text != (text := palette.name_target(puzzle, state.puzzle, i, self.is_hidden)):
                name.text = text
        look = self.model.make_look(state)
        for node, is_shut in zip(self._inner_doors, look.shut, strict=True):
            node.visible = is_shut
        colour = palette.EXIT_OPEN if look.is_open else palette.EXIT_LOCKED
        for part in self._exit:
            part.color = _to_bytes(colour)

    def uncover(self, eyes: Iterable[_Point], pose: RoomPose) -> None:
        """Show obstacles that hide the robot from any of these cameras, m, as glass, and the others opaque."""
        robot = (pose.x, pose.y, pose.z + self.instance.robot.body_height / 2)
        eyes = tuple(eyes)
        for solid, node in self._obstacles:
            opacity = GLASS if any(is_hidden_by(solid, eye, robot) for eye in eyes) else None
            if node.opacity != opacity:
                node.opacity = opacity

    # --- annotations -----------------------------------------------------------------------

    def draw_trail(self, states: Sequence[RoomState]) -> None:
        """Draw the robot's path so far on the floor."""
        self._draw_line("trail", [(s.x, s.y) for s in states[-LONGEST_TRAIL:]], palette.TRAIL, 8 * LAYER)

    def draw_future(self, name: Literal["plan", "preview"], states: Sequence[RoomState]) -> None:
        """Draw the predicted path of the running option (`plan`) or another (`preview`), and its final posture."""
        colour, layers = FUTURES[name]
        self._draw_line(name, [(s.x, s.y) for s in states], colour, layers * LAYER)
        ghost = self._ghosts.get(name)
        if len(states) > 1:
            if ghost is None:
                ghost = self._ghosts[name] = _RobotModel(self._scene, f"{ROOT}/ghost-{name}", self.rules.robot,
                                                         self.instance.robot, colour, 0.35)
            ghost.place(self.model.make_pose(states[-1]))
        if ghost is not None:
            ghost.frame.visible = len(states) > 1

    def draw_path(self, points: Sequence[tuple[float, float]]) -> None:
        """Draw a path planner's path for the body's axis."""
        self._draw_line("path", points, palette.MUTED, 6 * LAYER)

    def draw_hand_path(self, points: Sequence[_Point]) -> None:
        """Draw the path of the hand in the air."""
        self._draw_segments("hand-path", np.array(points, dtype=np.float32).reshape(-1, 3), PLAN)

    def draw_confetti(self, share: float) -> None:
        """Draw confetti over the exit for a share from 0 to 1, and none for other values."""
        places = make_confetti(self.instance.exit.centre, min(max(share, 0.0), 1.0))
        if self._confetti is None:
            colours = np.resize(np.array([_to_bytes(line) for line in palette.LINES], dtype=np.uint8), (SCRAPS, 3))
            self._confetti = self._scene.add_point_cloud(f"{ROOT}/confetti", places, colours, point_size=0.14,
                                                         point_shape="square", point_shading="flat")
        self._confetti.points, self._confetti.visible = places, 0.0 <= share < 1.0

    def draw_goals(self, goals: Sequence[tuple[str, float, float]]) -> None:
        """Label the goals (name, x, y) of running calls; calls at the same place share a label."""
        height = self.instance.frame.wall_height / 2
        words: dict[_Point, list[str]] = {}
        for name, x, y in goals:
            words.setdefault((x, y, height), []).append(name)
        shown = {place: ", ".join(names) for place, names in words.items()}
        for place, (text, label) in list(self._goals.items()):
            if shown.get(place) != text:
                label.remove()
                del self._goals[place]
        for place, text in shown.items():
            if place not in self._goals:
                label = self._scene.add_label(f"{ROOT}/goals/{place[0]:g}/{place[1]:g}", text, position=place)
                self._goals[place] = text, label

    def _draw_line(self, name: str, points: Sequence[tuple[float, float]], colour: str, height: float) -> None:
        at = np.array([(x, y, height) for x, y in points], dtype=np.float32)
        self._draw_segments(name, at.reshape(-1, 3), colour)

    def _draw_segments(self, name: str, at: NDArray[np.float32], colour: str) -> None:
        """Draw lines from point to point, shape (points, 3); none if all points are equal."""
        moved = np.any(at[1:] != at[:-1], axis=1)
        segments = np.stack([at[:-1], at[1:]], axis=1)[moved]
        visible = len(segments) > 0
        if not visible:
            segments = np.zeros((1, 2, 3), dtype=np.float32)
        self._scene.add_line_segments(f"{ROOT}/{name}", segments, _to_bytes(colour), thickness=LINE_WIDTH,
                                      thickness_units="screen", visible=visible)

    # --- building ----------------------------------------------------------------------------

    def _add(self, painted: Painted) -> viser.MeshHandle:
        return _add_mesh(self._scene, f"{ROOT}/{painted.name}", painted.mesh.vertices, painted.mesh.triangles,
                         painted.colour, painted.opacity)

    def _add_part(self, name: str, part: RoomPart, opacity: float | None = None) -> viser.MeshHandle:
        return self._add(Painted(name, meshes.make_part(part), palette.LOOKS[part.role], opacity))

    def _add_target(self, index: int) -> viser.MeshHandle:
        target, panel, puzzle = self.instance.targets[index], self.model.panels[index], self.instance.puzzle
        face, *_ = [self._add_part(f"targets/{index}/{name}", part) for name, part in panel._asdict().items()]
        for number, (colour, mesh) in enumerate(meshes.make_badges(self.instance, target)):
            self._add(Painted(f"targets/{index}/cue-{number}", mesh, colour))
        self._names.append(self._scene.add_label(
            f"{ROOT}/targets/{index}/name", palette.name_target(puzzle, puzzle.make_state(), index, self.is_hidden),
            anchor="bottom-center", position=(target.x, target.y, target.z + target.half_z + 0.25),
            font_screen_scale=0.9))
        return face

    def _add_door(self) -> viser.FrameHandle | None:
        """Leaf of the exit door in the frame of its hinge."""
        door, leaf = self.instance.door, self.model.leaf
        if door is None or leaf is None:
            return None
        hinge = self._scene.add_frame(f"{ROOT}/door", show_axes=False, wxyz=to_quaternion(0.0, 0.0, door.yaw),
                                      position=(*self.model.hinge, 0.0))
        self._add_part("door/leaf", leaf, 0.85)
        return hinge

    def _add_inner_door(self, index: int) -> viser.FrameHandle:
        node = self._scene.add_frame(f"{ROOT}/inner-doors/{index}", show_axes=False)
        self._add_part(f"inner-doors/{index}/leaf", self.model.inner_doors[index], 0.85)
        return node

    def _add_prop(self, index: int) -> viser.FrameHandle:
        prop, name = self.instance.props[index].prop, f"{ROOT}/props/{index}"
        node = self._scene.add_frame(name, show_axes=False)
        self._add_part(f"props/{index}/shape", self.model.props[index])
        self._scene.add_label(f"{name}/name", prop.name, position=(0.0, 0.0, prop.height / 2 + 0.2),
                              anchor="bottom-center", font_screen_scale=0.8)
        return node


def compute_overview(instance: RoomInstance, aspect: float = 1.6) -> tuple[_Point, _Point]:
    """Return position and target of a camera that shows a whole room, m.

    `aspect` is the picture's width over its height. On an upright picture the room fills the part above the panel.
    """
    if aspect >= 1.0:
        far = max(1.1 * instance.reach_x, 1.2 * instance.reach_y) + 0.6 * instance.wall_height - 1.5
        return (0.0, -instance.reach_y - 0.95 * far, 1.8 * far), (0.0, -0.08 * instance.reach_y, 0.0)
    lens = math.tan(math.radians(OVERVIEW_FIELD / 2))
    far = max((instance.reach_x + 1.0) / aspect, 3.0 * instance.reach_y) / lens + instance.wall_height
    south = -0.28 * far
    return (0.0, south - 0.34 * far, 0.94 * far), (0.0, south, 0.0)


def _add_lights(scene: viser.SceneApi) -> None:
    """Add ambient light, which makes colours equal on every side, and a sun, which shows shapes.

    An environment map would load late and fade in at every start of a recorded page.
    """
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(hdri=None)
    scene.add_light_ambient("/lights/ambient", intensity=2.1)
    scene.add_light_directional("/lights/sun", intensity=1.2, position=SUN_POSITION)
    scene.set_background_image(np.full((8, 8, 3), 236, dtype=np.uint8))


class _RobotModel:
    """The robot's shapes below one frame. A ghost has one colour and is transparent."""

    def __init__(self, scene: viser.SceneApi, name: str, robot: Robot, config: RobotConfig,
                 colour: str | None = None, opacity: float | None = None) -> None:
        self.frame = scene.add_frame(name, show_axes=False)
        self._arm = ArmPose(robot)
        self._links: dict[str, viser.FrameHandle] = {}
        for number, shape in enumerate([*make_base_shapes(config), *make_arm_shapes(robot, config)]):
            if not len(shape.faces):
                continue
            if shape.link not in self._links:
                self._links[shape.link] = scene.add_frame(f"{name}/{shape.link}", show_axes=False)
            _add_mesh(scene, f"{name}/{shape.link}/{number}", shape.vertices, shape.faces, colour or shape.colour,
                      opacity)

    def place(self, pose: RoomPose) -> None:
        """Move base and links to a pose."""
        self.frame.position = (pose.x, pose.y, pose.z)
        self.frame.wxyz = to_quaternion(pose.roll, pose.pitch, pose.heading)
        if len(self._links) < 2:
            return
        placements = self._arm.compute(pose.angles)
        for link, frame in self._links.items():
            placement = placements[link]
            frame.position = placement[:3, 3]
            frame.wxyz = SO3.from_matrix(placement[:3, :3]).wxyz


def _add_mesh(scene: viser.SceneApi, name: str, vertices: Any, faces: Any, colour: str,
              opacity: float | None = None) -> viser.MeshHandle:
    return scene.add_mesh_simple(name, np.asarray(vertices), np.asarray(faces), color=_to_bytes(colour),
                                 opacity=opacity, flat_shading=False, cast_shadow=False, receive_shadow=False)


def _to_bytes(colour: str) -> tuple[int, int, int]:
    red, green, blue = palette.to_rgb(colour)
    return round(255 * red), round(255 * green), round(255 * blue)
