"""Beliefs over dependency graphs, and the fewest expected primitives that a searcher can need from each.

A belief is which buttons are lit and which graphs of a family agree with all presses so far. A press divides it: the
button lights and opens the exit, lights alone, or does not light. Whoever does not know the graph plans over beliefs
(Åström 1965; Kaelbling, Littman and Cassandra 1998); where presses are the only news, beliefs form a graph without
cycles, and one pass backwards gives the optimal expected cost.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from hrl_escape.comparison.references.graph_family import GraphFamily, can_light
from hrl_escape.env.puzzles.buttons import ViolationRule
from hrl_escape.errors import UnsupportedError

MOST_BELIEFS = 3_000_000
"""Largest belief graph, about 1 kB a belief."""


@dataclasses.dataclass(frozen=True)
class Ways:
    """Lengths of ways between places, in primitives.

    Attributes:
        legs: float (places, buttons), from a place to the press of a button.
        arrivals: int (places, buttons), the place of the robot after that.
        leaving: float (places,), from a place to the open exit.
    """

    legs: NDArray[np.floating]
    arrivals: NDArray[np.int64]
    leaving: NDArray[np.floating]


class BeliefGraph:
    """Every belief that presses can lead to, children before parents.

    Args:
        family: the graphs and how likely they are.
        on_violation: effect of a press with unmet parents: none, or all buttons go off.

    Raises:
        UnsupportedError: more than `MOST_BELIEFS` beliefs.

    Attributes:
        opens: float32 (beliefs, buttons), probability that a press opens the exit.
        lights: float32 (beliefs, buttons), probability that it lights the button and does not open the exit.
        lit: int32 (beliefs, buttons), the belief after that; -1 where it cannot be.
        dark: int32 (beliefs, buttons), the belief after a press that does not light the button; -1 where it cannot be.
    """

    def __init__(self, family: GraphFamily, on_violation: ViolationRule = "ignore") -> None:
        self.family, self.on_violation = family, on_violation
        self._numbers: dict[tuple[int, int], int] = {}
        self._rows: list[tuple[list[float], list[float], list[int], list[int]]] = []
        self._levels: list[int] = []
        self.root = self._add(0, np.arange(len(family.weights), dtype=np.int32))
        opens, lights, lit, dark = zip(*self._rows, strict=True)
        self.opens, self.lights = np.array(opens, np.float32), np.array(lights, np.float32)
        self.lit, self.dark = np.array(lit, np.int32), np.array(dark, np.int32)
        del self._rows

    def __len__(self) -> int:
        return len(self.opens)

    def find(self, lit: int, graphs: NDArray[np.int32]) -> int | None:
        """Number of a belief; None for one that no choice between presses of unlit buttons leads to.

        Args:
            lit: bits of the buttons that are lit.
            graphs: int32, ascending numbers of the graphs that agree with all presses.
        """
        return self._numbers.get((lit, hash(graphs.tobytes())))

    def _add(self, lit: int, graphs: NDArray[np.int32]) -> int:
        """Number of a belief, added with all that it can lead to if it is new."""
        key = lit, hash(graphs.tobytes())
        if key in self._numbers:
            return self._numbers[key]
        if len(self._numbers) >= MOST_BELIEFS:
            raise UnsupportedError(f"more than {MOST_BELIEFS:,} beliefs")
        family, count = self.family, self.family.count
        weights = family.weights[graphs]
        total, level = float(weights.sum()), -1
        opens, lights, after, failed = [0.0] * count, [0.0] * count, [-1] * count, [-1] * count
        for button in range(count):
            if lit >> button & 1:
                continue
            allowed = can_light(family.parents[graphs, button], lit)
            if not allowed.any():
                continue  # known to be in vain
            is_goal = allowed & (family.goals[graphs] == button)
            lit_only = allowed & ~is_goal
            opens[button] = float(weights[is_goal].sum()) / total
            lights[button] = float(weights[lit_only].sum()) / total
            if lit_only.any():
                after[button] = self._add(lit | 1 << button, graphs[lit_only])
                level = max(level, self._levels[after[button]])
            if not allowed.all():
                failed[button] = self._add(lit if self.on_violation == "ignore" else 0, graphs[~allowed])
                level = max(level, self._levels[failed[button]])
        self._numbers[key] = len(self._rows)
        self._rows.append((opens, lights, after, failed))
        self._levels.append(level + 1)
        return self._numbers[key]

    @cached_property
    def _by_level(self) -> list[NDArray[np.int64]]:
        """Numbers of beliefs by the longest way that is left from them; each leads to lower levels only."""
        levels = np.array(self._levels)
        order = np.argsort(levels, kind="stable")
        return np.split(order, np.cumsum(np.bincount(levels))[:-1])

    def solve(self, ways: Ways) -> NDArray[np.float32]:
        """Fewest expected primitives to the exit, by the optimal choices, from every belief at every place.

        Returns:
            float32 (beliefs, places); infinite where no press opens the exit any more.
        """
        costs = np.full((len(self), len(ways.legs)), np.inf, np.float32)
        for beliefs in self._by_level:
            for button in range(self.family.count):
                here = self.compute_costs_after(costs, beliefs, button, ways)[:, ways.arrivals[:, button]]
                costs[beliefs] = np.minimum(here + ways.legs[:, button], costs[beliefs])
        return costs

    def compute_costs_after(self, costs: NDArray[np.float32], beliefs: NDArray[np.int64], button: int, ways: Ways
                            ) -> NDArray[np.float32]:
        """Expected primitives to the exit after a press, float32 (beliefs, places); infinite where it is in vain.

        Args:
            costs: from the beliefs that the press leads to.
            beliefs: numbers of the beliefs before it.
            button: the button that is pressed.
            ways: lengths of ways.
        """
        opens, lights = self.opens[beliefs, button, None], self.lights[beliefs, button, None]
        lit, dark = self.lit[beliefs, button], self.dark[beliefs, button]
        after = (opens * ways.leaving
                 + lights * np.where(lit[:, None] >= 0, costs[lit], 0)
                 + (1 - opens - lights) * np.where(dark[:, None] >= 0, costs[dark], 0))
        return np.where(opens + lights > 0, after, np.float32(np.inf))


@lru_cache(maxsize=8)
def make_belief_graph(family: GraphFamily, on_violation: ViolationRule) -> BeliefGraph:
    """The belief graph of a family, kept for the next room."""
    return BeliefGraph(family, on_violation)
