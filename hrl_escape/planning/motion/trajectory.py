"""`TimedTrajectory`: motion over time under limits of speed, acceleration and jerk."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import SOFT_LIMIT, EpisodeEnd, Kinematics, RoomState, Rules
from hrl_escape.env.poses import list_touched
from hrl_escape.env.robot import Robot, make_robot
from hrl_escape.env.velocities import list_levels
from hrl_escape.errors import ConfigError, EscapeError
from hrl_escape.files import write_json, write_text
from hrl_escape.planning import ros
from hrl_escape.planning.motion.legs import Contact, Grip, Press, time_legs
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.timing import TimedPath, evaluate_motion, time_path
from hrl_escape.planning.paths.problem import MotionPath
from hrl_escape.planning.plan import Plan

EFFORT_RATE = 100.0
"""Sampling rate of the efforts of joints, Hz."""


@dataclasses.dataclass(frozen=True, eq=False)
class TimedTrajectory:
    """Positions over time with constant jerk between knots, which ROS's joint trajectory controllers read as cubics.

    Attributes:
        names: names of the coordinates: `x`, `y`, `heading`, joints.
        times: times of the knots, rising from 0, (n,), s.
        positions: positions at the knots, (n, coordinates), m and rad.
        velocities: velocities at the knots, (n, coordinates), m/s and rad/s.
        limits: limits that it keeps.
        contacts: beginnings of touches, in order; none for a path of the arm.
        grips: times when the hand grips, releases or uses, in order.
    """

    names: tuple[str, ...]
    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    limits: MotionLimits
    contacts: tuple[Contact, ...] = ()
    grips: tuple[Grip, ...] = ()

    @property
    def duration(self) -> float:
        """Return the time of the last knot, s."""
        return float(self.times[-1])

    def evaluate(self, times: ArrayLike, order: int = 0) -> NDArray[np.float64]:
        """Return positions at times within the duration, or their first or second derivatives, (..., coordinates)."""
        if len(self.times) == 1:  # at rest
            shape = (*np.shape(times), len(self.names))
            return np.zeros(shape) if order else np.broadcast_to(self.positions[0], shape).copy()
        motion = TimedPath(self.times, self.positions, self.velocities)
        return evaluate_motion(motion, np.clip(times, 0.0, self.duration), order)

    def sample(self, rate: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Sample at a rate in Hz; the last sample is the end.

        Returns:
            Times (n,), s; positions (n, coordinates), m and rad; velocities (n, coordinates), m/s and rad/s.
        """
        if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0.0 < rate < math.inf:
            raise ConfigError("rate", rate, "samples a second, above 0")
        times = np.minimum(np.arange(math.ceil(self.duration * rate - 1e-9) + 1) / rate, self.duration)
        return times, self.evaluate(times), self.evaluate(times, 1)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"names": list(self.names), "times": self.times.tolist(), "positions": self.positions.tolist(),
                "velocities": self.velocities.tolist(), "limits": dataclasses.asdict(self.limits),
                "contacts": [contact._asdict() for contact in self.contacts],
                "grips": [grip._asdict() for grip in self.grips]}

    def to_ros(self, rate: float = 50.0, *, frame: str = "room",
               offset: tuple[float, float] = (0.0, 0.0)) -> dict[str, Any]:
        """Return the fields of a ROS `moveit_msgs/RobotTrajectory`, sampled at a rate in Hz.

        Joints are its `joint_trajectory`. The base is the planar joint `base` of its `multi_dof_joint_trajectory`, with
        velocities and accelerations along the axes of the frame. A part without motion has no points.

        Args:
            rate: samples a second.
            frame: name of the frame, the `frame_id`.
            offset: x and y of the room's origin in that frame, m. `World.to_ros` gives that of a map.
        """
        times, positions, velocities = self.sample(rate)
        first = 3 if self.names[:1] == ("x",) else 0
        positions[:, :2] += offset if first else 0.0
        rows = list(zip(times.tolist(), positions.tolist(), velocities.tolist(),
                        self.evaluate(times, 2).tolist(), strict=True))
        header = ros.make_header(frame)
        joints = [{"positions": p[first:], "velocities": v[first:], "accelerations": a[first:],
                   "time_from_start": ros.make_time(t)} for t, p, v, a in rows if self.names[first:]]
        base = [{"transforms": [{"translation": ros.make_point(*p[:2]), "rotation": ros.make_quaternion(p[2])}],
                 "velocities": [ros.make_twist(v)], "accelerations": [ros.make_twist(a)],
                 "time_from_start": ros.make_time(t)} for t, p, v, a in rows if first]
        return {"joint_trajectory": {"header": header, "joint_names": list(self.names[first:]), "points": joints},
                "multi_dof_joint_trajectory": {"header": header, "joint_names": ["base"] if first else [],
                                               "points": base}}

    def save(self, path: str | Path, rate: float = 50.0) -> None:
        """Write a file: `.json` with the knots, or `.csv` with one row per sample.

        Raises:
            ConfigError: another file ending.
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
        """Draw the path of the base on the room's map, with dots where touches begin and where the hand acts.

        Args:
            instance: the room.
            path: PNG, SVG or PDF file to write, or None to only return the figure.

        Returns:
            The matplotlib figure.
        """
        from hrl_escape.env.pictures.maps import Trajectory, make_map  # loads matplotlib
        from hrl_escape.figures import save_figure

        if self.names[:2] != ("x", "y"):
            raise ConfigError("names", self.names, "a trajectory that moves the base: x, y, ...")
        points = self.sample(50.0)[1][:, :2]
        figure = make_map(instance, None, [Trajectory(points, f"{self.duration:.1f} s")])
        presses = self.evaluate([event.time for event in (*self.contacts, *self.grips)])
        figure.axes[0].plot(*presses[:, :2].T, "o", color="black", markersize=5, zorder=5)
        if path is not None:
            save_figure(path, figure)
        return figure


def make_trajectory(motion: Plan | MotionPath, limits: MotionLimits | None = None, *, clearance: float = 0.2
                    ) -> TimedTrajectory:
    """Make a trajectory of a plan, or of a path of `ArmPlanner`.

    The trajectory of a plan presses the same targets in the same order, makes the same grips and pushes, and touches no
    solid, in the continuous kinematics of the room. It rests after each press and at each grip. Corners are rounded as
    far as this still holds.

    Args:
        motion: the plan or the path.
        limits: limits of speed, acceleration and jerk, or None for the defaults of `MotionLimits`.
        clearance: distance that the base keeps from solids where it can, m; for plans.

    Returns:
        The trajectory; of one knot at time 0 where a path ends at its start.

    Raises:
        ConfigError: the plan has no motion, a joint would exceed its limits (it can begin up to `SOFT_LIMIT` beyond
            them), its effort does not hold the arm, or the clearance is negative.
        UnsupportedError: no trajectory presses and pushes what the plan does.
    """
    if not (isinstance(clearance, (int, float)) and 0 <= clearance < math.inf):
        raise ConfigError("clearance", clearance, "a number of metres from 0 on")
    limits = limits or MotionLimits()
    if isinstance(motion, Plan):
        robot: Robot | None = make_robot(motion.instance.robot)
        names = ("x", "y", "heading", *robot.joint_names)
        parts = list(time_legs(motion, limits, clearance))
        if all(len(part.motion.times) < 2 for part in parts):
            raise ConfigError("motion", motion.name, "a plan that moves something")
    else:
        robot, names = motion.robot, motion.names
        parts = [Press(time_path(motion, limits.stack(names, robot)), ())]
    return join_presses(names, parts, limits, robot)


def join_presses(names: tuple[str, ...], parts: Sequence[Press], limits: MotionLimits, robot: Robot | None
                 ) -> TimedTrajectory:
    """Join pieces, where each begins at the end of the one before, and slow them down to the limits of the arm.

    All pieces keep the limits. A bare path has no robot. Pieces at rest make a trajectory of one knot.

    Raises:
        ConfigError: see `make_trajectory`.
    """
    _check_joints(names, parts, robot)
    contacts, grips, begin = [], [], 0.0
    times, knots, speeds = [np.zeros(1)], [parts[0].motion.positions[:1]], [parts[0].motion.velocities[:1]]
    for (part_times, positions, velocities), begun, acts in parts:
        times.append(part_times[1:] + begin)
        knots.append(positions[1:])
        speeds.append(velocities[1:])
        contacts += [Contact(begin + contact.time, contact.target) for contact in begun]
        grips += [Grip(begin + grip.time, grip.action) for grip in acts]
        begin += float(part_times[-1])
    trajectory = TimedTrajectory(names, np.concatenate(times), _unwind(names, knots), np.concatenate(speeds), limits,
                                 tuple(contacts), tuple(grips))
    return _keep_efforts(trajectory, robot) if robot and robot.joint_names else trajectory


def _check_joints(names: tuple[str, ...], parts: Sequence[Press], robot: Robot | None) -> None:
    """Check joint limits at the knots; positions between knots do not exceed them.

    A motion can begin up to `SOFT_LIMIT` beyond a limit, where physics left the joint.
    """
    joints = zip(robot.joint_names, robot.limits, robot.continuous, strict=True) if robot else ()
    for name, (low, high) in ((name, limits) for name, limits, turns in joints if not turns):
        column = names.index(name)
        angles = np.concatenate([motion.positions[:, column] for motion, *_ in parts])
        begin = min(max(float(angles[0]), low - SOFT_LIMIT), high + SOFT_LIMIT)
        if angles.min() < min(low, begin) - 1e-9 or angles.max() > max(high, begin) + 1e-9:
            raise ConfigError(f"motion.{name}", [float(angles.min()), float(angles.max())],
                              f"angles from {low:g} to {high:g} rad")


def _keep_efforts(trajectory: TimedTrajectory, robot: Robot) -> TimedTrajectory:
    """Slow a motion down until no joint exceeds its effort, ignoring the base's acceleration.

    In k times the time, speeds are 1 / k and the effort of the motion is 1 / k^2. The effort that holds the arm's
    weight stays.
    """
    from hrl_escape.planning.arm.model import ArmKinematics  # loads Pinocchio

    columns, efforts = [trajectory.names.index(name) for name in robot.joint_names], np.array(robot.efforts)
    times = trajectory.sample(EFFORT_RATE)[0]
    angles, speeds, strengths = (trajectory.evaluate(times, order)[:, columns] for order in range(3))
    arm = ArmKinematics(robot)
    held = np.array([arm.compute_efforts(at, 0.0 * at, 0.0 * at) for at in angles])
    moved = np.array([arm.compute_efforts(*rows) for rows in zip(angles, speeds, strengths, strict=True)]) - held
    spare = efforts - np.sign(moved) * held
    if (np.abs(held) > efforts).any():
        joint = int((np.abs(held) - efforts).max(axis=0).argmax())
        raise ConfigError(f"motion.{robot.joint_names[joint]}", float(np.abs(held[:, joint]).max()),
                          f"postures that {efforts[joint]:g} N m hold")
    with np.errstate(divide="ignore", invalid="ignore"):
        slower = math.sqrt(max(1.0, float(np.nan_to_num(np.abs(moved) / spare, posinf=1.0).max(initial=1.0))))
    return dataclasses.replace(trajectory, times=trajectory.times * slower, velocities=trajectory.velocities / slower,
                               contacts=tuple(Contact(c.time * slower, c.target) for c in trajectory.contacts),
                               grips=tuple(Grip(grip.time * slower, grip.action) for grip in trajectory.grips))


def _unwind(names: Sequence[str], knots: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the knots of all parts in one array, with headings unwrapped across parts."""
    if "heading" in names:
        column = names.index("heading")
        last = float(knots[0][-1, column])
        for number, part in enumerate(knots[1:], 1):
            if len(part):
                knots[number] = part.copy()
                knots[number][:, column] += round((last - float(part[0, column])) / math.tau) * math.tau
                last = float(knots[number][-1, column])
    return np.concatenate(knots)


# --- driving ---------------------------------------------------------------------------

SHOVE = 0.05
"""Further push at a target that should be touched and is not, m or rad, as under physics."""
LONGEST_WAIT = 2.0
"""Longest wait for a press, s."""
APPROACH = 0.05
"""Time before a touch whose direction is the direction of the push, s."""
STEP_SHARES = (1.0, 0.5, 0.25, 0.125, 0.0625)
"""Shares of a step to advance a trajectory's clock; the first without a collision is used."""
ASTRAY = 1e-3
"""Distance from its first place, m or rad, within which a trajectory can start."""


class Tracker:
    """Chooses the velocities of each step, and the levels of the gripper.

    Each step leads from the state reached to the place of the trajectory one step later. The clock of the trajectory
    waits while a target that it has reached is not yet pressed, and for one step while the hand acts. It runs slower
    where the line between two steps meets a solid, in rooms whose blocked moves have no effect.

    Args:
        trajectory: trajectory of base and arm.
        rules: the room's rules.
        time_step: time step of the environment, s.
        state: first state.

    Attributes:
        pressed: targets whose touch has begun, in order.
        error: distance of each coordinate from the trajectory after the last step, (coordinates,), m and rad; 0 while
            the robot pushes.

    Raises:
        EscapeError: the trajectory has other coordinates than the robot, or begins somewhere else.
    """

    def __init__(self, trajectory: TimedTrajectory, rules: Rules, time_step: float, state: RoomState) -> None:
        names = ("x", "y", "heading", *rules.robot.joint_names)
        if trajectory.names != names:
            raise EscapeError(f"this trajectory moves {', '.join(trajectory.names)}, and what is tracked moves "
                              f"{', '.join(names)}")
        self._trajectory, self._rules, self._step = trajectory, rules, time_step
        self._at = self._wanted = trajectory.positions[0]
        self._state, self._now, self._waited = state, 0.0, 0.0
        self._due, self._push = list(trajectory.contacts), np.zeros(len(names))
        self._acts = list(trajectory.grips)
        self.pressed: list[int] = []
        self.see(state)
        if self.error.max() > ASTRAY:
            raise EscapeError(f"this trajectory starts at {np.round(self._wanted, 3).tolist()}, the environment is at "
                              f"{np.round(self._at, 3).tolist()}")

    @property
    def is_done(self) -> bool:
        """Return whether the trajectory has ended."""
        return self._now >= self._trajectory.duration - 1e-9 and not self._acts

    def see(self, state: RoomState) -> None:
        """Update with the state that the last step led to."""
        begun = list_touched(state.touching & ~self._state.touching)
        self.pressed += begun
        if self._due and self._due[0].target in begun:
            self._due, self._waited = self._due[1:], 0.0
        heading = self._at[2] + math.remainder(self._rules.get_heading(state) - self._at[2], math.tau)
        self._state, self._at = state, np.array([state.x, state.y, heading, *self._rules.get_angles(state)])
        self.error = np.zeros(len(self._at)) if self._push.any() else np.abs(self._at - self._wanted)

    def choose(self) -> NDArray[np.float64]:
        """Return the action of the next step, as the environment takes it."""
        self._push, grip = np.zeros(len(self._at)), 0
        if self._due and self._due[0].time < self._now and self._waited < LONGEST_WAIT:
            self._waited += self._step
            touch = self._due[0].time
            way = self._trajectory.evaluate(touch) - self._trajectory.evaluate(touch - APPROACH)
            self._push = way * SHOVE / max(float(np.abs(way).max()), 1e-9)
        elif self._acts and self._acts[0].time <= self._now:
            actions = self._rules.actions
            grip = actions.primitives[actions.find(self._acts.pop(0).action)].grip
        else:
            self._due, self._waited = self._due[1:] if self._waited else self._due, 0.0
            self._now = self._find_next()
        self._wanted = self._trajectory.evaluate(self._now)
        rates = (self._wanted + self._push - self._at) / self._step
        middle = self._at[2] + rates[2] * self._step / 2.0
        cos, sin = math.cos(middle), math.sin(middle)
        robot = self._rules.instance.robot
        sides = [-sin * rates[0] + cos * rates[1]] if robot.drive == "strafing" else []
        return np.array([cos * rates[0] + sin * rates[1], *sides, *rates[2:], *list_levels(robot, grip)])

    def _find_next(self) -> float:
        """Return the time of the trajectory after the next step, at most the next act of the hand."""
        last, rules = min([self._trajectory.duration, *(act.time for act in self._acts[:1])]), self._rules
        after = [min(self._now + share * self._step, last) for share in STEP_SHARES]
        if isinstance(rules, Kinematics) and rules.instance.dynamics.blocked == "stay":
            ways = ((moment, (self._trajectory.evaluate(moment) - self._at)[:2].tolist()) for moment in after)
            free = (moment for moment, way in ways if rules.compute_advance(self._state, *way)[0] >= 1.0)
            return next(free, after[0])
        return after[0]


class Tracking(NamedTuple):
    """Record of a tracked trajectory.

    Attributes:
        states: states after each step, the first one included.
        pressed: targets whose touch began, in order.
        errors: distance of each coordinate from the trajectory after each step, (steps, coordinates), m and rad.
        end: how the episode ended; `STOPPED` if it can continue.
        seconds: duration, s.
    """

    states: tuple[RoomState, ...]
    pressed: tuple[int, ...]
    errors: NDArray[np.float64]
    end: EpisodeEnd
    seconds: float

    @property
    def distance(self) -> float:
        """Return the largest distance of the base's axis from the trajectory, m."""
        return float(np.hypot(self.errors[:, 0], self.errors[:, 1]).max(initial=0.0))


def track(trajectory: TimedTrajectory, env: gymnasium.Env) -> Tracking:
    """Drive a trajectory of base and arm by `Tracker`, until it or the episode ends.

    Args:
        trajectory: trajectory of a plan, or of base and arm.
        env: an `EscapeRoomContinuousEnv`, wrapped or not, at the start of the trajectory.

    Returns:
        States, presses and errors.

    Raises:
        EscapeError: another environment, or it is somewhere else.
    """
    room: Any = env.unwrapped
    if not isinstance(room, EscapeRoomContinuousEnv):
        raise EscapeError(f"a trajectory is tracked in hrl_escape/EscapeRoomContinuous-v1, not in {env}")
    states, errors, end = [room.get_state()], [], EpisodeEnd.STOPPED
    tracker = Tracker(trajectory, room.rules, room.velocities.time_step, states[0])
    while not (tracker.is_done or end.is_over):
        _, _, terminated, truncated, _ = env.step(tracker.choose())
        states.append(room.get_state())
        tracker.see(states[-1])
        errors.append(tracker.error)
        end = EpisodeEnd.of_step(room.rules.has_escaped(states[-1]), terminated, truncated)
    shape = (-1, len(trajectory.names))
    return Tracking(tuple(states), tuple(tracker.pressed), np.array(errors).reshape(shape), end,
                    (len(states) - 1) * room.velocities.time_step)
