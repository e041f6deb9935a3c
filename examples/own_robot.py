"""Your own robot: a UR5e from its published Denavit-Hartenberg table, on a base with a differential drive.

Run it:

    python examples/own_robot.py

The table is Universal Robots' "DH Parameters for calculations of kinematics and dynamics" (UR5e). Links are
cylinders along the table's d and a. If you have the URDF of your robot, `load_urdf(path)` reads it with its meshes.
"""

import argparse
import math

import numpy as np

from hrl_escape import RoomConfig, generate
from hrl_escape.env.config import RobotConfig, ShapeConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.planning import ArmPlanner, Scene

UR5E = (  # d, a [m], alpha [rad]
    (0.1625, 0.0, math.pi / 2), (0.0, -0.425, 0.0), (0.0, -0.3922, 0.0),
    (0.1333, 0.0, math.pi / 2), (0.0997, 0.0, -math.pi / 2), (0.0996, 0.0, 0.0),
)


def write_urdf(table: tuple[tuple[float, float, float], ...]) -> str:
    """Write the URDF of a table: joint i turns about z, its link goes d along z and a along x and turns by alpha."""
    parts, place = ['<link name="link-0"/>'], 'xyz="0 0 0" rpy="0 0 0"'
    for number, (d, a, alpha) in enumerate(table, 1):
        shapes = ""
        for length, origin in ((d, f'xyz="0 0 {d / 2}"'), (a, f'xyz="{a / 2} 0 {d}" rpy="0 {math.pi / 2} 0"')):
            if length:
                cylinder = f'<geometry><cylinder radius="0.05" length="{abs(length) - 0.04}"/></geometry>'
                shapes += "".join(f"<{kind}><origin {origin}/>{cylinder}</{kind}>" for kind in ("visual", "collision"))
        parts += [f'<link name="link-{number}">{shapes}</link>',
                  f'<joint name="joint-{number}" type="revolute"><parent link="link-{number - 1}"/>'
                  f'<child link="link-{number}"/><origin {place}/><axis xyz="0 0 1"/>'
                  f'<limit lower="{-math.pi}" upper="{math.pi}" effort="150" velocity="3.14"/></joint>']
        place = f'xyz="{a} 0 {d}" rpy="{alpha} 0 0"'
    parts.append(f'<link name="flange"/><joint name="end" type="fixed"><parent link="link-{len(table)}"/>'
                 f'<child link="flange"/><origin {place}/></joint>')
    return f'<robot name="arm">{"".join(parts)}</robot>'


def multiply_table(table: tuple[tuple[float, float, float], ...], angles: list[float]) -> np.ndarray:
    """Compute the placement of the flange in the frame of the arm's base, (4, 4), as the product of the table."""
    at = np.eye(4)
    for (d, a, alpha), angle in zip(table, angles, strict=True):
        cos, sin, cos_a, sin_a = math.cos(angle), math.sin(angle), math.cos(alpha), math.sin(alpha)
        at = at @ np.array([[cos, -sin * cos_a, sin * sin_a, a * cos], [sin, cos * cos_a, -cos * sin_a, a * sin],
                            [0.0, sin_a, cos_a, d], [0.0, 0.0, 0.0, 1.0]])
    return at


def main() -> None:
    """Check the URDF against the table, then plan a motion around a post."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    robot = RobotConfig(kind="urdf", urdf=write_urdf(UR5E), joints=6, hand_link="flange", drive="differential",
                        body_radius=0.4, body_height=0.6)
    room = generate(RoomConfig(room=ShapeConfig(width=8, depth=8), robot=robot), seed=0)
    arm = ArmPlanner(room)
    angles = [0.3, -1.2, 1.4, -0.5, 1.0, 0.2]
    apart = np.abs(arm.kinematics.compute_placement(angles)[:3, 3] - multiply_table(UR5E, angles)[:3, 3] - (0, 0, 0.6))
    print(f"flange within {apart.max():.0e} m of the table's product")

    state = arm.rules.make_state(room.starts[0])
    target = np.array([state.x, state.y, 1.0]) + (0.45, 0.3, 0.0)
    postures = arm.solve_ik(target, state)
    print(f"{len(postures)} postures reach {np.round(target, 2).tolist()}, joint margin {postures[0].margin:.2f} rad")

    post = Solid("cylinder", state.x + 0.75, state.y + 0.1, 0.06, 0.06, height=1.6)
    cluttered = ArmPlanner(Scene.of(room, state).add("post", post).instance)
    free = [p.angles for p in postures if cluttered.is_free(state, p.angles.tolist())]
    path = cluttered.plan(state, free)
    print(f"motion through {len(path.points)} postures, {path.checks} tested")


if __name__ == "__main__":
    main()
