"""Tensor forms of puzzles without a table: they have maps, watch every primitive, or have too many states.

The word is the puzzle's own state. Rules and observations equal those in the files of the puzzles.
"""

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
    pack_bits,
    register_tensor_puzzle,
    unpack_bits,
)
from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.base import PUSH, USE
from hrl_escape.env.puzzles.bit_flip import BitFlipPuzzle
from hrl_escape.env.puzzles.blocks_world import IN_HAND, BlocksWorldPuzzle
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.puzzles.light_box import LightBoxPuzzle
from hrl_escape.env.puzzles.lights_out import LightsOutPuzzle, list_flips
from hrl_escape.env.puzzles.mini_grid import HELD, PLACE_BITS, MiniGridPuzzle
from hrl_escape.env.puzzles.puddle_world import PuddleWorldPuzzle
from hrl_escape.env.puzzles.recipes import COUNT_BITS, MATERIALS, MOST_KEPT, NAMES, RECIPES, SHIFTS, RecipesPuzzle
from hrl_escape.env.puzzles.sokoban import BOX_BITS, SokobanPuzzle
from hrl_escape.env.puzzles.taxi import DEPOTS, REFUSED, RIDING, TaxiPuzzle
from hrl_escape.errors import UnsupportedError

# --- words with bit i for target i ----------------------------------------------------------


class _BitTensorPuzzle(TensorPuzzle):
    """Base class of these forms: presses count in index order, and the word `goal` is the solution."""

    @abstractmethod
    def press(self, tables: PuzzleTables, state: Tensor, target: int, bit: int) -> Tensor:
        """Return the states after a press of one target in every room, int64 (rooms,); `bit` is its bit in a word."""

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        for target in range(targets):
            bit = as_signed(1 << target)
            state = torch.where((contacts.pressed & bit) != 0, self.press(tables, state, target, bit), state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        return state == tables["goal"]


class _ButtonsTensorPuzzle(_BitTensorPuzzle):
    """Tensor form of `ButtonsPuzzle`."""

    def make_tables(self, puzzles: Sequence[ButtonsPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Return the tables by instance.

        Bits of each button's parents and, if any, its locks (buttons, instances); goals and rules (instances,). If some
        instance can fail, the bit of the failure (instances,). With doors, the index of the button that opens each, -1
        for absent doors (doors, instances).
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
        """Return the word with all bits on (instances,)."""
        return {"goal": np.array([as_signed((1 << puzzle.count) - 1) for puzzle in puzzles], dtype=np.int64)}

    def press(self, tables: PuzzleTables, state: Tensor, target: int, bit: int) -> Tensor:
        lower = (1 << target) - 1
        return torch.where((state & lower) == lower, state ^ bit, state & ~(lower | bit))


class _LightBoxTensorPuzzle(_BitTensorPuzzle):
    """Tensor form of `LightBoxPuzzle`."""

    def make_tables(self, puzzles: Sequence[LightBoxPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Return bits of each light's parents and of its family (lights, instances), goal and chance (instances,)."""
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
        """Return the flips of each press (lights, instances), and each goal (instances,)."""
        flips = np.zeros((len(puzzles), len(frame.target_names)), dtype=np.int64)
        for row, puzzle in zip(flips, puzzles, strict=True):
            row[: puzzle.count] = list_flips(puzzle.count, puzzle.columns)
        return {"flips": np.ascontiguousarray(flips.T),
                "goal": np.array([puzzle.goal for puzzle in puzzles], dtype=np.int64)}

    def press(self, tables: PuzzleTables, state: Tensor, target: int, bit: int) -> Tensor:
        return state ^ tables["flips"][target]

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        goal = tables["goal"].expand_as(state)
        return torch.cat([unpack_bits(word, targets, torch.float32) for word in (state, goal)])


# --- maps ----------------------------------------------------------------------------------


_CELL = (1 << BOX_BITS) - 1


class _MiniGridTensorPuzzle(TensorPuzzle):
    """Tensor form of `MiniGridPuzzle`; all instances of a batch have equal numbers of doors, keys and balls."""

    def make_tables(self, puzzles: Sequence[MiniGridPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Return the tables by instance.

        `cells`: cell of each inner door, -1 for absent ones; `doors`: index of its door, -1 for other cells (inner
        doors, instances); `locked` doors (doors, instances); `goal`: cell of the goal; `size`: rows and columns of the
        map (2, instances); `is_ball` of each thing (things, instances).

        Raises:
            UnsupportedError: numbers of doors, keys or balls differ.
        """
        grids = [puzzle.grid for puzzle in puzzles]
        first = grids[0]
        if any((len(g.doors), len(g.things), g.keys) != (len(first.doors), len(first.things), first.keys)
               for g in grids):
            raise UnsupportedError("the levels of a batch need equal numbers of doors, keys and balls. Make one batch "
                                   "per level")
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
        doors = torch.arange(tables["locked"].shape[0], device=state.device).unsqueeze(1)
        return pack_bits(torch.cat([state >> 2 * doors & 1 != 0, self._list_places(tables, state) == HELD]))

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
        """Return `cells` of the inner doors, -1 for none, `goals` (goals, instances), and `size` of the map."""
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
        """Return whether each box is on each goal, bool (boxes, goals, rooms)."""
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
        return pack_bits(torch.cat([filled.any(1), filled.any(0)]))

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        rows, columns = tables["size"]
        seen = list[Tensor]()
        for cell in self._list_boxes(tables, state):
            seen += [cell // columns / rows.to(torch.float64), cell % columns / columns.to(torch.float64)]
        filled = self._find_filled(tables, state).any(0).to(torch.float64)
        return torch.cat([torch.stack(seen), filled]).to(torch.float32)


# --- words of other layouts ----------------------------------------------------------------


_SETTLED, _DELIVERED = 1 << 5, 1 << 6


class _BlocksWorldTensorPuzzle(TensorPuzzle):
    """Tensor form of `BlocksWorldPuzzle`."""

    def make_tables(self, puzzles: Sequence[BlocksWorldPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Return `wanted` supports of blocks, -1 for any, and `clear` (blocks, instances); `free_hand`.

        `counts` are the numbers of blocks. If they differ, `order` (numbers, instances) maps the observation numbers of
        each instance to the numbers of the instance with the most blocks, followed by one that is always 0.
        """
        most, counts = len(frame.target_names), [len(puzzle.names) for puzzle in puzzles]
        wanted = [[dict(puzzle.goal).get(block, -1) for puzzle in puzzles] for block in range(most)]
        clear = [[block in puzzle.clear for puzzle in puzzles] for block in range(most)]
        parts = np.arange(2 * most * (most + 1)).reshape(2, most, most + 1)
        order = np.full((parts.size, len(puzzles)), parts.size)
        for column, count in enumerate(counts):
            own = parts[:, :count, [*range(count), most]].ravel()
            order[: len(own), column] = own
        return {"wanted": np.array(wanted, dtype=np.int64), "clear": np.array(clear, dtype=bool),
                "free_hand": np.array([puzzle.free_hand for puzzle in puzzles], dtype=bool),
                "counts": np.array(counts, dtype=np.int64), "order": order if min(counts) < most else order[:0]}

    def _list_towers(self, tables: PuzzleTables, state: Tensor) -> tuple[Tensor, Tensor]:
        """Block under each block, int64 (blocks, rooms), -1 if absent, and the indices of the blocks (blocks, 1)."""
        blocks = torch.arange(tables["wanted"].shape[0], device=state.device).unsqueeze(1)
        return torch.where(blocks < tables["counts"], state >> 4 * blocks & 15, -1), blocks

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
        return pack_bits(towers == blocks)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        towers, blocks = self._list_towers(tables, state)
        seen = [towers[block] == torch.cat([blocks, torch.full_like(blocks[:1], IN_HAND)]) for block in range(targets)]
        for block in range(targets):
            wanted = (tables["wanted"][block] == blocks).expand(-1, state.shape[0])
            seen += [wanted, tables["clear"][block].expand(1, state.shape[0])]
        if not len(tables["order"]):
            return torch.cat(seen).to(torch.float32)
        every = torch.cat([*seen, torch.zeros_like(seen[0][:1])]).to(torch.float32)
        return every.gather(0, tables["order"].expand(-1, state.shape[0]))


class _PuddleWorldTensorPuzzle(TensorPuzzle):
    """Tensor form of `PuddleWorldPuzzle`."""

    def make_tables(self, puzzles: Sequence[PuddleWorldPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Return ends and radius of each puddle, of size 0 if absent (5, puddles, instances), and the cost."""
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
        """Return the indices of the goals (instances,)."""
        return {"goal": np.array([NAMES.index(puzzle.goal) for puzzle in puzzles], dtype=np.int64)}

    def _count(self, state: Tensor) -> Tensor:
        """Number of each material and thing, int64 (names, rooms)."""
        return torch.stack([state >> shift & (2**COUNT_BITS - 1 if number < MATERIALS else 1)
                            for number, shift in enumerate(SHIFTS[:-1])])

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        for target, name in enumerate(NAMES):
            recipe, counts = RECIPES[name], self._count(state)
            needs = [*((thing, 1) for thing in recipe.takes), *recipe.uses]
            able = counts[target] < (MOST_KEPT if target < MATERIALS else 1)
            for needed, number in needs:
                able = able & (counts[NAMES.index(needed)] >= number)
            change = (1 << SHIFTS[target]) - sum(number << SHIFTS[NAMES.index(used)] for used, number in recipe.uses)
            state = torch.where((contacts.pressed >> target & 1 != 0) & able, state + change, state)
        return state

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        goal = tables["goal"].expand(state.shape).unsqueeze(0)
        return self._count(state).gather(0, goal).squeeze(0) > 0

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        return pack_bits(self._count(state) > 0)

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        most = torch.tensor([MOST_KEPT] * MATERIALS + [1] * (len(NAMES) - MATERIALS), device=state.device).unsqueeze(1)
        return (self._count(state).to(torch.float64) / most).to(torch.float32)


class _TaxiTensorPuzzle(TensorPuzzle):
    """Tensor form of `TaxiPuzzle`."""

    def make_tables(self, puzzles: Sequence[TaxiPuzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Return the probability of changing the destination (instances,)."""
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


register_tensor_puzzle(MiniGridPuzzle, _MiniGridTensorPuzzle())
register_tensor_puzzle(SokobanPuzzle, _SokobanTensorPuzzle())
register_tensor_puzzle(BlocksWorldPuzzle, _BlocksWorldTensorPuzzle())
register_tensor_puzzle(PuddleWorldPuzzle, _PuddleWorldTensorPuzzle())
register_tensor_puzzle(RecipesPuzzle, _RecipesTensorPuzzle())
register_tensor_puzzle(TaxiPuzzle, _TaxiTensorPuzzle())
register_tensor_puzzle(ButtonsPuzzle, _ButtonsTensorPuzzle())
register_tensor_puzzle(BitFlipPuzzle, _BitFlipTensorPuzzle())
register_tensor_puzzle(LightBoxPuzzle, _LightBoxTensorPuzzle())
register_tensor_puzzle(LightsOutPuzzle, _LightsOutTensorPuzzle())
