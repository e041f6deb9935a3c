"""Potions in tensors: the word is the puzzle's own state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import PuzzleTables, TensorContacts, TensorPuzzle, register_tensor_puzzle
from hrl_escape.env.puzzles.potions import RULE_SHIFT, TRIAL_SHIFT, PotionsPuzzle, list_rules

__all__ = ["PotionsTensorPuzzle"]

_STONE, _TRIALS = (1 << TRIAL_SHIFT) - 1, (1 << RULE_SHIFT - TRIAL_SHIFT) - 1


class PotionsTensorPuzzle(TensorPuzzle):
    """`env.puzzles.potions.PotionsPuzzle`."""

    def make_tables(self, puzzles: Sequence[PotionsPuzzle], targets: int) -> dict[str, NDArray[Any]]:
        """Bits that potions turn on and off (2, rules x potions, instances), perfect stone and trials (instances,)."""
        most = max(len(list_rules(puzzle.features)) for puzzle in puzzles)
        turned = np.zeros((len(puzzles), 2, most, targets), dtype=np.int64)
        for number, puzzle in enumerate(puzzles):
            for rule, effects in enumerate(list_rules(puzzle.features)):
                for potion, (feature, is_on) in enumerate(effects):
                    turned[number, 0 if is_on else 1, rule, potion] = 1 << feature
        return {"turned": np.ascontiguousarray(np.moveaxis(turned.reshape(len(puzzles), 2, -1), 0, -1)),
                "perfect": np.array([(1 << puzzle.features) - 1 for puzzle in puzzles], dtype=np.int64),
                "trials": np.array([puzzle.trials for puzzle in puzzles], dtype=np.int64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Drip each pressed potion on the stone, one after the other."""
        stone, trials, rule = state & _STONE, state >> TRIAL_SHIFT & _TRIALS, state >> RULE_SHIFT
        for potion in range(targets):
            row = (rule * targets + potion).unsqueeze(0)
            on, off = (table.expand(-1, state.shape[0]).gather(0, row).squeeze(0) for table in tables["turned"])
            acts = ((contacts.pressed >> potion & 1) != 0) & (trials < tables["trials"])
            stone = torch.where(acts, (stone | on) & ~off, stone)
            is_perfect = acts & (stone == tables["perfect"])
            stone, trials = torch.where(is_perfect, 0, stone), trials + is_perfect.to(torch.int64)
        return stone | trials << TRIAL_SHIFT | rule << RULE_SHIFT

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """All trials are done."""
        return (state >> TRIAL_SHIFT & _TRIALS) == tables["trials"]

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """All bits once all trials are done, int64 (rooms,)."""
        potions = (tables["perfect"] + 1) ** 2 - 1  # two for each feature
        return torch.where(self.is_solved(tables, state), potions, 0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """One number a feature, and the share of the trials done, float32 (features + 1, rooms)."""
        places = torch.arange(targets // 2, device=state.device).unsqueeze(1)
        share = (state >> TRIAL_SHIFT & _TRIALS).to(torch.float64) / tables["trials"]
        return torch.cat([(state >> places & 1).to(torch.float32), share.to(torch.float32).unsqueeze(0)])


register_tensor_puzzle(PotionsPuzzle, PotionsTensorPuzzle())
