"""Taxi in tensors: the word is the puzzle's own state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.taxi import DEPOTS, REFUSED, RIDING, TaxiPuzzle

_SETTLED, _DELIVERED = 1 << 5, 1 << 6


class TaxiTensorPuzzle(TensorPuzzle):
    """Tensor form of `TaxiPuzzle`."""

    def make_tables(self, puzzles: Sequence[TaxiPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Probability of changing the destination (instances,)."""
        return {"fickleness": np.array([puzzle.fickleness for puzzle in puzzles], dtype=np.float64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Pick up, put down, or ride on."""
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
        """Return true where the passenger has been delivered, bool (rooms,)."""
        return state & _DELIVERED != 0

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts,
                       targets: int) -> Tensor:
        """`REFUSED` where a grip or release had no effect, else 0, shape (rooms,)."""
        return torch.where((contacts.grip != 0) & (after == before), REFUSED, 0.0)

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Bit of the destination's depot, int64 (rooms,)."""
        return 1 << (state >> 3 & 3)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """One number a place of the passenger, then one a destination, float32 (9, rooms)."""
        places = torch.arange(RIDING + 1, device=state.device).unsqueeze(1)
        return torch.cat([places == state & 7, places[:RIDING] == state >> 3 & 3]).to(torch.float32)


register_tensor_puzzle(TaxiPuzzle, TaxiTensorPuzzle())
