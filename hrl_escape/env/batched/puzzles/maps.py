"""MiniGrid's levels and Sokoban in tensors: the word is the puzzle's own state, with the cell of each thing.

Their rules, and what they show, are those of the puzzles' own files.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.base import PUSH, USE
from hrl_escape.env.puzzles.mini_grid import HELD, PLACE_BITS, MiniGridPuzzle
from hrl_escape.env.puzzles.sokoban import BOX_BITS, SokobanPuzzle
from hrl_escape.errors import UnsupportedError

_CELL = (1 << BOX_BITS) - 1


class _MiniGridTensorPuzzle(TensorPuzzle):
    """Tensor form of `MiniGridPuzzle`; all instances of a batch have equal numbers of doors, keys and balls."""

    def make_tables(self, puzzles: Sequence[MiniGridPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Tables by instance.

        `cells`: cell of each inner door, -1 where there are fewer; `doors`: its door's number, -1 for other cells
        (inner doors, instances); `locked` doors (doors, instances); `goal`: its cell, `size`: rows and columns of the
        map (2, instances); `is_ball`, of each thing (things, instances).

        Raises:
            UnsupportedError: numbers of doors, keys or balls differ.
        """
        grids = [puzzle.grid for puzzle in puzzles]
        first = grids[0]
        if any((len(g.doors), len(g.things), g.keys) != (len(first.doors), len(first.things), first.keys)
               for g in grids):
            raise UnsupportedError("the levels of a batch need equal numbers of doors, keys and balls: make one "
                                   "batch for each")
        cells = np.full((max(1, *(len(g.blockable) for g in grids)), len(grids)), -1, dtype=np.int64)
        doors = cells.copy()
        for number, grid in enumerate(grids):
            cells[: len(grid.blockable), number] = grid.blockable
            doors[: len(grid.blockable), number] = [grid.doors.index(cell) if cell in grid.doors else -1
                                                    for cell in grid.blockable]
        locked = [[g.is_locked(door) for g in grids] for door in range(len(first.doors))]
        balls = [[thing >= g.keys for g in grids] for thing in range(len(first.things))]
        return {"cells": cells, "doors": doors,
                "locked": np.array(locked, dtype=bool).reshape(-1, len(grids)),
                "is_ball": np.array(balls, dtype=bool).reshape(-1, len(grids)),
                "goal": np.array([-1 if g.goal is None else g.goal for g in grids], dtype=np.int64),
                "size": np.array([[len(g.rows) for g in grids], [g.columns for g in grids]], dtype=np.int64)}

    def _list_places(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Place of each thing, int64 (things, rooms)."""
        things = torch.arange(tables["is_ball"].shape[0], device=state.device).unsqueeze(1)
        return state >> 2 * tables["locked"].shape[0] + PLACE_BITS * things & HELD

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        doors, grip = tables["locked"].shape[0], contacts.grip
        row = contacts.ahead.clamp(min=0).unsqueeze(0)
        cell, door = (tables[name].expand(-1, state.shape[0]).gather(0, row).squeeze(0) for name in ("cells", "doors"))
        is_there = (contacts.ahead >= 0) & (cell >= 0)
        places = self._list_places(tables, state)
        held = places == HELD
        has_key = (held & ~tables["is_ball"]).any(0)
        after = state
        for number in range(doors):
            is_free = ~tables["locked"][number] | (state >> 2 * number & 2 != 0) | has_key
            turned = (state | 2 << 2 * number) ^ 1 << 2 * number
            after = torch.where(is_there & (grip == USE) & (door == number) & is_free, turned, after)
        is_floor, lying = is_there & (door < 0), places == cell
        takes = is_floor & (grip == 1) & ~held.any(0)
        puts = is_floor & (grip == -1) & ~lying.any(0) & (cell != tables["goal"])
        for thing in range(places.shape[0]):
            shift = 2 * doors + PLACE_BITS * thing
            bare = after & ~(HELD << shift)
            after = torch.where(takes & lying[thing], bare | HELD << shift,
                                torch.where(puts & held[thing], bare | cell << shift, after))
        return after

    def find_shut(self, tables: PuzzleTables, state: Tensor, doors: int) -> Tensor:
        cells, door = (tables[name][:doors] for name in ("cells", "doors"))
        is_shut = (door >= 0) & (state >> 2 * door.clamp(min=0) & 1 == 0)
        for place in self._list_places(tables, state):
            is_shut = is_shut | ((cells == place) & (cells >= 0))
        return is_shut

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        has_ball = ((self._list_places(tables, state) == HELD) & tables["is_ball"]).any(0)
        opened = torch.ones_like(state, dtype=torch.bool)
        for number in range(tables["locked"].shape[0]):
            opened = opened & (state >> 2 * number & 2 != 0)
        return torch.where(tables["is_ball"].any(0), has_ball, opened)

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        doors, lit = tables["locked"].shape[0], torch.zeros_like(state)
        for number in range(doors):
            lit = lit | (state >> 2 * number & 1) << number
        for thing, place in enumerate(self._list_places(tables, state)):
            lit = lit | (place == HELD).to(torch.int64) << doors + thing
        return lit

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        numbers = [(state >> bit & 1).to(torch.float64) for bit in range(2 * tables["locked"].shape[0])]
        rows, columns = tables["size"]
        for place in self._list_places(tables, state):
            is_held = place == HELD
            numbers += [is_held.to(torch.float64), torch.where(is_held, 0, place // columns) / rows.to(torch.float64),
                        torch.where(is_held, 0, place % columns) / columns.to(torch.float64)]
        return torch.stack(numbers).to(torch.float32)


class _SokobanTensorPuzzle(TensorPuzzle):
    """Tensor form of `SokobanPuzzle`."""

    def make_tables(self, puzzles: Sequence[SokobanPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """`cells`: cell of each inner door, -1 for none; `goals`: their cells (goals, instances); `size` of the map."""
        levels = [puzzle.level for puzzle in puzzles]
        cells = np.full((max(len(level.floor) for level in levels), len(levels)), -1, dtype=np.int64)
        for number, level in enumerate(levels):
            cells[: len(level.floor), number] = level.floor
        return {"cells": cells, "goals": np.array([level.goals for level in levels], dtype=np.int64).T,
                "size": np.array([[len(level.rows) for level in levels], [level.columns for level in levels]],
                                 dtype=np.int64)}

    def _list_boxes(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Cell of each box, int64 (boxes, rooms)."""
        boxes = torch.arange(tables["goals"].shape[0], device=state.device).unsqueeze(1)
        return state >> BOX_BITS * boxes & _CELL

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        cells = tables["cells"].expand(-1, state.shape[0])
        box, to = (cells.gather(0, number.clamp(min=0).unsqueeze(0)).squeeze(0)
                   for number in (contacts.ahead, contacts.beyond))
        boxes = self._list_boxes(tables, state)
        is_there = (contacts.grip == PUSH) & (contacts.ahead >= 0) & (contacts.beyond >= 0) & (box >= 0) & (to >= 0)
        is_there = is_there & ~(boxes == to).any(0)
        for number, cell in enumerate(boxes):
            moved = state & ~(_CELL << BOX_BITS * number) | to << BOX_BITS * number
            state = torch.where(is_there & (cell == box), moved, state)
        return state

    def _find_filled(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true for each pair of a box and the goal on which it stands, bool (boxes, goals, rooms)."""
        return self._list_boxes(tables, state).unsqueeze(1) == tables["goals"].unsqueeze(0)

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts,
                       targets: int) -> Tensor:
        then, now = (self._find_filled(tables, state).sum((0, 1)) for state in (before, after))
        return (now - then).to(torch.float64)

    def find_shut(self, tables: PuzzleTables, state: Tensor, doors: int) -> Tensor:
        cells = tables["cells"][:doors]
        is_shut = torch.zeros((cells.shape[0], state.shape[0]), dtype=torch.bool, device=state.device)
        for cell in self._list_boxes(tables, state):
            is_shut = is_shut | (cells == cell)
        return is_shut

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        return self._find_filled(tables, state).any(0).all(0)

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        filled = self._find_filled(tables, state)
        lit = torch.cat([filled.any(1), filled.any(0)]).to(torch.int64)
        return (lit << torch.arange(len(lit), device=state.device).unsqueeze(1)).sum(0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        rows, columns = tables["size"]
        seen = list[Tensor]()
        for cell in self._list_boxes(tables, state):
            seen += [cell // columns / rows.to(torch.float64), cell % columns / columns.to(torch.float64)]
        filled = self._find_filled(tables, state).any(0).to(torch.float64)
        return torch.cat([torch.stack(seen), filled]).to(torch.float32)


register_tensor_puzzle(MiniGridPuzzle, _MiniGridTensorPuzzle())
register_tensor_puzzle(SokobanPuzzle, _SokobanTensorPuzzle())
