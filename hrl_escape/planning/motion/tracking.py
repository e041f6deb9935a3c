"""A controller that drives trajectories in the continuous environment, by their velocities and feedback."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.episode_end import EpisodeEnd
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.env.poses import list_touched
from hrl_escape.errors import EscapeError
from hrl_escape.planning.motion.trajectory import TimedTrajectory

SHOVE = 0.05
"""Distance, m or rad, by which a target is pushed that should be touched and is not, as under physics."""
LONGEST_WAIT = 2.0
"""Longest wait for a press, s."""
APPROACH = 0.05
"""Time before a touch whose direction is that of the push, s."""
ASTRAY = 1e-3
"""Distance from its first place, m or rad, at which a trajectory can still be begun."""


class Tracker:
    """Chooses the velocities of each step.

    Each step leads from the state reached to where the trajectory is a step later. Its clock stands still while a
    target that it has come to is not yet pressed, and the robot pushes on.

    Args:
        trajectory: of base and arm.
        rules: the room's rules.
        time_step: of the environment, s.
        state: where it begins.

    Attributes:
        pressed: targets whose touch has begun, in order.
        error: distance of each coordinate from the trajectory after the last step, shape (coordinates,), m and rad; 0
            while the robot pushes.

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
        self.pressed: list[int] = []
        self.error = self._see(state)
        if self.error.max() > ASTRAY:
            raise EscapeError(f"this trajectory starts at {np.round(self._wanted, 3).tolist()}, the environment is at "
                              f"{np.round(self._at, 3).tolist()}")

    @property
    def is_done(self) -> bool:
        """True at the trajectory's end."""
        return self._now >= self._trajectory.duration - 1e-9

    def _see(self, state: RoomState) -> NDArray[np.float64]:
        """Take in a state; returns its distance from where it should be."""
        begun = list_touched(state.touching & ~self._state.touching)
        self.pressed += begun
        if self._due and self._due[0].target in begun:
            self._due, self._waited = self._due[1:], 0.0
        heading = self._at[2] + math.remainder(self._rules.get_heading(state) - self._at[2], math.tau)
        self._state, self._at = state, np.array([state.x, state.y, heading, *self._rules.get_angles(state)])
        return np.zeros(len(self._at)) if self._push.any() else np.abs(self._at - self._wanted)

    def see(self, state: RoomState) -> None:
        """Take in the state that the last step led to."""
        self.error = self._see(state)

    def choose(self) -> NDArray[np.float64]:
        """Choose the velocities of the next step, as the environment takes them."""
        self._push = np.zeros(len(self._at))
        if self._due and self._due[0].time < self._now and self._waited < LONGEST_WAIT:
            self._waited += self._step
            touch = self._due[0].time
            way = self._trajectory.evaluate(touch) - self._trajectory.evaluate(touch - APPROACH)
            self._push = way * SHOVE / max(float(np.abs(way).max()), 1e-9)
        else:
            self._due, self._waited = self._due[1:] if self._waited else self._due, 0.0
            self._now = min(self._now + self._step, self._trajectory.duration)
        self._wanted = self._trajectory.evaluate(self._now)
        rates = (self._wanted + self._push - self._at) / self._step
        middle = self._at[2] + rates[2] * self._step / 2.0
        cos, sin = math.cos(middle), math.sin(middle)
        sides = [-sin * rates[0] + cos * rates[1]] if self._rules.instance.robot.drive == "strafing" else []
        return np.array([cos * rates[0] + sin * rates[1], *sides, *rates[2:]])


class Tracking(NamedTuple):
    """Record of a tracked trajectory.

    Attributes:
        states: after each step, the first one included.
        pressed: targets whose touch began, in order.
        errors: distance of each coordinate from the trajectory after each step, shape (steps, coordinates), m and rad.
        end: how the episode ended; `STOPPED` where it can go on.
        seconds: that it took.
    """

    states: tuple[RoomState, ...]
    pressed: tuple[int, ...]
    errors: NDArray[np.float64]
    end: EpisodeEnd
    seconds: float

    @property
    def distance(self) -> float:
        """Largest distance of the base's axis from where it should have been, m."""
        return float(np.hypot(self.errors[:, 0], self.errors[:, 1]).max(initial=0.0))


def track(trajectory: TimedTrajectory, env: gymnasium.Env) -> Tracking:
    """Drive a trajectory of base and arm by `Tracker`, until it or the episode ends.

    Args:
        trajectory: of a plan, or of base and arm.
        env: an `EscapeRoomContinuousEnv`, wrapped or not, where the trajectory starts.

    Raises:
        EscapeError: another environment, or it is somewhere else.
    """
    room: Any = env.unwrapped
    if not isinstance(room, EscapeRoomContinuousEnv):
        raise EscapeError(f"a trajectory is tracked in hrl_escape/EscapeRoomContinuous-v1, not in {env}")
    states, errors, end = [room.get_state()], [], EpisodeEnd.STOPPED
    tracker = Tracker(trajectory, room.rules, room.time_step, states[0])
    while not (tracker.is_done or end.is_over):
        _, _, terminated, truncated, _ = env.step(tracker.choose())
        states.append(room.get_state())
        tracker.see(states[-1])
        errors.append(tracker.error)
        end = EpisodeEnd.of_step(room.rules.has_escaped(states[-1]), terminated, truncated)
    shape = (-1, len(trajectory.names))
    return Tracking(tuple(states), tuple(tracker.pressed), np.array(errors).reshape(shape), end,
                    (len(states) - 1) * room.time_step)
