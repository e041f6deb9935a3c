"""`TimedTrajectory`: motion over time under limits of speed and acceleration, to sample, export and draw.

Two parametrisations: `trapezoid` goes each straight line of a path from rest to rest, every
coordinate in the same share of its way; `toppra` rounds the corners and is time-optimal along the curve
(Pham and Pham 2018), by the library of that name.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import math
from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline

from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.geometry import Footprint, compute_distance_many, compute_first_contact, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Rules
from hrl_escape.env.poses import list_touched
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.traits import Pushing
from hrl_escape.errors import ConfigError, MissingExtraError, UnsupportedError
from hrl_escape.files import write_json, write_text
from hrl_escape.planning.areas import grow_solids
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.path import MotionPath, round_corners
from hrl_escape.planning.plan import Plan

LIMITED_DIRECTIONS = 8
"""Directions in the plane along which the base's speed and acceleration are limited for toppra."""
GRID_DISTANCE = 0.02
"""Largest distance of toppra's grid points along a path, in metres of motion."""
LEAST_POINTS = 12
"""Fewest grid points on each line and each rounded corner."""
TAIL = 1e-4
"""Distance before the end of a line or corner, as a share of it, at which the limits are imposed once more."""


@dataclasses.dataclass(frozen=True, eq=False)
class TimedTrajectory:
    """Positions over time: cubic between knots, as ROS's joint trajectory controllers read them.

    Attributes:
        names: of the coordinates: `x`, `y`, `heading`, joints.
        times: of the knots, rising from 0, shape (n,), s.
        positions: at the knots, shape (n, coordinates), m and rad.
        velocities: at the knots, shape (n, coordinates), m/s and rad/s.
        method: `trapezoid` or `toppra`.
        limits: speeds and accelerations that it keeps.
    """

    names: tuple[str, ...]
    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    method: str
    limits: MotionLimits

    @property
    def duration(self) -> float:
        """Time of the last knot, s."""
        return float(self.times[-1])

    @cached_property
    def _spline(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.times, self.positions, self.velocities)

    def evaluate(self, times: ArrayLike, order: int = 0) -> NDArray[np.float64]:
        """Positions at times within the duration, or their first or second derivatives; shape (..., coordinates)."""
        return np.asarray(self._spline(np.clip(times, 0.0, self.duration), order))

    def sample(self, rate: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Sample at a rate in Hz; the last sample is the end.

        Returns:
            Times (n,), positions (n, coordinates), velocities (n, coordinates).
        """
        if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0.0 < rate < math.inf:
            raise ConfigError("rate", rate, "samples a second, above 0")
        times = np.minimum(np.arange(math.ceil(self.duration * rate - 1e-9) + 1) / rate, self.duration)
        return times, self.evaluate(times), self.evaluate(times, 1)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"names": list(self.names), "times": self.times.tolist(), "positions": self.positions.tolist(),
                "velocities": self.velocities.tolist(), "method": self.method,
                "limits": dataclasses.asdict(self.limits)}

    def to_ros(self, rate: float = 50.0) -> dict[str, Any]:
        """Return the fields of a ROS `trajectory_msgs/JointTrajectory`; the base's coordinates stand as joints, too."""
        times, positions, velocities = self.sample(rate)
        points = [{"positions": p, "velocities": v,
                   "time_from_start": {"sec": int(t), "nanosec": int(round((t - int(t)) * 1e9))}}
                  for t, p, v in zip(times.tolist(), positions.tolist(), velocities.tolist(), strict=True)]
        return {"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "room"}, "joint_names": list(self.names),
                "points": points}

    def save(self, path: str | Path, rate: float = 50.0) -> None:
        """Write a file: `.json` with the knots, or `.csv` with one row a sample.

        Raises:
            ConfigError: another ending.
            FileWriteError: the file could not be written.
        """
        kind = Path(path).suffix.lower()
        if kind == ".json":
            write_json(path, self.to_dict())
        elif kind == ".csv":
            times, positions, velocities = self.sample(rate)
            text = io.StringIO()
            rows = csv.writer(text, lineterminator="\n")
            rows.writerow(["time", *self.names, *(f"{name}_velocity" for name in self.names)])
            rows.writerows(np.column_stack([times, positions, velocities]).tolist())
            write_text(path, text.getvalue())
        else:
            raise ConfigError("path", str(path), "a name that ends in .json or .csv")

    def draw(self, instance: RoomInstance, path: str | Path | None = None) -> Any:
        """Draw the base's way on the room's map; PNG, SVG or PDF if a path is given. Returns the matplotlib figure."""
        from hrl_escape.env.drawing.maps import Trajectory, make_map  # loads matplotlib
        from hrl_escape.figures import save_figure

        if self.names[:2] != ("x", "y"):
            raise ConfigError("names", self.names, "a trajectory that moves the base: x, y, ...")
        points = self.sample(50.0)[1][:, :2]
        figure = make_map(instance, None, [Trajectory(points, f"{self.method}, {self.duration:.1f} s")])
        if path is not None:
            save_figure(path, figure)
        return figure


def make_trajectory(motion: Plan | MotionPath, limits: MotionLimits | None = None, *,
                    method: Literal["trapezoid", "toppra"] = "trapezoid", clearance: float = 0.2) -> TimedTrajectory:
    """Make a trajectory of a plan, or of a path of `ArmPlanner`; it rests at the end of every leg.

    Args:
        motion: the plan or the path.
        limits: of speed and acceleration; None for the defaults of `MotionLimits`.
        method: `trapezoid`, or `toppra`, which takes the extra `toppra` and rests only between legs.
        clearance: distance that the base keeps from solids where it can, m; for plans.

    Raises:
        MissingExtraError: toppra is not installed.
        ConfigError: no such method, or nothing moves.
        UnsupportedError: the trajectory of a plan would not press what the plan presses, in the plan's order.
    """
    limits = limits or MotionLimits()
    if method not in ("trapezoid", "toppra"):
        raise ConfigError("method", method, "'trapezoid' or 'toppra'")
    paths = smooth_plan(motion, clearance) if isinstance(motion, Plan) else [motion]
    paths = [path for path in paths if np.ptp(path.points, axis=0).max() > 1e-9]
    parts = [_time_by_toppra(path, limits) if method == "toppra" else _time_by_trapezoids(path, limits)
             for path in paths]
    if not parts:
        raise ConfigError("motion", getattr(motion, "name", "path"), "a motion that moves something")
    times, knots, speeds, begin = [np.zeros(1)], [parts[0][1][:1]], [np.zeros_like(parts[0][1][:1])], 0.0
    for part_times, positions, velocities in parts:
        times.append(part_times[1:] + begin)
        knots.append(positions[1:])
        speeds.append(velocities[1:])
        begin += float(part_times[-1])
    trajectory = TimedTrajectory(paths[0].names, np.concatenate(times), _unwind(paths, knots), np.concatenate(speeds),
                                 method, limits)
    if isinstance(motion, Plan):
        _check_same_presses(motion, trajectory.evaluate(_list_looks(trajectory)))
    return trajectory


def _list_looks(trajectory: TimedTrajectory) -> NDArray[np.float64]:
    """Times so close that the base moves by at most `LOOK` and turns and joints move by as many radians between two."""
    spans = np.diff(trajectory.times)
    moved = np.abs(np.diff(trajectory.positions, axis=0)).max(axis=1)
    counts = 1 + np.ceil(2.0 * moved / LOOK).astype(int)  # cubics may move up to twice as fast as in the mean
    parts = [start + span * np.arange(count) / count
             for start, span, count in zip(trajectory.times, spans, counts, strict=False)]
    return np.append(np.concatenate(parts), trajectory.duration)


def _unwind(paths: Sequence[MotionPath], knots: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Knots of all parts in one array, with headings that go on where the part before ended."""
    if "heading" in paths[0].names:
        column, last = paths[0].names.index("heading"), float(knots[0][-1, paths[0].names.index("heading")])
        for number, path in enumerate(paths, 1):
            turns = round((last - float(path.points[0, column])) / math.tau)
            knots[number] = knots[number].copy()
            knots[number][:, column] += turns * math.tau
            last = float(knots[number][-1, column])
    return np.concatenate(knots)


def _list_limits(names: Sequence[str], limits: MotionLimits) -> NDArray[np.float64]:
    """Speed and acceleration of each coordinate, shape (coordinates, 2)."""
    pairs = {"x": (limits.speed, limits.acceleration), "y": (limits.speed, limits.acceleration),
             "heading": (limits.turn_speed, limits.turn_acceleration)}
    return np.array([pairs.get(name, (limits.joint_speed, limits.joint_acceleration)) for name in names])


_Timed = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def _time_by_trapezoids(path: MotionPath, limits: MotionLimits) -> _Timed:
    """Knots of a motion that rests at every point of a path: time-optimal along each line."""
    rates = _list_limits(path.names, limits)
    times, positions, velocities, now = [0.0], [path.points[0]], [np.zeros(len(path.names))], 0.0
    for begin, end in zip(path.points, path.points[1:], strict=False):
        change = end - begin
        sizes = np.abs(change)
        if path.names[:2] == ("x", "y"):
            sizes[:2] = math.hypot(*change[:2])
        if sizes.max() < 1e-12:
            continue
        moved = sizes > 1e-12
        speed, acceleration = (float((rates[moved, k] / sizes[moved]).min()) for k in range(2))  # of the share, 1/s
        rise = min(speed / acceleration, math.sqrt(1.0 / acceleration))
        top = acceleration * rise
        cruise = max(0.0, (1.0 - acceleration * rise**2) / top)
        share = 0.5 * acceleration * rise**2
        for moment, done, rate in ((rise, share, top), (rise + cruise, 1.0 - share, top),
                                   (2 * rise + cruise, 1.0, 0.0)):
            if now + moment > times[-1] + 1e-12:
                times.append(now + moment)
                positions.append(begin + done * change)
                velocities.append(rate * change)
        now += 2 * rise + cruise
    return np.array(times), np.array(positions), np.array(velocities)


def _time_by_toppra(path: MotionPath, limits: MotionLimits) -> _Timed:
    """Knots of the fastest motion along a path with rounded corners."""
    try:
        from toppra import algorithm, constraint, interpolator
    except ImportError:
        raise MissingExtraError("toppra", "toppra", "time-optimal trajectories") from None
    curve = round_corners(path)
    rates = _list_limits(path.names, limits)
    mix = np.eye(len(path.names))
    if path.names[:2] == ("x", "y"):  # the base's speed is limited in every direction, not by its x and y
        angles = np.arange(LIMITED_DIRECTIONS) * math.pi / LIMITED_DIRECTIONS
        rows = np.zeros((LIMITED_DIRECTIONS, len(path.names)))
        rows[:, 0], rows[:, 1] = np.cos(angles), np.sin(angles)
        mix = np.concatenate([rows, mix[2:]])
        base = np.array([[limits.speed, limits.acceleration]]) * math.cos(math.pi / (2 * LIMITED_DIRECTIONS))
        rates = np.concatenate([np.repeat(base, LIMITED_DIRECTIONS, axis=0), rates[2:]])

    class Curve(interpolator.AbstractGeometricPath):
        """The curve in the directions that are limited."""

        @property
        def dof(self) -> int:
            return len(mix)

        @property
        def path_interval(self) -> Any:
            return np.array([curve.x[0], curve.x[-1]])

        @property
        def waypoints(self) -> Any:
            return None

        def __call__(self, path_positions: Any, order: int = 0) -> Any:
            return curve(path_positions, order) @ mix.T

    sides = np.stack([-rates, rates], axis=-1)
    wanted = [constraint.JointVelocityConstraint(sides[:, 0]), constraint.JointAccelerationConstraint(
        sides[:, 1], discretization_scheme=constraint.DiscretizationType.Interpolation)]
    ends = zip(curve.x, curve.x[1:], strict=False)
    grid = np.unique(np.concatenate([  # a piece's own curvature must hold up to its end, where the next one's begins
        np.append(np.linspace(a, b, max(LEAST_POINTS, 2 + math.ceil((b - a) / GRID_DISTANCE))), b - TAIL * (b - a))
        for a, b in ends]))
    search = algorithm.TOPPRA(wanted, Curve(), gridpoints=grid, parametrizer="ParametrizeConstAccel")
    rates_squared = search.compute_parameterization(0.0, 0.0)
    if rates_squared is None or rates_squared[1] is None:
        raise ConfigError("limits", limits, "limits under which the path can be followed")
    rate = np.maximum(np.asarray(rates_squared[1]).ravel(), 0.0)  # of the path's length, at the grid points
    steps = 2.0 * np.diff(grid) / np.maximum(rate[1:] + rate[:-1], 1e-9)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    return _slow_down(times, curve(grid), curve(grid, 1) * rate[:, None], mix, rates)


def _slow_down(times: NDArray[np.float64], positions: NDArray[np.float64], velocities: NDArray[np.float64],
               mix: NDArray[np.float64], rates: NDArray[np.float64]) -> _Timed:
    """Slow the motion down by the factor at which the cubics between the knots keep every limit.

    Between two knots the acceleration is linear, so it is largest at one of them; the speed is a parabola, largest at
    one of them or at its apex.

    Args:
        times: of the knots, s.
        positions: at the knots.
        velocities: at the knots.
        mix: directions that are limited, shape (directions, coordinates).
        rates: largest speed and acceleration in each of them, shape (directions, 2).
    """
    spline = CubicHermiteSpline(times, positions @ mix.T, velocities @ mix.T)
    cubic, square, speed, _ = spline.c  # (intervals, directions) each
    spans = np.diff(times)[:, None]
    begin, end = 2.0 * square, 2.0 * square + 6.0 * cubic * spans
    with np.errstate(divide="ignore", invalid="ignore"):
        apex = np.clip(np.nan_to_num(-square / (3.0 * cubic)), 0.0, spans)
    fastest = np.maximum(np.abs(speed + 2.0 * square * apex + 3.0 * cubic * apex**2), np.abs(velocities @ mix.T)[1:])
    strongest = np.maximum(np.abs(begin), np.abs(end))
    factor = max(1.0, float((fastest / rates[:, 0]).max()), math.sqrt(float((strongest / rates[:, 1]).max())))
    return times * factor, positions, velocities / factor


ROUNDINGS = (0.3, 0.1, 0.03)
"""Largest cuts of a corner, m; the first that stays clear is taken."""
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
    if room.robot.drive == "differential" or not room.robot.base.turns_anywhere:
        return _follow_moves(plan, rules)
    radius = room.robot.outer_radius + CONTACT_SKIN
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


def _check_same_presses(plan: Plan, places: NDArray[np.float64]) -> None:
    """Check that a motion leaves the puzzle in the same state as its plan.

    A press is the first moment of touching a target. A motion may press more than its plan where the puzzle does not
    mind, such as a button that is lit already. Where the puzzle's state follows from more than presses (things carried
    or pushed, chance), the presses must be the plan's, one by one.

    Args:
        plan: the plan.
        places: x, y (m), heading and joint angles (rad) along the motion, shape (n, 3 + joints).

    Raises:
        UnsupportedError: the states differ.
    """
    rules, puzzle, first = Rules(plan.instance), plan.instance.puzzle, plan.states[0]
    home = np.array(rules.robot.home)
    still = (0,) * len(home)
    wanted = _list_begun(state.touching for state in plan.states)
    found = _list_begun((first.touching, *(
        rules.compute_touching(x, y, 0, heading, still, tuple(angles - home))
        for (x, y, heading), angles in zip(places[:, :3].tolist(), places[:, 3:], strict=True))))
    if [target for together in wanted for target in together] == [target for one in found for target in one]:
        return
    grips = any(plan.instance.robot.actions.primitives[action].grip for action in plan.primitives)
    if not (grips or puzzle.is_watching or puzzle.is_random or isinstance(puzzle, Pushing)):
        state = first.puzzle
        for together in found:
            state = puzzle.update(state, Contacts(together))
        if state == plan.states[-1].puzzle:
            return

    def write(begun: list[tuple[int, ...]]) -> str:
        """Names of the targets pressed, in order."""
        return ", ".join(plan.instance.targets[target].name for one in begun for target in one) or "nothing"

    raise UnsupportedError(f"the trajectory of {plan.name!r} would press {write(found)}, where the plan presses "
                           f"{write(wanted)}: follow its primitives instead")


def _list_begun(touching: Iterable[int]) -> list[tuple[int, ...]]:
    """List the bits of the targets whose touch begins, from the bits touched at consecutive places."""
    begun, before = [], -1
    for now in touching:
        new = now & ~before
        if new:
            begun.append(list_touched(new))
        before = now
    return begun
