"""`track`: a controller that drives a trajectory in the continuous environment, by its velocities and feedback."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.episode_end import EpisodeEnd
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import EscapeError
from hrl_escape.planning.motion.trajectory import TimedTrajectory

PUSH = 0.05
"""Distance, m or rad, by which a target is pushed that should be touched and is not, as under physics."""
PATIENCE = 2.0
"""Longest wait for a press, s."""


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
    """Drive a trajectory of base and arm, until it or the episode ends.

    Each step asks for the velocities that lead from the state reached to where the trajectory is a step later. Its
    clock stands still while a target that it has come to is not yet pressed, and the robot pushes on.

    Args:
        trajectory: of a plan, or of base and arm.
        env: an `EscapeRoomContinuousEnv`, wrapped or not, where the trajectory starts.

    Raises:
        EscapeError: another environment, or it is somewhere else.
    """
    room: Any = env.unwrapped
    if not isinstance(room, EscapeRoomContinuousEnv) or trajectory.names != (
            names := ("x", "y", "heading", *room.rules.robot.joint_names)):
        raise EscapeError(f"a trajectory of {', '.join(trajectory.names)} is tracked in "
                          "hrl_escape/EscapeRoomContinuous-v1 with a robot that has these coordinates")
    step, states = room.time_step, [room.get_state()]
    at = _read(room, states[0], trajectory.positions[0])
    if np.abs(at - trajectory.positions[0]).max() > 1e-3:
        raise EscapeError(f"this trajectory starts at {np.round(trajectory.positions[0], 3).tolist()}, the environment "
                          f"is at {np.round(at, 3).tolist()}")
    due, pressed, errors, now, waited = list(trajectory.contacts), [], [], 0.0, 0.0
    end = EpisodeEnd.STOPPED
    while now < trajectory.duration - 1e-9 and not end.is_over:
        push = np.zeros(len(names))
        if due and due[0].time < now and waited < PATIENCE:
            waited += step
            before = trajectory.evaluate(due[0].time - 0.05)
            push = trajectory.evaluate(due[0].time) - before
            push *= PUSH / max(float(np.abs(push).max()), 1e-9)
        else:
            due, waited = due[1:] if waited else due, 0.0
            now = min(now + step, trajectory.duration)
        wanted = trajectory.evaluate(now)
        rates = (wanted + push - at) / step
        middle = at[2] + rates[2] * step / 2.0
        cos, sin = math.cos(middle), math.sin(middle)
        sides = [-sin * rates[0] + cos * rates[1]] if room.instance.robot.drive == "strafing" else []
        action = np.array([cos * rates[0] + sin * rates[1], *sides, *rates[2:]])
        _, _, terminated, truncated, info = env.step(action)
        states.append(room.get_state())
        at = _read(room, states[-1], at)
        errors.append(np.abs(at - wanted) if not push.any() else np.zeros(len(names)))
        pressed += np.flatnonzero(info["pressed"]).tolist()
        if due and due[0].target in pressed[len(trajectory.contacts) - len(due) :]:
            due, waited = due[1:], 0.0
        end = EpisodeEnd.of_step(room.rules.has_escaped(states[-1]), terminated, truncated)
    return Tracking(tuple(states), tuple(pressed), np.array(errors).reshape(-1, len(names)), end,
                    (len(states) - 1) * step)


def _read(room: EscapeRoomContinuousEnv, state: RoomState, before: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coordinates of a state, the heading as near as can be to the one before."""
    heading = before[2] + math.remainder(room.rules.get_heading(state) - before[2], math.tau)
    return np.array([state.x, state.y, heading, *room.rules.get_angles(state)])
