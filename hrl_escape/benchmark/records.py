"""Best known returns that agents have beaten in evaluations: raised, with a warning, for all that follows."""

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
    """Raise the `best` known return of each episode, by its start, that evaluations have beaten, and warn.

    `source` is agent and seed in words; see `record_return`.
    """
    from hrl_escape.planning.best_known import record_return  # brings the planners in

    for evaluation in evaluations:
        episodes = zip(starts, best, evaluation.returns, evaluation.lengths, strict=True)
        for (instance, state), known, value, length in episodes:
            if length and value > known + 1e-9:
                record_return(instance, state, value, source)


def record_escapes(env: gymnasium.Env, seeds: Sequence[int], evaluations: Sequence[Evaluation], source: str) -> None:
    """Raise the best known returns of a room that the escapes of a training run have beaten, and warn.

    It plans once from the start of each episode that escaped, and searches for the best known return only where the
    agent beat that plan. Left alone are other environments than rooms, puzzles with rewards of their own, and returns
    that a wrapper made: those that an escape after so many primitives does not earn. The evaluation environment is
    reset where an episode escaped; arguments are those of `run_observers`.
    """
    room: Any = env.unwrapped
    if not isinstance(getattr(room, "instance", None), RoomInstance):
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
