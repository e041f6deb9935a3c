"""Published arms, by URDF and SRDF: inverse kinematics, pairs of links that can touch, named postures.

Run: `python -m benchmarks.published_arms` (four minutes of a core) after `pip install --no-deps example-robot-data`, or
`--robots FOLDER` with the folder that has its `ur_description`; exits with 1 if a target is missed. Forty positions and
forty poses of an arm come from joint angles drawn within its limits, each solved from the default starts, collisions
left aside. Pairs are compared with the SRDF's own list, read here without the package: of all links with a shape, those
neither joined nor listed are tested. Last, a UR5 on a map of ROS's map_server reaches over a table.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from PIL import Image

from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.robot import load_urdf
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning import ArmPlanner, World


class Arm(NamedTuple):
    """Files of an arm below the folder of robots, its joints, and the link that is its hand."""

    name: str
    urdf: str
    joints: int
    hand: str
    srdf: str | None = None


ARMS = (
    Arm("Panda", "panda_description/urdf/panda.urdf", 7, "panda_hand", "panda_description/srdf/panda.srdf"),
    Arm("UR5", "ur_description/urdf/ur5_robot.urdf", 6, "ee_link", "ur_description/srdf/ur5.srdf"),
    Arm("UR10", "ur_description/urdf/ur10_robot.urdf", 6, "ee_link"),
    Arm("Kinova j2s6", "kinova_description/robots/kinova.urdf", 6, "j2s6s200_end_effector",
        "kinova_description/srdf/kinova.srdf"),
    Arm("SO-100", "so_arm_description/urdf/so100.urdf", 5, "gripper"),
    Arm("Z1", "z1_description/urdf/z1.urdf", 6, "link06", "z1_description/srdf/z1.srdf"),
    Arm("xArm 7", "xarm_description/urdf/xarm7.urdf", 7, "link7", "xarm_description/srdf/xarm7.srdf"),
)
COUNT = 40
MAP = "image: hall.pgm\nresolution: 0.05\norigin: [-3.0, 2.0, 0.0]\n"


def find_robots() -> Path:
    """Folder of the robots that `example-robot-data` has installed."""
    known = (Path(folder) / "cmeel.prefix/share/example-robot-data/robots" for folder in sys.path)
    return next((folder for folder in known if folder.is_dir()), Path("robots"))


def make_robot(robots: Path, arm: Arm) -> RobotConfig:
    """The arm on a mobile base."""
    return RobotConfig(kind="urdf", urdf=load_urdf(robots / arm.urdf), joints=arm.joints, hand_link=arm.hand,
                       body_radius=0.4, body_height=0.5)


def count_solved(planner: ArmPlanner, seed: int = 0) -> tuple[int, int]:
    """Positions, and poses, of random joint angles that inverse kinematics solves."""
    state, rng = planner.rules.make_state(planner.instance.starts[0]), np.random.default_rng(seed)
    low, high = np.array(planner.rules.robot.limits).T
    cos, sin = planner.rules.get_rotation(state.heading_steps, state.heading_offset)
    base = np.array([[cos, -sin, 0, state.x], [sin, cos, 0, state.y], [0, 0, 1, state.z], [0, 0, 0, 1]])
    solved = [0, 0]
    for _ in range(COUNT):
        pose = base @ planner.kinematics.compute_placement(rng.uniform(low, high).tolist())
        for kind, target in enumerate((pose[:3, 3], pose)):
            solved[kind] += bool(planner.solve_ik(target, state, only_free=False))
    return solved[0], solved[1]


def list_wrong_pairs(planner: ArmPlanner, robots: Path, arm: Arm) -> list[frozenset[str]]:
    """Pairs of links that are tested though the SRDF allows them, or not tested though it does not.

    Links that move as one, or that are joined by one movable joint, may always touch.
    """
    srdf = ElementTree.parse(robots / (arm.srdf or "")).getroot()
    allowed = {frozenset((pair.get("link1", ""), pair.get("link2", ""))) for pair in srdf.iter("disable_collisions")}
    urdf = ElementTree.parse(robots / arm.urdf).getroot()
    joints = [(j.get("type"), j.find("parent").get("link"), j.find("child").get("link"))  # type: ignore[union-attr]
              for j in urdf.findall("joint")]
    body = {link.get("name"): link.get("name") for link in urdf.findall("link")}
    for kind, parent, child in joints:
        if kind == "fixed":
            old, new = body[child], body[parent]
            body = {link: new if of == old else of for link, of in body.items()}
    joined = {frozenset((body[parent], body[child])) for kind, parent, child in joints if kind != "fixed"}
    shaped = [link.get("name", "") for link in urdf.findall("link") if link.find("collision") is not None]
    wanted = {frozenset(pair) for pair in itertools.combinations(shaped, 2)
              if len(bodies := frozenset(str(body[link]) for link in pair)) == 2 and bodies not in joined} - allowed
    collisions = planner._get_collisions(0.0)
    frames, items = collisions._model.frames, collisions._geometry.geometryObjects.tolist()
    names = [frames[item.parentFrame].name if item.parentJoint and item.name != "hand" else item.name for item in items]
    tested = {frozenset((names[pair.first], names[pair.second]))
              for pair in collisions._geometry.collisionPairs.tolist()}
    tested = {pair for pair in tested if len(pair) == 2 and pair <= set(shaped)}
    return sorted(tested ^ wanted, key=sorted)


def reach_over_a_table(robots: Path) -> int:
    """Postures of the motion of a UR5, from a map to the path that leads over a table."""
    with tempfile.TemporaryDirectory() as folder:
        cells = np.full((160, 200), 254, np.uint8)  # 10 x 8 m, as a SLAM tool would have left it
        cells[70:90, 98:110] = 0
        Image.fromarray(cells).save(Path(folder) / "hall.pgm")
        (Path(folder) / "hall.yaml").write_text(MAP)
        world = World.read(Path(folder) / "hall.yaml", make_robot(robots, ARMS[1]), (1.2, 6.0, 0.0), height=0.7)
    planner = ArmPlanner(world.instance, srdf=robots / (ARMS[1].srdf or ""))
    raised = (0.0, -1.2, 0.6, 0.0, 0.0, 0.0)
    state = world.make_state(1.2, 6.0, 0.0, raised)
    goals = planner.solve_ik([*world.to_room([2.0, 6.0]), 1.0], state)
    return len(planner.plan(state, [posture.angles for posture in goals]).points)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each arm."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=Path, default=find_robots(), help="folder with ur_description and others")
    robots = parser.parse_args(arguments).robots
    if not (robots / ARMS[1].urdf).is_file():
        parser.error(f"{robots} has no {ARMS[1].urdf}: pip install --no-deps example-robot-data, or give --robots")
    is_missed = False
    print("| arm | positions solved | poses solved | pairs otherwise than its SRDF | named postures, free |",
          "|---|---|---|---|---|", sep="\n")
    for arm in ARMS:
        room = generate(RoomConfig(room=ShapeConfig(width=8, depth=8), robot=make_robot(robots, arm)), 0)
        planner = ArmPlanner(room, srdf=robots / arm.srdf if arm.srdf else None)
        state = planner.rules.make_state(room.starts[0])
        positions, poses = count_solved(planner)
        has_matrix = arm.srdf is not None and "<disable_collisions" in (robots / arm.srdf).read_text()
        wrong = list_wrong_pairs(planner, robots, arm) if has_matrix else None
        free = [planner.is_free(state, angles) for angles in planner.postures.values()]
        print(f"| {arm.name} | {positions} of {COUNT} | {poses} of {COUNT} | {'-' if wrong is None else len(wrong)} | "
              f"{f'{sum(free)} of {len(free)}' if free else '-'} |", flush=True)
        for pair in wrong or ():
            print(*sorted(pair), file=sys.stderr)
        is_missed |= positions < COUNT or bool(wrong)
    print(f"\nA UR5 over a table of a map: {reach_over_a_table(robots)} postures.")
    sys.exit(is_missed)


if __name__ == "__main__":
    main()
