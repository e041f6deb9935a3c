"""Continuous paths made of plans of primitives: shortcuts for the base that keep a clearance, leg by leg."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.geometry import Footprint, compute_distance_many, compute_first_contact, stack_footprints
from hrl_escape.env.kinematics import Rules
from hrl_escape.planning.lattice.areas import grow_solids
from hrl_escape.planning.plan import Plan
from hrl_escape.planning.trajectories.path import MotionPath, round_corners

__all__ = ["smooth_plan"]

ROUNDINGS = (0.3, 0.1, 0.03)
"""Distances by which corners may be cut, m; the first that stays clear is taken."""
LOOK = 0.01
"""Distance of the places at which rounded corners are tested, m: between two of them a disc gets no nearer to a solid
than a fraction of the contact skin."""


def smooth_plan(plan: Plan, clearance: float) -> list[MotionPath]:
    """Paths of a plan's legs: each ends exactly where the leg ends, by the fewest straight lines that stay clear.

    Heading and joints go evenly from the leg's first to its last state, as the base strafes in any direction. A base
    with a differential drive cannot, and one that is a rectangle must not turn anywhere: they follow the plan's own
    lines and turn on the spot between them.

    Args:
        plan: the plan.
        clearance: distance that the base keeps from solids, m, less where start or end of a leg are nearer; a leg's
            own straight moves are kept where nothing else does.

    Returns:
        One path for each leg; one for each line or turn of such a base.
    """
    rules, room = Rules(plan.instance), plan.instance
    if room.robot.drive == "differential" or room.robot.footprint == "rectangle":
        return _follow_moves(plan, rules)
    radius = room.robot.body_radius + CONTACT_SKIN
    names = ("x", "y", "heading", *rules.robot.joint_names)
    paths = []
    for part in plan.parts:
        states = plan.states[part.start : part.stop + 1]
        wide = grow_solids(room, states[0], part.goal, clearance)
        exact = [*(solid.footprint for solid in room.solids), *([room.door.footprint] if room.door else [])]
        if room.puzzle.is_solved(states[0].puzzle):
            exact = [solid.footprint for solid in room.solids]
        places = plan.path[part.start : part.stop + 1]
        kept = _shorten(places, [*wide, *exact], radius)
        moved = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places[kept], axis=0).T))])
        begin, end = (np.array([rules.get_heading(s), *rules.get_angles(s)]) for s in (states[0], states[-1]))
        end[0] = begin[0] + math.remainder(end[0] - begin[0], math.tau)
        if moved[-1] > 0.0:
            share = moved / moved[-1]
            points = np.column_stack([places[kept], begin + share[:, None] * (end - begin)])
        else:
            points = np.column_stack([places[[0, -1]], np.stack([begin, end])])
        path = MotionPath(names, points, np.ones(len(names)), 0.0, plan.planner)
        paths.append(_choose_margin(path, exact, radius))
    return paths


def _follow_moves(plan: Plan, rules: Rules) -> list[MotionPath]:
    """One path for each run of the same primitive."""
    names, paths, at = ("x", "y", "heading", *rules.robot.joint_names), [], 0
    places = np.array([(s.x, s.y, rules.get_heading(s), *rules.get_angles(s)) for s in plan.states])
    places[:, 2] = np.unwrap(places[:, 2])
    for _, run in itertools.groupby(plan.primitives):
        end = at + len(list(run))
        paths.append(MotionPath(names, places[[at, end]], np.ones(len(names)), 0.0, plan.planner))
        at = end
    return paths


def _shorten(places: NDArray[np.float64], solids: Sequence[Footprint], radius: float) -> list[int]:
    """Indices of places by which straight lines go round solids: from each to the last one in sight."""
    def is_clear(a: int, b: int) -> bool:
        (x, y), (to_x, to_y) = places[a].tolist(), places[b].tolist()
        return not any(compute_first_contact(x, y, to_x - x, to_y - y, radius - 1e-9, s) < 1.0 for s in solids)

    kept, last = [0], len(places) - 1
    while kept[-1] < last:
        at = kept[-1]
        kept.append(next((k for k in range(last, at, -1) if k == at + 1 or is_clear(at, k)), last))
    return kept


def _choose_margin(path: MotionPath, solids: Sequence[Footprint], radius: float) -> MotionPath:
    """The path with the largest margin at which its rounded corners are clear of all solids."""
    for margin in ROUNDINGS:
        rounded = dataclasses.replace(path, margin=margin)
        curve = round_corners(rounded)
        places = curve(np.linspace(0.0, curve.x[-1], 2 + math.ceil(curve.x[-1] / LOOK)))[:, :2]
        if (compute_distance_many(places, stack_footprints(list(solids))) >= radius - CONTACT_SKIN / 2).all():
            return rounded
    return path
