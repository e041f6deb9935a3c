"""Load and plan with every URDF, SRDF and map of a folder: `python -m benchmarks.robots FOLDER`.

For each URDF the table shows whether it loads, how far the hand is from where Pinocchio has it, and whether a motion of
its longest arm (up to seven joints) is planned. For each SRDF it shows how many postures and pairs it gives the URDF
of its robot, for each map how many cells are solid. Every file runs in its own process, and crashes are counted.
The folder of `example-robot-data` (125 MB) is a good start: `pip download --no-deps example-robot-data`, then unzip.
"""

from __future__ import annotations

import collections
import dataclasses
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

import numpy as np
import tyro

from hrl_escape.cli import run_script
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.robot import Robot, make_robot
from hrl_escape.env.urdf import load_urdf
from hrl_escape.errors import EscapeError, PlanningFailed

SECONDS = 120


def find_hand(text: str) -> tuple[str, int]:
    """Return the link at the end of the longest arm, and how many independent joints move it."""
    root = ElementTree.fromstring(text)
    above = {child.get("link"): (parent.get("link"), joint) for joint in root.findall("joint")
             if (child := joint.find("child")) is not None and (parent := joint.find("parent")) is not None}
    best = ("", 0)
    for link in root.findall("link"):
        name, count = link.get("name"), 0
        for _ in above:
            if name not in above:
                break
            name, joint = above[name]
            count += joint.get("type") in ("revolute", "continuous", "prismatic") and joint.find("mimic") is None
        if count > best[1]:
            best = (link.get("name", ""), count)
    return best


def make_config(path: Path) -> RobotConfig:
    """Configuration of a room's robot with the arm of a URDF."""
    text = load_urdf(path)
    hand, joints = find_hand(text)
    return RobotConfig(kind="urdf", urdf=text, joints=min(joints, 7), hand_link=hand, body_radius=0.3, body_height=0.4)


def compare_with_pinocchio(robot: Robot, text: str) -> float:
    """Return the largest distance of the hand from where Pinocchio has it in the file's own URDF, m."""
    import pinocchio

    model = pinocchio.buildModelFromXML(text)
    data, frame = model.createData(), model.getFrameId(robot.hand_link)
    rng, errors = np.random.default_rng(0), []
    low, high = np.array(robot.limits).T
    first = None
    for _ in range(20):
        angles, q = rng.uniform(low, high), pinocchio.neutral(model)
        for name, value in robot.compute_values(angles).items():
            joint = model.joints[model.getJointId(name)]
            q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        pinocchio.framesForwardKinematics(model, data, q)
        offset = robot.compute_hand(angles) - data.oMf[frame].translation
        first = offset if first is None else first  # where the arm is mounted
        errors.append(np.abs(offset - first).max())
    return float(max(errors))


def check_urdf(path: Path) -> dict[str, Any]:
    """Load one robot, for a room and without one, and plan a motion of its arm past a post."""
    from hrl_escape.planning import Arm, Obstacle

    config = make_config(path)
    robot = make_robot(config)
    found = {"joints": len(robot.joint_names), "error": compare_with_pinocchio(robot, load_urdf(path))}
    post = Obstacle.cylinder("post", 0.05, 1.5, (0.8, 0.8, 0.75))
    arm = Arm.from_urdf(path, hand=config.hand_link or "", joints=robot.joint_names, obstacles=[post])
    rng, (low, high) = np.random.default_rng(1), arm.limits.T
    near = np.clip(arm.home + rng.uniform(-1.0, 1.0, (200, len(low))), low, high)
    goal = next((angles for angles in near if arm.is_free(angles, 0.002)), arm.home)
    began = time.process_time()
    try:
        found["plan"] = f"{len(arm.plan('home', goal, budget=20_000).points)} points"
    except PlanningFailed as failed:
        found["plan"] = f"{failed.reason.value}: {failed.nearest[:80]}"
    found["seconds"] = round(time.process_time() - began, 2)
    return found


def check_srdf(path: Path, urdfs: list[Path]) -> dict[str, Any]:
    """Read one SRDF for the URDF of its robot."""
    from hrl_escape.planning.arm.srdf import read_srdf

    name = ElementTree.parse(path).getroot().get("name")
    for urdf in urdfs:
        if ElementTree.parse(urdf).getroot().get("name") == name:
            text, postures = read_srdf(path, make_robot(make_config(urdf)))
            return {"urdf": urdf.name, "postures": len(postures), "pairs": text.count("<disable_collisions")}
    return {"urdf": "none of its name"}


def check_map(path: Path) -> dict[str, Any]:
    """Read one map."""
    from hrl_escape.planning.occupancy_grid import read_occupancy_grid

    grid = read_occupancy_grid(path)
    return {"cells": grid.values.size, "solid": int(grid.find_solid(unknown_is_free=False).sum())}


def check(path: Path, folder: Path) -> dict[str, Any]:
    """Check one file; an error of the package is a result, any other is a fault."""
    try:
        if path.suffix == ".urdf":
            return check_urdf(path)
        return check_srdf(path, sorted(folder.rglob("*.urdf"))) if path.suffix == ".srdf" else check_map(path)
    except EscapeError as error:
        return {"refused": str(error)[:160]}
    except Exception as error:
        return {"raw error": f"{type(error).__name__}: {error}"[:160]}


@dataclasses.dataclass
class Args:
    """What to check."""

    folder: Annotated[Path, tyro.conf.Positional]
    """With URDF, SRDF and YAML files in it or below it."""
    one: Path | None = None
    """Check only this file, in this process, and print JSON."""


def run(args: Args) -> int:
    """Print the table, and how many files crashed or ended in a raw error; 1 if any did."""
    if args.one:
        print(json.dumps(check(args.one, args.folder)))
        return 0
    files = sorted(path for kind in ("*.urdf", "*.srdf", "*.yaml") for path in args.folder.rglob(kind))
    counts = collections.Counter[str]()
    for path in files:
        command = [sys.executable, "-m", "benchmarks.robots", str(args.folder), "--one", str(path)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS)
            lines = done.stdout.strip().splitlines()
            found = json.loads(lines[-1]) if done.returncode == 0 else {"crash": f"exit status {done.returncode}"}
        except subprocess.TimeoutExpired:
            found = {"crash": f"longer than {SECONDS} s"}
        counts[next((key for key in ("crash", "raw error", "refused") if key in found), "read")] += 1
        print(f"{path.relative_to(args.folder)}: {found}", flush=True)
    print(dict(counts))
    return 1 if counts["crash"] or counts["raw error"] else 0


if __name__ == "__main__":
    sys.exit(run_script(run))
