"""Blocks World in tensors: the word is the puzzle's own state, four bits a block."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.blocks_world import IN_HAND, BlocksWorldPuzzle


class BlocksWorldTensorPuzzle(TensorPuzzle):
    """Tensor form of `BlocksWorldPuzzle`."""

    def make_tables(self, puzzles: Sequence[BlocksWorldPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """`wanted`: what each block must stand on, -1 for anything, and `clear` (blocks, instances); `free_hand`."""
        wanted = [[dict(puzzle.goal).get(block, -1) for puzzle in puzzles] for block in range(len(frame.target_names))]
        clear = [[block in puzzle.clear for puzzle in puzzles] for block in range(len(frame.target_names))]
        return {"wanted": np.array(wanted, dtype=np.int64), "clear": np.array(clear, dtype=bool),
                "free_hand": np.array([puzzle.free_hand for puzzle in puzzles], dtype=bool)}

    def _list_towers(self, tables: PuzzleTables, state: Tensor) -> tuple[Tensor, Tensor]:
        """List the blocks under each, int64 (blocks, rooms), and the blocks' own numbers (blocks, 1)."""
        blocks = torch.arange(tables["wanted"].shape[0], device=state.device).unsqueeze(1)
        return state >> 4 * blocks & 15, blocks

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Take the top block of the first touched place's tower, or put the held one there."""
        towers, blocks = self._list_towers(tables, state)
        base = torch.full_like(state, targets)
        for place in reversed(range(targets)):
            base = torch.where(contacts.touching >> place & 1 != 0, place, base)
        is_base, held = blocks == base, towers == IN_HAND
        stands = (is_base & (towers == blocks)).any(0)
        top = base
        for _ in range(targets):
            above = (towers == top) & (blocks != top)
            top = torch.where(above.any(0), above.to(torch.int8).argmax(0), top)
        takes = (contacts.grip == 1) & stands & ~held.any(0)
        puts = (contacts.grip == -1) & (stands | (is_base & held).any(0))
        for block in range(targets):
            bare = state & ~(15 << 4 * block)
            taken = torch.where(takes & (top == block), bare | IN_HAND << 4 * block, state)
            state = torch.where(puts & held[block], bare | torch.where(stands, top, base) << 4 * block, taken)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return true where the goal's facts hold, bool (rooms,)."""
        towers, blocks = self._list_towers(tables, state)
        wanted, solved = tables["wanted"], ~(tables["free_hand"] & (towers == IN_HAND).any(0))
        solved = solved & ((wanted < 0) | (wanted == towers)).all(0)
        for block in range(wanted.shape[0]):
            is_clear = (towers[block] != IN_HAND) & ~((towers == block) & (blocks != block)).any(0)
            solved = solved & (is_clear | ~tables["clear"][block])
        return solved

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bits of the places on which a tower stands, int64 (rooms,)."""
        towers, blocks = self._list_towers(tables, state)
        return ((towers == blocks).to(torch.int64) << blocks).sum(0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """For each block what it stands on, then what the goal wants of it, float32 (2 n (n + 1), rooms)."""
        towers, blocks = self._list_towers(tables, state)
        seen = [towers[block] == torch.cat([blocks, torch.full_like(blocks[:1], IN_HAND)]) for block in range(targets)]
        for block in range(targets):
            wanted = (tables["wanted"][block] == blocks).expand(-1, state.shape[0])
            seen += [wanted, tables["clear"][block].expand(1, state.shape[0])]
        return torch.cat(seen).to(torch.float32)


register_tensor_puzzle(BlocksWorldPuzzle, BlocksWorldTensorPuzzle())
