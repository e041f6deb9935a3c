"""`MotionSearch`: collision-free motions of an arm among solids, with a clearance for every pair of bodies.

OMPL searches in coordinates scaled to metres of motion. Motions are certified whole: all along a path every pair keeps
half of its margin.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import Clock, OutOfTime
from hrl_escape.env.robot import Robot
from hrl_escape.errors import ConfigError, PlanningFailed, PlanningReason, UnknownNameError
from hrl_escape.kernels import read_clock
from hrl_escape.planning.arm.inverse import subtract_angles
from hrl_escape.planning.arm.model import ArmCollisions, Key
from hrl_escape.planning.arm.motion_test import TESTED, BaseTest, MotionTest, split_coordinates
from hrl_escape.planning.paths.planners import OMPL_PLANNERS, find_joint_path
from hrl_escape.planning.paths.problem import CheckerBudget, MotionPath, Spent

CLEARANCE, OWN_CLEARANCE = 0.02, 0.001
"""Distances that a path keeps, m: of the robot from solids and the floor, and of its links from each other.

Where a pair is nearer at start or goal, it keeps half that distance; the base keeps the first of `BASE_CLEARANCES`
that start and goal allow. Less than `OWN_CLEARANCE` at start or goal is refused.
"""
BASE_CLEARANCES = (0.02, 0.005, 0.001)  # m
_CORNER_CLEARANCES = (0.02, 0.01, 0.005, 0.002)  # m, tried for a path with corners


class SearchLimits(NamedTuple):
    """Planner of OMPL, seed, places that may be tested, and seconds (None for no limit)."""

    planner: str
    seed: int
    budget: int
    time_limit: float | None


class BaseMotion(NamedTuple):
    """Motion of the base together with the arm: box of x, y, heading, m and rad, each (3,), and the base's test."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    does_fit: BaseTest


class MotionSearch:
    """Motions of one robot among solids. Not thread-safe.

    Attributes:
        robot: the robot.
    """

    def __init__(self, touching: ArmCollisions) -> None:
        """Store the test of collisions, with margin 0."""
        self.robot: Robot = touching.robot
        self._touching, self._tests = touching, dict[float, ArmCollisions]()
        self._low, self._high = np.array(self.robot.limits).T

    def get_collisions(self, margin: float) -> ArmCollisions:
        """Return the test in which what is nearer than a margin, m, collides."""
        if margin not in self._tests:
            self._tests[margin] = self._touching.with_margins(margin, {})
        return self._tests[margin]

    def read_angles(self, given: Any, name: str) -> NDArray[np.float64]:
        """Return configurations (n, joints), rad, of one (joints,) or several (n, joints).

        Raises:
            ConfigError: there is none, or one beyond the joint limits; `name` is the argument's.
        """
        try:
            angles = np.atleast_2d(np.asarray(given, dtype=np.float64))
        except (TypeError, ValueError):
            angles = np.zeros((0, 0))
        low, high = np.where(self.robot.continuous, [[-np.inf], [np.inf]], (self._low, self._high))
        right = angles.ndim == 2 and len(angles) and angles.shape[1] == len(low)
        if not right or not (np.isfinite(angles).all() and (angles >= low - 1e-9).all()
                             and (angles <= high + 1e-9).all()):
            raise ConfigError(name, given, f"angles of {len(low)} joints from {np.round(low, 3).tolist()} to "
                                           f"{np.round(high, 3).tolist()} rad")
        return np.clip(angles, low, high)

    def find_path(self, pose: tuple[float, float, float], start: NDArray[np.float64], goals: NDArray[np.float64],
                  limits: SearchLimits, base: BaseMotion | None = None) -> MotionPath:
        """Search for a motion from a start to the first goal that is reached.

        Args:
            pose: of the base at the start: x, y, m, and heading, rad.
            start: joint angles (joints,), rad; with `base`, x, y, heading and joint angles, m and rad.
            goals: likewise, (n, coordinates).
            limits: limits of the search.
            base: motion of the base, or None if it rests.

        Raises:
            PlanningFailed: there is no path; its reason says why.
            UnknownNameError: there is no such planner.
        """
        planner = limits.planner
        if planner not in OMPL_PLANNERS:
            raise UnknownNameError("path planner", planner, OMPL_PLANNERS)
        began, clock, joints = read_clock(), Clock(limits.time_limit), len(self.robot.joint_names)
        place = pose if base is None else None
        does_base_fit: BaseTest = base.does_fit if base else lambda at, margin: True

        def fail(reason: PlanningReason, nearest: str = "") -> PlanningFailed:
            return PlanningFailed(reason, "configuration", None if self._touching.rules.stands else pose,
                                  read_clock() - began, (planner,), nearest=nearest)

        plain = self.get_collisions(CLEARANCE)
        near = [plain.measure_near(*split_coordinates(at, place), within=CLEARANCE) for at in (start, *goals)]
        faults = [self._find_fault(at, place, distances, does_base_fit)
                  for at, distances in zip((start, *goals), near, strict=True)]
        if faults[0]:
            raise fail(PlanningReason.START_INVALID, faults[0])
        if all(faults[1:]):
            raise fail(PlanningReason.GOAL_INVALID, faults[1])
        goals = np.array([goal for goal, fault in zip(goals, faults[1:], strict=True) if not fault])
        margins = dict.fromkeys(plain.list_own_pairs(), 0.9 * OWN_CLEARANCE)
        for distances, fault in zip(near, faults, strict=True):
            for pair, away in () if fault else distances.items():
                margins[pair] = min(margins.get(pair, CLEARANCE), 0.5 * away)
        fitting = [margin for margin in BASE_CLEARANCES if all(does_base_fit(at, margin) for at in (start, *goals))]
        if not fitting:
            raise fail(PlanningReason.UNREACHABLE_AT_RESOLUTION, "the base has less than 1 mm of room at start or goal")
        spent = CheckerBudget(limits.budget, clock)
        *far, turn = plain.sweeps.tolist()
        scale = np.maximum(far if base is None else (1.0, 1.0, max(turn, 0.1), *far), 1e-3)
        test = MotionTest(plain.with_margins(CLEARANCE, margins), place, does_base_fit, fitting[0], spent, scale)
        goals = self.list_turns(start, goals)
        low = np.concatenate([[] if base is None else base.low, self._low])
        high = np.concatenate([[] if base is None else base.high, self._high])
        low, high = np.minimum(low, start), np.maximum(high, start)
        around = np.concatenate([np.zeros(len(start) - joints, dtype=bool), self.robot.continuous])
        low, high = np.where(around, start - math.tau, low), np.where(around, start + math.tau, high)
        kept = least = min([test.margin, *margins.values()])

        def certify(path: NDArray[np.float64]) -> bool:
            nonlocal kept
            kept = _find_clearance(path / scale, test, margins, least)  # corners are rounded within it
            return kept > 0.0

        try:
            path = find_joint_path(low * scale, high * scale, start * scale, goals * scale,
                                   lambda at: test.is_free(at / scale), TESTED, spent, planner=planner,
                                   seed=limits.seed,
                                   is_move_free=lambda begin, end: test.is_move_free(begin / scale, end / scale),
                                   certify=certify)
        except OutOfTime:
            raise fail(clock.reason) from None
        if path is None:
            raise fail(PlanningReason.BUDGET_EXHAUSTED if spent.calls >= limits.budget
                       else PlanningReason.UNREACHABLE_AT_RESOLUTION,
                       self._describe_line(start, min(goals, key=lambda goal: np.linalg.norm((goal - start) * scale)),
                                           test))
        points = path / scale
        if kept == 0.0:  # the motions of the second search are certified one by one
            kept = max(least, _find_clearance(points, test, margins, least))
        names = self.robot.joint_names if base is None else ("x", "y", "heading", *self.robot.joint_names)
        return MotionPath(names, points, scale, kept / 4.0, planner, spent.calls, read_clock() - began, self.robot)

    def list_turns(self, start: NDArray[np.float64], goals: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return goals with continuous joints in the nearest turn, then with one of them the other way round."""
        joints = len(self.robot.joint_names)
        turning = np.flatnonzero(self.robot.continuous) + len(start) - joints
        nearest = goals.copy()
        nearest[:, -joints:] = start[-joints:] + subtract_angles(self.robot, goals[:, -joints:], start[-joints:])
        others = []
        for column in turning:
            other = nearest.copy()
            other[:, column] -= np.where(other[:, column] >= start[column], math.tau, -math.tau)
            others.append(other)
        return np.concatenate([nearest, *others])

    def _describe_line(self, start: NDArray[np.float64], goal: NDArray[np.float64], test: MotionTest) -> str:
        """Say what is in the way on the straight line between coordinates; empty if nothing is."""
        count = math.ceil(float(np.linalg.norm((goal - start) * test.scale)) / TESTED)
        for at in np.linspace(start, goal, count + 1):
            if not test.is_free(at):
                meets = test.collisions.list_collisions(*split_coordinates(at, test.place))
                return f"the straight line, on which {', '.join(meets) or 'the base meets a solid'}"
        return ""

    def _find_fault(self, at: NDArray[np.float64], place: tuple[float, float, float] | None,
                    near: Mapping[frozenset[Key], float], does_base_fit: BaseTest) -> str:
        """Say why a path may not begin or end at coordinates, given the near pairs; empty if it may."""
        if min(near.values(), default=CLEARANCE) <= 0.0:
            meets = self.get_collisions(0.0).list_collisions(*split_coordinates(at, place))
            if meets:
                return ", ".join(meets)
        if not does_base_fit(at, 0.0):
            return "the base meets a solid"
        return ", ".join(f"nearer than {1000 * OWN_CLEARANCE:g} mm: {self.get_collisions(CLEARANCE).describe(pair)}"
                         for pair, away in near.items() if away < OWN_CLEARANCE)


def _find_clearance(points: NDArray[np.float64], test: MotionTest, margins: Mapping[frozenset[Key], float],
                    least: float) -> float:
    """Return the first of `_CORNER_CLEARANCES` and `least` that all pairs keep half of along a path, m; 0 for none.

    A motion that keeps half of a clearance keeps half of a smaller one, so it is not certified again.
    """
    tests, segment = CheckerBudget(10 * test.budget.most + 10_000, test.budget.clock), 0
    for clearance in (*(each for each in _CORNER_CLEARANCES if least < each <= test.margin), least):
        wider = test.collisions.with_margins(CLEARANCE, {pair: max(kept, clearance) for pair, kept in margins.items()})
        wide = dataclasses.replace(test, collisions=wider, budget=tests)
        try:
            while segment + 1 < len(points) and wide.keeps_half(points[segment], points[segment + 1]):
                segment += 1
        except Spent:
            break
        if segment + 1 == len(points):
            return clearance
    return 0.0
