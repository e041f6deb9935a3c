"""Escaping for real: meta-actions in the planner's order, looking after each what came of it.

Where a `Plan` is a sequence fixed beforehand, this is closed-loop and so works under noise,
slip and physics too, and for puzzles that take pushing.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium

from hrl_escape.options.goals import ExitGoal, Goal
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.options.planner import RoomPlanner, get_planner
from hrl_escape.options.synthesis import list_goals, make_meta_options

__all__ = ["Escape", "escape"]

MOST_FAILURES = 5
"""Meta-actions in a row that may fail before it gives up."""


@dataclasses.dataclass(frozen=True)
class Escape:
    """How an escape went.

    Attributes:
        decisions: `info["option"]` of each meta-action, with its `duration`.
        primitives: that ran in all.
        reward: undiscounted return.
        terminated: it escaped.
        truncated: the episode was cut off first.
    """

    decisions: tuple[dict[str, Any], ...]
    primitives: int
    reward: float
    terminated: bool
    truncated: bool


def escape(env: gymnasium.Env, planner: RoomPlanner | None = None) -> Escape:
    """Escape from where an environment is now.

    Args:
        env: a flat environment, wrapped or not, within an episode.
        planner: the room's planner; None takes the shared one.

    Raises:
        PlanningFailed: there is no way out.
    """
    room: Any = env.unwrapped
    planner = planner or get_planner(room.instance)
    options = make_meta_options(room.instance, "press", planner)
    numbers: dict[Goal, int] = {goal: n for n, goal in enumerate((*list_goals(room.instance), ExitGoal()))}
    wrapped = OptionsEnv(env, options, include_primitives=False)
    wrapped.resume()
    decisions: list[dict[str, Any]] = []
    primitives, total, failures = 0, 0.0, 0
    terminated = truncated = False
    while not (terminated or truncated) and failures < MOST_FAILURES:
        goal = planner.order_goals(room.get_state())[0]
        _, reward, terminated, truncated, info = wrapped.step(numbers[goal])
        decisions.append(info["option"] | {"duration": info["duration"]})
        primitives, total = primitives + info["duration"], total + float(reward)
        failures = 0 if info["option"]["ended"] in ("reached", "episode-over") else failures + 1
    return Escape(tuple(decisions), primitives, total, terminated, truncated)
