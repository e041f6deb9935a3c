"""Push blocks onto plates: a puzzle with continuous state that requires physics dynamics.

Each block has its own plate on the floor. The exit is open while the centre of every block is over its plate, and
closes if a block is pushed off again. The state is the pose of each block relative to its plate. Loose blocks, which
have no plate, are movable obstacles; only edited rooms have them. There are no panels.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Prop, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.mixins import Propped
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

LARGEST_OFFSET = 300.0
"""Bound of observed offsets, m; larger than any room."""
_OFFSETS = (-LARGEST_OFFSET, LARGEST_OFFSET)


class BlockPose(NamedTuple):
    """Pose of a block in the frame of its plate."""

    x: float  # m
    y: float  # m
    yaw: float  # rad, in [-pi/4, pi/4): a square is symmetric under quarter turns


@dataclasses.dataclass(frozen=True)
class PushBlockConfig(PuzzleConfig):
    """Configuration of the pushing puzzle."""

    kind = "push-block"
    needs_physics = True
    count: Annotated[int, Range(1, 16)] = 1
    """Number of blocks, each with a plate."""
    block_size: Annotated[float, Range(0.1, 10, "m")] = 0.6
    """Side of a block."""
    block_height: Annotated[float, Range(0.05, 5, "m")] = 0.4
    """Height of a block."""
    block_mass: Annotated[float, Range(0.01, 10_000, "kg")] = 5.0
    """Mass of a block. The robot pushes with 20 N per kg of its own mass; heavier blocks move less."""
    plate_size: Annotated[float, Range(0.1, 20, "m")] = 1.5
    """Side of a plate. Smaller plates require more precise pushes."""

    def make_puzzle(self, rng: np.random.Generator) -> PushBlockPuzzle:
        """Make the puzzle. It has no random parts; the room samples the places of the props."""
        props = []
        for i in range(self.count):
            props.append(Prop(f"block-{i + 1}", "block", self.block_size / 2, self.block_height, self.block_mass))
            props.append(Prop(f"plate-{i + 1}", "plate", self.plate_size / 2))
        return PushBlockPuzzle(tuple(props))


@dataclasses.dataclass(frozen=True)
class PushBlockPuzzle(Propped, Modelled, Puzzle):
    """A concrete pushing puzzle: each block belongs on the plate that follows it in `things`."""

    kind = "push-block"
    fixed_names = ()
    things: tuple[Prop, ...] = (Prop(), Prop("plate", "plate"))
    """A block, its plate, the next block, and so on; loose blocks are last."""

    def check(self) -> None:
        """Check that blocks and plates alternate and that loose blocks are last."""
        kinds, names = tuple(prop.kind for prop in self.things), [prop.name for prop in self.things]
        pairs = kinds.count("plate")
        if not pairs or kinds != (*("block", "plate") * pairs, *("block",) * (len(kinds) - 2 * pairs)):
            raise ConfigError("puzzle.things", kinds, "block, plate, block, plate, ..., then loose blocks")
        if len(set(names)) < len(names):
            raise ConfigError("puzzle.things", names, "unique names")

    @cached_property
    def pairs(self) -> tuple[tuple[Prop, Prop], ...]:
        """Pairs of a block and its plate."""
        count = sum(prop.kind == "plate" for prop in self.things)
        return tuple(zip(self.things[: 2 * count : 2], self.things[1 : 2 * count : 2], strict=True))

    def with_props(self, props: tuple[Prop, ...]) -> PushBlockPuzzle:
        """Return the same puzzle with other blocks and plates."""
        return dataclasses.replace(self, things=props)

    @property
    def props(self) -> tuple[Prop, ...]:
        """Blocks and plates that the room must place, in the order of `things`."""
        return self.things

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Bounds for each block: offset x and y (m), yaw (rad), and 1 if it is on its plate."""
        return (_OFFSETS, _OFFSETS, (-math.pi / 4, math.pi / 4), (0.0, 1.0)) * len(self.pairs)

    def make_state(self) -> tuple[BlockPose, ...]:
        """Return the state with all blocks far away, before the room reports their poses."""
        return (BlockPose(LARGEST_OFFSET, LARGEST_OFFSET, 0.0),) * len(self.pairs)

    def update(self, state: tuple[BlockPose, ...], contacts: Contacts) -> tuple[BlockPose, ...]:
        """Return the pose of each block relative to its plate."""
        poses = contacts.prop_poses[: 2 * len(self.pairs)]
        if not poses:
            return state
        return tuple(_see_from(plate, block) for block, plate in zip(poses[::2], poses[1::2], strict=True))

    def _list_on_plate(self, state: tuple[BlockPose, ...]) -> tuple[bool, ...]:
        return tuple(max(abs(block.x), abs(block.y)) <= plate.half_size
                     for block, (_, plate) in zip(state, self.pairs, strict=True))

    def is_solved(self, state: tuple[BlockPose, ...]) -> bool:
        """Return whether the centre of every block is over its plate, edges included."""
        return all(self._list_on_plate(state))

    def observe(self, state: tuple[BlockPose, ...]) -> tuple[float, ...]:
        """Return four numbers per block: offset from its plate (m, plate frame), yaw (rad), 1 on the plate."""
        numbers: list[float] = []
        for block, is_on in zip(state, self._list_on_plate(state), strict=True):
            numbers += [min(max(offset, -LARGEST_OFFSET), LARGEST_OFFSET) for offset in (block.x, block.y)]
            numbers += [block.yaw, float(is_on)]
        return tuple(numbers)

    def describe(self, state: tuple[BlockPose, ...]) -> tuple[str, ...]:
        """Return one sentence per block: whether it is on its plate."""
        return tuple(f"{block.name} is {'on' if is_on else 'off'} {plate.name}."
                     for (block, plate), is_on in zip(self.pairs, self._list_on_plate(state), strict=True))

    def get_facts(self, state: tuple[BlockPose, ...]) -> frozenset[str]:
        """Return `on-plate(block-i)` for every block on its plate."""
        return frozenset(f"on-plate({block.name})"
                         for (block, _), is_on in zip(self.pairs, self._list_on_plate(state), strict=True) if is_on)

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: one operator per block, which pushes it onto its plate."""
        operators = []
        for block, plate in self.pairs:
            fact = frozenset({f"on-plate({block.name})"})
            operators.append(Operator(f"push-{block.name}-onto-{plate.name}", block.name, "push",
                                      forbidden=fact, add=fact, destination=plate.name))
        facts = tuple(f"on-plate({block.name})" for block, _ in self.pairs)
        return SymbolicModel(facts, tuple(operators), frozenset(facts))


def _see_from(plate: tuple[float, float, float], block: tuple[float, float, float]) -> BlockPose:
    dx, dy, yaw = (b - p for b, p in zip(block, plate, strict=True))
    cos, sin = math.cos(plate[2]), math.sin(plate[2])
    quarter = math.pi / 2
    return BlockPose(cos * dx + sin * dy, cos * dy - sin * dx, (yaw + quarter / 2) % quarter - quarter / 2)


register_puzzle(PushBlockConfig, PushBlockPuzzle)
