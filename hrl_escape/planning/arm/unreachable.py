"""Proof that a hand cannot touch a target, and the reason: height, distance, joint limits or whole joint steps.

The proof covers every place that the body can get to, every heading of the lattice and every joint
configuration: a table of lower bounds rules out most cells, and the rest are searched one by one.
Inverse kinematics only names the reason.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import compute_distance_many, make_footprint, stack_footprints
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.planning.arm.joint_lattice import NEVER
from hrl_escape.planning.arm.reacher import Reacher
from hrl_escape.planning.arm.search import collect_hands, find_place
from hrl_escape.planning.arm.tables import bound_costs

__all__ = ["explain_unreachable"]

_TRIES = 2_000  # poses of the base tried before the whole lattice is mapped
_FINE_HAND, _FINE_BASE = 0.005, 0.0125  # sides of the cells of a proof, m
_SPLIT = 4  # places along each side of one of its base cells: 3 mm apart
_PLACES = 4  # places round the target for inverse kinematics


def explain_unreachable(reacher: Reacher, target: int) -> str | None:
    """Name the reason why no place within reach of the body touches a target, or return None.

    None means that some place touches it, or that the joint steps are too fine to search the whole lattice
    and inverse kinematics gets there. The exit door counts as open; collisions of the arm do not count.

    Args:
        reacher: the arm in the room.
        target: index of the target.
    """
    if reacher.collide:
        reacher = Reacher(reacher.instance, collide=False)
    room = CollisionMap(reacher.instance, door_shut=False)
    goal = reacher.instance.targets[target]
    hands = None
    if _try_places(reacher, room, target):
        return None
    if reacher.is_whole:
        half_cells = math.ceil(reacher.reach / _FINE_HAND) + 1
        hands = collect_hands(reacher.get_lattice(), goal.z, goal.half_z, reacher.limit, _FINE_HAND, half_cells)
        if _search_places(reacher, room, target, hands):
            return None
    places, closest = _list_places(reacher, room, target)
    if any(_has_ik_solution(reacher, x, y, target, limits=True) for x, y in places):
        step = reacher.instance.robot.joint_step_deg
        reason = f"joint steps: the hand would touch {goal.name} only between whole steps of {step:g} deg"
        return None if hands is None else reason
    if any(_has_ik_solution(reacher, x, y, target, limits=False) for x, y in places):
        return f"joint limits: only joints beyond their limits would bring the hand to {goal.name}"
    heights = reacher.heights
    if goal.z - goal.half_z - reacher.limit > heights[1]:
        return f"too high: {goal.name} hangs from {goal.z - goal.half_z:.2f} m up, the hand gets to {heights[1]:.2f} m"
    if goal.z + goal.half_z + reacher.limit < heights[0]:
        return f"too low: {goal.name} hangs up to {goal.z + goal.half_z:.2f} m, the hand gets to {heights[0]:.2f} m"
    farthest = reacher.reach if hands is None else float(np.nanmax(np.hypot(hands[..., 0], hands[..., 1]), initial=0.0))
    stand = f"gets no nearer than {closest:.2f} m" if math.isfinite(closest) else "cannot come near"
    return f"too far: the body {stand} to {goal.name}, the hand reaches out {farthest:.2f} m at its height"


def _can_stand(reacher: Reacher, room: CollisionMap, place: NDArray[np.float64], half: float) -> bool:
    """Return whether the body may get from a start into a square: there is no proof that it cannot."""
    square = make_footprint(float(place[0]), float(place[1]), half, half)
    return any(room.find_proof(start.x, start.y, square, 0.0) is None for start in reacher.instance.starts)


def _find_open_cells(reacher: Reacher, room: CollisionMap, centres: NDArray[np.float64], within: NDArray[np.bool_],
                     cell: float) -> tuple[NDArray[np.int_], NDArray[np.float64]]:
    """Cells (n, 2) in which the body may fit, by falling number of headings that reach, and their centres."""
    counts = np.count_nonzero(within, axis=2)
    cells = np.argwhere(counts)
    points = centres[cells[:, 0], cells[:, 1]]
    slack = cell * math.sqrt(0.5) + 1e-6
    on_floor = (np.abs(points) <= np.array([reacher.instance.reach_x, reacher.instance.reach_y]) + slack).all(axis=1)
    keep = on_floor & (compute_distance_many(points, room.solids) >= room.inner - slack)
    order = np.argsort(-counts[cells[keep, 0], cells[keep, 1]], kind="stable")
    return cells[keep][order], points[keep][order]


def _try_places(reacher: Reacher, room: CollisionMap, target: int) -> bool:
    """Search the likeliest places for one that touches."""
    home = (0,) * reacher.instance.robot.joints
    table = reacher.make_table(target, home)
    within = np.asarray(table.costs >= 0)
    tries = 0
    for (i, j), (x, y) in zip(*_find_open_cells(reacher, room, table.get_centres(), within, table.cell), strict=True):
        if not room.is_free(x, y) or not _can_stand(reacher, room, np.array([x, y]), table.cell / 2):
            continue
        for heading in np.flatnonzero(within[i, j]).tolist():
            if reacher.get_configuration(float(x), float(y), heading, home, target) is not None:
                return True
            tries += 1
            if tries == _TRIES:
                return False
    return False


def _search_places(reacher: Reacher, room: CollisionMap, target: int, hands: NDArray[np.float32]) -> bool:
    """Search all cells that a fine table leaves open for a place that touches."""
    goal, kinematics = reacher.instance.targets[target], reacher.kinematics
    costs = np.where(np.isnan(hands[..., 2]), NEVER, 0).astype(np.int16)
    headings = np.arange(kinematics.headings, dtype=np.float64) * kinematics.turn_step
    within = bound_costs(costs, _FINE_HAND, headings, goal.yaw, goal.half_x + reacher.limit,
                         goal.half_y + reacher.limit, _FINE_BASE) >= 0
    middles = np.moveaxis(np.indices(within.shape[:2]), 0, -1) + 0.5 - np.array(within.shape[:2]) / 2
    cells, centres = _find_open_cells(reacher, room, (goal.x, goal.y) + middles * _FINE_BASE, within, _FINE_BASE)
    offsets = _FINE_BASE * ((np.moveaxis(np.indices((_SPLIT, _SPLIT)), 0, -1).reshape(-1, 2) + 0.5) / _SPLIT - 0.5)
    box = np.array([goal.x, goal.y, goal.z, goal.footprint.cos, goal.footprint.sin, goal.half_x, goal.half_y,
                    goal.half_z])
    home = (0,) * reacher.instance.robot.joints
    for (i, j), centre in zip(cells, centres, strict=True):
        places = np.array([place for place in (centre + offsets).tolist() if room.is_free(*place)])
        if not len(places) or not _can_stand(reacher, room, centre, _FINE_BASE / 2):
            continue
        for heading in np.flatnonzero(within[i, j]).tolist():
            n = find_place(hands, _FINE_HAND, places, kinematics.get_rotation(heading, 0.0), box, reacher.limit)
            if n >= 0 and reacher.get_configuration(
                    float(places[n, 0]), float(places[n, 1]), heading, home, target) is not None:
                return True
    return False


def _list_places(reacher: Reacher, room: CollisionMap, target: int) -> tuple[list[tuple[float, float]], float]:
    """Places within the arm's length of a target, from near to far, and the least distance, m."""
    starts = np.array([(start.x, start.y) for start in reacher.instance.starts])
    points = np.concatenate([room.grid.get_centres(np.argwhere(room.distance >= room.inner)), starts])
    away = compute_distance_many(points, stack_footprints([reacher.instance.targets[target].footprint]))
    order = np.argsort(away, kind="stable")
    stands = [n for n in order[away[order] <= reacher.reach + reacher.limit].tolist()
              if _can_stand(reacher, room, points[n], 0.0)]
    if not stands:
        far = [float(away[n]) for n in order[:: max(1, len(order) // 2000)].tolist()
               if _can_stand(reacher, room, points[n], 0.0)]
        return [], min(far, default=math.inf)
    chosen = [stands[round(k)] for k in np.linspace(0, len(stands) - 1, _PLACES)]
    return [(float(points[n, 0]), float(points[n, 1])) for n in chosen], float(away[stands[0]])


def _has_ik_solution(reacher: Reacher, x: float, y: float, target: int, *, limits: bool) -> bool:
    """Return whether inverse kinematics brings the hand to a target from a place, at some heading of the lattice."""
    goal, robot, kinematics = reacher.instance.targets[target], reacher.kinematics.robot, reacher.kinematics
    shape = goal.footprint
    dx, dy = x - goal.x, y - goal.y
    u = min(max(shape.cos * dx + shape.sin * dy, -goal.half_x), goal.half_x)
    v = min(max(shape.cos * dy - shape.sin * dx, -goal.half_y), goal.half_y)
    px, py = goal.x + shape.cos * u - shape.sin * v - x, goal.y + shape.sin * u + shape.cos * v - y
    facing = round(math.atan2(py, px) / kinematics.turn_step)
    low, high = np.array(robot.limits).T
    seeds = [robot.home, *np.random.default_rng(0).uniform(low, high, size=(2, len(robot.home)))]
    for quarter in range(4):
        cos, sin = kinematics.get_rotation((facing + quarter * kinematics.headings // 4) % kinematics.headings, 0.0)
        for height in (goal.z - goal.half_z, goal.z, goal.z + goal.half_z):
            point = (cos * px + sin * py, cos * py - sin * px, height)
            if reacher.arm.solve_ik(point, seeds, reacher.limit, limits) is not None:
                return True
    return False
