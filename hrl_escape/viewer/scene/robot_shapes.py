"""Visible shapes of a robot and placements of its links, from the URDF that every engine loads.

Shapes are triangle meshes in the frame of their link; forward kinematics places the links.
Nothing here draws. Frames and units as in `env.robot`: metres, radians, base on the floor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.drawing import palette
from hrl_escape.env.drawing.meshes import make_base
from hrl_escape.env.robot import BASE_LINK, Robot
from hrl_escape.viewer.extra import trimesh

_GREY = "#9aa3b2"
_SLIMMER = 0.7
"""Factor by which links of generated arms are drawn slimmer than they are, so that the hand stands out."""


class Shape(NamedTuple):
    """One coloured mesh in the frame of a link."""

    link: str  # the link's name
    vertices: NDArray[np.float64]  # (n, 3), m
    faces: NDArray[np.int64]  # (m, 3), numbers of vertices
    colour: str  # `#rrggbb`


def make_base_shapes(config: RobotConfig) -> list[Shape]:
    """The wheeled base, with an arrow on top that shows the heading."""
    return [Shape(BASE_LINK, mesh.vertices, mesh.triangles, colour) for colour, mesh in make_base(config).items()]


def make_arm_shapes(robot: Robot, config: RobotConfig) -> list[Shape]:
    """The shapes of the URDF without the base, and a ball for the hand."""
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
        mesh = trimesh.load(kind.get("filename", ""), force="mesh")
        mesh.apply_scale(_read(kind, "scale", "1 1 1"))
    else:
        mesh = trimesh.Trimesh()
    mesh.apply_transform(_read_origin(visual))
    return Shape(link, np.asarray(mesh.vertices), np.asarray(mesh.faces),
                 palette.ARM if generated else _read_colour(visual, named))


def _read_colour(visual: ElementTree.Element, named: dict[str, ElementTree.Element]) -> str:
    material = visual.find("material")
    colour = None
    if material is not None:
        colour = material.find("color")
        if colour is None and material.get("name", "") in named:
            colour = named[material.get("name", "")].find("color")
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
        """Placement (4, 4) of every link in the base's frame.

        Args:
            angles: angles of the joints that primitives move, rad.
        """
        values = {**self._robot.rest, **dict(zip(self._robot.joint_names, angles, strict=True))}
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
    """Quaternion w, x, y, z of roll, pitch and yaw about fixed axes, rad."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2), math.sin(a / 2)) for a in (roll, pitch, yaw))
    return (cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy)
