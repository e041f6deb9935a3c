"""Best-first search: the frontier, and cheapest steps to a goal, exact within a budget and greedy beyond it."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Hashable, Iterable
from typing import Generic, TypeVar

MOST_EXACT = 10_000
"""Number of states after which the search becomes greedy, and its steps may no longer be the cheapest."""
_GREED = 5
"""Weight of the estimate in the greedy search."""

_State = TypeVar("_State", bound=Hashable)
_Step = TypeVar("_Step")
_Key = TypeVar("_Key", bound=Hashable)
_Node = TypeVar("_Node")


class OpenNodes(Generic[_Key, _Node]):
    """Open nodes of a best-first search: only the cheapest of each key; among equal estimates the first."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, float, _Key, _Node]] = []
        self._costs: dict[_Key, float] = {}
        self._pushed = 0

    def push(self, key: _Key, cost: float, estimate: float, node: _Node) -> None:
        """Add a node unless one with its key costs no more.

        `cost` is the cost of the way to the node, `estimate` the estimated cost of the whole way through it. The
        smallest estimate is popped first.
        """
        if cost < self._costs.get(key, math.inf):
            self._costs[key] = cost
            self._pushed += 1
            heapq.heappush(self._heap, (estimate, self._pushed, cost, key, node))

    def pop(self) -> tuple[float, int, float, _Key, _Node] | None:
        """Pop the node with the smallest estimate, as (estimate, number, cost, key, node), or None if there is none."""
        while self._heap:
            entry = heapq.heappop(self._heap)
            if entry[2] <= self._costs[entry[3]]:
                return entry
        return None


def find_cheapest_steps(start: _State, is_goal: Callable[[_State], bool],
                        list_steps: Callable[[_State], Iterable[tuple[_Step, int, _State]]],
                        estimate: Callable[[_State], float], most: float = math.inf) -> tuple[_Step, ...] | None:
    """Find the cheapest steps from a state to a goal by A*, or None if there are none within `most` states.

    After `MOST_EXACT` states the estimate counts five times, and the steps may no longer be the cheapest.

    Args:
        start: initial state.
        is_goal: returns whether a state is a goal.
        list_steps: returns the steps from a state, as (step, cost, next state).
        estimate: lower bound on the cost from a state to a goal; infinite if no goal is reachable.
        most: largest number of states to expand.
    """
    tie, weight, rest = itertools.count(), 1, estimate(start)
    cost: dict[_State, int] = {start: 0}
    came: dict[_State, tuple[_State, _Step]] = {}
    queue, done = [(rest, rest, next(tie), start)] if rest < math.inf else [], set[_State]()
    while queue and len(done) < most:
        *_, here = heapq.heappop(queue)
        if is_goal(here):
            found: list[_Step] = []
            while here in came:
                here, step = came[here]
                found.append(step)
            return tuple(reversed(found))
        if here in done:
            continue
        done.add(here)
        if len(done) == MOST_EXACT:
            weight = _GREED
            queue = [(cost[then] + weight * rest, rest, number, then) for _, rest, number, then in queue]
            heapq.heapify(queue)
        for step, price, then in list_steps(here):
            total = cost[here] + price
            if total < cost.get(then, math.inf) and (rest := estimate(then)) < math.inf:
                cost[then], came[then] = total, (here, step)
                heapq.heappush(queue, (total + weight * rest, rest, next(tie), then))
    return None
