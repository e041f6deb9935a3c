"""Lights Out on the walls: a press flips a light and its neighbours on a board of rows and columns.

The exit opens while the board shows the goal pattern. The tasks are those in OGBench's puzzle environments (Park et al.
2025), whose presses have the same effect. Presses commute, and two presses of one light cancel. The fewest presses are
therefore the smallest solution of a linear system over GF(2) (Anderson and Feil 1998). The state is a word whose bit i
is light i, row by row.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Annotated

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Panels, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.bits import BitPuzzle
from hrl_escape.env.puzzles.mixins import Graphed
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.errors import ConfigError
from hrl_escape.names import join_words
from hrl_escape.settings import Range

TASKS: dict[tuple[int, int], tuple[tuple[str, str], ...]] = {
    (3, 3): (("000 000 000", "110 101 011"), ("111 111 111", "011 111 111"), ("010 111 010", "101 010 101"),
             ("010 101 010", "111 111 111"), ("111 111 111", "101 101 101")),
    (4, 4): (("0000 0000 0000 0000", "1111 1111 1111 1111"), ("1111 1111 1111 1111", "1111 1001 1001 1111"),
             ("1000 0000 0000 0001", "0101 1010 0101 1010"), ("1001 1001 1001 1001", "0000 0000 0000 0000"),
             ("0101 0010 0001 1000", "0000 0000 0000 0000")),
    (4, 5): (("11011 01010 01010 11011", "00000 00000 00000 00000"),
             ("00000 00000 00000 00000", "11111 11111 11111 11111"),
             ("00000 00100 00100 00000", "11111 10001 10001 11111"),
             ("00000 00000 00000 00000", "00000 00100 00100 00000"),
             ("00000 00000 00000 00000", "10001 01110 01110 10001")),
    (4, 6): (("110111 001010 010100 111011", "000000 000000 000000 000000"),
             ("111111 111111 111111 111111", "000000 000000 000000 000000"),
             ("000000 000000 000000 000000", "111110 110101 101011 011111"),
             ("010101 101010 010101 101010", "100001 000000 000000 100001"),
             ("000000 000000 000000 000000", "100001 011110 011110 100001")),
}  # fmt: skip
"""(rows, columns) -> pairs of patterns (start, goal), one word per row."""


@dataclasses.dataclass(frozen=True)
class LightsOutConfig(PuzzleConfig):
    """Configuration of Lights Out."""

    kind = "lights-out"
    rows: Annotated[int, Range(1, 6)] = 3
    """Number of rows of the board."""
    columns: Annotated[int, Range(1, 6)] = 3
    """Number of columns of the board."""
    task: Annotated[int, Range(1, 5)] | None = None
    """Number of a task of OGBench, for 3 x 3, 4 x 4, 4 x 5 and 4 x 6. By default from all off to all on, or
    scrambled."""
    scramble: Annotated[int, Range(0, 36)] = 0
    """Number of different presses, drawn by the instance seed, from all off to the goal. More presses make a harder
    goal. 0: the goal is all on."""
    buttons: Panels = Panels(width=0.8)
    """Sizes and places of the lights' panels."""

    def check(self) -> None:
        """Check the limits that relate several fields."""
        if self.task is not None and (self.rows, self.columns) not in TASKS:
            sizes = ", ".join(f"{rows} x {columns}" for rows, columns in TASKS)
            raise ConfigError("puzzle.task", self.task, f"a board of {sizes}")
        if self.task is not None and self.scramble:
            raise ConfigError("puzzle.scramble", self.scramble, "0 if puzzle.task is given")
        if self.scramble > self.rows * self.columns:
            raise ConfigError("puzzle.scramble", self.scramble, f"at most {self.rows * self.columns} presses")
        super().check()

    def make_puzzle(self, rng: np.random.Generator) -> LightsOutPuzzle:
        """Sample the scrambling presses, if any."""
        count = self.rows * self.columns
        start, goal = 0, (1 << count) - 1
        if self.task is not None:
            start, goal = map(_read, TASKS[self.rows, self.columns][self.task - 1])
        elif self.scramble:
            goal = 0
            for light in rng.choice(count, self.scramble, replace=False).tolist():
                goal ^= list_flips(count, self.columns)[light]
        return LightsOutPuzzle(count, self.columns, start, goal)


@dataclasses.dataclass(frozen=True)
class LightsOutPuzzle(Graphed, BitPuzzle):
    """A concrete board. The name of light i, row by row, is `light-<i+1>`."""

    kind, word = "lights-out", "light"
    about = "A press flips several lights of a board. The exit opens once the lights show a goal pattern."
    count: Annotated[int, Range(1, 36)] = 1
    """Number of lights on the board, rows times columns."""
    columns: Annotated[int, Range(1, 36)] = 1
    """Number of lights in a row."""
    start: Annotated[int, Range(0, 2**36 - 1)] = 0
    """Start pattern, as a word."""
    goal: Annotated[int, Range(0, 2**36 - 1)] = 1
    """Goal pattern, as a word; it opens the exit."""

    def check(self) -> None:
        """Check that the board is a rectangle and that the goal is reachable."""
        if self.count % self.columns:
            raise ConfigError("puzzle.columns", self.columns, f"a divisor of puzzle.count = {self.count}")
        for name in ("start", "goal"):
            if getattr(self, name) >> self.count:
                raise ConfigError(f"puzzle.{name}", getattr(self, name), f"below 2^{self.count}")
        if self._find_due(self.start) is None:
            raise ConfigError("puzzle.goal", self.goal, "a pattern that presses can reach from puzzle.start")

    def _find_due(self, state: int) -> int | None:
        return find_fewest_presses(self.count, self.columns, state ^ self.goal)

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Indices of the lights that are on in the goal."""
        return tuple(i for i in range(self.count) if self.goal >> i & 1)

    def make_state(self) -> int:
        """Return the start pattern."""
        return self.start

    def is_state(self, state: object) -> bool:
        """Return whether an untrusted value is a pattern that can reach the goal."""
        return super().is_state(state) and isinstance(state, int) and self._find_due(state) is not None

    def update(self, state: int, contacts: Contacts) -> int:
        """Flip each pressed light and its neighbours."""
        for light in contacts.pressed:
            state ^= list_flips(self.count, self.columns)[light]
        return state

    def is_solved(self, state: int) -> bool:
        """Return whether the board shows the goal pattern."""
        return state == self.goal

    def observe(self, state: int) -> tuple[float, ...]:
        """Return the lights, then the goal's lights: 1 on, 0 off."""
        return tuple(float(word >> i & 1) for word in (state, self.goal) for i in range(self.count))

    @property
    def light_numbers(self) -> tuple[int, ...]:
        """Index of each light among the observation numbers."""
        return tuple(range(self.count))

    def describe(self, state: int) -> tuple[str, ...]:
        """Return a sentence with the lights that are on in the goal."""
        wanted = [self.target_names[i] for i in self.goal_targets]
        return (f"Wanted on: {join_words(wanted) or 'none'}; the others off.",)

    def compute_progress(self, state: int) -> float:
        """Return the fraction, in [0, 1], of the lights that equal the goal's."""
        return 1.0 - (state ^ self.goal).bit_count() / self.count

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `settled(light-i)` for every light that the shortest solution from this state does not press."""
        due = self._find_due(state)
        due = (1 << self.count) - 1 if due is None else due
        return frozenset(f"settled({name})" for i, name in enumerate(self.target_names) if not due >> i & 1)

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: one operator per light, applicable while the shortest solution presses it."""
        fact = [f"settled({name})" for name in self.target_names]
        operators = (Operator(f"press-{name}", name, "press", forbidden=frozenset({fact[i]}), add=frozenset({fact[i]}))
                     for i, name in enumerate(self.target_names))
        return SymbolicModel(tuple(fact), tuple(operators), frozenset(fact))


@lru_cache
def list_flips(count: int, columns: int) -> tuple[int, ...]:
    """Return for each light the word of the lights that its press flips."""
    flips = []
    for light in range(count):
        row, column = divmod(light, columns)
        near = ((row, column), (row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1))
        flips.append(sum(1 << i * columns + j for i, j in near if 0 <= i < count // columns and 0 <= j < columns))
    return tuple(flips)


@lru_cache
def _eliminate(count: int, columns: int) -> tuple[tuple[tuple[int, int, int], ...], tuple[int, ...]]:
    """Gauss-Jordan elimination of the effects of presses.

    Returns rows (pivot bit, flips, presses with that effect), and a basis of the sets of presses without effect.
    """
    rows: list[tuple[int, int, int]] = []
    quiet = []
    for light, flips in enumerate(list_flips(count, columns)):
        presses = 1 << light
        for bit, other, made_by in rows:
            if flips & bit:
                flips, presses = flips ^ other, presses ^ made_by
        if not flips:
            quiet.append(presses)
            continue
        pivot = flips & -flips
        rows = [(bit, other ^ flips, made_by ^ presses) if other & pivot else (bit, other, made_by)
                for bit, other, made_by in rows]
        rows.append((pivot, flips, presses))
    return tuple(rows), tuple(quiet)


@lru_cache(maxsize=65_536)
def find_fewest_presses(count: int, columns: int, flips: int) -> int | None:
    """Return the smallest set of presses that flips exactly the lights in `flips`, as a word, or None if there is none.

    Among the smallest sets it returns the least number. After one of its presses, the answer is the remaining presses.
    """
    rows, quiet = _eliminate(count, columns)
    presses = 0
    for bit, other, made_by in rows:
        if flips & bit:
            flips, presses = flips ^ other, presses ^ made_by
    if flips:
        return None
    sets = [presses]
    for nothing in quiet:
        sets += [each ^ nothing for each in sets]
    return min(sets, key=lambda each: (each.bit_count(), each))


def _read(pattern: str) -> int:
    return sum(1 << i for i, light in enumerate(pattern.replace(" ", "")) if light == "1")


register_puzzle(LightsOutConfig, LightsOutPuzzle)
