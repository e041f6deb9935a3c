"""Goal spaces of a room: events that can come about in it, or displacements on its floor."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.goal_space import GoalSpace, GoalView
from hrl_escape.errors import UnsupportedError
from hrl_escape.synthesis.situation import Situations

RADIUS = 4
"""Length of a displacement, in moves."""
BEARINGS = 8
"""Directions of displacements, over a full turn."""
EXIT_RADIUS = 0.75
"""Distance from the centre of the exit at which it counts as reached, in moves."""


def make_event_space(rooms: Situations) -> GoalSpace:
    """Absolute goals: touch a target, make a fact true, be at the exit; in this order.

    A point is the place, in moves, and a bit for each touched target and each fact that a relevant operator makes true.
    """
    instance, stride = rooms.instance, rooms.instance.robot.actions.stride
    facts = [fact for fact in rooms.model.propositions if any(fact in each.add for each in rooms.operators)]
    targets = len(instance.targets)

    def project(observation: Any) -> NDArray[np.float64]:
        here = rooms.read(observation)
        touched = (here.state.touching >> target & 1 for target in range(targets))
        held = (fact in here.facts for fact in facts)
        return np.array([here.state.x / stride, here.state.y / stride, *touched, *held], np.float64)

    bits = targets + len(facts)
    goals = np.full((bits + 1, 2 + bits), np.nan)
    goals[range(bits), range(2, 2 + bits)] = 1.0
    goals[bits, :2] = np.divide(rooms.get_place(None), stride)
    return GoalSpace(project, goals, tolerance=EXIT_RADIUS, view=_make_view(rooms), privileges=("landmarks", "state"))


def make_displacement_space(rooms: Situations) -> GoalSpace:
    """Relative goals: so many moves in each of eight directions. A point is a square of the floor, one move wide.

    Raises:
        UnsupportedError: the robot has an arm, which no displacement on the floor moves.
    """
    instance, stride = rooms.instance, rooms.instance.robot.actions.stride
    if instance.robot.joints:
        raise UnsupportedError(f"no displacements are synthesised for the room {instance.name!r}: its robot presses by "
                               "hand, and they move the base alone")

    def project(observation: Any) -> NDArray[np.float64]:
        here = rooms.read(observation).state
        return np.round([here.x / stride, here.y / stride])

    angles = 2 * np.pi * np.arange(BEARINGS) / BEARINGS
    goals = np.round(RADIUS * np.stack([np.cos(angles), np.sin(angles)], axis=1)).astype(np.float64) + 0.0
    return GoalSpace(project, goals, is_relative=True, view=_make_view(rooms), privileges=("state",))


def _make_view(rooms: Situations) -> GoalView:
    """Pose, touched targets and facts, as whole numbers."""
    size = rooms.pose_count + len(rooms.model.propositions)

    def see(observation: Any) -> NDArray[np.float64]:
        here = rooms.read(observation)
        return np.concatenate([rooms.list_pose(here), rooms.list_facts(here)[:len(rooms.model.propositions)]])

    return GoalView(spaces.Box(-np.inf, np.inf, (size,), np.float64), see)
