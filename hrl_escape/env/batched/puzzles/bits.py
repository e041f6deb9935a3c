"""Tensor forms of the puzzles whose word has bit i for target i: buttons, BitFlip, LightBox, Lights Out."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.puzzles.base import (
    PuzzleTables,
    TensorContacts,
    TensorPuzzle,
    as_signed,
    register_tensor_puzzle,
    unpack_bits,
)
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.bit_flip import BitFlipPuzzle
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.puzzles.light_box import LightBoxPuzzle
from hrl_escape.env.puzzles.lights_out import LightsOutPuzzle, list_flips


class _BitTensorPuzzle(TensorPuzzle):
    """Base of these forms: presses count one after the other, in index order."""

    @abstractmethod
    def press(self, tables: PuzzleTables, state: Tensor, target: int, bit: int) -> Tensor:
        """States after a press of one target in every room, int64 (rooms,); `bit` is its own in a word."""

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        for target in range(targets):
            bit = as_signed(1 << target)
            state = torch.where((contacts.pressed & bit) != 0, self.press(tables, state, target, bit), state)
        return state


class _ButtonsTensorPuzzle(_BitTensorPuzzle):
    """Tensor form of `ButtonsPuzzle`."""

    def make_tables(self, puzzles: Sequence[ButtonsPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Tables by instance.

        Bits of each button's parents and, if any, its locks (buttons, instances); goals and rules (instances,); where
        some instance can be failed, the bit for that (instances,); with doors, the button that opens each, -1 where
        there are fewer (doors, instances).
        """
        parents, locks = np.zeros((2, len(puzzles), len(frame.target_names)), dtype=np.uint64)
        for number, puzzle in enumerate(puzzles):
            parents[number, : puzzle.count], locks[number, : puzzle.count] = puzzle.parent_masks, puzzle.lock_masks
        tables = {
            "parents": np.ascontiguousarray(parents.T).view(np.int64),
            "goal": np.array([puzzle.goal for puzzle in puzzles], dtype=np.int64),
            "resets": np.array([puzzle.on_violation == "reset" for puzzle in puzzles]),
            "allow_off": np.array([puzzle.allow_off for puzzle in puzzles]),
        }
        if any(puzzle.failure for puzzle in puzzles):
            tables["fails"] = np.array([as_signed(puzzle.failure) for puzzle in puzzles])
        if locks.any():
            tables["locks"] = np.ascontiguousarray(locks.T).view(np.int64)
        if doors := max(len(puzzle.doors) for puzzle in puzzles):
            openers = [(*puzzle.doors, *[-1] * (doors - len(puzzle.doors))) for puzzle in puzzles]
            tables["openers"] = np.array(openers, dtype=np.int64).T
        return tables

    def press(self, tables: PuzzleTables, state: Tensor, target: int, bit: int) -> Tensor:
        unmet = tables["parents"][target] & ~state
        if "locks" in tables:
            unmet = unmet | tables["locks"][target] & state
        violated = state | tables["fails"] if "fails" in tables else state
        when_off = torch.where(unmet == 0, state | bit, torch.where(tables["resets"], 0, violated))
        when_on = torch.where(tables["allow_off"], state & ~bit, state)
        after = torch.where((state & bit) != 0, when_on, when_off)
        failed = self.is_failed(tables, state)
        return after if failed is None else torch.where(failed, state, after)

    def find_shut(self, tables: PuzzleTables, state: Tensor, doors: int) -> Tensor:
        openers = tables["openers"]
        return (openers >= 0) & (state >> openers.clamp(min=0) & 1 == 0)

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        solved, failed = ((state >> tables["goal"]) & 1) != 0, self.is_failed(tables, state)
        return solved if failed is None else solved & ~failed

    def is_failed(self, tables: PuzzleTables, state: Tensor) -> Tensor | None:
        return (state & tables["fails"]) != 0 if "fails" in tables else None

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        return state & ~tables["fails"] if "fails" in tables else state


class _BitFlipTensorPuzzle(_BitTensorPuzzle):
    """Tensor form of `BitFlipPuzzle`."""

    def make_tables(self, puzzles: Sequence[BitFlipPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """The word with all bits on (instances,)."""
        return {"all_on": np.array([as_signed((1 << puzzle.count) - 1) for puzzle in puzzles], dtype=np.int64)}

    def press(self, tables: PuzzleTables, state: Tensor, target: int, bit: int) -> Tensor:
        lower = (1 << target) - 1
        return torch.where((state & lower) == lower, state ^ bit, state & ~(lower | bit))

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        return state == tables["all_on"]


class _LightBoxTensorPuzzle(_BitTensorPuzzle):
    """Tensor form of `LightBoxPuzzle`."""

    def make_tables(self, puzzles: Sequence[LightBoxPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Bits of each light's parents and of its family (lights, instances), the goal and the chance (instances,)."""
        parents, families = np.zeros((2, len(frame.target_names), len(puzzles)), dtype=np.int64)
        for number, puzzle in enumerate(puzzles):
            parents[: puzzle.count, number], families[: puzzle.count, number] = puzzle.parent_masks, puzzle.family_masks
        return {"parents": parents, "families": families,
                "goal": np.array([puzzle.goal for puzzle in puzzles], dtype=np.int64),
                "success": np.array([puzzle.success for puzzle in puzzles], dtype=np.float64)}

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        pressed = torch.where(contacts.uniform < tables["success"], contacts.pressed, 0)
        return super().update(tables, state, contacts._replace(pressed=pressed), targets)

    def press(self, tables: PuzzleTables, state: Tensor, target: int, bit: int) -> Tensor:
        is_ready = (tables["parents"][target] & ~state) == 0
        return torch.where((state & bit) != 0, state & ~tables["families"][target],
                           torch.where(is_ready, state | bit, 0))

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        return (state >> tables["goal"] & 1) != 0


class _LightsOutTensorPuzzle(_BitTensorPuzzle):
    """Tensor form of `LightsOutPuzzle`."""

    def make_tables(self, puzzles: Sequence[LightsOutPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Flips of each press (lights, instances), and each goal (instances,)."""
        flips = np.zeros((len(puzzles), len(frame.target_names)), dtype=np.int64)
        for row, puzzle in zip(flips, puzzles, strict=True):
            row[: puzzle.count] = list_flips(puzzle.count, puzzle.columns)
        return {"flips": np.ascontiguousarray(flips.T),
                "goal": np.array([puzzle.goal for puzzle in puzzles], dtype=np.int64)}

    def press(self, tables: PuzzleTables, state: Tensor, target: int, bit: int) -> Tensor:
        return state ^ tables["flips"][target]

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        return state == tables["goal"]

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        goal = tables["goal"].expand_as(state)
        return torch.cat([unpack_bits(word, targets, torch.float32) for word in (state, goal)])


register_tensor_puzzle(ButtonsPuzzle, _ButtonsTensorPuzzle())
register_tensor_puzzle(BitFlipPuzzle, _BitFlipTensorPuzzle())
register_tensor_puzzle(LightBoxPuzzle, _LightBoxTensorPuzzle())
register_tensor_puzzle(LightsOutPuzzle, _LightsOutTensorPuzzle())
