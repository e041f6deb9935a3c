"""Small URDF arms for tests, and worlds in which they stand."""

from __future__ import annotations

from collections.abc import Sequence

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.kinematics import RoomState
from hrl_escape.planning.arm.arm_planner import ArmPlanner
from hrl_escape.planning.world import World

LIMIT = '<limit lower="-1" upper="1" effort="10" velocity="1"/>'
BOOM = '<box size="0.6 0.05 0.05"/>'


def make_arm(geometry: str = BOOM, *, kind: str = "revolute", limit: str = LIMIT, place: str = 'xyz="0.3 0 0"',
             rest: str = "") -> str:
    """An arm of one joint about z, 0.7 m above the floor, whose only link is a shape ahead of it."""
    return (f'<robot name="r"><link name="foot"/><link name="boom"><collision><origin {place}/><geometry>{geometry}'
            f'</geometry></collision></link><joint name="turn" type="{kind}"><parent link="foot"/><child link="boom"/>'
            f'<origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>{limit}</joint>{rest}</robot>')


def make_config(urdf: str, hand: str = "boom", joints: int = 1) -> RobotConfig:
    """A robot with that arm on a disc of 0.3 m by 0.4 m."""
    return RobotConfig(kind="urdf", urdf=urdf, joints=joints, hand_link=hand, body_radius=0.3, body_height=0.4,
                       hand_radius=0.01)


def place_arm(urdf: str, solids: Sequence[Solid] = (), *, hand: str = "boom", joints: int = 1,
              angles: Sequence[float] | None = None) -> tuple[ArmPlanner, RoomState]:
    """Planner of the arm in the middle of a floor, and its state there."""
    world = World.of(solids, make_config(urdf, hand, joints), (0.0, 0.0, 0.0), floor=(-4.0, 4.0, -4.0, 4.0))
    return ArmPlanner(world.instance), world.make_state(0.0, 0.0, angles=angles)
