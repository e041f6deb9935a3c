"""Sokoban: a move into a box pushes it one cell, unless a wall or another box is behind it; each box belongs on a goal.

Rows of Boxoban's files and of other collections are read as they are, or the instance seed draws a level by playing it
backwards. A box on a goal earns 1, one that leaves it -1, as in gym-sokoban; boxes against walls and in corners are
dead ends. The state is a word of `BOX_BITS` a box: its cell on the map.
"""

from __future__ import annotations

import dataclasses
import itertools
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from hrl_escape.env.puzzles.base import PUSH, Contacts, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.pushing import PUSH_SIDES, BoxMap, draw_level, find_fewest_shoves, tidy_level
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.env.puzzles.traits import Pushing
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

BOX_BITS = 8
"""Bits of a box's cell in a state."""
MOST_BOXES = 7


@dataclasses.dataclass(frozen=True)
class SokobanConfig(PuzzleConfig):
    """Schematic of Sokoban; the room must have as many cells as its level without the outer walls."""

    kind = "sokoban"
    size: Annotated[int, Range(3, 14)] = 6
    """Side of drawn levels, without the outer walls."""
    boxes: Annotated[int, Range(1, MOST_BOXES)] = 2
    """Boxes of drawn levels."""
    rows: tuple[str, ...] = ()
    """An explicit level, such as one of Boxoban's."""

    def make_puzzle(self, rng: np.random.Generator) -> SokobanPuzzle:
        """Draw a level, or take the given one without its outer walls."""
        return SokobanPuzzle(tidy_level(self.rows) if self.rows else draw_level(self.size, self.boxes, rng))


@dataclasses.dataclass(frozen=True)
class SokobanPuzzle(Pushing, Modelled, Puzzle):
    """A concrete level. Boxes are called `box-1`, ..., goals `goal-1`, ..., row by row."""

    kind = "sokoban"
    are_pads = True
    rows: tuple[str, ...] = ("@$.",)
    """The level, without its outer walls where it has some."""

    def check(self) -> None:
        """Check that the state fits into a word."""
        if len(self.level.boxes) > MOST_BOXES or len("".join(self.rows)) > 1 << BOX_BITS:
            raise ConfigError("puzzle.rows", self.rows, f"at most {MOST_BOXES} boxes and {1 << BOX_BITS} cells")

    @cached_property
    def level(self) -> BoxMap:
        """Cells of the level and their neighbours."""
        return BoxMap(self.rows)

    @property
    def map_rows(self) -> tuple[str, ...]:
        """The map: walls, floor, and the start, heading for +x."""
        cells = ["#" if c == "#" else ">" if c in "@+" else " " for c in "".join(self.rows)]
        wide = self.level.columns
        return tuple("".join(cells[begin: begin + wide]) for begin in range(0, len(cells), wide))

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the boxes, `box-1` and so on, then of the goals, `goal-1` and so on."""
        return tuple(f"{what}-{number + 1}" for what in ("box", "goal") for number in range(len(self.level.boxes)))

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Numbers of the goals: a box must stand on each."""
        return tuple(range(len(self.level.boxes), 2 * len(self.level.boxes)))

    @property
    def target_cells(self) -> tuple[int, ...]:
        """Cells in which the boxes stand at first, and those of the goals."""
        return (*self.level.boxes, *self.level.goals)

    @property
    def blockable_cells(self) -> tuple[int, ...]:
        """Cells that are no walls."""
        return self.level.floor

    @property
    def has_dead_ends(self) -> bool:
        """True: a box in a corner can never leave it."""
        return True

    # --- states ------------------------------------------------------------------------

    def encode(self, cells: tuple[int, ...]) -> int:
        """State with the boxes in these cells."""
        return sum(cell << BOX_BITS * box for box, cell in enumerate(cells))

    def decode(self, state: int) -> tuple[int, ...]:
        """Cell of each box."""
        return tuple(state >> BOX_BITS * box & (1 << BOX_BITS) - 1 for box in range(len(self.level.boxes)))

    def make_state(self) -> int:
        """State with the boxes in their first cells."""
        return self.encode(self.level.boxes)

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value gives every box a cell of the floor of its own."""
        if type(state) is not int or not 0 <= state < 1 << BOX_BITS * len(self.level.boxes):
            return False
        cells = self.decode(state)
        return len(set(cells)) == len(cells) and set(cells) <= set(self.level.floor)

    def update(self, state: int, contacts: Contacts) -> int:
        """Push the box ahead into the cell beyond it, if that is free."""
        if contacts.grip != PUSH or contacts.ahead < 0 or contacts.beyond < 0:
            return state
        cells, floor = self.decode(state), self.level.floor
        box, to = floor[contacts.ahead], floor[contacts.beyond]
        if box not in cells or to in cells:
            return state
        return self.encode(tuple(to if cell == box else cell for cell in cells))

    def compute_reward(self, before: int, after: int, contacts: Contacts) -> float:
        """1 for a box that comes onto a goal, -1 for one that leaves it."""
        return float(self._count_filled(after) - self._count_filled(before))

    def _count_filled(self, state: int) -> int:
        return len({*self.decode(state)}.intersection(self.level.goals))

    def get_shut(self, state: int) -> int:
        """Bits of the cells in which boxes stand."""
        return sum(1 << self.level.floor.index(cell) for cell in self.decode(state))

    def is_solved(self, state: int) -> bool:
        """Return whether a box stands on every goal."""
        return self._count_filled(state) == len(self.level.goals)

    def observe(self, state: int) -> tuple[float, ...]:
        """Two numbers a box, row and column as shares of the map, then one a goal, 1 with a box on it."""
        cells = self.decode(state)
        places = [divmod(cell, self.level.columns) for cell in cells]
        shares = [share for row, column in places for share in (row / len(self.rows), column / self.level.columns)]
        return (*shares, *(float(goal in cells) for goal in self.level.goals))

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Lit targets: boxes on goals, and goals with a box on them."""
        cells, goals = self.decode(state), self.level.goals
        return (*(cell in goals for cell in cells), *(goal in cells for goal in goals))

    # --- for planners ------------------------------------------------------------------

    def _write_place(self, box: int, cell: int) -> str:
        row, column = divmod(cell, self.level.columns)
        return f"at({self.target_names[box]},cell-{row + 1}-{column + 1})"

    def _write_filled(self, cell: int) -> frozenset[str]:
        goals = self.level.goals
        return frozenset({f"filled(goal-{goals.index(cell) + 1})"}) if cell in goals else frozenset()

    def get_facts(self, state: int) -> frozenset[str]:
        """`at(box,cell)` for every box, `filled(goal)` for every goal with a box on it."""
        cells = self.decode(state)
        places = {self._write_place(box, cell) for box, cell in enumerate(cells)}
        return frozenset(places).union(*map(self._write_filled, cells))

    def make_contacts(self, operator: Operator) -> Contacts:
        """Contacts of the move that carries out an operator."""
        cell, to = self._ends[operator.name]
        return Contacts((), grip=PUSH, ahead=self.level.floor.index(cell), beyond=self.level.floor.index(to))

    def make_symbolic_model(self) -> SymbolicModel:
        """One operator for each box, cell and side; the room plans how the player gets to the box."""
        return self._model[0]

    @cached_property
    def _ends(self) -> dict[str, tuple[int, int]]:
        """For each operator, the cells from which and to which it pushes its box."""
        return self._model[1]

    @cached_property
    def _model(self) -> tuple[SymbolicModel, dict[str, tuple[int, int]]]:
        level, boxes = self.level, range(len(self.level.boxes))
        operators, ends = list[Operator](), dict[str, tuple[int, int]]()
        for box, (number, side), cell in itertools.product(boxes, enumerate(PUSH_SIDES), level.floor):
            to, behind = level.find_beside(cell, number), level.find_beside(cell, number ^ 2)
            if to < 0 or behind < 0:
                continue
            here, there = frozenset({self._write_place(box, cell)}), frozenset({self._write_place(box, to)})
            taken = frozenset(self._write_place(other, to) for other in boxes if other != box)
            gone = here | self._write_filled(cell)
            name = f"push-{self.target_names[box]}-{side}-{len(ends) + 1}"
            operators.append(Operator(name, self.target_names[box], f"push-{side}", here, taken,
                                      there | self._write_filled(to), gone))
            ends[name] = cell, to
        places = (self._write_place(box, cell) for box in boxes for cell in level.floor)
        filled = tuple(fact for goal in level.goals for fact in self._write_filled(goal))
        return SymbolicModel((*places, *filled), tuple(operators), frozenset(filled)), ends

    def list_cells(self, state: int, action: str, target: int) -> tuple[int, ...]:
        """Number of the cell in which the box of an operator stands now, as a tuple of one."""
        return (self.level.floor.index(self.decode(state)[target]),)

    def plan(self, state: int, place: int = -1) -> tuple[Operator, ...] | None:
        """The pushes of a solution with the fewest moves, from the cell where the robot stands."""
        player = self.level.start if place < 0 else self.level.floor[place]
        found = list[Operator]()
        for shove in find_fewest_shoves(self.rows, player, frozenset(self.decode(state))) or ():
            box = self.decode(state).index(shove.cell)
            found.append(next(op for op in self.make_symbolic_model().operators
                              if (op.target, op.action) == (self.target_names[box], f"push-{shove.side}")
                              and self._ends[op.name][0] == shove.cell))
            state = self.update(state, self.make_contacts(found[-1]))
        return tuple(found) if self.is_solved(state) else None


register_puzzle(SokobanConfig, SokobanPuzzle)
