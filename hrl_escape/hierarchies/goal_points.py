"""Goal spaces of a room: its events, or displacements on its floor."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.goal_space import GoalSpace, GoalView
from hrl_escape.errors import UnsupportedError
from hrl_escape.hierarchies.situation import Situations

RADIUS = 4
"""Length of a displacement, in moves."""
BEARINGS = 8
"""Directions of displacements, over a full turn."""


def make_event_space(rooms: Situations) -> GoalSpace:
    """Make absolute goals: touch a target, make a fact true, or be at the exit, in this order.

    A point has a bit for each touched target, for each fact that a relevant operator makes true, and for the exit.
    """
    facts = [fact for fact in rooms.model.propositions if any(fact in each.add for each in rooms.operators)]
    instance = rooms.instance
    targets, leaves = len(instance.targets), instance.exit

    def project(observation: Any) -> NDArray[np.float64]:
        here = rooms.read(observation)
        touched = (here.state.touching >> target & 1 for target in range(targets))
        held = (fact in here.facts for fact in facts)
        return np.array([*touched, *held, leaves.contains(here.state.x, here.state.y)], np.float64)

    count = targets + len(facts) + 1
    goals = np.where(np.eye(count, dtype=np.bool_), 1.0, np.nan)
    names = (*(f"touch({target.name})" for target in instance.targets), *facts, "exit")
    return GoalSpace(project, goals, view=_make_view(rooms), names=names, privileges=("landmarks", "state"))


def make_displacement_space(rooms: Situations) -> GoalSpace:
    """Make relative goals: displacements in eight directions. A point is a square of the floor, one move wide.

    Raises:
        UnsupportedError: the robot presses by hand, and displacements move only its base.
    """
    instance, stride = rooms.instance, rooms.instance.robot.actions.stride
    if instance.dynamics.press_with == "hand":
        raise UnsupportedError(f"no displacements are synthesised for the room {instance.name!r}: its robot presses by "
                               "hand, and they move the base alone")

    def project(observation: Any) -> NDArray[np.float64]:
        here = rooms.read(observation).state
        return np.round([here.x / stride, here.y / stride])

    angles = 2 * np.pi * np.arange(BEARINGS) / BEARINGS
    goals = np.round(RADIUS * np.stack([np.cos(angles), np.sin(angles)], axis=1)).astype(np.float64) + 0.0
    names = tuple(f"{x:+.0f}, {y:+.0f} moves" for x, y in goals)
    return GoalSpace(project, goals, is_relative=True, view=_make_view(rooms), names=names, privileges=("state",))


def _make_view(rooms: Situations) -> GoalView:
    """Pose, touched targets and facts, as whole numbers."""
    size = rooms.pose_count + len(rooms.model.propositions)

    def see(observation: Any) -> NDArray[np.float64]:
        here = rooms.read(observation)
        return np.concatenate([rooms.list_pose(here), rooms.list_facts(here)[:len(rooms.model.propositions)]])

    return GoalView(spaces.Box(-np.inf, np.inf, (size,), np.float64), see)
