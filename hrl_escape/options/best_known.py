"""The best return known for a room: what scores are normalised by.

Without `options` it is the best plan of primitives that the planners find; with options it is
the best that those options alone can do, so that a result's distance from the best splits
into an option gap and a learning gap. Known returns can be beaten: `record_return` takes a
better one over and says so.
"""

from __future__ import annotations

import heapq
import itertools
import math
import threading
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.errors import ConfigError, FileReadError, PlanningFailed
from hrl_escape.files import read_json, write_json
from hrl_escape.options.bounds import LegBounds
from hrl_escape.options.execution import Run
from hrl_escape.options.goals import ExitGoal, PressGoal
from hrl_escape.options.joint import find_joint_plan
from hrl_escape.options.option import Option
from hrl_escape.options.planner import RoomPlanner, get_planner
from hrl_escape.options.routes import Pose, get_pose
from hrl_escape.options.synthesis import FLAVOURS, AncestorsOption, PlannedOption, make_meta_options
from hrl_escape.options.tasks import Leg, TaskSearch

__all__ = ["BestKnown", "best_known_return", "find_best_known", "record_return"]

MOST_STARTS = 32
"""Of an instance with more starts, the first so many stand for all."""
MOST_RUNS = 20_000
BOUND_LEGS = 20_000
_PLAIN = (PressGoal, ExitGoal)


class BestKnown(NamedTuple):
    """The best return known from one state.

    Attributes:
        value: undiscounted return.
        source: what found it: `planner`, `options`, or what `record_return` was told.
        upper_bound: no return is higher, by geometry alone; infinity where that was not asked for.
    """

    value: float
    source: str
    upper_bound: float


def best_known_return(instance: RoomInstance, *, options: str | Sequence[Option] | None = None,
                      state: RoomState | None = None, records: str | Path | None = None) -> float:
    """The best return known for a room, without noise, slip and physics.

    Args:
        instance: the room.
        options: None for the best by primitives; options, or a flavour of meta-actions, for the best that
            these alone can do.
        state: where the episode begins; None for the mean over the instance's starts.
        records: JSON file of returns that agents reached (see `record_return`), read if it exists.

    Returns:
        Undiscounted return; `horizon` times the step's reward where nothing is known to escape.
    """
    if state is not None:
        return find_best_known(instance, state, options=options, records=records).value
    rules = get_planner(instance).rules
    starts = [rules.make_state(start) for start in instance.starts[:MOST_STARTS]]
    return float(np.mean([find_best_known(instance, s, options=options, records=records).value for s in starts]))


def find_best_known(instance: RoomInstance, state: RoomState, *, options: str | Sequence[Option] | None = None,
                    records: str | Path | None = None, bound: bool = False) -> BestKnown:
    """The best return known from one state, with where it comes from.

    Args:
        instance: the room.
        state: where the episode begins.
        options: see `best_known_return`.
        records: see `best_known_return`.
        bound: work out `upper_bound` too.
    """
    name = options if isinstance(options, str) else "" if options is None else None
    key = (instance.id, name, get_pose(state))
    with _LOCK:
        found = _KNOWN.get(key) if name is not None else None
    if found is None:
        planner = get_planner(instance)
        if options is None or options == "press":
            found = _find_by_plan(planner, state, joint=options is None)
        else:
            if isinstance(options, str) and options not in FLAVOURS:
                raise ConfigError("options", options, f"options, or one of {FLAVOURS}")
            made = make_meta_options(instance, options, planner) if isinstance(options, str) else tuple(options)
            found = _find_by_options(planner, state, made)
        if name is not None:
            with _LOCK:
                found = _KNOWN.setdefault(key, found)
    if options is None and records is not None:
        recorded = _read_records(records).get(_name_record(instance, state))
        if recorded is not None and recorded["return"] > found.value:
            found = BestKnown(recorded["return"], recorded["source"], math.inf)
    if bound and found.upper_bound == math.inf:
        found = found._replace(upper_bound=_compute_upper_bound(instance, state))
    return found


def record_return(instance: RoomInstance, state: RoomState, value: float, source: str,
                  records: str | Path | None = None) -> bool:
    """Take over a return if it is better than what was known; warns when it is.

    In rooms with noise, slip or physics nothing is taken over: a lucky episode is no reference.

    Args:
        instance: the room.
        state: where the episode began.
        value: its undiscounted return.
        source: who reached it, such as `dqn, seed 3`.
        records: JSON file that keeps better returns; None keeps them for this process.

    Returns:
        Whether it was better.
    """
    dynamics = instance.dynamics
    if dynamics.noise or dynamics.slip or dynamics.kind == "physics":
        return False
    known = find_best_known(instance, state, records=records)
    if value <= known.value + 1e-9:
        return False
    with _LOCK:
        _KNOWN[instance.id, "", get_pose(state)] = BestKnown(value, source, math.inf)
        if records is not None:
            content = _read_records(records)
            content[_name_record(instance, state)] = {"return": value, "source": source}
            write_json(records, content)
    warnings.warn(
        f"{source} reached a return of {value:g} in room {instance.id} from ({state.x:.2f}, {state.y:.2f}), where "
        f"{known.value:g} was the best known (by {known.source}). Scores of this room are normalised anew",
        stacklevel=2,
    )
    return True


_KNOWN: dict[tuple[str, str | None, Pose], BestKnown] = {}
_LOCK = threading.RLock()


def _name_record(instance: RoomInstance, state: RoomState) -> str:
    arm = "".join(f" {n}" for n in state.joint_steps)
    return f"{instance.id} {state.x!r} {state.y!r} {state.heading_steps} {state.heading_offset!r}{arm}"


def _read_records(records: str | Path) -> dict:
    try:
        content = read_json(records, "file of best known returns")
    except FileReadError:
        if Path(records).exists():
            raise
        return {}
    if not isinstance(content, dict):
        raise FileReadError(f"{records}: this is no file of best known returns")
    return content


def _give_up(instance: RoomInstance) -> float:
    return instance.horizon * instance.reward.step


def _compute_return(instance: RoomInstance, primitives: float) -> float:
    """Return of escaping with so many primitives; that of never escaping if the horizon comes first."""
    if primitives > instance.horizon:
        return _give_up(instance)
    reward = instance.reward
    bonus = reward.exit if reward.exit_replaces_step else reward.step + reward.exit
    return reward.step * (primitives - 1) + bonus


def _find_by_plan(planner: RoomPlanner, state: RoomState, joint: bool) -> BestKnown:
    """Return of the planner's escape; its legs are meta-actions unless they are planned jointly."""
    instance = planner.instance
    try:
        plan = planner.solve(state)
    except PlanningFailed:
        return BestKnown(_give_up(instance), "nothing", math.inf)
    cost = plan.cost
    if joint and instance.dynamics.press_with == "body" and all(isinstance(p.goal, _PLAIN) for p in plan.parts):
        goals = [part.goal for part in plan.parts if isinstance(part.goal, PressGoal)]
        found = find_joint_plan(planner.rules, state, [*goals, ExitGoal()], planner.get_fields(True),
                                planner.get_fields(False), cost)
        cost = len(found) if found else cost
    return BestKnown(_compute_return(instance, cost), "planner" if joint else "options", math.inf)


def _compute_upper_bound(instance: RoomInstance, state: RoomState) -> float:
    """Return of the fewest primitives that straight lines allow, over all orders."""
    bounds = LegBounds(instance)
    search = TaskSearch(instance.puzzle.make_symbolic_model(), lower_bound=bounds.bound_leg)

    def extend(last, then):
        cost = bounds.bound_start(state, then) if last is None else bounds.bound_leg(last, then)
        return Leg(cost, then)

    tasks = search.find_order(instance.puzzle.get_facts(state.puzzle), None, extend, BOUND_LEGS)
    return _give_up(instance) if tasks is None else _compute_return(instance, max(1.0, tasks.lower_bound))


# --- with options alone ----------------------------------------------------------------------


def _find_by_options(planner: RoomPlanner, state: RoomState, options: Sequence[Option]) -> BestKnown:
    """Search over sequences of options, each run to its end by the room's kinematics.

    Options that go for one goal by plan are told apart by (puzzle, option) and keep their
    cheapest end, as in task planning; after any other option the pose counts too.
    """
    instance, rules = planner.instance, planner.rules
    tie = itertools.count()
    heap: list[tuple[int, int, RoomState, bool]] = [(0, next(tie), state, False)]
    best: dict[tuple, int] = {}
    runs = 0
    while heap and runs < MOST_RUNS:
        spent, _, here, escaped = heapq.heappop(heap)
        if escaped:
            return BestKnown(_compute_return(instance, spent), "options", math.inf)
        for index, option in enumerate(options):
            if not option.initiation(here):
                continue
            runs += 1
            after, duration, escapes = simulate(option, here, rules, instance.horizon - spent)
            planned = isinstance(option, (PlannedOption, AncestorsOption))
            if duration == 0 or (planned and not escapes and after.puzzle == here.puzzle):
                continue
            key = (after.puzzle, index if planned else get_pose(after))
            if escapes or spent + duration < best.get(key, instance.horizon):
                best[key] = spent + duration
                heapq.heappush(heap, (spent + duration, next(tie), after, escapes))
    return BestKnown(_give_up(instance), "nothing", math.inf)


def simulate(option: Option, state: RoomState, rules: Kinematics, most: int) -> tuple[RoomState, int, bool]:
    """Run an option without noise; returns the state reached, primitives, and whether it escaped.

    Probabilistic terminations are drawn from a fixed seed. An option whose planning fails
    runs no further.
    """
    rng = np.random.default_rng(0)
    here = state
    count = 0
    try:
        run = Run(0, option, here)
        while count < most:
            step = rules.step(here, run.choose(here))
            here, count = step.state, count + 1
            if step.terminated:
                return here, count, True
            if run.ends_at(here, rng):
                break
    except PlanningFailed:
        pass
    return here, count, False
