"""What scores are measured by: a room's worst return, its best known, and what given actions can reach.

All are of the episodes that a run is evaluated in, start by start. The planners do the work
(`options.best_known`); nothing here learns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import EscapeError
from hrl_escape.experiments.grid import AgentSpec

__all__ = ["CEILING", "PLANNER", "Scale", "measure_scale"]

PLANNER, CEILING = "planner", "ceiling"


@dataclass(frozen=True)
class Scale:
    """The ends of the scale for a run's evaluation episodes.

    Attributes:
        worst: return of an episode without escape.
        starts: where each episode begins: x, y (m), heading (turn steps, and rad beyond them).
        best: best known return of each.
        reachable: best known return of each by the actions the agent has.
        source: what found `best`: `planner`, or `ceiling` where no plan is known and the
            return of an escape by the first primitive stands for it.
    """

    worst: float
    starts: tuple[tuple[float, ...], ...]
    best: tuple[float, ...]
    reachable: tuple[float, ...]
    source: str

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Scale:
        """What `dataclasses.asdict` gave and JSON carried."""
        return cls(
            value["worst"], tuple(tuple(start) for start in value["starts"]), tuple(value["best"]),
            tuple(value["reachable"]), value["source"],
        )


def measure_scale(instance: RoomInstance, agent: AgentSpec, states: Sequence[RoomState]) -> Scale:
    """Find the scale for episodes that begin in these states."""
    from hrl_escape.options.best_known import find_best_known  # brings the planners in

    worst = instance.horizon * instance.reward.step
    try:
        best = tuple(find_best_known(instance, state).value for state in states)
    except EscapeError:  # a puzzle that planners cannot do
        best = (worst,)
    source = PLANNER
    if min(best) <= worst:
        reward = instance.reward
        at_once = reward.exit if reward.exit_replaces_step else reward.step + reward.exit
        best, source = (at_once,) * len(states), CEILING
    reachable = best
    if source == PLANNER and agent.chooses_options and not agent.options.include_primitives:
        flavour = agent.options.flavour
        reachable = tuple(find_best_known(instance, state, options=flavour).value for state in states)
    starts = tuple((state.x, state.y, state.heading_steps, state.heading_offset) for state in states)
    return Scale(worst, starts, best, reachable, source)
