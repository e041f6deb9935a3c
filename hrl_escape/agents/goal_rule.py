"""Rule of an environment with goals, a function of two of them, by the convention of Gymnasium-Robotics' `GoalEnv`.

Its observations are a Dict of `observation`, `achieved_goal` and `desired_goal` (Plappert et al. 2018).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import gymnasium

__all__ = ["GoalRule", "read_goal_rule"]


class GoalRule(NamedTuple):
    """Reward and termination as functions of an achieved goal, a desired goal and `info`.

    Agents give an empty `info`: both must be functions of the two goals alone.

    Attributes:
        compute_reward: reward of a step after which the one was achieved and the other one desired.
        compute_terminated: True if this ends the episode, whatever else may end it.
    """

    compute_reward: Callable[[Any, Any, Mapping[str, Any]], Any]
    compute_terminated: Callable[[Any, Any, Mapping[str, Any]], Any]


def read_goal_rule(env: gymnasium.Env) -> GoalRule | None:
    """The rule of an environment, through any wrappers; None where it lacks one of the two methods."""
    if not all(env.has_wrapper_attr(name) for name in GoalRule._fields):
        return None
    return GoalRule(*map(env.get_wrapper_attr, GoalRule._fields))
