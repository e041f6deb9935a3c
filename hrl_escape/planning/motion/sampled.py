"""Trajectories by sampling, without a plan of primitives.

OMPL plans the path of a disc in the plane and of a rectangle in SE(2) or, if it cannot strafe, by `drives.py`, around
every other target. For a hand, inverse kinematics finds postures from places of the base, and the motion of the arm is
planned in joint space. A grip begins like a press, or on a map at a place before the object. So does a push, which ends
in a straight line. The room's kinematics replay the result, which is accepted if it presses the target alone.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import NO_LIMIT
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.geometry import compute_distance
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Glide, RoomState
from hrl_escape.env.puzzles.mixins import Mapped
from hrl_escape.errors import PlanningFailed, PlanningReason
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.planning.areas import Area, compute_goal_area, sample_places
from hrl_escape.planning.arm.joint_lattice import NEVER
from hrl_escape.planning.arm.reacher import Reacher
from hrl_escape.planning.goals import Goal, GripGoal, PressGoal, is_reached, name_goal, parse_goal
from hrl_escape.planning.motion.drives import Floor, find_drive, list_docks
from hrl_escape.planning.motion.legs import (
    MISSED_BY,
    ROUNDINGS,
    Mover,
    Press,
    act_at,
    differ_in_boxes,
    list_bodies,
    list_shut_doors,
    rest,
)
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.timing import time_path
from hrl_escape.planning.motion.trajectory import TimedTrajectory, join_presses
from hrl_escape.planning.paths.problem import DEFAULT_PLANNER, MotionPath
from hrl_escape.planning.routes import COMPASS, list_places

WAY_PLANNER = "InformedRRTstar"
"""Planner of the path of the base: asymptotically optimal."""
WAY_CHECKS = 40_000
"""Places tested for one path. The shortest path found by then is taken. Without one, RRT-Connect tests as many
again."""
ARM_CHECKS = 20_000
"""Configurations tested for one motion of the arm."""
STANDS = 12
"""Places of the base where inverse kinematics searches for postures."""
IK_SEEDS = 8
RETREATS, RETREAT = 64, 0.3
"""Postures drawn to leave a target that the hand touches, and the distance of the hand from its middle there, m."""
INSIDE = 0.2
"""Distance from the edge of a region where a path into it ends, m."""
BACK = (0.005, 0.01, 0.02, 0.05)
"""Lengths of the line that leaves a solid against which physics pressed the base, m."""
AROUND = tuple(k * math.tau / 16 for k in range(16))
"""Directions of that line relative to the heading, rad."""
SQUARE = 0.15
"""Length of the straight line that ends at a target, m."""


class _Place(NamedTuple):
    """A place of the base, m, its heading there, rad, and joint angles that press a target, (postures, joints), rad."""

    at: tuple[float, float]
    heading: float
    postures: NDArray[np.float64]


_NO_POSTURES = np.zeros((0, 0))


class MotionSampler(Mover):
    """Plans trajectories to the goals of one room. It is not thread-safe.

    Args:
        instance: the room.
        limits: limits of the trajectories.
        way_planner: OMPL's planner for the path of the base, one of `OMPL_PLANNERS`.
        seed: equal seeds give equal trajectories.
    """

    def __init__(self, instance: RoomInstance, limits: MotionLimits, way_planner: str = WAY_PLANNER, seed: int = 0
                 ) -> None:
        super().__init__(instance, limits, way_planner)
        self._limits, self._seed, self._floors = limits, seed, dict[bool, CollisionMap]()
        self._is_physical = self._room.dynamics.kind == "physics"
        self._strafes = self._room.robot.drive == "strafing"
        self._needs_room = not (self._strafes or self._room.robot.base.turns_anywhere)
        self._by_hand = self._room.dynamics.press_with == "hand"
        self._is_mapped = isinstance(self._room.puzzle, Mapped)  # its targets are floor

    def plan(self, state: RoomState, goal: Goal | str) -> TimedTrajectory:
        """Plan a trajectory that reaches a goal and presses no other target, except on a map.

        Args:
            state: first state.
            goal: a goal, or its text as in `RoomPlanner.plan`.

        Returns:
            The trajectory, checked by the room's continuous kinematics.

        Raises:
            PlanningFailed: none was found, which does not prove that there is none.
            GoalError, UnknownNameError: the room has no such goal.
        """
        if isinstance(goal, str):
            goal = parse_goal(goal, self._room)
        name = name_goal(goal, self._room)
        for way in self._list_plans(state, goal):
            presses = self._time(way, state, goal)
            if presses is not None:
                return join_presses(self._names, presses, self._limits, self._rules.robot)
        raise PlanningFailed(PlanningReason.UNREACHABLE_AT_RESOLUTION, name,
                             (state.x, state.y, self._rules.get_heading(state)), 0.0, (self._planner,))

    def _list_plans(self, state: RoomState, goal: Goal) -> Iterator[list[MotionPath]]:
        """Yield paths of base and arm, one after another, to a goal, or to where a grip or push begins."""
        if isinstance(goal, GripGoal) and self._is_mapped:
            yield from self._list_approaches(state, goal)
        elif isinstance(goal, GripGoal) and state.touching >> goal.target & 1:
            yield []
        elif isinstance(goal, (PressGoal, GripGoal)) and self._by_hand:
            yield from self._list_presses(state, PressGoal(goal.target), isinstance(goal, GripGoal))
        else:
            touch = PressGoal(goal.target) if isinstance(goal, GripGoal) else goal
            yield from ([way] for way in self._list_ways(state, touch))

    def _time(self, paths: Sequence[MotionPath], state: RoomState, goal: Goal) -> list[Press] | None:
        """Time paths one after another. Return None unless they reach the goal and press and push nothing else."""
        wanted, pressed, presses, before = getattr(goal, "target", None), [], [], state
        for path in paths:
            motion = time_path(path, self._rates)
            played = self._play(motion, state)
            if played is None or differ_in_boxes(self._room, state, played[1]):
                return None
            contacts, state = played
            pressed += [contact.target for contact in contacts]
            presses.append(Press(rest(motion) if contacts else motion, contacts))
        if isinstance(goal, GripGoal):
            last = self._act(state, goal) if self._is_mapped or {*pressed} <= {wanted} else None
            return None if last is None else [*presses, last]
        if wanted is not None:
            return presses if pressed == [wanted] else None
        is_alone = self._is_mapped or not pressed
        return presses if is_alone and is_reached(goal, before, state, self._rules) else None

    # --- grips and pushes ----------------------------------------------------------------

    def _list_approaches(self, state: RoomState, goal: GripGoal) -> Iterator[list[MotionPath]]:
        """Yield paths of the base to a place on the map where the hand reaches a goal, or the base pushes it."""
        x, y, heading, *angles = self._get_pose(state)
        for places in list_places(goal, state, self._rules):
            for place in places:
                if math.hypot(place.x - x, place.y - y) <= place.tolerance:
                    turn = 0.0 if place.heading is None else math.remainder(place.heading - heading, math.tau)
                    yield [self._make_path(np.array([(x, y, heading, *angles), (x, y, heading + turn, *angles)]))]
            ends = [_Place((place.x, place.y), heading if place.heading is None else place.heading, _NO_POSTURES)
                    for place in places]
            yield from ([way] for way in self._list_ways(state, ends))

    def _act(self, state: RoomState, goal: GripGoal) -> Press | None:
        """Reach a goal from its place by an act of the hand at rest, or a straight push. Return None if it fails."""
        pose, actions, side = self._get_pose(state), self._rules.actions, goal.action.partition("push-")[2]
        if not side:
            hold = Glide(0.0, 0.0, 0.0, (0.0,) * self._room.robot.joints, 0.0,
                         actions.primitives[actions.find(goal.action)].grip)
            done, press = self._rules.glide(state, hold).state, act_at(pose, goal.action)
            return press if is_reached(goal, state, done, self._rules) else None
        line = np.stack([pose, pose])
        line[1, :2] += actions.stride * np.array(COMPASS[side][:2])
        motion = time_path(self._make_path(line), self._rates)
        played = self._play(motion, state)
        if played is None or not is_reached(goal, state, played[1], self._rules):
            return None
        return Press(motion, played[0])

    # --- the base ------------------------------------------------------------------------

    def _list_ways(self, state: RoomState, goal: Goal | Sequence[_Place]) -> Iterator[MotionPath]:
        """Yield paths of the base to a goal or to any of some places, with corners rounded less and less."""
        points = self._find_way(state, goal)
        if points is not None:
            for margin in ROUNDINGS if self._strafes and len(points) > 2 else (0.0,):
                yield self._make_path(points, margin)

    def _find_way(self, state: RoomState, goal: Goal | Sequence[_Place]) -> NDArray[np.float64] | None:
        """Return the poses (n, coordinates) that OMPL finds for the base with the arm at rest, or None."""
        find = self._find_drive if self._needs_room else self._find_path
        shut = self._room.door is not None and not self._room.puzzle.is_solved(state.puzzle)
        poses = find(state, goal, shut)
        return None if poses is None else np.column_stack([poses, np.tile(self._rules.get_angles(state),
                                                                          (len(poses), 1))])

    def _find_path(self, state: RoomState, goal: Goal | Sequence[_Place], shut: bool) -> NDArray[np.float64] | None:
        """Return the poses (n, 3) of a base that strafes or turns anywhere."""
        from hrl_escape.planning.paths.navigator import Navigator  # loads OMPL

        heading, floor = self._rules.get_heading(state), self._avoid(state, getattr(goal, "target", None), shut)
        navigator, start = Navigator(self._room, lambda _: floor), (state.x, state.y)
        begin = self._back_off(start, heading, floor)
        aim = np.array([place.at for place in goal]) if isinstance(goal, Sequence) else self._aim(goal, floor)
        tries = (navigator.plan(begin, aim, planner, seed=self._seed, optimise=True, budget=WAY_CHECKS,
                                clock=NO_LIMIT, door_shut=shut, heading=heading)
                 for planner in dict.fromkeys((self._planner, DEFAULT_PLANNER)))
        found = next((way for way in tries if way.status == "exact" and len(way.path) > 1), None)
        if found is None:
            return None
        last = _find_place(goal, found.path[-1]).heading if isinstance(goal, Sequence) else None
        path, headings = found.path, found.headings
        if begin != start:
            path = np.concatenate([[start], path])
            headings = np.concatenate([headings[:1], headings])
        if len(headings):
            return np.column_stack([path, headings])
        if isinstance(goal, PressGoal):
            path = self._press_head_on(path, goal.target, state, floor)
            if np.ptp(path, axis=0).max() < 1e-9:
                return None  # it stands at the target already
        return (_strafe if self._strafes else _drive)(path, heading, last)

    def _find_drive(self, state: RoomState, goal: Goal | Sequence[_Place], shut: bool) -> NDArray[np.float64] | None:
        """Return the poses (n, 3) of a base that drives, and turns where there is room."""
        untouched, start = state._replace(touching=0), [state.x, state.y, self._rules.get_heading(state)]
        between = self._avoid(untouched, None, shut)
        floor = Floor(self._avoid(state, None, shut) if state.touching else between, between,
                      self._avoid(untouched, getattr(goal, "target", None), shut))
        ends = self._list_ends(goal, floor.entering)
        planners = tuple(dict.fromkeys((self._planner, DEFAULT_PLANNER)))
        begin = np.array([*self._back_off((state.x, state.y), start[2], floor.leaving), start[2]])
        found = find_drive(floor, begin, ends, self._rates[:3], planners, seed=self._seed, budget=WAY_CHECKS)
        return found if found is None or begin.tolist() == start else np.concatenate([[start], found])

    def _back_off(self, start: tuple[float, float], heading: float, floor: CollisionMap) -> tuple[float, float]:
        """Return the nearest place with the clearance of plans.

        It lies straight from a place that physics left too near to a solid. If that place has the clearance, or none
        was found, it is returned.
        """
        (x, y), rotation = start, (math.cos(heading), math.sin(heading))
        if not self._is_physical or floor.does_fit(x, y, rotation):
            return start
        for length, turn in itertools.product(BACK, (0.0, math.pi) if self._needs_room else AROUND):
            dx, dy = length * math.cos(heading + turn), length * math.sin(heading + turn)
            if (floor.does_fit(x + dx, y + dy, rotation)
                    and floor.base.find_free_fraction(x, y, rotation, dx, dy, floor.footprints) == 1.0):
                return x + dx, y + dy
        return start

    def _list_ends(self, goal: Goal | Sequence[_Place], floor: CollisionMap) -> NDArray[np.float64]:
        """Poses (n, 3) of such a base at a goal, or at any of some places; a heading that is nan is left open."""
        if isinstance(goal, Sequence):
            return np.array([(*place.at, place.heading) for place in goal])
        if isinstance(goal, PressGoal) and self._room.targets[goal.target].kind == "panel":
            target = self._room.targets[goal.target]
            return list_docks(floor, target.footprint, self._room.compute_press_margin(target), INSIDE)
        aim = self._aim(goal, floor)
        places = aim if isinstance(aim, np.ndarray) else sample_places(compute_goal_area(goal, self._room), floor)
        heading = getattr(goal, "heading", None)
        return np.column_stack([places, np.full(len(places), math.nan if heading is None else heading)])

    def _aim(self, goal: Goal, floor: CollisionMap) -> Goal | NDArray[np.float64]:
        """Places well inside a region, where a small error does no harm; the goal itself where there are none."""
        shape, reach = compute_goal_area(goal, self._room)
        is_rectangle = self._strafes and not self._room.robot.base.turns_anywhere
        if isinstance(goal, PressGoal) or is_rectangle and not self._is_physical:
            return goal
        half_x, half_y = (half - min(INSIDE, half / 2.0) for half in (shape.half_x, shape.half_y))
        places = sample_places(Area(shape._replace(half_x=half_x, half_y=half_y), reach / 2.0), floor)
        return places if len(places) else goal

    def _press_head_on(self, path: NDArray[np.float64], target: int, state: RoomState, floor: CollisionMap
                       ) -> NDArray[np.float64]:
        """A path (n, 2) whose last line goes for the target by the shortest way, `INSIDE` beyond the first touch.

        That line begins at the last corner if nothing is in its way, else `SQUARE` before the path's end.
        """
        shape, reach = self._room.targets[target].footprint, self._room.compute_press_reach(self._room.targets[target])
        turn = np.array([[shape.cos, shape.sin], [-shape.sin, shape.cos]])

        def go_on(place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            """Return the direction of the shortest way to the target, and the place where the base meets it."""
            local, half = turn @ (place - (shape.x, shape.y)), np.array([shape.half_x, shape.half_y])
            ahead = turn.T @ (np.clip(local, -half, half) - local)
            (x, y), (dx, dy), gap = place.tolist(), ahead.tolist(), max(math.hypot(*ahead), 1e-9)
            share = min(self._rules.compute_free_fraction(x, y, dx, dy, state.puzzle),
                        max(0.0, 1.0 - max(0.0, reach - INSIDE) / gap))
            return ahead, place + share * ahead

        ahead, end = go_on(path[-1])
        if shape.is_disc or (gap := math.hypot(*ahead)) < 1e-9:
            return path
        (x, y), (to_x, to_y) = path[-2].tolist(), go_on(path[-2])[1].tolist()
        if compute_distance(to_x, to_y, shape) <= reach and floor.is_move_free(x, y, to_x, to_y):
            return np.concatenate([path[:-1], [(to_x, to_y)]])
        back = path[-1] - SQUARE / gap * ahead
        (to_x, to_y), (last_x, last_y) = back.tolist(), path[-1].tolist()
        has_room = floor.is_move_free(x, y, to_x, to_y) and floor.is_move_free(to_x, to_y, last_x, last_y)
        return np.concatenate([path[:-1], [back, end]] if has_room else [path, [end]])

    def _avoid(self, state: RoomState, wanted: int | None, door_shut: bool) -> CollisionMap:
        """Clearances, with what must not be touched on the way as solids: other targets of the body, shut doors.

        Under physics also all panels but the wanted one, and the end of an open doorway at the door's hinge.
        """
        room, grown = self._room, list_shut_doors(self._room, state)
        grown += list_bodies(room, 0 if wanted is None or self._by_hand else 1 << wanted, door_shut)
        for number, target in enumerate(() if self._by_hand or self._is_mapped else room.targets):
            if number != wanted and not state.touching >> number & 1:
                more = max(0.0, room.compute_press_reach(target) - room.robot.outer_radius - CONTACT_SKIN) + MISSED_BY
                shape = target.footprint
                grown.append(shape._replace(half_x=shape.half_x + more, half_y=shape.half_y + more))
        if door_shut not in self._floors:
            self._floors[door_shut] = CollisionMap(room, door_shut=door_shut)
        return self._floors[door_shut].keep_out(grown) if grown else self._floors[door_shut]

    # --- the arm -------------------------------------------------------------------------

    @cached_property
    def _reacher(self) -> Reacher:
        return Reacher(self._room)

    def _list_presses(self, state: RoomState, goal: PressGoal, grips: bool) -> Iterator[list[MotionPath]]:
        """Yield the arm's motion from the place of the base, then ways to places where the hand reaches a target.

        A hand that touches the target already also leaves it and comes back.
        """
        target = self._room.targets[goal.target]

        def find_postures(at: RoomState) -> NDArray[np.float64]:
            return self._find_postures(at, (target.x, target.y, target.z))

        for path in self._move_arm(state, find_postures(state)):
            yield [path]
        places = self._list_places(state, goal, find_postures)
        for way in self._list_ways(state, places) if places else ():
            played = self._play(time_path(way, self._rates), state)
            if played is None or {contact.target for contact in played[0]} - {goal.target}:
                continue
            if played[0]:
                yield [way]  # the hand, carried along, presses the target; to grip, it may have to come back to it
            if not played[0] or grips:
                for path in self._move_arm(played[1], _find_place(places, way.points[-1, :2]).postures):
                    yield [way, path]
        if state.touching >> goal.target & 1:  # the hand has to leave the target before it can press it again
            for leave in self._move_arm(state, self._list_retreats(state, (target.x, target.y, target.z))):
                played = self._play(time_path(leave, self._rates), state)
                if played is not None and not played[0] and not played[1].touching >> goal.target & 1:
                    yield from ([leave, *rest] for rest in self._list_presses(played[1], goal, grips))

    def _list_places(self, state: RoomState, goal: PressGoal,
                     find_postures: Callable[[RoomState], NDArray[np.float64]]) -> list[_Place]:
        """Places of the base, and the heading there with the fewest joint steps, that have postures for a press."""
        rules = self._rules
        table = self._reacher.make_table(goal.target, state.joint_steps, joint_offsets=state.joint_offsets,
                                   heading_offset=state.heading_offset)
        floor = self._avoid(state, goal.target, True)
        costs = np.where(table.costs >= 0, table.costs, NEVER)
        within = costs.min(axis=2) < NEVER
        within[within] = floor.are_free(table.get_centres()[within])
        cells = np.argwhere(within)
        away = np.hypot(*(table.get_centres()[within] - (state.x, state.y)).T)
        cells = cells[np.argsort(away, kind="stable")]
        found = []
        for i, j in cells[np.linspace(0, len(cells) - 1, min(STANDS, len(cells))).astype(int)].tolist():
            x, y = table.get_centres()[i, j].tolist()
            at = state._replace(x=x, y=y, heading_steps=int(costs[i, j].argmin()))
            if len(postures := find_postures(at)):
                found.append(_Place((x, y), rules.get_heading(at), postures))
        return found

    def _find_postures(self, state: RoomState, point: tuple[float, float, float]) -> NDArray[np.float64]:
        """Joint angles (postures, joints) that bring the hand to a target's middle, the nearest first."""
        tolerance = 0.9 * self._reacher.limit
        found = self._reacher.planner.solve_ik(point, state, seeds=IK_SEEDS, tolerance=tolerance,
                                   only_free=self._is_physical)
        here = np.array(self._rules.get_angles(state))
        angles = np.array([posture.angles for posture in found]).reshape(-1, len(here))
        return angles[np.argsort(np.abs(angles - here).max(axis=1, initial=0.0), kind="stable")]

    def _list_retreats(self, state: RoomState, point: tuple[float, float, float]) -> NDArray[np.float64]:
        """Joint angles (postures, joints), rad, with the hand well away from a target's middle, the nearest first."""
        robot, heading = self._rules.robot, self._rules.get_heading(state)
        low, high = np.array(robot.limits).T
        angles = np.random.default_rng(self._seed).uniform(low, high, (RETREATS, len(low)))
        cos, sin = math.cos(heading), math.sin(heading)
        hands = robot.compute_hand(angles) @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        away = np.linalg.norm(hands + (state.x, state.y, state.z) - point, axis=1) > RETREAT
        angles = angles[away]
        return angles[np.argsort(np.abs(angles - self._rules.get_angles(state)).max(axis=1), kind="stable")][:IK_SEEDS]

    def _move_arm(self, state: RoomState, postures: NDArray[np.float64]) -> Iterator[MotionPath]:
        """Motions of the arm alone: OMPL's, then straight ones, as kinematic arms pass through solids."""
        base, here = [state.x, state.y, self._rules.get_heading(state)], np.array(self._rules.get_angles(state))
        found: list[NDArray[np.float64]] = []
        try:
            if len(postures):
                found.append(self._reacher.planner.plan(state, postures, planner=DEFAULT_PLANNER, seed=self._seed,
                                            budget=ARM_CHECKS).points)
        except PlanningFailed:
            pass
        if self._room.dynamics.kind == "kinematic":
            found += [np.stack([here, posture]) for posture in postures]
        for points in found:
            yield self._make_path(np.column_stack([np.tile(base, (len(points), 1)), points]))


def _find_place(places: Sequence[_Place], at: NDArray[np.float64]) -> _Place:
    return min(places, key=lambda place: math.dist(place.at, at))


def _strafe(path: NDArray[np.float64], heading: float, last: float | None) -> NDArray[np.float64]:
    """Poses (n, 3) along a path (n, 2) of a base that turns evenly to its last heading."""
    gone = np.append(0.0, np.cumsum(np.hypot(*np.diff(path, axis=0).T)))
    turn = 0.0 if last is None else math.remainder(last - heading, math.tau)
    return np.column_stack([path, heading + turn * gone / gone[-1]])


def _drive(path: NDArray[np.float64], heading: float, last: float | None) -> NDArray[np.float64]:
    """Poses (n, 3) along a path (n, 2) of a base that turns on the spot and drives ahead."""
    poses = [(*path[0], heading)]
    for (x, y), (to_x, to_y) in zip(path[:-1].tolist(), path[1:].tolist(), strict=True):
        heading += math.remainder(math.atan2(to_y - y, to_x - x) - heading, math.tau)
        poses += [(x, y, heading), (to_x, to_y, heading)]
    if last is not None:
        poses.append((*path[-1], heading + math.remainder(last - heading, math.tau)))
    return np.array(poses)
