"""Robots from their URDF among obstacles: `python -m benchmarks.arm_tasks [FOLDER]`.

Plans motions of twelve robots among obstacles at any placement. Bullet, which planned none of them, retraces every path
and measures its clearance; trajectories are checked at 1 kHz. Two tasks follow: a cup out of a shelf, and a hand under
a table. FOLDER is the folder of `example-robot-data` (`pip install --no-deps example-robot-data`), by default the
installed one. The dual Panda, the arm of continuous joints and the tasks need none.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

import numpy as np
import pybullet
import pybullet_data
import tyro
from numpy.typing import NDArray
from PIL import Image

from benchmarks.published_arms import find_robots
from hrl_escape.cli import run_script
from hrl_escape.env.mesh_files import load_mesh, write_meshes
from hrl_escape.env.placements import compute_roll_pitch_yaw
from hrl_escape.env.robot import BASE_LINK
from hrl_escape.errors import ConfigError, PlanningFailed, UnknownNameError
from hrl_escape.planning import Arm, Obstacle
from hrl_escape.planning.paths.problem import MotionPath

PANDA = Path(pybullet_data.getDataPath()) / "franka_panda" / "panda.urdf"
PANDA_JOINTS = tuple(f"panda_joint{number}" for number in range(1, 8))
READY = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)  # rad
FORWARD = (0.0, math.pi / 2, 0.0)  # roll, pitch and yaw of a hand whose z axis is ahead
NEAR = 0.1  # largest distance that Bullet measures, m
HULL_MARGIN = 0.002  # largest excess of Bullet's hulls of two links, m


# --- robots ---------------------------------------------------------------------------------------


def make_panda(**options: Any) -> Arm:
    """Make a Panda, its gripper open, in MoveIt's posture `ready`."""
    home = dict(zip(PANDA_JOINTS, READY, strict=True)) | {"panda_finger_joint1": 0.04}
    return Arm.from_urdf(PANDA, hand="panda_grasptarget", joints=PANDA_JOINTS, home=home, **options)


def make_dual_panda() -> Arm:
    """Make two Pandas side by side as one robot of 14 joints."""
    whole = ElementTree.Element("robot", name="dual-panda")
    ElementTree.SubElement(whole, "link", name="stand")
    for side, y in (("left", 0.35), ("right", -0.35)):
        panda = ElementTree.parse(PANDA).getroot()
        for element in panda.iter():
            for key in ("name", "link", "joint"):
                if element.tag in ("link", "joint", "parent", "child", "mimic") and key in element.attrib:
                    element.set(key, f"{side}_{element.get(key)}")
        for mesh in panda.iter("mesh"):
            mesh.set("filename", str(PANDA.parent / mesh.get("filename", "").removeprefix("package://")))
        whole.extend([*panda.findall("link"), *panda.findall("joint")])
        foot = ElementTree.SubElement(whole, "joint", name=f"{side}_foot", type="fixed")
        ElementTree.SubElement(foot, "parent", link="stand")
        ElementTree.SubElement(foot, "child", link=f"{side}_panda_link0")
        ElementTree.SubElement(foot, "origin", xyz=f"0 {y} 0")
    joints = [f"{side}_{name}" for side in ("left", "right") for name in PANDA_JOINTS]
    return Arm.from_urdf(ElementTree.tostring(whole, encoding="unicode"), hand="left_panda_grasptarget", joints=joints,
                         home=dict(zip(joints, 2 * READY, strict=True)))


def make_continuous() -> Arm:
    """Make an arm of six joints that turn without limits, from twenty lines of URDF."""
    lines, axes = ['<robot name="turning"><link name="foot"/>'], ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
    above = 0.1
    for number, axis in enumerate(axes):
        length = 0.12 if number % 3 == 0 else 0.35 - 0.03 * number
        parent = f"part-{number}" if number else "foot"
        lines += [f'<link name="part-{number + 1}"><collision><origin xyz="0 0 {length / 2}"/><geometry>'
                  f'<cylinder radius="0.045" length="{length}"/></geometry></collision></link>',
                  f'<joint name="turn-{number + 1}" type="continuous"><parent link="{parent}"/>'
                  f'<child link="part-{number + 1}"/><origin xyz="0 0 {above}"/><axis xyz="{axis}"/>'
                  '<limit effort="90" velocity="2"/></joint>']
        above = length + 0.05
    return Arm.from_urdf("".join([*lines, "</robot>"]), hand="part-6")


def list_published(robots: Path) -> dict[str, Callable[[], Arm]]:
    """List ten published robots by name; `robots` is the folder that has their `ur_description`."""
    tiago, ur = robots / "tiago_description/robots", robots / "ur_description/urdf"
    xarm, kinova = robots / "xarm_description", robots / "kinova_description"
    bent = {"shoulder_lift_joint": -1.2, "elbow_joint": 1.2}

    def make_tiago(file: str, side: str = "") -> Arm:
        arm = [f"arm_{side}{number}_joint" for number in range(1, 8)]
        return Arm.from_urdf(tiago / file, hand=f"arm_{side}tool_link", joints=["torso_lift_joint", *arm],
                             home={arm[0]: 0.2, arm[1]: -1.0, arm[3]: 1.5})

    return {
        "Panda": lambda: Arm.from_urdf(robots / "panda_description/urdf/panda.urdf", hand="panda_hand_tcp",
                                       srdf=robots / "panda_description/srdf/panda.srdf",
                                       home=dict(zip(PANDA_JOINTS, READY, strict=True)), joints=PANDA_JOINTS),
        "UR5": lambda: Arm.from_urdf(ur / "ur5_joint_limited_robot.urdf", hand="ee_link", home=bent,
                                     srdf=robots / "ur_description/srdf/ur5.srdf"),
        "UR10": lambda: Arm.from_urdf(ur / "ur10_joint_limited_robot.urdf", hand="ee_link", home=bent),
        "xArm 7": lambda: Arm.from_urdf(xarm / "urdf/xarm7.urdf", srdf=xarm / "srdf/xarm7.srdf", hand="link7",
                                        joints=[f"joint{number}" for number in range(1, 8)]),
        "TIAGo with torso": lambda: make_tiago("tiago.urdf"),
        "TIAGo dual with torso": lambda: make_tiago("tiago_dual.urdf", "left_"),
        "Baxter": lambda: Arm.from_urdf(robots / "baxter_description/urdf/baxter.urdf", hand="left_wrist"),
        "PR2": lambda: Arm.from_urdf(robots / "pr2_description/urdf/pr2.urdf", hand="r_gripper_tool_frame",
                                     srdf=robots / "pr2_description/srdf/pr2_manipulation.srdf"),
        "SO-101": lambda: Arm.from_urdf(robots / "so_arm_description/urdf/so101.urdf"),
        "Kinova j2s6": lambda: Arm.from_urdf(kinova / "robots/kinova.urdf", srdf=kinova / "srdf/kinova.srdf",
                                             hand="j2s6s200_end_effector",
                                             home={f"j2s6s200_joint_{k}": a for k, a in ((2, 2.9), (3, 1.3))}),
    }


# --- the independent check ------------------------------------------------------------------------


class ArmCheck:
    """Distances by Bullet between an arm's links, and between links and obstacles; and pictures."""

    def __init__(self, arm: Arm) -> None:
        self.arm, self.client = arm, pybullet.connect(pybullet.DIRECT)
        root = ElementTree.fromstring(arm.robot.urdf)
        for link in root.findall("link"):
            if link.find("inertial") is None:  # Bullet prints a warning for each of these
                link.append(ElementTree.fromstring(
                    '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'))
        with tempfile.TemporaryDirectory() as folder:
            write_meshes(root, Path(folder))
            path = Path(folder) / "robot.urdf"
            path.write_text(ElementTree.tostring(root, encoding="unicode"))
            self.body = pybullet.loadURDF(str(path), useFixedBase=True, physicsClientId=self.client)
            self.obstacles = {each.name: self._place(each, Path(folder)) for each in arm.obstacles}
        infos = [pybullet.getJointInfo(self.body, j, physicsClientId=self.client)
                 for j in range(pybullet.getNumJoints(self.body, physicsClientId=self.client))]
        self.numbers = {info[1].decode(): j for j, info in enumerate(infos)}
        self.parents = [info[16] for info in infos]
        self._moved = self._find_moved()
        names = {-1: BASE_LINK} | {number: info[12].decode() for number, info in enumerate(infos)}
        allowed = {frozenset(pair[:2]) for pair in arm._search.get_collisions(0.0).list_allowed()}
        self._tested = {(a, b) for a, b in itertools.combinations(names, 2)
                        if frozenset((names[a], names[b])) not in allowed}
        for each in arm.attached:
            colour = COLOURS.get(each.obstacle.name, (0.62, 0.66, 0.7, 1.0))
            link = [info[12].decode() for info in infos].index(each.obstacle.name)
            pybullet.changeVisualShape(self.body, link, rgbaColor=colour, physicsClientId=self.client)

    def _place(self, obstacle: Obstacle, folder: Path) -> int:
        place = obstacle.placement[:3, 3].tolist()
        turn = pybullet.getQuaternionFromEuler(compute_roll_pitch_yaw(obstacle.placement[:3, :3]))
        sizes: dict[str, Any] = {}
        if obstacle.shape == "mesh":
            mesh = load_mesh(obstacle.file)
            path = folder / f"{obstacle.name}.obj"
            path.write_text("".join(f"v {a} {b} {c}\n" for a, b, c in mesh.vertices.tolist())
                            + "".join(f"f {a} {b} {c}\n" for a, b, c in (mesh.triangles + 1).tolist()))
            sizes = {"fileName": str(path), "meshScale": obstacle.sizes}
        elif obstacle.shape == "box":
            sizes = {"halfExtents": [size / 2 for size in obstacle.sizes]}
        else:
            sizes = {"radius": obstacle.sizes[0]}
        kind = {"box": pybullet.GEOM_BOX, "cylinder": pybullet.GEOM_CYLINDER, "sphere": pybullet.GEOM_SPHERE,
                "mesh": pybullet.GEOM_MESH}[obstacle.shape]
        long = {"cylinder": {"height": obstacle.sizes[-1]}, "mesh": {"flags": pybullet.GEOM_FORCE_CONCAVE_TRIMESH}}
        drawn = {"cylinder": {"length": obstacle.sizes[-1]}}
        shape = pybullet.createCollisionShape(kind, **sizes, **long.get(obstacle.shape, {}),
                                              physicsClientId=self.client)
        colour = COLOURS.get(obstacle.name.partition("-")[0], (0.62, 0.66, 0.7, 1.0))
        visual = pybullet.createVisualShape(kind, **sizes, **drawn.get(obstacle.shape, {}), rgbaColor=colour,
                                            physicsClientId=self.client)
        return pybullet.createMultiBody(0, shape, visual, place, turn, physicsClientId=self.client)

    def place(self, angles: NDArray[np.float64]) -> None:
        """Put the arm into a configuration."""
        for name, value in self.arm.robot.compute_values(angles).items():
            pybullet.resetJointState(self.body, self.numbers[name], float(value), physicsClientId=self.client)

    def _find_moved(self) -> list[int]:
        """Links that a planned joint moves."""
        planned = {self.numbers[name] for name in (*self.arm.joint_names, *self.arm.robot.mimics)}
        moved = list[int]()
        for link, parent in enumerate(self.parents):
            if link in planned or parent in moved:
                moved.append(link)
        return moved

    def list_pairs(self, postures: NDArray[np.float64]) -> list[tuple[int, int]]:
        """List pairs of links that are not allowed to touch, and apart in all of some postures."""
        pairs = [(a, b) for a, b in itertools.combinations(range(-1, len(self.parents)), 2)
                 if b in self._moved and (a, b) in self._tested]
        for posture in postures:
            self.place(posture)
            pairs = [pair for pair in pairs if self.measure(*pair) > 1e-3]
        return pairs

    def measure(self, a: int, b: int) -> float:
        """Distance of two links, up to `NEAR`, m."""
        points = pybullet.getClosestPoints(self.body, self.body, NEAR, a, b, physicsClientId=self.client)
        return min((point[8] for point in points), default=NEAR)

    def measure_obstacles(self) -> float:
        """Least distance of a moving link from an obstacle or the floor, up to `NEAR`, m."""
        least = NEAR
        for body in self.obstacles.values():
            points = pybullet.getClosestPoints(self.body, body, NEAR, physicsClientId=self.client)
            least = min([least, *(point[8] for point in points if point[3] in self._moved)])
        return least

    def measure_path(self, path: MotionPath, step: float = 0.01) -> tuple[float, float]:
        """Least distances along a path, m: from obstacles, and between links of the robot, at 10 mm of motion."""
        places = path.interpolate(step / float(path.scale.max()))
        pairs, outer, own = self.list_pairs(path.points[[0, -1]]), NEAR, NEAR
        for number, at in enumerate(places):
            self.place(at)
            outer = min(outer, self.measure_obstacles())
            if number % 4 == 0:
                own = min([own, *(self.measure(*pair) for pair in pairs)])
        return outer, own

    def draw(self, eye: tuple[float, float, float], target: tuple[float, float, float], size: tuple[int, int]
             ) -> NDArray[np.uint8]:
        """Return a picture of the present configuration, (height, width, 4), uint8, the background transparent."""
        width, height = size[0] * 2, size[1] * 2
        view = pybullet.computeViewMatrix(eye, target, (0, 0, 1))
        lens = pybullet.computeProjectionMatrixFOV(38, width / height, 0.05, 10)
        _, _, pixels, _, bodies = pybullet.getCameraImage(
            width, height, view, lens, lightDirection=(0.5, -1.5, 2.5), shadow=0,
            renderer=pybullet.ER_TINY_RENDERER, physicsClientId=self.client)
        picture = np.array(pixels, dtype=np.uint8).reshape(height, width, 4).copy()
        picture[..., 3] = np.where(np.array(bodies).reshape(height, width) >= 0, 255, 0)
        return np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))

    def draw_whole(self) -> NDArray[np.uint8]:
        """Return a picture of the whole robot and its obstacles, as of `draw`."""
        boxes = np.array([pybullet.getAABB(body, link, physicsClientId=self.client) for body, link in (
            *((self.body, link) for link in range(len(self.parents))),
            *((body, -1) for body in self.obstacles.values()))])
        low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        middle, far = (low + high) / 2, 1.1 * float(np.linalg.norm(high - low))
        x, y, z = (middle + far * np.array([0.75, -1.0, 0.45])).tolist()
        return self.draw((x, y, z), tuple(middle.tolist()), (400, 400))

    def close(self) -> None:
        """Disconnect from Bullet."""
        pybullet.disconnect(self.client)


COLOURS = {"cup": (0.84, 0.37, 0.0, 1.0), "shelf": (0.76, 0.62, 0.44, 1.0), "table": (0.76, 0.62, 0.44, 1.0),
           "leg": (0.6, 0.48, 0.34, 1.0)}


# --- motions among obstacles ----------------------------------------------------------------------


def clutter(arm: Arm, rng: np.random.Generator, count: int = 6) -> Arm:
    """Add obstacles of all shapes where the hand can be, at any placement, with the home posture clear of them."""
    low, high = arm.limits.T
    reach = max(float(np.linalg.norm(arm.compute_placement(q)[:3, 3] - arm.compute_placement("home")[:3, 3]))
                for q in rng.uniform(low, high, (20, len(low))))

    def make(number: int, size: float, at: tuple[float, ...], grown: float = 0.0) -> Obstacle:
        name, wide = f"thing-{number}", 2 * grown
        return (Obstacle.box(name, (size + wide, 2 * size + wide, size + wide), at),
                Obstacle.cylinder(name, size / 2 + grown, 3 * size + wide, at),
                Obstacle.sphere(name, 0.7 * size + grown, at))[number % 3]

    for _ in range(50 * count):
        at = (*arm.compute_placement(rng.uniform(low, high))[:3, 3], *rng.uniform(-math.pi, math.pi, 3))
        number, size = len(arm.obstacles), float(rng.uniform(0.04, 0.12)) * reach
        if number < count and arm.add(make(number, size, at, 0.03)).is_free("home"):
            arm = arm.add(make(number, size, at))
    return arm


def list_queries(arm: Arm, count: int) -> tuple[Arm, list[tuple[NDArray[np.float64], NDArray[np.float64]]]]:
    """Put an arm among obstacles and choose motions between free postures, the first from home."""
    rng, (low, high) = np.random.default_rng(0), arm.limits.T
    arm = clutter(arm, rng)
    samples = (q for q in (rng.uniform(low, high) for _ in itertools.count()) if arm.is_free(q, 0.002))
    return arm, list(itertools.pairwise([arm.home, *itertools.islice(samples, count)]))


def plan_motions(arm: Arm, count: int, picture: Path | None = None, budget: int = 100_000) -> dict[str, float]:
    """Plan motions between free postures, the first from home, and check all of them.

    A picture shows the arm at home among its obstacles.

    Returns:
        Share that was found; seconds of CPU, median and largest; share of straight paths, and of those that the URDF's
        efforts hold; least distances by Bullet from obstacles and between links, mm; and the largest share of a limit
        that trajectories use at 1 kHz.
    """
    arm, queries = list_queries(arm, count)
    check = ArmCheck(arm)
    if picture:
        check.place(arm.home)
        Image.fromarray(check.draw_whole()).save(picture)
    times, clearances, straight, held, strain = [], [], 0, 0, 0.0
    for before, goal in queries:
        began = time.thread_time()
        try:
            path = arm.plan(before, goal, budget=budget)
        except PlanningFailed as failed:
            print(f"  {failed.reason.value} after {time.thread_time() - began:.1f} CPU s {failed.nearest}", flush=True)
            continue
        times.append(time.thread_time() - began)
        clearances.append(check.measure_path(path))
        straight += len(path.points) == 2
        try:
            strain = max(strain, measure_strain(arm, path))
            held += 1
        except ConfigError:  # the efforts of the URDF do not hold the arm
            pass
    check.close()
    outer, own = np.array(clearances).reshape(-1, 2).min(axis=0, initial=NEAR)
    return {"found": len(times) / count, "median s": float(np.median(times)), "most s": max(times, default=math.nan),
            "straight": straight / max(1, len(times)), "held": held / max(1, len(times)),
            "clearance mm": 1000 * outer, "own mm": 1000 * own, "strain": strain}


def measure_strain(arm: Arm, path: MotionPath) -> float:
    """Return the largest share of a limit of speed or acceleration, or of the joints' ranges, at 1 kHz."""
    trajectory = arm.trajectory(path)
    times, positions, velocities = trajectory.sample(1000)
    limits = trajectory.limits.stack(trajectory.names, arm.robot)
    low, high = arm.limits.T
    middle, half = (high + low) / 2, np.where(arm.robot.continuous, np.inf, (high - low) / 2)
    assert np.allclose(positions[[0, -1]], path.points[[0, -1]], atol=1e-9)
    return float(max((np.abs(velocities) / limits[:, 0]).max(),
                     (np.abs(trajectory.evaluate(times, 2)) / limits[:, 1]).max(),
                     (np.abs(positions - middle) / half).max()))


# --- tasks ----------------------------------------------------------------------------------------


def write_shelf(path: Path) -> Path:
    """Write the mesh of a shelf with two boards, open at the front: 0.4 m deep, 0.8 m wide, 0.9 m high."""
    boards = (((0.19, 0.0, 0.45), (0.02, 0.8, 0.9)), ((0.0, 0.39, 0.45), (0.4, 0.02, 0.9)),
              ((0.0, -0.39, 0.45), (0.4, 0.02, 0.9)), *(((0.0, 0.0, z), (0.4, 0.8, 0.02)) for z in (0.01, 0.45, 0.89)))
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    lines = []
    for number, (centre, size) in enumerate(boards):
        for signs in itertools.product((-0.5, 0.5), repeat=3):
            x, y, z = (c + s * d for c, s, d in zip(centre, signs, size, strict=True))
            lines.append(f"v {x} {y} {z}")
        lines += [f"f {' '.join(str(8 * number + 1 + corner) for corner in side)}" for side in sides]
    path.write_text("\n".join(lines) + "\n")
    return path


@dataclasses.dataclass
class Step:
    """One motion of a task, with the arm as it was when it moved."""

    name: str
    arm: Arm
    path: MotionPath


def take_from_shelf(folder: Path) -> list[Step]:
    """Take a cup out of a shelf and put it on a table: grip, carry, and return."""
    shelf = Obstacle.mesh("shelf", write_shelf(folder / "shelf.obj"), (0.75, 0.0, 0.0))
    cup = Obstacle.cylinder("cup", 0.03, 0.12, (0.64, 0.1, 0.521))
    table = Obstacle.box("table", (0.5, 0.7, 0.04), (0.0, -0.75, 0.3))
    stand = Obstacle.box("stand", (0.25, 0.25, 0.3), (-0.05, 0.0, 0.15))
    arm = make_panda(base_pose=(0.0, 0.0, 0.3), obstacles=[shelf, cup, table, stand], floor=0.0)
    steps = list[Step]()

    def move(name: str, arm: Arm, start: Any, *targets: tuple[float, ...]) -> NDArray[np.float64]:
        postures = [p.angles for target in targets for p in arm.solve_ik(target, start, seeds=32)]
        path = arm.plan(start, postures)
        steps.append(Step(name, arm, path))
        return path.points[-1]

    before = move("reach before the cup", arm, "home", (0.53, 0.1, 0.53, *FORWARD))
    grip = move("reach the cup", arm, before, (0.64, 0.1, 0.53, *FORWARD))
    holding = arm.attach("cup", grip, may_touch=["shelf", "panda_leftfinger", "panda_rightfinger"], mass=0.2)
    lifted = move("lift it", holding, grip, (0.64, 0.1, 0.56, *FORWARD))
    holding = holding.detach("cup", lifted).attach("cup", lifted, may_touch=["panda_leftfinger", "panda_rightfinger"],
                                                   mass=0.2)
    out = move("take it out", holding, lifted, (0.4, 0.05, 0.6, *FORWARD))
    down = move("put it on the table", holding, out, *((0.0, -0.7, 0.41, 0.0, math.pi / 2, yaw)
                                                       for yaw in (-math.pi / 2, -1.2, -1.9)))
    released = holding.detach("cup", down)
    move("leave it", released, down, (0.0, -0.5, 0.43, 0.0, math.pi / 2, -math.pi / 2))
    return steps


def reach_under_table() -> list[Step]:
    """Reach a cup that stands under a table."""
    legs = [Obstacle.cylinder(f"leg-{number}", 0.025, 0.58, (x, y, 0.29))
            for number, (x, y) in enumerate(itertools.product((0.5, 1.1), (-0.4, 0.4)))]
    obstacles = [Obstacle.box("table", (0.7, 0.9, 0.04), (0.8, 0.0, 0.6)), *legs,
                 Obstacle.cylinder("cup", 0.03, 0.12, (0.65, 0.1, 0.06))]
    arm = make_panda(base_pose=(0.0, 0.0, 0.0), obstacles=obstacles, floor=0.0)
    above = arm.solve_ik((0.5, 0.1, 0.69, math.pi, 0.0, 0.0), seeds=32)
    under = arm.solve_ik((0.57, 0.1, 0.1, *FORWARD), seeds=64)
    start = arm.plan("home", [posture.angles for posture in above])
    return [Step("over the table", arm, start),
            Step("under the table", arm, arm.plan(start.points[-1], [posture.angles for posture in under]))]


TASKS: dict[str, Callable[[Path], list[Step]]] = {"shelf": take_from_shelf, "table": lambda folder: reach_under_table()}
VIEWS = {"shelf": ((-0.75, -2.1, 1.45), (0.38, -0.2, 0.5)), "table": ((0.9, -2.3, 1.1), (0.4, 0.0, 0.4))}


def check_task(steps: list[Step]) -> float:
    """Return the least distance from obstacles on the way, m; trajectories keep their limits.

    What may touch, as a cup and the board under it, is not measured.
    """
    least = NEAR
    for step in steps:
        check = ArmCheck(step.arm)
        for name in {name for pair in step.arm.rules.allowed for name in pair} & {*check.obstacles}:
            pybullet.removeBody(check.obstacles.pop(name), physicsClientId=check.client)
        least = min(least, check.measure_path(step.path)[0])
        check.close()
        assert measure_strain(step.arm, step.path) <= 1.0 + 1e-6, step.name
    return least


def draw_task(name: str, steps: list[Step], path: Path, size: tuple[int, int] = (400, 360)) -> None:
    """Write a picture of the ends of a task's motions, side by side, at most three."""
    pictures = []
    for step in steps if len(steps) < 3 else (steps[1], steps[3], steps[5]):
        check = ArmCheck(step.arm)
        check.place(step.path.points[-1])
        pictures.append(check.draw(*VIEWS[name], size))
        check.close()
    Image.fromarray(np.concatenate(pictures, axis=1)).save(path)


# --- the script -----------------------------------------------------------------------------------


@dataclasses.dataclass
class Args:
    """What to measure."""

    folder: Annotated[Path | None, tyro.conf.Positional] = None
    """Folder of example-robot-data; the installed one by default."""
    plans: int = 50
    """Motions of each robot."""
    budget: int = 100_000
    """Configurations that a search may test; by default as many as in `Arm.plan`."""
    robots: tuple[str, ...] = ()
    """Only these robots."""
    pictures: Path | None = None
    """Folder for pictures of the robots and the tasks."""


def run(args: Args) -> int:
    """Print a row for each robot and task; 1 if a path is not free or a trajectory exceeds a limit."""
    folder = args.folder or find_robots()
    folder = folder / "robots" if (folder / "robots").is_dir() else folder
    robots = {"dual Panda": make_dual_panda, "continuous joints": make_continuous}
    robots |= list_published(folder) if folder.is_dir() else {}
    unknown = [name for name in args.robots if name not in robots]
    if unknown:
        raise UnknownNameError("robot", unknown[0], list(robots))
    is_good = True
    for name, make in robots.items():
        if args.plans and (not args.robots or name in args.robots):
            arm = make()
            picture = args.pictures and args.pictures / f"arm-{name.lower().replace(' ', '-')}.png"
            found = plan_motions(arm, args.plans, picture, args.budget)
            is_good &= (found["clearance mm"] > 0.0 and found["own mm"] > -1000 * HULL_MARGIN
                        and found["strain"] <= 1.0 + 1e-6)
            print(f"{name}, {len(arm.joint_names)} joints: " + ", ".join(f"{key} {value:.3g}"
                                                                        for key, value in found.items()), flush=True)
    for name, make_task in TASKS.items() if not args.robots else ():
        with tempfile.TemporaryDirectory() as place:
            began = time.thread_time()
            steps = make_task(Path(place))
            seconds, least = time.thread_time() - began, check_task(steps)
            print(f"{name}: {len(steps)} motions in {seconds:.1f} CPU s, clearance {1000 * least:.1f} mm", flush=True)
            is_good &= least > 0.0
            if args.pictures:
                draw_task(name, steps, args.pictures / f"arm-{name}.png")
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(run_script(run))
