"""Beliefs over the puzzles that a configuration can draw, and the expected cost of each.

A belief holds, for every puzzle that agrees with all presses so far, its state and its odds. A press divides a belief
by what is seen after it. Unlike the beliefs of `belief_graph`, these can lead back to each other: a wrong press loses
progress, and with noise a press can have no effect. Value iteration computes the costs, from beliefs with few puzzles
to beliefs with many.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.references.graph_family import iterate_outcomes
from hrl_escape.benchmark.references.path_lengths import PathLengths
from hrl_escape.env.puzzles.base import Contacts, Puzzle, PuzzleConfig
from hrl_escape.errors import UnsupportedError

MOST_PUZZLE_BELIEFS = 200_000
"""Largest number of beliefs."""
LEAST_ODDS = 1e-4
"""Odds, relative to the likeliest puzzle, below which a puzzle that noise only makes unlikely does not fall."""
OPEN = -1
"""In place of a belief: the exit is open."""
_GRID = 1000  # steps of log odds in a unit
_CLOSE = 0.01  # primitives; value iteration ends at smaller changes

PuzzleOdds: TypeAlias = tuple[tuple[int, Any, int], ...]
"""(number of the puzzle, its state, log odds in steps below the likeliest) for each puzzle, in order."""


def list_drawn(config: PuzzleConfig) -> dict[Puzzle, float]:
    """Compute the probability of every puzzle that a configuration draws by `integers`, `choice` and `permutation`."""
    found: dict[Puzzle, float] = defaultdict(float)
    for puzzle, probability in iterate_outcomes(config.make_puzzle):
        found[puzzle] += probability
    return dict(found)


def find_solved(puzzle: Puzzle) -> Any:
    """Return a state of a puzzle that opens the exit, the first that presses reach."""
    queue, known = [puzzle.make_state()], set()
    for state in queue:  # grows
        if puzzle.is_solved(state):
            return state
        for target in range(len(puzzle.target_names)):
            then = puzzle.update(state, Contacts((target,)))
            if then not in known:
                known.add(then)
                queue.append(then)
    raise UnsupportedError(f"no presses open the exit of a puzzle of kind {puzzle.kind}")


class PuzzleBeliefs:
    """Beliefs that presses can lead to.

    Args:
        puzzles: puzzles that can be drawn, with their probabilities. They have the same targets.

    Raises:
        UnsupportedError: more than `MOST_PUZZLE_BELIEFS` beliefs.

    Attributes:
        root: the belief before the first press.
        chances: float32 (beliefs, targets, outcomes), probability of each outcome of a press.
        after: int32 (beliefs, targets, outcomes), number of the belief after it, or `OPEN`.
    """

    def __init__(self, puzzles: Mapping[Puzzle, float]) -> None:
        self._puzzles = tuple(puzzles)
        self._steps: dict[tuple[int, Any, int], list[tuple[float, Any, Any]]] = {}
        unit = max((round(-math.log(1 - chance) * _GRID) for puzzle in puzzles for chance in puzzle.chances), default=1)
        self._limit = math.ceil(-math.log(LEAST_ODDS) * _GRID / unit) * unit  # so that odds are multiples of one press
        most = max(puzzles.values())
        self.root: PuzzleOdds = tuple((number, puzzle.make_state(), self._count_steps(weight / most))
                                  for number, (puzzle, weight) in enumerate(puzzles.items()))
        self._numbers: dict[PuzzleOdds, int] = {self.root: 0}
        queue, count = [self.root], len(self._puzzles[0].target_names)
        rows: list[list[list[tuple[float, int]]]] = []
        for belief in queue:  # grows
            row: list[list[tuple[float, int]]] = []
            for target in range(count):
                ends: list[tuple[float, int]] = []
                for seen, (chance, then) in self.press(belief, target).items():
                    if not seen[0] and then not in self._numbers:
                        if len(self._numbers) >= MOST_PUZZLE_BELIEFS:
                            raise UnsupportedError(f"more than {MOST_PUZZLE_BELIEFS:,} beliefs")
                        self._numbers[then] = len(self._numbers)
                        queue.append(then)
                    ends.append((chance, OPEN if seen[0] else self._numbers[then]))
                row.append(ends)
            rows.append(row)
        shape = (len(rows), count, max(len(ends) for row in rows for ends in row))
        self.chances, self.after = np.zeros(shape, np.float32), np.zeros(shape, np.int32)
        for number, row in enumerate(rows):
            for target, ends in enumerate(row):
                self.chances[number, target, : len(ends)] = [chance for chance, _ in ends]
                self.after[number, target, : len(ends)] = [then for _, then in ends]
        self._sizes = np.array([len({number for number, _, _ in belief}) for belief in queue])

    def __len__(self) -> int:
        return len(self.chances)

    def find(self, belief: PuzzleOdds) -> int:
        """Return the number of a belief."""
        return self._numbers[belief]

    def press(self, belief: PuzzleOdds, target: int) -> dict[tuple[bool, tuple[float, ...]], tuple[float, PuzzleOdds]]:
        """Return the outcomes of a press: what is seen -> its probability and the belief after it.

        What is seen is whether the exit is open, and the puzzle's numbers in observations.
        """
        odds = [math.exp(-steps / _GRID) for _, _, steps in belief]
        total = sum(odds)
        parts: dict[tuple[bool, tuple[float, ...]], dict[tuple[int, Any], float]] = {}
        for (number, state, _), weight in zip(belief, odds, strict=True):
            for chance, then, seen in self._step(number, state, target):
                part = parts.setdefault(seen, {})
                part[number, then] = part.get((number, then), 0.0) + weight * chance / total
        found = {}
        for seen, part in parts.items():
            most = max(part.values())
            found[seen] = sum(part.values()), tuple(
                (number, state, self._count_steps(weight / most)) for (number, state), weight in sorted(part.items()))
        return found

    def _step(self, number: int, state: Any, target: int) -> list[tuple[float, Any, Any]]:
        key = number, state, target
        if key not in self._steps:
            puzzle, ends = self._puzzles[number], []
            edges = (0.0, *puzzle.chances, 1.0)
            for low, high in zip(edges, edges[1:], strict=False):
                then = puzzle.update(state, Contacts((target,), uniform=(low + high) / 2))
                ends.append((high - low, then, (puzzle.is_solved(then), puzzle.observe(then))))
            self._steps[key] = ends
        return self._steps[key]

    def _count_steps(self, odds: float) -> int:
        """Return log odds below 1 in steps, with a limit, so that there are finitely many beliefs."""
        return min(round(-math.log(odds) * _GRID), self._limit)

    def solve(self, ways: PathLengths) -> NDArray[np.float32]:
        """Return the fewest expected primitives from each belief and place, (beliefs + 1, places).

        The last row, number `OPEN`, is the way to the exit.
        """
        costs = np.zeros((len(self) + 1, len(ways.legs)), np.float32)
        costs[OPEN] = ways.leaving
        for size in np.unique(self._sizes):
            group, change = np.flatnonzero(self._sizes == size), math.inf
            while change > _CLOSE:
                found = np.min([self.compute_costs_after(costs, group, target)[:, ways.arrivals[:, target]]
                                + ways.legs[:, target] for target in range(self.chances.shape[1])], axis=0)
                change = float(np.abs(found - costs[group]).max())
                costs[group] = found
        return costs

    def compute_costs_after(self, costs: NDArray[np.float32], beliefs: NDArray[np.integer], target: int
                            ) -> NDArray[np.float32]:
        """Return the expected primitives to the exit after a press, float32 (beliefs, places)."""
        return np.einsum("bk,bkp->bp", self.chances[beliefs, target], costs[self.after[beliefs, target]])
