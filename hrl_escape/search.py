"""Best-first search: the frontier, and the cheapest steps to a goal, exact as long as that is quick, then greedy."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Hashable, Iterable
from typing import Generic, TypeVar

MOST_EXACT = 10_000
"""States beyond which the search goes on greedily, so that its steps need not be the cheapest."""
_GREED = 5
"""Weight of the estimate from there on."""

_State = TypeVar("_State", bound=Hashable)
_Step = TypeVar("_Step")
_Key = TypeVar("_Key", bound=Hashable)
_Node = TypeVar("_Node")


class OpenNodes(Generic[_Key, _Node]):
    """Open nodes of a best-first search: of each key only the one that costs least, of equal estimates the first."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, float, _Key, _Node]] = []
        self._costs: dict[_Key, float] = {}
        self._pushed = 0

    def push(self, key: _Key, cost: float, estimate: float, node: _Node) -> None:
        """Add a node unless one with its key has come that costs no more.

        The cost is that of the way to it, the estimate that of the whole way through it; the least is taken first.
        """
        if cost < self._costs.get(key, math.inf):
            self._costs[key] = cost
            self._pushed += 1
            heapq.heappush(self._heap, (estimate, self._pushed, cost, key, node))

    def pop(self) -> tuple[float, int, float, _Key, _Node] | None:
        """Take out the node of least estimate, as (estimate, number, cost, key, node); None if none is left."""
        while self._heap:
            entry = heapq.heappop(self._heap)
            if entry[2] <= self._costs[entry[3]]:
                return entry
        return None


def find_cheapest_steps(start: _State, is_goal: Callable[[_State], bool],
                        list_steps: Callable[[_State], Iterable[tuple[_Step, int, _State]]],
                        estimate: Callable[[_State], float], most: float = math.inf) -> tuple[_Step, ...] | None:
    """A* from a state to a goal; None if there is no way, or none within `most` states.

    Beyond `MOST_EXACT` states the estimate counts five times, and the steps need not be the cheapest.

    Args:
        start: first state.
        is_goal: says whether a state is a goal.
        list_steps: steps from a state, as (step, its cost, next state).
        estimate: lower bound of the cost from a state to a goal; infinite where none can be reached.
        most: states after which the search gives up.
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
