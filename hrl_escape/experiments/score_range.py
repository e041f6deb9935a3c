"""Ends of the scales of a comparison: best known and worst returns, and the fewest primitives known for an escape.

Each is computed for the starts of a run's evaluation episodes, by the planners (`planning.best_known`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import EscapeError
from hrl_escape.experiments.grid import AgentSpec

__all__ = ["CEILING", "PLANNER", "ScoreRange", "compute_score_range"]

PLANNER, CEILING = "planner", "ceiling"


@dataclass(frozen=True)
class ScoreRange:
    """Best known and worst results of a run's evaluation episodes.

    Attributes:
        worst: return of an episode without escape.
        starts: pose at the start of each episode: x, y (m), heading (turn steps, and rad beyond them).
        best: best known return of each.
        reachable: best known return of each by the actions the agent has.
        fewest: primitives of the best known escape of each.
        fewest_reachable: the same by the actions the agent has; None where they cannot escape.
        source: what found `best` and `fewest`: `planner`, or `ceiling` where no plan is known and an escape
            by the first primitive stands for it.
    """

    worst: float
    starts: tuple[tuple[float, ...], ...]
    best: tuple[float, ...]
    reachable: tuple[float, ...]
    fewest: tuple[int, ...]
    fewest_reachable: tuple[int | None, ...]
    source: str


def compute_score_range(instance: RoomInstance, agent: AgentSpec, states: Sequence[RoomState]) -> ScoreRange:
    """Compute the range for episodes that begin in these states."""
    from hrl_escape.options.best_with_options import find_best_with_options  # these bring the planners in
    from hrl_escape.planning.best_known import find_best_known

    worst = instance.horizon * instance.reward.step
    starts = tuple((state.x, state.y, state.heading_steps, state.heading_offset) for state in states)
    try:
        known = [find_best_known(instance, state) for state in states]
    except EscapeError:  # a puzzle that planners cannot do
        known = []
    fewest = tuple(found.primitives for found in known if found.primitives is not None and found.value > worst)
    if len(fewest) < len(states):
        reward = instance.reward
        at_once = (reward.exit if reward.exit_replaces_step else reward.step + reward.exit,) * len(states)
        ones = (1,) * len(states)
        return ScoreRange(worst, starts, at_once, at_once, ones, ones, CEILING)
    best, reachable = tuple(found.value for found in known), known
    if agent.chooses_options and not agent.options.include_primitives:
        reachable = [find_best_with_options(instance, state, agent.options.flavour) for state in states]
    return ScoreRange(worst, starts, best, tuple(found.value for found in reachable), fewest,
                      tuple(found.primitives if found.value > worst else None for found in reachable), PLANNER)
