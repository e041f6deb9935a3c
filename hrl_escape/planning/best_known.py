"""Best known return of a room, the reference that normalises scores.

It is the return of the best plan of primitives that the planners find, until an agent finds a better one.
`hrl_escape.options.best_with_options` computes the best return with given options, which splits the distance from the
best into an option gap and a learning gap. Where moves err or slip, `compute_expected_escape` returns what the planner
can expect.
"""

from __future__ import annotations

import hashlib
import math
import threading
import warnings
from collections import OrderedDict
from collections.abc import Hashable
from typing import NamedTuple

import numpy as np

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.noise import draw_episode
from hrl_escape.errors import EscapeError, PlanningFailed
from hrl_escape.planning.goals import Goal
from hrl_escape.planning.lower_bounds import bound_escape
from hrl_escape.planning.plan import Plan, strip
from hrl_escape.planning.planner import RoomPlanner, get_planner
from hrl_escape.planning.route import Pose, get_pose

MOST_STARTS = 32
"""Maximum number of starts of an instance that are used."""
ORDERS = 3
"""Number of operator orders that are planned in detail."""
JOINT_NODES = 1_000_000
"""Search nodes of the joint search for a best known plan, about two seconds at most."""


class BestKnown(NamedTuple):
    """The best return known from one state.

    Attributes:
        value: undiscounted return.
        source: its origin: `planner`, `options`, or the source given to `record_return`.
        upper_bound: upper bound of every return, from geometry alone.
        primitives: length of the episode with this return, or None if no escape is known.
        plan: the plan with this return, or None if no escape is known or an agent reached the return.
    """

    value: float
    source: str
    upper_bound: float
    primitives: int | None = None
    plan: Plan | None = None


def best_known_return(instance: RoomInstance, *, state: RoomState | None = None) -> float:
    """Return the best known return of a room without noise, slip and physics.

    A random puzzle has its most probable outcomes.

    Args:
        instance: the room.
        state: first state of the episode, or None for the mean over the instance's starts.

    Returns:
        Undiscounted return; `horizon` times the reward of a step if no escape is known.
    """
    if state is not None:
        return find_best_known(instance, state).value
    return float(np.mean([find_best_known(instance, s).value for s in list_start_states(instance)]))


def list_start_states(instance: RoomInstance) -> list[RoomState]:
    """Return the instance's start states.

    These are its first `MOST_STARTS` starts, or as many pairs with the puzzle's first states.
    """
    rules, puzzles = get_planner(instance).rules, instance.puzzle.list_starts()
    states = [rules.make_state(start) for start in instance.starts[:MOST_STARTS]]
    if len(puzzles) == 1:
        return states
    pairs = [state._replace(puzzle=puzzle) for puzzle in puzzles for state in states]
    return [pairs[n] for n in np.linspace(0, len(pairs) - 1, min(len(pairs), MOST_STARTS)).astype(int)]


def find_best_known(instance: RoomInstance, state: RoomState) -> BestKnown:
    """Find the best known return from one state, with its source, its plan and an upper bound.

    It is the best of legs planned one by one in several orders, a joint search for a shorter escape over orders and
    poses (with more than six buttons, along the best of these orders), and returns that agents or given options have
    reached.

    Args:
        instance: the room.
        state: first state of the episode.
    """
    get_planner(instance).routes.check_query(state)
    key = (instance.id, get_pose(state), state.puzzle)
    with _LOCK:
        found = _KNOWN.get(key)
    if found is None:
        found = find_by_plan(get_planner(instance), state, jointly=True)
    with _LOCK:
        found = _KNOWN.get(key, found)
        _remember(instance, state, found)
    return found


def improve_best_known(instance: RoomInstance, state: RoomState, found: BestKnown) -> None:
    """Record a return above the best known one, found by a search over given options."""
    known = find_best_known(instance, state)
    if found.value > known.value:
        with _LOCK:
            _remember(instance, state, found._replace(upper_bound=known.upper_bound))


def record_return(instance: RoomInstance, state: RoomState, value: float, source: str) -> bool:
    """Record a return above the best known one in this process, and warn.

    Rooms with noise, slip, physics or a random puzzle keep their value, because a lucky episode is not a reference.

    Args:
        instance: the room.
        state: first state of the episode.
        value: its undiscounted return.
        source: its origin, such as `dqn, seed 3`.

    Returns:
        True if it was better. It is kept while the state is among the last `MOST_REMEMBERED`.
    """
    dynamics = instance.dynamics
    if dynamics.is_random or dynamics.kind == "physics" or instance.puzzle.is_random:
        return False
    known = find_best_known(instance, state)
    if value <= known.value + 1e-9:
        return False
    step = instance.reward.step
    follows = step and not instance.has_extra_reward  # without noise an episode's length follows from its return
    primitives = 1 + round((value - compute_escape_return(instance, 1)) / step) if follows else None
    with _LOCK:
        _remember(instance, state, BestKnown(value, source, known.upper_bound, primitives))
    warnings.warn(
        f"{source} reached a return of {value:g} in room {instance.id} from ({state.x:.2f}, {state.y:.2f}), where "
        f"{known.value:g} was the best known (by {known.source}). Scores of this room are now normalised by it",
        stacklevel=2,
    )
    return True


MOST_REMEMBERED = 512
"""Number of first states whose best known returns and plans are kept; the least recently used is dropped."""
_KNOWN: OrderedDict[tuple[str, Pose, Hashable], BestKnown] = OrderedDict()
_LOCK = threading.RLock()


def _remember(instance: RoomInstance, state: RoomState, found: BestKnown) -> None:
    """Store the knowledge of a state as the most recent. The caller holds the lock."""
    key = (instance.id, get_pose(state), state.puzzle)
    _KNOWN[key] = found
    _KNOWN.move_to_end(key)
    if len(_KNOWN) > MOST_REMEMBERED:
        _KNOWN.popitem(last=False)


def compute_worst_return(instance: RoomInstance) -> float:
    """Return the return of an episode without an escape."""
    return instance.horizon * instance.reward.step


def compute_escape_return(instance: RoomInstance, primitives: float) -> float:
    """Return the return of an escape after a number of primitives, or of no escape if the horizon comes first."""
    if primitives > instance.horizon:
        return compute_worst_return(instance)
    return instance.reward.step * (primitives - 1) + instance.reward.on_exit


def find_by_plan(planner: RoomPlanner, state: RoomState, jointly: bool) -> BestKnown:
    """Return the best return by plans, with legs planned jointly over all orders, or one by one as options do."""
    instance = planner.instance
    bound = compute_escape_return(instance, bound_escape(instance, state))
    try:
        best = planner.list_escapes(state, ORDERS)[0]
        best = planner.shorten_escape(state, best, JOINT_NODES) if jointly else best
    except PlanningFailed:
        return BestKnown(compute_worst_return(instance), "nothing", bound)
    if instance.has_extra_reward:
        return BestKnown(best.compute_return(), "planner" if jointly else "options", math.inf, best.cost, best)
    return BestKnown(compute_escape_return(instance, best.cost), "planner" if jointly else "options", bound,
                     best.cost, best)


ROLLOUTS = 20
"""Number of rollouts for an expectation."""


class Replanner:
    """Policy that follows the best known plan, and plans the next leg again when the robot is off the plan."""

    def __init__(self, instance: RoomInstance) -> None:
        self._instance = instance
        self._plan: Plan | None = None
        self._next = 0
        self._order: tuple[Goal, ...] = ()
        self._puzzle: Hashable = None

    def choose(self, state: RoomState, begins: bool) -> int | None:
        """Return the number of the next primitive, or None if no plan escapes from this state."""
        if begins or self._plan is None or not self._find_place(self._plan, state):
            self._plan, self._next = self._make_plan(state, begins), 0
        if self._plan is None or self._next >= len(self._plan.primitives):
            return None
        self._next += 1
        return self._plan.primitives[self._next - 1]

    def _find_place(self, plan: Plan, state: RoomState) -> bool:
        """Return whether the robot is at the plan's present state, or still at the one before a slip."""
        here = strip(state)
        if self._next < len(plan.primitives) and here == strip(plan.states[self._next]):
            return True
        if self._next and here == strip(plan.states[self._next - 1]):
            self._next -= 1
            return True
        return False

    def _make_plan(self, state: RoomState, begins: bool) -> Plan | None:
        planner = get_planner(self._instance)
        try:
            if begins:
                self._order = ()
                return find_best_known(self._instance, state).plan
            if not self._order or state.puzzle != self._puzzle:  # after a press another order can be the best
                self._order, self._puzzle = planner.order_goals(state), state.puzzle
            return planner.plan_onward(state, self._order)
        except EscapeError:
            self._order = ()
            return None


class ExpectedEscape(NamedTuple):
    """Means over rollouts of the `Replanner`."""

    value: float  # undiscounted return
    primitives: float  # primitives to the escape; the horizon for a rollout without one


def compute_expected_escape(instance: RoomInstance, state: RoomState, rollouts: int = ROLLOUTS) -> ExpectedEscape:
    """Return the planner's expected escape from one state, by rollouts with noise, without physics.

    The noise depends on the room and the number of the rollout, so the numbers are reproducible.
    """
    rules = Kinematics(instance)
    stream = int.from_bytes(hashlib.sha256(f"rollouts of {instance.id}".encode()).digest()[:8], "big") >> 1
    returns, lengths = [], []
    for number in range(rollouts):
        here = state._replace(noise_key=draw_episode(stream, number, 1)[1], primitives=0)
        policy, total, length, ended = Replanner(instance), 0.0, 0, False
        while not ended and length < instance.horizon:
            primitive = policy.choose(here, length == 0)
            if primitive is None:  # stands to the end
                total += (instance.horizon - length) * instance.reward.step
                length = instance.horizon
                break
            step = rules.step(here, primitive)
            here, total, length, ended = step.state, total + step.reward, length + 1, step.terminated
        returns.append(total)
        lengths.append(length)
    return ExpectedEscape(float(np.mean(returns)), float(np.mean(lengths)))
