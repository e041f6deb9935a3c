"""A plan's legs as motions in time that press, grip and push what the plan does.

A plan is cut wherever a touch begins, and once more before a target that is left and touched again; before and after
every grip and push. Each piece is the first of several ways that does the same in the room's own continuous kinematics:
the fewest straight lines, a way round found by OMPL, the plan's own moves.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import NO_LIMIT
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.geometry import Footprint, NearCells, compute_distance, compute_first_contact
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Glide, Kinematics, RoomState, Rules
from hrl_escape.env.poses import list_touched
from hrl_escape.env.puzzles.mixins import Barring, Pushing, get_mixin
from hrl_escape.errors import UnsupportedError
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.timing import TimedPath, evaluate_motion, time_path
from hrl_escape.planning.paths.problem import DEFAULT_PLANNER, CheckerBudget, MotionPath, step_aside
from hrl_escape.planning.plan import Plan, make_planned_room

ROUNDINGS = (0.3, 0.1, 0.03, 0.0)
"""Largest cuts of a corner, m, tried in order."""
LOOK = 0.01
"""Distance, m, and angle, rad, between two tested places of a motion."""
PRESS_SECONDS = 0.1
"""Rest after each press, s, long enough to be seen in samples of 10 Hz."""
ASIDE = (1.0, 1.5, 2.0, 3.0)
"""Lengths of the line that leaves a place near a solid, as shares of the clearance."""
MISSED_BY = 1e-3
"""Distance between a way and the targets that it must not press, m."""
DETOUR_CHECKS = 20_000
"""Places that are tested at most for one way round."""
HINGE_ROOM = 0.1
"""Distance that the base keeps from a door that swings open, beyond its thickness, along the doorway, m."""
_LOST = 1e-6  # largest obstruction of a motion, m and rad


class Contact(NamedTuple):
    """The beginning of a touch."""

    time: float  # s
    target: int  # index of the target


class Grip(NamedTuple):
    """An act of the hand, while base and arm rest."""

    time: float  # s
    action: str  # name of the primitive: grip, release or use


class Press(NamedTuple):
    """A piece of a plan in time, with what it presses, and what the hand does."""

    motion: TimedPath
    contacts: tuple[Contact, ...]
    grips: tuple[Grip, ...] = ()


def time_legs(plan: Plan, limits: MotionLimits, clearance: float) -> Iterator[Press]:
    """Time a plan, piece after piece.

    Raises:
        UnsupportedError: nowhere was a way that presses and pushes the same.
    """
    legs = _Legs(plan, limits, clearance)
    for part in plan.parts:
        for begin, end in itertools.pairwise([part.start, *_list_stops(plan, part.start, part.stop)]):
            yield legs.time_piece(begin, end, part.name)


def _list_stops(plan: Plan, start: int, stop: int) -> list[int]:
    """Indices of the states of a leg where the motion rests."""
    touched, stops, last = [state.touching for state in plan.states], [], start
    for k in range(start + 1, stop + 1):
        begun = touched[k] & ~touched[k - 1]
        acts = bool(find_act(plan, k - 1)) or differ_in_boxes(plan.instance, plan.states[k - 1], plan.states[k])
        if (acts or begun & touched[last]) and k - 1 > last:
            stops.append(k - 1)
        if acts or begun or k == stop:
            stops.append(k)
            last = k
    return stops


def find_act(plan: Plan, index: int) -> str:
    """Name of a plan's primitive by its index if the hand acts, as in grip, release and use; else empty."""
    primitive = plan.instance.robot.actions.primitives[plan.primitives[index]]
    return primitive.name if primitive.grip else ""


def differ_in_boxes(room: RoomInstance, one: RoomState, other: RoomState) -> bool:
    """Return whether something that can be pushed is in other cells in two states."""
    return isinstance(room.puzzle, Pushing) and one.puzzle != other.puzzle


class Mover:
    """A room's robot in motion: its coordinates, their limits, and its paths played by kinematics with nothing random.

    These are the limits of the room that plans are made in. A touch lasts until the robot leaves the room's own margin
    of presses, which under physics is larger than the margin that begins a touch.
    """

    def __init__(self, instance: RoomInstance, limits: MotionLimits, planner: str) -> None:
        self._room, self._near, self._planner = make_planned_room(instance), Rules(instance), planner
        self._rules = Kinematics(self._room, is_still=True)
        self._names = ("x", "y", "heading", *self._rules.robot.joint_names)
        self._rates = limits.stack(self._names, self._rules.robot)

    def _get_pose(self, state: RoomState) -> NDArray[np.float64]:
        return np.array([state.x, state.y, self._rules.get_heading(state), *self._rules.get_angles(state)])

    def _make_path(self, points: NDArray[np.float64], margin: float = 0.0) -> MotionPath:
        return MotionPath(self._names, points, np.ones(len(self._names)), margin, self._planner)

    def _play(self, motion: TimedPath, state: RoomState) -> tuple[tuple[Contact, ...], RoomState] | None:
        """Return the touches that begin in a motion of base and arm, and the last state, or None at a solid."""
        rules, contacts = self._rules, []
        for time, at in zip(*_list_looks(motion), strict=True):
            x, y, heading, *angles = at
            turn = math.remainder(heading - rules.get_heading(state), math.tau)
            joints = tuple(a - b for a, b in zip(angles, rules.get_angles(state), strict=True))
            before = state.touching
            done = rules.glide(state, Glide(x - state.x, y - state.y, turn, joints, 0.0))
            state = done.state
            if before & ~state.touching:
                touching = state.touching | before & self._near.compute_touching(*state.pose)
                state = state._replace(touching=touching)
            if (math.hypot(x - state.x, y - state.y) > _LOST
                    or abs(math.remainder(heading - rules.get_heading(state), math.tau)) > _LOST):
                return None
            contacts += [Contact(time, target) for target in done.pressed]
        return tuple(contacts), state


class _Legs(Mover):
    """One plan's pieces."""

    def __init__(self, plan: Plan, limits: MotionLimits, clearance: float) -> None:
        super().__init__(plan.instance, limits, plan.planner)
        self._plan, self._clearance = plan, clearance
        self._radius = plan.instance.robot.outer_radius + CONTACT_SKIN
        self._strafes = plan.instance.robot.drive == "strafing" and plan.instance.robot.base.turns_anywhere
        self._by_body = plan.instance.dynamics.press_with == "body"

    def time_piece(self, begin: int, end: int, name: str) -> Press:
        """Time the first way from one state of the plan to another that does what the plan does."""
        states = self._plan.states
        if act := find_act(self._plan, begin):
            return act_at(self._get_pose(states[begin]), act)
        wanted = states[end].touching & ~states[end - 1].touching
        for path in self._list_ways(begin, end, wanted):
            margins = ROUNDINGS if self._strafes and len(path.points) > 2 else (0.0,)
            for margin in margins:
                motion = time_path(dataclasses.replace(path, margin=margin), self._rates)
                played = self._play(motion, states[begin])
                if played is None or sorted(c.target for c in played[0]) != list(list_touched(wanted)):
                    continue
                if wanted & (wanted - 1) and played[1].puzzle != states[end].puzzle:
                    continue  # a plan's primitive touches several targets at once, in the order of their numbers
                if not differ_in_boxes(self._room, states[end], played[1]):
                    return Press(rest(motion) if wanted else motion, played[0])
        targets = ", ".join(self._room.targets[t].name for t in list_touched(wanted)) or "nothing"
        raise UnsupportedError(f"no trajectory was found for the leg {name!r} of {self._plan.name!r} that presses "
                               f"{targets} and nothing else on its way, with the same effect, and pushes the same: "
                               "follow its primitives instead")

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
        solids = [(solid, self._radius) for solid in self._list_solids(start, wanted)]
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
        """Yield ways with the requested clearance, half and a quarter of it.

        Straight lines out of the first place and into the last are exempt. If none leads away from a solid, a way can
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
        """Return a shortened way by OMPL round everything, or None if it finds none."""
        from hrl_escape.planning.paths.planners import find_joint_path  # loads OMPL

        if not all(_is_free(x, y, discs) for x, y in places[[0, -1]].tolist()):
            return None
        floor, budget = np.array([self._room.reach_x, self._room.reach_y]), CheckerBudget(DETOUR_CHECKS, NO_LIMIT)
        near = NearCells(discs, discs)

        def is_free(at: NDArray[np.float64]) -> bool:
            x, y = at.tolist()
            return _is_free(x, y, near[math.floor(x), math.floor(y)])

        found = find_joint_path(-floor, floor, places[0], places[-1:], is_free, LOOK, budget, planner=DEFAULT_PLANNER,
                                seed=0)
        return None if found is None else _shorten(found, discs)

    def _list_solids(self, state: RoomState, wanted: int) -> list[Footprint]:
        """Solids and shut doors, and what else is in the way of a base that presses the targets of some bits."""
        room, doors = self._room, list_shut_doors(self._room, state)
        is_shut = not room.puzzle.is_solved(state.puzzle)
        if room.door is not None and is_shut:
            doors.append(room.door.footprint)
        return [*self._rules.footprints, *doors, *list_bodies(room, wanted if self._by_body else 0, is_shut)]

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
            for k in run if primitive.turn else (list(run)[-1],):  # a turn can pass half a circle
                pose = self._get_pose(self._plan.states[k + 1])
                pose[2] = poses[-1][2] + math.remainder(pose[2] - poses[-1][2], math.tau)
                poses.append(pose)
        return self._make_path(np.array(poses))


def list_shut_doors(room: RoomInstance, state: RoomState) -> list[Footprint]:
    """Footprints of the inner doors that are shut."""
    shut = get_mixin(room.puzzle, Barring).get_shut(state.puzzle) if room.inner_doors else 0
    return [door.footprint for number, door in enumerate(room.inner_doors) if shut >> number & 1]


def list_bodies(room: RoomInstance, pushed: int, door_shut: bool) -> list[Footprint]:
    """List what else is in the base's way under physics: panels, and the hinge's end of an open doorway.

    Nothing is in the way of a room without physics. `pushed` are bits of the targets that the base may push against.
    """
    if room.dynamics.kind != "physics":
        return []
    bodies = [target.footprint for number, target in enumerate(room.targets) if target.kind == "panel"
              and not pushed >> number & 1 and target.z - target.half_z < room.robot.body_height]
    if room.door is not None and not door_shut:
        door, post = room.door.footprint, room.door.half_y + HINGE_ROOM
        x, y = (at - way * (door.half_x - post) for at, way in ((door.x, door.cos), (door.y, door.sin)))
        bodies.append(door._replace(x=x, y=y, half_x=post))
    return bodies


def _list_looks(motion: TimedPath) -> tuple[list[float], list[list[float]]]:
    """Times after the start, and positions there, between which nothing moves by more than `LOOK`."""
    spans, moved = np.diff(motion.times), np.abs(np.diff(motion.positions, axis=0)).max(axis=1, initial=0.0)
    counts = 1 + np.ceil(2.0 * moved / LOOK).astype(int)  # cubics may move up to twice as fast as in the mean
    parts = [start + span * np.arange(1, count + 1) / count
             for start, span, count in zip(motion.times, spans, counts, strict=False)]
    times = np.concatenate([*parts, np.zeros(0)])
    if not len(times):
        return [], []
    places = evaluate_motion(motion, times)
    places[-1] = motion.positions[-1]
    return times.tolist(), places.tolist()


def rest(motion: TimedPath) -> TimedPath:
    """A motion that waits at its end."""
    times, positions, velocities = motion
    return TimedPath(np.append(times, times[-1] + PRESS_SECONDS), np.concatenate([positions, positions[-1:]]),
                     np.concatenate([velocities, np.zeros_like(velocities[:1])]))


def act_at(pose: NDArray[np.float64], action: str) -> Press:
    """Return a rest at a pose (coordinates,) with an act of the hand at its beginning."""
    return Press(rest(TimedPath(np.zeros(1), pose[None], np.zeros_like(pose)[None])), (), (Grip(0.0, action),))


_Discs = list[tuple[Footprint, float]]
"""Footprints, and the least distance of the axis from each."""


def _grow(discs: _Discs, ends: NDArray[np.float64], clearance: float) -> _Discs:
    """Distances that the axis keeps from footprints with a clearance, or as near as an end is."""
    return [(shape, max(near, min(near + clearance, *(compute_distance(x, y, shape) for x, y in ends.tolist()))))
            for shape, near in discs]


def _is_free(x: float, y: float, discs: Iterable[tuple[Footprint, float]]) -> bool:
    return all(compute_distance(x, y, shape) >= near - 1e-9 for shape, near in discs)


def _is_clear(start: Sequence[float], end: Sequence[float], discs: _Discs) -> bool:
    (x, y), (to_x, to_y) = start, end
    return not any(compute_first_contact(x, y, to_x - x, to_y - y, near - 1e-9, shape) < 1.0 for shape, near in discs)


def _shorten(places: NDArray[np.float64], discs: _Discs) -> NDArray[np.float64] | None:
    """Select places that straight lines round everything connect, or return None if they lead nowhere."""
    kept, last, line = [0], len(places) - 1, places.tolist()
    while kept[-1] < last:
        at = kept[-1]
        following = next((k for k in range(last, at, -1) if _is_clear(line[at], line[k], discs)), None)
        if following is None:
            return None
        kept.append(following)
    return places[kept]
