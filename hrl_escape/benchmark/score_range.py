"""Scales of a comparison: worst and best known returns, and the fewest known primitives of an escape.

Planners compute them for the starts of a run's evaluation episodes (`planning.best_known`).
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import EscapeError
from hrl_escape.files import read_json, write_json
from hrl_escape.version import __version__

PLANNER, CEILING = "planner", "ceiling"


@dataclass(frozen=True)
class ScoreRange:
    """Best known and worst results of a run's evaluation episodes."""

    worst: float  # return of an episode without escape
    starts: tuple[tuple[float, ...], ...]
    """Pose at the start of each episode: x, y (m), heading (turn steps, and rad beyond them); for several rooms also a
    number for the room."""
    best: tuple[float, ...]  # best known return of each
    reachable: tuple[float, ...]  # best known return of each with the agent's actions
    fewest: tuple[float, ...]  # primitives of the best known escape of each, or their expectation
    fewest_reachable: tuple[float | None, ...]  # the same with the agent's actions, or None if they cannot escape
    source: str
    """Source of `best` and `fewest`: `planner`, or `ceiling` if no plan is known and an escape by the first primitive
    is assumed."""
    is_expected: bool = False
    """True if `best` and `fewest` are means over rollouts of the planner, in rooms with noise or slip; a single episode
    can be better."""


def compute_score_range(starts: Sequence[tuple[RoomInstance, RoomState]], agent: AgentSpec, cache: Path,
                        parts: int = 1) -> ScoreRange:
    """Compute the score range of episodes for an agent's actions.

    Args:
        starts: room and first state of each episode, or of each room of a sequence.
        agent: its options decide which escapes are reachable.
        cache: folder for results of planners, shared by runs.
        parts: number of rooms in an episode, which share the horizon.
    """
    is_limited = agent.chooses_options and not agent.options.include_primitives
    ends = [_find_ends(*start, agent.options.option_set if is_limited else None, cache) for start in starts]
    instance = starts[0][0]
    worst = instance.horizon * instance.reward.step / parts
    several = len({room.id for room, _ in starts}) > 1
    poses = tuple((state.x, state.y, state.heading_steps, state.heading_offset,
                   *((float(int(room.digest[:12], 16)),) if several else ())) for room, state in starts)
    if any(end is None for end in ends):
        reward = instance.reward
        at_once = (reward.on_exit,) * len(starts)
        ones = (1,) * len(starts)
        return ScoreRange(worst, poses, at_once, at_once, ones, ones, CEILING)
    best, fewest, reachable, fewest_reachable = zip(*(end for end in ends if end), strict=True)
    return ScoreRange(worst, poses, best, reachable, fewest, fewest_reachable, PLANNER,
                      any(_has_noise(room) for room, _ in starts))


def _has_noise(instance: RoomInstance) -> bool:
    """Return whether the scales of a room are expectations."""
    return instance.dynamics.is_random and instance.dynamics.kind == "kinematic"


Ends = tuple[float, float, float, "float | None"]
"""Best known return and its primitives; the same with options only, where primitives can be None."""


def _find_ends(instance: RoomInstance, state: RoomState, option_set: str | None, cache: Path) -> Ends | None:
    """Find the best known results from one state, with a cache, or None if no planner finds an escape.

    `option_set` is given if options are the only actions.
    """
    start = [__version__, option_set, state.x, state.y, state.heading_steps, state.heading_offset, state.joint_steps]
    if _has_noise(instance):
        start.append("expected")
    path = cache / instance.id / f"{hashlib.sha256(json.dumps(start).encode()).hexdigest()[:12]}.json"
    if path.exists():
        with contextlib.suppress(EscapeError, TypeError, LookupError, ValueError):  # damaged: computed again
            known = read_json(path, "best known results")["ends"]
            if known is None:
                return None
            best, fewest, reachable, few = known
            return float(best), float(fewest), float(reachable), None if few is None else float(few)
    ends = _compute_ends(instance, state, option_set)
    write_json(path, {"start": start, "ends": ends}, indent=None)
    return ends


def _compute_ends(instance: RoomInstance, state: RoomState, option_set: str | None) -> Ends | None:
    from hrl_escape.options.best_with_options import find_best_with_options  # these load the planners
    from hrl_escape.planning.best_known import find_best_known

    worst = instance.horizon * instance.reward.step
    try:
        known = find_best_known(instance, state)
    except EscapeError:  # a puzzle that planners do not support
        return None
    if known.primitives is None or known.value <= worst:
        return None
    reachable = known if option_set is None else find_best_with_options(instance, state, option_set)
    ends = known.value, known.primitives, reachable.value, reachable.primitives if reachable.value > worst else None
    return _expect(instance, state, ends) if _has_noise(instance) else ends


def _expect(instance: RoomInstance, state: RoomState, ends: Ends) -> Ends:
    """Compute ends under noise by rollouts of the planner; the gap of the options is the same as without noise."""
    from hrl_escape.planning.best_known import compute_expected_escape

    best, fewest, reachable, fewest_reachable = ends
    value, primitives = compute_expected_escape(instance, state)
    return (value, primitives, value - (best - reachable),
            None if fewest_reachable is None else primitives * fewest_reachable / fewest)
