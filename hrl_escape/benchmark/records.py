"""Best known returns of rooms, raised with a warning when an evaluation beats them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium

from hrl_escape.agents.training.evaluation import Evaluation
from hrl_escape.env.instance import RoomInstance

if TYPE_CHECKING:
    from hrl_escape.env.kinematics import RoomState


def record_returns(starts: Sequence[tuple[RoomInstance, RoomState]], best: Sequence[float],
                   evaluations: Iterable[Evaluation], source: str) -> None:
    """Raise the best known returns that evaluations have beaten, and warn.

    Args:
        starts: room and first state of each episode.
        best: best known return of each episode.
        evaluations: of the run.
        source: agent and seed, for the warning.
    """
    from hrl_escape.planning.best_known import record_return  # loads the planners

    for evaluation in evaluations:
        episodes = zip(starts, best, evaluation.returns, evaluation.lengths, strict=True)
        for (instance, state), known, value, length in episodes:
            if length and value > known + 1e-9:
                record_return(instance, state, value, source)


def record_escapes(env: gymnasium.Env, seeds: Sequence[int], evaluations: Sequence[Evaluation], source: str) -> None:
    """Raise the best known returns of a room that a training run has beaten, and warn; see `run_observers`.

    It plans once from the start of each successful episode, and searches for the best known return only if the agent
    beat that plan. Environments that are not rooms, velocities, puzzles with rewards of their own, and returns that a
    wrapper changed are ignored. The evaluation environment is reset.
    """
    room: Any = env.unwrapped
    if not isinstance(getattr(room, "instance", None), RoomInstance) or (
            not isinstance(room.action_space, gymnasium.spaces.Discrete)):
        return
    for n, seed in enumerate(seeds):
        escapes = {(found.lengths[n], found.returns[n]) for found in evaluations if found.successes[n]}
        if not escapes:
            continue
        env.reset(seed=seed)
        instance, state = room.instance, room.get_state()
        from hrl_escape.planning.best_known import compute_escape_return, find_by_plan, record_return
        from hrl_escape.planning.planner import get_planner

        earned = [value for length, value in escapes if math.isclose(value, compute_escape_return(instance, length))]
        if earned and not instance.has_extra_reward and (
                max(earned) > find_by_plan(get_planner(instance), state, jointly=False).value + 1e-9):
            record_return(instance, state, max(earned), source)
