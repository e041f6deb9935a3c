"""Closed-loop execution of options towards a goal, each chosen from the state reached.

It supports noise, slip, physics, and puzzles with pushes.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium

from hrl_escape.env.kinematics import EpisodeEnd, RoomState
from hrl_escape.options.meta_actions import list_goals, make_meta_options, make_option
from hrl_escape.options.option import Option
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.goals import ExitGoal, Goal, check_goal, name_goal, parse_goal
from hrl_escape.planning.planner import RoomPlanner, get_planner

MOST_FAILURES = 5
"""Consecutive failures after which execution stops."""


@dataclasses.dataclass(frozen=True)
class ClosedLoopExecution:
    """Record of a closed-loop execution."""

    decisions: tuple[dict[str, Any], ...]
    """`info["option"]` of each decision, with its `duration` and the fields of its `PlanningSummary`."""
    states: tuple[RoomState, ...]  # states, the first one included
    rewards: tuple[float, ...]  # one a primitive
    is_reached: bool  # the goal was reached
    end: EpisodeEnd  # how the episode ended; `STOPPED` if it can continue

    @property
    def escaped(self) -> bool:
        """Return whether the robot escaped."""
        return self.end is EpisodeEnd.ESCAPED


def pursue(env: gymnasium.Env, goal: Goal | str | None = None, planner: RoomPlanner | None = None
           ) -> ClosedLoopExecution:
    """Step an environment from its present state until a goal is reached.

    Args:
        env: a flat environment, wrapped or not, within an episode.
        goal: the goal, or None to escape.
        planner: the room's planner, or None for the planner that this process shares.

    Raises:
        PlanningFailed: the goal cannot be reached.
    """
    room: Any = env.unwrapped
    planner = planner or get_planner(room.instance)
    goal = parse_goal(goal, room.instance) if isinstance(goal, str) else goal
    if goal is not None:
        check_goal(goal, room.instance)
    options: tuple[Option, ...]
    if goal is None:
        goals = (*list_goals(room.instance), ExitGoal())
        options = make_meta_options(room.instance, "press", planner)
    else:
        goals, options = (goal,), (make_option(name_goal(goal, room.instance), planner, goal),)
    wrapped = OptionsEnv(env, options, include_primitives=False, trace=True)
    wrapped.resume()
    decisions: list[dict[str, Any]] = []
    states, rewards = [room.get_state()], []
    failures, is_reached, end = 0, False, EpisodeEnd.STOPPED
    while not (is_reached or end.is_over) and failures < MOST_FAILURES:
        following = planner.order_goals(states[-1])[0] if goal is None else goal
        _, _, terminated, truncated, info = wrapped.step(goals.index(following))
        end = EpisodeEnd.of_step(planner.rules.has_escaped(room.get_state()), terminated, truncated)
        report = dataclasses.asdict(wrapped.planning_report)
        option = info["option"] | {"index": int(info["option"]["index"]), "duration": int(info["duration"])}
        decisions.append(option | report)
        states += [step.next_state for step in info["trace"]]
        rewards += info["rewards"]
        failures = 0 if info["option"]["ended"] == "reached" else failures + 1
        is_reached = planner.rules.has_escaped(states[-1]) if goal is None else info["option"]["ended"] == "reached"
    return ClosedLoopExecution(tuple(decisions), tuple(states), tuple(rewards), is_reached, end)
