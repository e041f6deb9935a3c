"""Ways of a base that drives straight, ahead or backwards, and turns on the spot where it has the room: a rectangle's.

OMPL finds lines between places with room for a whole turn; into and out of places without it, such as those at a wall,
leads one line more. What was found is cut short, in the time that it takes, by lines and turns that need no such room.
The floor that the base sweeps is tested exactly.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.geometry import Footprint
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.planning.motion.limits import compute_rest_to_rest
from hrl_escape.planning.paths.problem import PathProblem, Spent, compute_spacing

TURNS = (0.0, *(sign * math.radians(angle) for angle in range(5, 91, 5) for sign in (1.0, -1.0)))
"""Turns before the line out of a place without room for a whole turn, rad."""
FARTHEST_LINE = 4.0
"""Length of the longest such line, in radii of the base."""
SHARES = (0.0, 0.5, -0.5, 1.0, -1.0)
"""Places to press a panel along its side, as shares of half its length and half the base's width."""
_APART = 1e-6  # m between the base and a solid at the end of a line, beyond rounding

_Place = tuple[float, float]


class _Drive(NamedTuple):
    """Lines and turns, each from rest to rest."""

    seconds: float
    poses: tuple[tuple[float, float, float], ...]  # x and y, m; heading, rad, unwrapped


class Floor(NamedTuple):
    """One floor for the three parts of a way; targets that must not be touched on a part are solids of it."""

    leaving: CollisionMap  # of the first line
    between: CollisionMap
    entering: CollisionMap  # of the last line


def find_drive(floor: Floor, start: NDArray[np.float64], ends: NDArray[np.float64], rates: NDArray[np.float64],
               planners: Sequence[str], *, seed: int, budget: int) -> NDArray[np.float64] | None:
    """Find a way from a pose to any of some poses.

    Args:
        floor: what is in the way.
        start: x, y and heading, shape (3,), m and rad.
        ends: likewise, shape (n, 3); a heading that is nan is left open.
        rates: largest speed, acceleration and jerk along x, along y and of turns, shape (3, 3).
        planners: of `OMPL_PLANNERS`, tried in turn.
        seed: the same seed gives the same way.
        budget: places that each planner may test; a line counts as ten.

        Poses to pass through, (k, 3), m and rad, or None if none was found. Each is reached from the one before by a
        line along its heading or by a turn on the spot.
    """
    from hrl_escape.planning.paths.planners import find_line_path  # loads OMPL

    steering = _Steering(floor, rates)
    begin, ways_in = steering.find_room(floor.leaving, *start.tolist()), dict[_Place, list[list[float]]]()
    for end in ends.tolist():
        if (room := steering.find_room(floor.entering, *end)) is not None:
            ways_in.setdefault(room, []).append(end)
    if begin is None or not ways_in:
        return None
    rooms = np.array(list(ways_in))
    rooms = rooms[floor.between.get_parts(rooms) == floor.between.get_parts(np.array(begin))]
    if not len(rooms):
        return None
    rooms = rooms[np.argsort(np.hypot(*(rooms - begin).T), kind="stable")]
    for planner in planners:
        try:
            lines = find_line_path(planner, PathProblem(floor.between, np.array(begin), rooms, seed=seed, optimise=True,
                                                        budget=budget))
        except Spent:
            continue
        way = [] if lines is None else [(x, y) for x, y in lines.tolist()]
        drives = [drive for room, there in ways_in.items() if way for end in there
                  for places in ([*way, room], *steering.find_crossing(start.tolist(), end))
                  if (drive := steering.drive(start.tolist(), places, end))]
        best = min(drives, key=_get_seconds, default=None)
        if best is not None and len(best.poses) > 1:
            return np.array(best.poses)
    return None


def _get_seconds(drive: _Drive) -> float:
    return drive.seconds


def list_docks(collision: CollisionMap, panel: Footprint, margin: float, beyond: float) -> NDArray[np.float64]:
    """List the poses (n, 3) that drive straight at a panel, ahead or backwards, m and rad.

    The base touches the panel, a box on the floor, at a distance of `margin`. It then drives up to `beyond` further,
    or up to the first solid; m.
    """
    base, docks = collision.base, []
    front = base.front - CONTACT_SKIN + margin
    sides = [(panel.cos, panel.sin, panel.half_x, panel.half_y), (-panel.sin, panel.cos, panel.half_y, panel.half_x)]
    for (cos, sin, near, half), sign, share in itertools.product(sides, (1.0, -1.0), SHARES):
        away, aside = sign * (near + front), share * (half + base.inner_radius / 2.0)
        x, y = panel.x + away * cos - aside * sin, panel.y + away * sin + aside * cos
        rotation = -sign * cos, -sign * sin
        if collision.does_fit(x, y, rotation):
            free = base.find_free_fraction(x, y, rotation, beyond * rotation[0], beyond * rotation[1],
                                           collision.footprints)
            ahead, heading = max(0.0, free * beyond - _APART), math.atan2(*rotation[::-1])
            docks += [(x + ahead * rotation[0], y + ahead * rotation[1], heading + turn) for turn in (0.0, math.pi)]
    return np.array(docks).reshape(-1, 3)


class _Steering:
    """Lines and turns of one base on one floor."""

    def __init__(self, floor: Floor, rates: NDArray[np.float64]) -> None:
        self._floor, self._need = floor, compute_spacing(floor.between)[1]
        self._line, self._turn = rates[0].tolist(), rates[2].tolist()

    def find_room(self, collision: CollisionMap, x: float, y: float, heading: float) -> _Place | None:
        """The nearest place with room for a whole turn by one line from a pose, after as small a turn as possible.

        None where there is none.
        """
        between = self._floor.between
        if between.is_clear(x, y, self._need):
            return x, y
        if math.isnan(heading):
            headings = [k * math.pi / len(TURNS) for k in range(len(TURNS))]
        else:
            headings = [heading + turn for turn in TURNS if collision.is_turn_free(x, y, heading, turn)]
        step = between.inner / 10.0
        steps = range(1, math.ceil(FARTHEST_LINE * between.radius / step))
        for angle, k, sign in itertools.product(headings, steps, (1.0, -1.0)):
            cos, sin = math.cos(angle), math.sin(angle)
            to_x, to_y = x + sign * k * step * cos, y + sign * k * step * sin
            if between.is_clear(to_x, to_y, self._need) and collision.is_move_free(x, y, to_x, to_y, (cos, sin)):
                return to_x, to_y
        return None

    def find_crossing(self, start: Sequence[float], end: Sequence[float]) -> list[list[_Place]]:
        """The way by one turn, where the lines along the headings of two poses cross; none without room for it."""
        (x, y, heading), (to_x, to_y, to_heading) = start, end
        across = math.sin(to_heading - heading)
        if math.isnan(to_heading) or abs(across) < 1e-6:
            return []
        along = ((to_x - x) * math.sin(to_heading) - (to_y - y) * math.cos(to_heading)) / across
        x, y = x + along * math.cos(heading), y + along * math.sin(heading)
        return [[(x, y)]] if self._floor.between.is_clear(x, y, self._need) else []

    def drive(self, start: Sequence[float], way: Sequence[_Place], end: Sequence[float]) -> _Drive | None:
        """Return the shortest drive through a start, some of the places of a way and an end, or None.

        The first line of those that leave a target stays, and so does the last one of those to a heading.
        """
        first_kept, last_kept = self._floor.leaving is not self._floor.between, not math.isnan(end[2])
        places = [(start[0], start[1]), *way, (end[0], end[1])]
        best = self._follow(places, start[2], end[2])
        is_better = best is not None
        while best is not None and is_better:
            is_better = False
            for first, behind in itertools.combinations(range(first_kept, len(places) - last_kept), 2):
                shorter = [*places[: first + 1], *places[behind:]]
                drive = self._follow(shorter, start[2], end[2]) if behind > first + 1 else None
                if drive is not None and drive.seconds < best.seconds:
                    best, places, is_better = drive, shorter, True
                    break
        return best

    def _follow(self, places: Sequence[_Place], heading: float, last: float) -> _Drive | None:
        """The fastest drive through places, of all choices of driving ahead or backwards."""
        found = [_Drive(0.0, ((*places[0], heading),))]
        for number, ((x, y), (to_x, to_y)) in enumerate(itertools.pairwise(places), 2):
            collision = self._floor.entering if number == len(places) else self._floor[min(number - 2, 1)]
            if (length := math.hypot(to_x - x, to_y - y)) < 1e-9:
                continue
            ahead = math.atan2(to_y - y, to_x - x)
            if not collision.is_move_free(x, y, to_x, to_y, (math.cos(ahead), math.sin(ahead))):
                return None
            seconds = compute_rest_to_rest(length, *self._line)
            turned = [self._turn_to(collision, found, angle) for angle in (ahead, ahead + math.pi)]
            found = [_Drive(drive.seconds + seconds, (*drive.poses, (to_x, to_y, drive.poses[-1][2])))
                     for drive in turned if drive is not None]
        if math.isnan(last):
            return min(found, key=_get_seconds, default=None)
        return self._turn_to(self._floor.entering, found, last)

    def _turn_to(self, collision: CollisionMap, drives: Sequence[_Drive], heading: float) -> _Drive | None:
        """Return the fastest of some drives to one place with a turn to a heading, or None if none can turn so."""
        found = []
        for drive in drives:
            x, y, before = drive.poses[-1]
            short = math.remainder(heading - before, math.tau)
            turn = next((turn for turn in (short, short - math.copysign(math.tau, short))
                         if collision.is_turn_free(x, y, before, turn)), None)
            if abs(short) < 1e-9:
                found.append(drive)
            elif turn is not None:
                found.append(_Drive(drive.seconds + compute_rest_to_rest(abs(turn), *self._turn),
                                    (*drive.poses, (x, y, before + turn))))
        return min(found, key=_get_seconds, default=None)
