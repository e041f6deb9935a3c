"""Pursuing a goal for real: meta-actions in the planner's order, looking after each what came of it.

Where a `Plan` is a sequence fixed beforehand, this is closed-loop and so works under noise,
slip and physics too, and for puzzles that take pushing.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium

from hrl_escape.env.kinematics import RoomState
from hrl_escape.options.goals import ExitGoal, Goal, parse_goal
from hrl_escape.options.option import Option
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.options.planner import RoomPlanner, get_planner
from hrl_escape.options.synthesis import list_goals, make_meta_options, make_option

__all__ = ["Pursuit", "pursue"]

MOST_FAILURES = 5
"""Meta-actions in a row that may fail before it gives up."""


@dataclasses.dataclass(frozen=True)
class Pursuit:
    """How it went.

    Attributes:
        decisions: `info["option"]` of each meta-action, with its `duration`.
        states: met, the first one included.
        rewards: one a primitive.
        is_reached: the goal was reached.
        terminated: the robot escaped.
        truncated: the episode was cut off.
    """

    decisions: tuple[dict[str, Any], ...]
    states: tuple[RoomState, ...]
    rewards: tuple[float, ...]
    is_reached: bool
    terminated: bool
    truncated: bool


def pursue(env: gymnasium.Env, goal: Goal | str | None = None, planner: RoomPlanner | None = None) -> Pursuit:
    """Go for a goal from where an environment is now.

    Args:
        env: a flat environment, wrapped or not, within an episode.
        goal: what to reach; None to escape.
        planner: the room's planner; None takes the shared one.

    Raises:
        PlanningFailed: there is no way out.
    """
    room: Any = env.unwrapped
    planner = planner or get_planner(room.instance)
    goal = parse_goal(goal, room.instance) if isinstance(goal, str) else goal
    options: tuple[Option, ...]
    if goal is None:
        goals = (*list_goals(room.instance), ExitGoal())
        options = make_meta_options(room.instance, "press", planner)
    else:
        goals, options = (goal,), (make_option("pursue", planner, goal),)
    wrapped = OptionsEnv(env, options, include_primitives=False, trace=True)
    wrapped.resume()
    decisions: list[dict[str, Any]] = []
    states, rewards = [room.get_state()], []
    failures, is_reached, terminated, truncated = 0, False, False, False
    while not (is_reached or terminated or truncated) and failures < MOST_FAILURES:
        following = planner.order_goals(states[-1])[0] if goal is None else goal
        _, _, terminated, truncated, info = wrapped.step(goals.index(following))
        decisions.append(info["option"] | {"duration": info["duration"]})
        states += [step.next_state for step in info["trace"]]
        rewards += info["rewards"]
        failures = 0 if info["option"]["ended"] == "reached" else failures + 1
        is_reached = terminated if goal is None else info["option"]["ended"] == "reached"
    return Pursuit(tuple(decisions), tuple(states), tuple(rewards), is_reached, terminated, truncated)
