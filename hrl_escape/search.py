"""Search for the cheapest steps to a goal: exact as long as that is quick, then greedy."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Hashable, Iterable
from typing import TypeVar

__all__ = ["MOST_EXACT", "find_cheapest_steps"]

MOST_EXACT = 10_000
"""States beyond which the search goes on greedily, so that its steps need not be the cheapest."""
_GREED = 5
"""Weight of the estimate from there on."""

_State = TypeVar("_State", bound=Hashable)
_Step = TypeVar("_Step")


def find_cheapest_steps(
    start: _State, is_goal: Callable[[_State], bool],
    list_steps: Callable[[_State], Iterable[tuple[_Step, int, _State]]],
    estimate: Callable[[_State], float], most: float = math.inf,
) -> tuple[_Step, ...] | None:
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
