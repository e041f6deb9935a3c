"""A plan's legs as motions in time that press what the plan presses.

A plan is cut wherever a touch begins, and once more before a target that is left and touched again. Each piece is the
first of several ways that does the same in the room's own continuous kinematics: the fewest straight lines, a way
round found by OMPL, the plan's own moves.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from hrl_escape.clock import NO_LIMIT
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.geometry import Footprint, compute_distance, compute_first_contact
from hrl_escape.env.kinematics import Glide, Kinematics, RoomState
from hrl_escape.env.poses import list_touched
from hrl_escape.env.puzzles.traits import Barring, Pushing, get_trait
from hrl_escape.errors import UnsupportedError
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.timing import TimedPath, time_path
from hrl_escape.planning.motion_path import MotionPath
from hrl_escape.planning.paths.problem import DEFAULT_PLANNER, CheckerBudget, step_aside
from hrl_escape.planning.plan import Plan, make_planned_room

ROUNDINGS = (0.3, 0.1, 0.03, 0.0)
"""Largest cuts of a corner, m; the first with which a piece does what it must is taken."""
LOOK = 0.01
"""Distance, m, and angle, rad, between two places at which a motion is tested."""
PRESS_SECONDS = 0.1
"""Rest after each press, s: whoever looks ten times a second sees it."""
ASIDE = (1.0, 1.5, 2.0, 3.0)
"""Lengths of the line by which a place near a solid is left, as shares of the clearance."""
MISSED_BY = 1e-3
"""Distance by which a way misses targets that it must not press, m."""
DETOUR_CHECKS = 20_000
"""Places that are tested at most for one way round."""
_LOST = 1e-6  # m and rad by which a motion may be held up


class Contact(NamedTuple):
    """The beginning of a touch.

    Attributes:
        time: s.
        target: index of the target.
    """

    time: float
    target: int


class Press(NamedTuple):
    """A piece of a plan in time, with what it presses."""

    motion: TimedPath
    contacts: tuple[Contact, ...]


def time_legs(plan: Plan, limits: MotionLimits, clearance: float) -> Iterator[Press]:
    """Time a plan, piece after piece.

    Raises:
        UnsupportedError: the plan grips or pushes, or nowhere was a way that presses the same.
    """
    grips = any(plan.instance.robot.actions.primitives[action].grip for action in plan.primitives)
    if grips or isinstance(plan.instance.puzzle, Pushing):
        raise UnsupportedError(f"plan {plan.name!r} grips, uses or pushes things, which no trajectory does: follow its "
                               "primitives")
    legs = _Legs(plan, limits, clearance)
    for part in plan.parts:
        for begin, end in itertools.pairwise([part.start, *_list_stops(plan, part.start, part.stop)]):
            yield legs.time_piece(begin, end, part.name)


def _list_stops(plan: Plan, start: int, stop: int) -> list[int]:
    """Indices of the states in a leg at which its motion rests."""
    touched, stops, last = [state.touching for state in plan.states], [], start
    for k in range(start + 1, stop + 1):
        begun = touched[k] & ~touched[k - 1]
        if begun & touched[last] and k - 1 > last:
            stops.append(k - 1)
        if begun or k == stop:
            stops.append(k)
            last = k
    return stops


class _Legs:
    """One plan's pieces."""

    def __init__(self, plan: Plan, limits: MotionLimits, clearance: float) -> None:
        self._plan, self._room, self._clearance = plan, make_planned_room(plan.instance), clearance
        self._rules = rules = Kinematics(self._room, is_still=True)
        self._names = ("x", "y", "heading", *rules.robot.joint_names)
        self._rates = limits.stack(self._names, rules.robot)
        self._radius = plan.instance.robot.outer_radius + CONTACT_SKIN
        self._strafes = plan.instance.robot.drive == "strafing" and plan.instance.robot.base.turns_anywhere
        self._by_body = plan.instance.dynamics.press_with == "body"

    def time_piece(self, begin: int, end: int, name: str) -> Press:
        """Time the first way from one state of the plan to another that does what the plan does."""
        states = self._plan.states
        wanted = states[end].touching & ~states[end - 1].touching
        for path in self._list_ways(begin, end, wanted):
            margins = ROUNDINGS if self._strafes and len(path.points) > 2 else (0.0,)
            for margin in margins:
                motion = time_path(dataclasses.replace(path, margin=margin), self._rates)
                contacts = self._play(motion, states[begin])
                if contacts is not None and sorted(c.target for c in contacts) == list(list_touched(wanted)):
                    return Press(_rest(motion) if wanted else motion, contacts)
        targets = ", ".join(self._room.targets[t].name for t in list_touched(wanted)) or "nothing"
        raise UnsupportedError(f"no trajectory was found for the leg {name!r} of {self._plan.name!r} that presses "
                               f"{targets} and nothing else on its way: follow its primitives instead")

    def _play(self, motion: TimedPath, state: RoomState) -> tuple[Contact, ...] | None:
        """Touches that begin when the room's kinematics follows a motion; None where a solid is in the way."""
        contacts = []
        for time, at in zip(*list_looks(motion), strict=True):
            x, y, heading, *angles = at
            turn = math.remainder(heading - self._rules.get_heading(state), math.tau)
            joints = tuple(a - b for a, b in zip(angles, self._rules.get_angles(state), strict=True))
            state, _, _, _, pressed = self._rules.glide(state, Glide(x - state.x, y - state.y, turn, joints, 0.0))
            if (math.hypot(x - state.x, y - state.y) > _LOST
                    or abs(math.remainder(heading - self._rules.get_heading(state), math.tau)) > _LOST):
                return None
            contacts += [Contact(time, target) for target in pressed]
        return tuple(contacts)

    # --- ways ----------------------------------------------------------------------------

    def _list_ways(self, begin: int, end: int, wanted: int) -> Iterator[MotionPath]:
        """Ways of a piece, best first: short and clear, round what is in the way, the plan's own."""
        if not self._strafes:
            yield self._follow_moves(begin, end)
            return
        places, start = self._plan.path[begin : end + 1], self._plan.states[begin]
        reaches = [(t.footprint, self._room.compute_press_reach(t)) for number, t in enumerate(self._room.targets)
                   if self._by_body and not (wanted | start.touching) >> number & 1]
        avoided = _grow(reaches, places[[0, -1]], MISSED_BY)
        solids = [(solid, self._radius) for solid in self._list_solids(start)]
        for way in self._keep_clear(places, avoided, solids):
            yield self._make_way(way, begin, end)
        exact = [*avoided, *solids]
        if (short := _shorten(places, exact)) is not None:
            yield self._make_way(short, begin, end)
        yield self._follow_moves(begin, end)
        if (short := self._go_round(places, exact)) is not None:
            yield self._make_way(short, begin, end)

    def _keep_clear(self, places: NDArray[np.float64], avoided: _Discs, solids: _Discs
                    ) -> Iterator[NDArray[np.float64]]:
        """Ways with the clearance that is asked for, half and a quarter of it.

        But for straight lines out of the first place and into the last; where none leads away from a solid, a way may
        come as near to it as that end is.
        """
        bare = [*avoided, *solids]
        for clearance in (self._clearance, self._clearance / 2.0, self._clearance / 4.0):
            away, ends = [*avoided, *((solid, near + clearance) for solid, near in solids)], []
            for place in places[[0, -1]]:
                aside = step_aside(tuple(place.tolist()), 0.0, [share * clearance for share in ASIDE],
                                   lambda x, y, away=away: _is_free(x, y, away),
                                   lambda *line: _is_clear(line[:2], line[2:], bare))
                ends.append(place if aside is None else np.array(aside))
            grown = [*avoided, *_grow(solids, np.array(ends), clearance)]
            between = np.concatenate([ends[:1], places[1:-1], ends[1:]])
            short = _shorten(between, grown)
            if short is None:
                short = self._go_round(between, grown)
            if short is not None:
                way = np.concatenate([places[:1], short, places[-1:]])
                yield way[np.append(True, np.hypot(*np.diff(way, axis=0).T) > 0.0)]

    def _go_round(self, places: NDArray[np.float64], discs: _Discs) -> NDArray[np.float64] | None:
        """A way that OMPL finds round everything, shortened; None where it finds none."""
        from hrl_escape.planning.paths.planners import find_joint_path  # loads OMPL

        if not all(_is_free(x, y, discs) for x, y in places[[0, -1]].tolist()):
            return None
        floor, budget = np.array([self._room.reach_x, self._room.reach_y]), CheckerBudget(DETOUR_CHECKS, NO_LIMIT)
        found = find_joint_path(-floor, floor, places[0], places[-1:], lambda at: _is_free(at[0], at[1], discs), LOOK,
                                budget, planner=DEFAULT_PLANNER, seed=0)
        return None if found is None else _shorten(found, discs)

    def _list_solids(self, state: RoomState) -> list[Footprint]:
        """Solids and shut doors."""
        room = self._room
        shut = get_trait(room.puzzle, Barring).get_shut(state.puzzle) if room.inner_doors else 0
        doors = [door.footprint for number, door in enumerate(room.inner_doors) if shut >> number & 1]
        if room.door is not None and not room.puzzle.is_solved(state.puzzle):
            doors.append(room.door.footprint)
        return [*self._rules.footprints, *doors]

    def _make_way(self, places: NDArray[np.float64], begin: int, end: int) -> MotionPath:
        """A way through places along which heading and joints turn evenly."""
        first, last = (self._get_pose(self._plan.states[k])[2:] for k in (begin, end))
        last[0] = first[0] + math.remainder(last[0] - first[0], math.tau)
        moved = np.append(0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T)))
        share = moved / moved[-1] if moved[-1] > 0.0 else np.linspace(0.0, 1.0, len(places))
        return self._make_path(np.column_stack([places, first + share[:, None] * (last - first)]))

    def _follow_moves(self, begin: int, end: int) -> MotionPath:
        """The plan's own moves, with a rest wherever their direction changes."""
        poses = [self._get_pose(self._plan.states[begin])]
        for action, run in itertools.groupby(range(begin, end), key=lambda k: self._plan.primitives[k]):
            primitive = self._plan.instance.robot.actions.primitives[action]
            for k in run if primitive.turn else (list(run)[-1],):  # a turn may go on past half a circle
                pose = self._get_pose(self._plan.states[k + 1])
                pose[2] = poses[-1][2] + math.remainder(pose[2] - poses[-1][2], math.tau)
                poses.append(pose)
        return self._make_path(np.array(poses))

    def _get_pose(self, state: RoomState) -> NDArray[np.float64]:
        return np.array([state.x, state.y, self._rules.get_heading(state), *self._rules.get_angles(state)])

    def _make_path(self, points: NDArray[np.float64]) -> MotionPath:
        return MotionPath(self._names, points, np.ones(len(self._names)), 0.0, self._plan.planner)


def list_looks(motion: TimedPath) -> tuple[list[float], list[list[float]]]:
    """Times after the start, and positions there, between which nothing moves by more than `LOOK`."""
    spans, moved = np.diff(motion.times), np.abs(np.diff(motion.positions, axis=0)).max(axis=1, initial=0.0)
    counts = 1 + np.ceil(2.0 * moved / LOOK).astype(int)  # cubics may move up to twice as fast as in the mean
    parts = [start + span * np.arange(1, count + 1) / count
             for start, span, count in zip(motion.times, spans, counts, strict=False)]
    times = np.concatenate([*parts, np.zeros(0)])
    if not len(times):
        return [], []
    places = CubicHermiteSpline(*motion)(times)
    places[-1] = motion.positions[-1]
    return times.tolist(), places.tolist()


def _rest(motion: TimedPath) -> TimedPath:
    """A motion that waits at its end."""
    times, positions, velocities = motion
    return TimedPath(np.append(times, times[-1] + PRESS_SECONDS), np.concatenate([positions, positions[-1:]]),
                     np.concatenate([velocities, np.zeros_like(velocities[:1])]))


_Discs = list[tuple[Footprint, float]]
"""Footprints, and how near the axis may come to each."""


def _grow(discs: _Discs, ends: NDArray[np.float64], clearance: float) -> _Discs:
    """Distances that the axis keeps from footprints with a clearance, or as near as an end is."""
    return [(shape, max(near, min(near + clearance, *(compute_distance(x, y, shape) for x, y in ends.tolist()))))
            for shape, near in discs]


def _is_free(x: float, y: float, discs: _Discs) -> bool:
    return all(compute_distance(x, y, shape) >= near - 1e-9 for shape, near in discs)


def _is_clear(start: Sequence[float], end: Sequence[float], discs: _Discs) -> bool:
    (x, y), (to_x, to_y) = start, end
    return not any(compute_first_contact(x, y, to_x - x, to_y - y, near - 1e-9, shape) < 1.0 for shape, near in discs)


def _shorten(places: NDArray[np.float64], discs: _Discs) -> NDArray[np.float64] | None:
    """Some of the places, by which straight lines go round everything; None where they do not lead on."""
    kept, last, line = [0], len(places) - 1, places.tolist()
    while kept[-1] < last:
        at = kept[-1]
        following = next((k for k in range(last, at, -1) if _is_clear(line[at], line[k], discs)), None)
        if following is None:
            return None
        kept.append(following)
    return places[kept]
