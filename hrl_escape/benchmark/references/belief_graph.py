"""Beliefs over dependency graphs, and the optimal expected cost of each.

A belief is the set of buttons that are on and the graphs that agree with all presses so far (Astrom 1965; Kaelbling,
Littman and Cassandra 1998). A press divides it by its outcome: the button turns on and opens the exit, turns on, or
stays off; in the last case nothing else changes, all buttons turn off, or the episode ends. Beliefs form an acyclic
graph, so one pass backwards computes the costs.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.references.graph_family import GraphFamily, can_light
from hrl_escape.benchmark.references.path_lengths import PathLengths
from hrl_escape.env.puzzles.buttons import VIOLATION_RULES
from hrl_escape.errors import UnsupportedError

MOST_BELIEFS = 3_000_000
"""Largest number of beliefs, at about 1 kB each."""


class BeliefGraph:
    """Beliefs that presses can lead to in a family of graphs, children before parents.

    Args:
        family: the graphs.
        lit: bits of the buttons that are on at first.

    Raises:
        UnsupportedError: more than `MOST_BELIEFS` beliefs.

    Attributes:
        opens: float32 (beliefs, buttons), probability that a press opens the exit.
        lights: probability that it turns the button on without opening the exit.
        fails: probability that it fails the puzzle.
        resets: probability that it visibly turns buttons off.
        lit: int32 (beliefs, buttons), the belief after a press that turns the button on; -1 if impossible.
        reset: the belief after a press that visibly turns buttons off.
        dark: the belief after a press without effect.
    """

    def __init__(self, family: GraphFamily, lit: int = 0) -> None:
        self.family = family
        self._numbers: dict[tuple[int, int], int] = {}
        self._rows: list[tuple[list[Any], ...]] = []
        self._levels: list[int] = []
        self.root = self._add(lit, np.arange(len(family.weights), dtype=np.int32))
        opens, lights, fails, resets, *after = zip(*self._rows, strict=True)
        self.opens, self.lights = np.array(opens, np.float32), np.array(lights, np.float32)
        self.fails, self.resets = np.array(fails, np.float32), np.array(resets, np.float32)
        self.lit, self.reset, self.dark = (np.array(beliefs, np.int32) for beliefs in after)
        del self._rows

    def __len__(self) -> int:
        return len(self.opens)

    def find(self, lit: int, graphs: NDArray[np.int32]) -> int | None:
        """Number of a belief, or None for one that no choice between presses of unlit buttons leads to.

        `lit` are the bits of the buttons that are on, `graphs` the ascending numbers, int32, of those that all presses
        agree with.
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
        opens, lights, fails, resets = ([0.0] * count for _ in range(4))
        after, reset, dark = ([-1] * count for _ in range(3))
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
            ended, undone, unchanged = split_mistakes(family.rules[graphs], ~allowed, lit)
            fails[button], resets[button] = (float(weights[part].sum()) / total for part in (ended, undone))
            for beliefs, part, bits in ((after, lit_only, lit | 1 << button), (reset, undone, 0),
                                        (dark, unchanged, lit)):
                if part.any():
                    beliefs[button] = self._add(bits, graphs[part])
                    level = max(level, self._levels[beliefs[button]])
        self._numbers[key] = len(self._rows)
        self._rows.append((opens, lights, fails, resets, after, reset, dark))
        self._levels.append(level + 1)
        return self._numbers[key]

    @cached_property
    def _by_level(self) -> list[NDArray[np.int64]]:
        """Numbers of beliefs by the longest way that is left from them; each leads to lower levels only."""
        levels = np.array(self._levels)
        order = np.argsort(levels, kind="stable")
        return np.split(order, np.cumsum(np.bincount(levels))[:-1])

    def solve(self, ways: PathLengths) -> NDArray[np.float32]:
        """Fewest expected primitives to the exit, by the optimal choices, float32 (beliefs, places).

        A puzzle that is failed counts as `ways.failure` primitives; infinite where no press opens the exit any more.
        """
        costs = np.full((len(self), len(ways.legs)), np.inf, np.float32)
        for beliefs in self._by_level:
            for button in range(self.family.count):
                here = self.compute_costs_after(costs, beliefs, button, ways)[:, ways.arrivals[:, button]]
                costs[beliefs] = np.minimum(here + ways.legs[:, button], costs[beliefs])
        return costs

    def compute_costs_after(self, costs: NDArray[np.float32], beliefs: NDArray[np.int64], button: int, ways: PathLengths
                            ) -> NDArray[np.float32]:
        """Expected primitives to the exit after a press, float32 (beliefs, places); infinite where it is in vain.

        `costs` are those from the beliefs that it leads to, `beliefs` the numbers of those before it.
        """
        opens, lights, fails, resets = (odds[beliefs, button, None] for odds in
                                        (self.opens, self.lights, self.fails, self.resets))
        after = opens * ways.leaving + fails * np.float32(ways.failure)
        for odds, then in ((lights, self.lit), (resets, self.reset), (1 - opens - lights - fails - resets, self.dark)):
            known = then[beliefs, button]
            after = after + odds * np.where(known[:, None] >= 0, costs[known], 0)
        return np.where(opens + lights > 0, after, np.float32(np.inf))


def split_mistakes(rules: NDArray[np.int64], mistaken: NDArray[np.bool_], lit: int) -> list[NDArray[np.bool_]]:
    """Split the graphs that make a press wrong by its visible effect: failure, reset, or none.

    Args:
        rules: rule for wrong presses of each graph, (graphs,).
        mistaken: whether the press is wrong under each graph, (graphs,).
        lit: bits of the buttons that were on; if none was, a reset has no visible effect.
    """
    ignored, resets, fails = (mistaken & (rules == VIOLATION_RULES.index(rule)) for rule in ("ignore", "reset", "fail"))
    return [fails, resets & bool(lit), ignored | resets & (not lit)]
