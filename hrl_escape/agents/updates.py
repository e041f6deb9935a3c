"""How a learner hands out its updates, so that several learners can make theirs in one go.

`learn` of an agent is `observe` as a generator: it yields what an update needs and is sent what came of it. An agent
that is alone answers itself (`run_alone`); trials that run together are answered by one batched update
(`trials.py`). Nothing here knows networks.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Protocol

from hrl_escape.errors import DivergenceError

__all__ = ["Metrics", "Together", "Updates", "run_alone"]

Metrics = dict[str, float]
"""Numbers to log."""

Updates = Generator[Any, Mapping[str, float], Metrics]
"""Yields what an update is made from, is sent that update's metrics, returns those of the decision."""


class Together(Protocol):
    """Several agents of one class and the same settings, whose updates are made at once.

    An agent class that has `learn(transition) -> Updates` can be trained in trials; one whose `learn` yields
    has a static method `make_together(agents)` that gives such an object.
    """

    def update(self, requests: Sequence[Any]) -> list[Metrics | DivergenceError]:
        """Make one update of each agent, from what each yielded, in the agents' order.

        No agent's numbers may depend on the others'. One whose loss is not finite is left as it is.
        """
        ...


def run_alone(updates: Updates, update: Callable[[Any], Mapping[str, float]]) -> Metrics:
    """Let one agent make its updates as they come; returns the metrics of the decision."""
    try:
        request = next(updates)
        while True:
            request = updates.send(update(request))
    except StopIteration as end:
        return end.value
