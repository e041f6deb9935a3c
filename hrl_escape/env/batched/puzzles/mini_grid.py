"""MiniGrid's levels in tensors: two bits a door, then the place of each thing, as in the puzzle's own state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.base import USE
from hrl_escape.env.puzzles.mini_grid import HELD, PLACE_BITS, MiniGridPuzzle
from hrl_escape.errors import UnsupportedError


class MiniGridTensorPuzzle(TensorPuzzle):
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
        """Take, put down, open or shut what is in the cell ahead."""
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
        """Return true where a shut door or a thing blocks a cell, bool (inner doors, rooms)."""
        cells, door = (tables[name][:doors] for name in ("cells", "doors"))
        is_shut = (door >= 0) & (state >> 2 * door.clamp(min=0) & 1 == 0)
        for place in self._list_places(tables, state):
            is_shut = is_shut | ((cells == place) & (cells >= 0))
        return is_shut

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true where a ball is held or, on a map without balls, all doors have been opened, bool (rooms,)."""
        has_ball = ((self._list_places(tables, state) == HELD) & tables["is_ball"]).any(0)
        opened = torch.ones_like(state, dtype=torch.bool)
        for number in range(tables["locked"].shape[0]):
            opened = opened & (state >> 2 * number & 2 != 0)
        return torch.where(tables["is_ball"].any(0), has_ball, opened)

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of the doors that stand open, and of the thing that is held, int64 (rooms,)."""
        doors, lit = tables["locked"].shape[0], torch.zeros_like(state)
        for number in range(doors):
            lit = lit | (state >> 2 * number & 1) << number
        for thing, place in enumerate(self._list_places(tables, state)):
            lit = lit | (place == HELD).to(torch.int64) << doors + thing
        return lit

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """Two numbers a door, three a thing, float32 (numbers, rooms)."""
        numbers = [(state >> bit & 1).to(torch.float64) for bit in range(2 * tables["locked"].shape[0])]
        rows, columns = tables["size"]
        for place in self._list_places(tables, state):
            is_held = place == HELD
            numbers += [is_held.to(torch.float64), torch.where(is_held, 0, place // columns) / rows.to(torch.float64),
                        torch.where(is_held, 0, place % columns) / columns.to(torch.float64)]
        return torch.stack(numbers).to(torch.float32)


register_tensor_puzzle(MiniGridPuzzle, MiniGridTensorPuzzle())
