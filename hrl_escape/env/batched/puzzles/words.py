"""Blocks World, Puddle World, the recipe game and Taxi in tensors: the word is the puzzle's own state.

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
from hrl_escape.env.puzzles.blocks_world import IN_HAND, BlocksWorldPuzzle
from hrl_escape.env.puzzles.puddle_world import PuddleWorldPuzzle
from hrl_escape.env.puzzles.recipes import COUNT_BITS, MATERIALS, MOST_KEPT, NAMES, RECIPES, RecipesPuzzle
from hrl_escape.env.puzzles.taxi import DEPOTS, REFUSED, RIDING, TaxiPuzzle

_SHIFTS = [COUNT_BITS * min(number, MATERIALS) + max(number - MATERIALS, 0) for number in range(len(NAMES))]
_SETTLED, _DELIVERED = 1 << 5, 1 << 6


class _BlocksWorldTensorPuzzle(TensorPuzzle):
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
        towers, blocks = self._list_towers(tables, state)
        wanted, solved = tables["wanted"], ~(tables["free_hand"] & (towers == IN_HAND).any(0))
        solved = solved & ((wanted < 0) | (wanted == towers)).all(0)
        for block in range(wanted.shape[0]):
            is_clear = (towers[block] != IN_HAND) & ~((towers == block) & (blocks != block)).any(0)
            solved = solved & (is_clear | ~tables["clear"][block])
        return solved

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        towers, blocks = self._list_towers(tables, state)
        return ((towers == blocks).to(torch.int64) << blocks).sum(0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        towers, blocks = self._list_towers(tables, state)
        seen = [towers[block] == torch.cat([blocks, torch.full_like(blocks[:1], IN_HAND)]) for block in range(targets)]
        for block in range(targets):
            wanted = (tables["wanted"][block] == blocks).expand(-1, state.shape[0])
            seen += [wanted, tables["clear"][block].expand(1, state.shape[0])]
        return torch.cat(seen).to(torch.float32)


class _PuddleWorldTensorPuzzle(TensorPuzzle):
    """Tensor form of `PuddleWorldPuzzle`."""

    def make_tables(self, puzzles: Sequence[PuddleWorldPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Ends and radius of each puddle, of no size where there are fewer (5, puddles, instances), and the cost."""
        most = max(1, *(len(puzzle.areas) for puzzle in puzzles))
        areas = np.zeros((5, most, len(puzzles)), dtype=np.float64)
        for number, puzzle in enumerate(puzzles):
            for place, area in enumerate(puzzle.areas):
                areas[:, place, number] = area.x1, area.y1, area.x2, area.y2, area.radius
        return {"areas": areas, "cost": np.array([puzzle.cost for puzzle in puzzles], dtype=np.float64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        return state | (contacts.pressed != 0).to(state.dtype)

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts,
                       targets: int) -> Tensor:
        x1, y1, x2, y2, radius = tables["areas"]
        along_x, along_y, to_x, to_y = x2 - x1, y2 - y1, contacts.x - x1, contacts.y - y1  # (puddles, rooms)
        length = along_x * along_x + along_y * along_y
        share = ((to_x * along_x + to_y * along_y) / torch.where(length > 0, length, 1.0)).clamp(0.0, 1.0)
        off_x, off_y = to_x - share * along_x, to_y - share * along_y
        depth = (radius - torch.sqrt(off_x * off_x + off_y * off_y)).clamp(min=0.0)
        return -tables["cost"] * depth.amax(0)

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        return state == 1


class _RecipesTensorPuzzle(TensorPuzzle):
    """Tensor form of `RecipesPuzzle`."""

    def make_tables(self, puzzles: Sequence[RecipesPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Numbers of the goals (instances,)."""
        return {"goal": np.array([NAMES.index(puzzle.goal) for puzzle in puzzles], dtype=np.int64)}

    def _count(self, state: Tensor) -> Tensor:
        """Number of each material and thing, int64 (names, rooms)."""
        return torch.stack([state >> shift & (2**COUNT_BITS - 1 if number < MATERIALS else 1)
                            for number, shift in enumerate(_SHIFTS)])

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        for target, name in enumerate(NAMES):
            recipe, counts = RECIPES[name], self._count(state)
            needs = [*((thing, 1) for thing in recipe.takes), *recipe.uses]
            able = counts[target] < (MOST_KEPT if target < MATERIALS else 1)
            for needed, number in needs:
                able = able & (counts[NAMES.index(needed)] >= number)
            change = (1 << _SHIFTS[target]) - sum(number << _SHIFTS[NAMES.index(used)] for used, number in recipe.uses)
            state = torch.where((contacts.pressed >> target & 1 != 0) & able, state + change, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        goal = tables["goal"].expand(state.shape).unsqueeze(0)
        return self._count(state).gather(0, goal).squeeze(0) > 0

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        numbers = torch.arange(len(NAMES), device=state.device).unsqueeze(1)
        return ((self._count(state) > 0).to(torch.int64) << numbers).sum(0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        most = torch.tensor([MOST_KEPT] * MATERIALS + [1] * (len(NAMES) - MATERIALS), device=state.device).unsqueeze(1)
        return (self._count(state).to(torch.float64) / most).to(torch.float32)


class _TaxiTensorPuzzle(TensorPuzzle):
    """Tensor form of `TaxiPuzzle`."""

    def make_tables(self, puzzles: Sequence[TaxiPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Probability of changing the destination (instances,)."""
        return {"fickleness": np.array([puzzle.fickleness for puzzle in puzzles], dtype=np.float64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        passenger, destination = state & 7, state >> 3 & 3
        is_riding = passenger == RIDING
        here = torch.full_like(state, RIDING)
        for depot in reversed(range(len(DEPOTS))):
            here = torch.where(contacts.touching >> depot & 1 != 0, depot, here)
        picks = (contacts.grip > 0) & ~is_riding & (contacts.touching >> passenger & 1 != 0)
        puts = (contacts.grip < 0) & is_riding & (here != RIDING)
        rides = (tables["fickleness"] > 0) & contacts.has_moved & is_riding & (state & _SETTLED == 0) & ~puts
        share = (contacts.uniform - (1.0 - tables["fickleness"])) / tables["fickleness"].clamp(min=1e-9)
        turn = 1 + (share * (RIDING - 1)).to(torch.int64).clamp(0, RIDING - 2)
        wanted = torch.where(share >= 0.0, (destination + turn) % RIDING, destination)
        rest = state & ~7
        after = torch.where(picks, rest | RIDING, state)
        after = torch.where(puts, rest | here | torch.where(here == destination, _DELIVERED, 0), after)
        after = torch.where(rides, state & ~(3 << 3) | wanted << 3 | _SETTLED, after)
        return torch.where(self.is_solved(tables, state), state, after)

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        return state & _DELIVERED != 0

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts,
                       targets: int) -> Tensor:
        return torch.where((contacts.grip != 0) & (after == before), REFUSED, 0.0)

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        return 1 << (state >> 3 & 3)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        places = torch.arange(RIDING + 1, device=state.device).unsqueeze(1)
        return torch.cat([places == state & 7, places[:RIDING] == state >> 3 & 3]).to(torch.float32)


register_tensor_puzzle(BlocksWorldPuzzle, _BlocksWorldTensorPuzzle())
register_tensor_puzzle(PuddleWorldPuzzle, _PuddleWorldTensorPuzzle())
register_tensor_puzzle(RecipesPuzzle, _RecipesTensorPuzzle())
register_tensor_puzzle(TaxiPuzzle, _TaxiTensorPuzzle())
