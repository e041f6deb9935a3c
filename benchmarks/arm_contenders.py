"""Six queries for arms, compared with OMPL's own bindings and pyroboplan: `python -m benchmarks.arm_contenders FOLDER`.

All planners get the same Pinocchio model, the same convex hulls, the same pairs of bodies and the same clearances. OMPL
(`SimpleSetup`, RRTConnect, with simplification) and pyroboplan (bidirectional RRT-Connect) test configurations that are
apart by 0.05 rad, pyroboplan's default; and, named `fine`, so near to each other that between them, too, half of the
clearance from obstacles is certain, as it is on the package's paths. pyroboplan has one padding for all pairs, so its
obstacles are grown by the rest. Then the clearance of every path is measured every 0.005 rad. FOLDER is the folder of
`example-robot-data`.

pyroboplan: `pip install --no-deps pyroboplan meshcat u-msgpack-python tornado pyzmq toppra`; without it, its columns
are empty.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import math
import sys
import time
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pinocchio
import tyro
from numpy.typing import NDArray
from ompl import base, geometric, util

from benchmarks.machine import describe_machine
from hrl_escape.cli import run_script
from hrl_escape.errors import PlanningFailed
from hrl_escape.planning import Arm, Obstacle
from hrl_escape.planning.arm.motion_search import CLEARANCE, OWN_CLEARANCE

try:
    from pyroboplan.planning.rrt import RRTPlanner, RRTPlannerOptions
except ImportError:  # no dependency of this project
    RRTPlanner = None

SPACING, MEASURED = 0.05, 0.005
"""Distances of tested and of measured configurations, rad."""
SECONDS = 60.0
SEEDS = 15


@dataclasses.dataclass(frozen=True)
class Query:
    """One motion."""

    name: str
    arm: Arm
    start: NDArray[np.float64]
    goal: NDArray[np.float64]


def make_obstacles(kind: str, distance: float, grown: float = 0.0) -> list[Obstacle]:
    """Obstacles in front of an arm: posts, a table or a shelf of boxes; each grown by a distance, m."""
    def box(name: str, size: tuple[float, float, float], at: tuple[float, ...]) -> Obstacle:
        return Obstacle.box(name, [side + 2 * grown for side in size], at)

    if kind == "posts":
        return [Obstacle.cylinder(f"post-{number}", 0.05 + grown, 1.6 + 2 * grown, (distance * math.cos(angle),
                                                                                   distance * math.sin(angle), 0.8))
                for number, angle in enumerate((-0.9, 0.0, 0.9))]
    if kind == "table":
        return [box("table", (0.6, 1.2, 0.04), (distance + 0.2, 0.0, 0.35)),
                Obstacle.sphere("ball", 0.12 + grown, (distance, 0.0, 0.55))]
    return [box(f"board-{number}", (0.35, 0.9, 0.03), (distance + 0.2, 0.0, z))
            for number, z in enumerate((0.2, 0.6, 1.0))]


ARMS = {
    "Panda": ("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf", "panda_hand_tcp"),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", None, "ee_link"),
    "UR10": ("ur_description/urdf/ur10_robot.urdf", None, "ee_link"),
    "xArm 7": ("xarm_description/urdf/xarm7.urdf", None, "link7"),
}
QUERIES = (("Panda", "posts", 0.5), ("Panda", "table", 0.4), ("Panda", "shelf", 0.45), ("UR5", "posts", 0.5),
           ("UR10", "table", 0.6), ("xArm 7", "posts", 0.45))


def make_arm(folder: Path, name: str, obstacles: list[Obstacle]) -> Arm:
    """Load an arm of `example-robot-data`."""
    file, srdf, hand = ARMS[name]
    robots = folder / "robots" if (folder / "robots").is_dir() else folder
    joints = [f"panda_joint{number}" for number in range(1, 8)] if name == "Panda" else None
    return Arm.from_urdf(robots / file, srdf=srdf and robots / srdf, hand=hand, joints=joints, obstacles=obstacles)


def make_query(folder: Path, name: str, kind: str, distance: float) -> Query:
    """Choose two free postures, apart and with the hand on both sides of the obstacles."""
    arm = make_arm(folder, name, make_obstacles(kind, distance))
    wide = make_arm(folder, name, make_obstacles(kind, distance, CLEARANCE))
    rng, (low, high) = np.random.default_rng(1), np.clip(arm.limits.T, -2.8, 2.8)
    ends = list[NDArray[np.float64]]()
    while len(ends) < 2:
        at = rng.uniform(low, high)
        x, y, z = arm.compute_placement(at)[:3, 3]
        side = 1 if len(ends) else -1
        if x > 0.6 * distance and side * y > 0.25 and 0.1 < z < 0.9 and wide.is_free(at, 2 * OWN_CLEARANCE):
            ends.append(at)
    return Query(f"{name}, {kind}", arm, *ends)


@lru_cache
def copy_model(arm: Arm) -> tuple[Any, Any, NDArray[np.float64], NDArray[np.int64]]:
    """Return the arm's own model and shapes with a fixed base, the margin of each pair, m, and the planned columns."""
    tests = arm._search.get_collisions(0.0)
    model, geometry = pinocchio.buildModelFromXML(arm.robot.urdf), pinocchio.GeometryModel()
    assert list(model.names)[1:] == list(tests._model.names)[2:]
    for item in tests._geometry.geometryObjects:
        geometry.addGeometryObject(pinocchio.GeometryObject(item.name, max(0, item.parentJoint - 1), item.placement,
                                                            item.geometry))
    fixed, margins = {each.name for each in arm.obstacles}, list[float]()
    for pair in tests._geometry.collisionPairs:
        geometry.addCollisionPair(pinocchio.CollisionPair(pair.first, pair.second))
        margins.append(CLEARANCE if geometry.geometryObjects[pair.second].name in fixed else 0.9 * OWN_CLEARANCE)
    rest = tests._joints.make_q(arm.home)[4:]
    columns = np.array([model.joints[model.getJointId(name)].idx_q for name in arm.joint_names])
    low, high = rest.copy(), rest.copy()
    low[columns], high[columns] = arm.limits.T
    model.lowerPositionLimit, model.upperPositionLimit = low, high
    return model, geometry, np.array(margins), columns


def fill(arm: Arm, angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the model's configuration for planned angles, rad."""
    model, _, _, columns = copy_model(arm)
    q = model.lowerPositionLimit.copy()  # locked joints have no range
    q[columns] = angles
    return q


def measure(arm: Arm, points: NDArray[np.float64]) -> tuple[float, float]:
    """Return the least distances along a path, m: from obstacles, and between links."""
    model, geometry, margins, _ = copy_model(arm)
    data, shapes = model.createData(), geometry.createData()
    near = np.full(len(margins), math.inf)
    for a, b in zip(points[:-1], points[1:], strict=True):
        for share in np.linspace(0.0, 1.0, math.ceil(np.linalg.norm(b - a) / MEASURED) + 1):
            pinocchio.computeDistances(model, data, geometry, shapes, fill(arm, a + share * (b - a)))
            near = np.minimum(near, [each.min_distance for each in shapes.distanceResults])
    return (float(near[margins == CLEARANCE].min(initial=math.inf)),
            float(near[margins < CLEARANCE].min(initial=math.inf)))


def find_fine_spacing(arm: Arm) -> float:
    """Return the distance of tested configurations, rad, between which half of `CLEARANCE` from obstacles is certain.

    Half-way between two of them a link has approached an obstacle by at most half the clearance. Pairs of links, whose
    clearance is a twentieth, are left out.
    """
    tests = arm._search.get_collisions(0.0)
    _, _, margins, _ = copy_model(arm)
    return CLEARANCE / float(np.linalg.norm(tests._bounds.speeds[margins == CLEARANCE, 3:], axis=1).max())


def plan_here(query: Query, seed: int) -> Callable[[], NDArray[np.float64] | None]:
    """This package."""
    arm = dataclasses.replace(query.arm)  # without models that are loaded already
    arm.is_free(query.start)

    def plan() -> NDArray[np.float64] | None:
        try:
            return arm.plan(query.start, query.goal, seed=seed, time_limit=SECONDS).points
        except PlanningFailed:
            return None

    return plan


def plan_with_ompl(query: Query, seed: int, spacing: float) -> Callable[[], NDArray[np.float64] | None]:
    """OMPL's own bindings, with a test of one configuration at a time."""
    model, geometry, margins, columns = copy_model(query.arm)
    data, shapes = model.createData(), geometry.createData()
    for request, margin in zip(shapes.collisionRequests, margins, strict=True):
        request.security_margin = float(margin)
    count, (low, high), q = len(columns), query.arm.limits.T, fill(query.arm, query.start)
    util.RNG.setSeed(seed + 1)
    space = base.RealVectorStateSpace(count)
    bounds = base.RealVectorBounds(count)
    for number in range(count):
        bounds.setLow(number, float(low[number]))
        bounds.setHigh(number, float(high[number]))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)

    def is_valid(state: Any) -> bool:
        q[columns] = [state[number] for number in range(count)]
        return not pinocchio.computeCollisions(model, data, geometry, shapes, q, True)

    setup.setStateValidityChecker(is_valid)
    information = setup.getSpaceInformation()
    information.setStateValidityCheckingResolution(spacing / space.getMaximumExtent())
    ends = [space.allocState() for _ in range(2)]
    for end, values in zip(ends, (query.start, query.goal), strict=True):
        for number in range(count):
            end[number] = float(values[number])
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(geometric.RRTConnect(information))

    def plan() -> NDArray[np.float64] | None:
        if not setup.solve(SECONDS) or not setup.haveExactSolutionPath():
            return None
        setup.simplifySolution()
        return np.array([[state[number] for number in range(count)] for state in setup.getSolutionPath().getStates()])

    return plan


def plan_with_pyroboplan(query: Query, grown: Arm, seed: int, spacing: float
                         ) -> Callable[[], NDArray[np.float64] | None]:
    """The planner of pyroboplan."""
    model, geometry, _, columns = copy_model(grown)
    options = RRTPlannerOptions(max_step_size=spacing, max_connection_dist=100.0, rrt_connect=False,
                                bidirectional_rrt=True, max_planning_time=SECONDS, rng_seed=seed,
                                collision_distance_padding=0.9 * OWN_CLEARANCE)
    planner = RRTPlanner(model, geometry, options)

    def plan() -> NDArray[np.float64] | None:
        with contextlib.redirect_stdout(io.StringIO()):
            points = planner.plan(fill(grown, query.start), fill(grown, query.goal))
        return np.array(points)[:, columns] if points is not None and len(points) else None

    return plan


@dataclasses.dataclass
class Args:
    """What to measure."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of example-robot-data."""
    seeds: int = SEEDS
    """Runs of each query."""


def run(args: Args) -> int:
    """Print a row for each query and planner."""
    ratios: dict[str, list[float]] = {}
    for name, kind, distance in QUERIES:
        query = make_query(args.folder, name, kind, distance)
        grown = make_arm(args.folder, name, make_obstacles(kind, distance, CLEARANCE - 0.9 * OWN_CLEARANCE))
        makers: dict[str, Callable[[int], Callable[[], NDArray[np.float64] | None]]] = {
            "hrl-escape": partial(plan_here, query)}
        for label, spacing in (("", SPACING), (", fine", find_fine_spacing(query.arm))):
            makers[f"OMPL{label}"] = partial(plan_with_ompl, query, spacing=spacing)
            if RRTPlanner is not None:
                makers[f"pyroboplan{label}"] = partial(plan_with_pyroboplan, query, grown, spacing=spacing)
        for planner, make in makers.items():
            seconds, lengths, outer, own = [], [], math.inf, math.inf
            for seed in range(args.seeds):
                plan = make(seed)
                began = time.thread_time()
                points = plan()
                seconds.append(time.thread_time() - began)
                if points is not None:
                    lengths.append(float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()))
                    kept = measure(query.arm, points)
                    outer, own = min(outer, kept[0]), min(own, kept[1])
            middle = float(np.median(seconds))
            ratios.setdefault(planner, []).append(middle)
            print(f"{query.name}: {planner} {len(lengths)}/{args.seeds}, {middle:.2f} CPU s (most {max(seconds):.2f}), "
                  f"length {np.median(lengths) if lengths else math.nan:.2f} rad, clearance {1000 * outer:.1f} mm, "
                  f"own {1000 * own:.1f} mm", flush=True)
    for planner, times in ratios.items():
        shares = np.array(times) / np.array(ratios["hrl-escape"])
        print(f"{planner}: {np.median(shares):.2f} times our CPU time in the median query, from {shares.min():.2f} to "
              f"{shares.max():.2f}")
    print(json.dumps(describe_machine("ompl", "pin", *(("pyroboplan",) if RRTPlanner else ()))))
    return 0


if __name__ == "__main__":
    sys.exit(run_script(run))
