"""Bases of puzzles whose state is a word with one bit per target: bit i is 1 while target i is on."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Annotated, Any, ClassVar

from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.env.puzzles.graphs import ButtonNumber, compute_order, find_ancestors, mask_parents
from hrl_escape.env.puzzles.mixins import Graphed
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range


class BitPuzzle(Modelled, Puzzle):
    """Base class of puzzles of bits. A subclass adds rules, the symbolic model, and the field `count`.

    Attributes:
        word: prefix of target names; target i is `<word>-<i+1>`.
    """

    word: ClassVar[str]
    count: int
    """Number of targets, and of bits in the state."""

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the targets, `<word>-1` to `<word>-<count>`."""
        return tuple(f"{self.word}-{i + 1}" for i in range(self.count))

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is an integer with one bit per target."""
        return type(state) is int and 0 <= state < 1 << self.count

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each target is on."""
        return tuple(bool(state >> i & 1) for i in range(self.count))

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `on(<name>)` for every target that is on."""
        return frozenset(f"on({name})" for i, name in enumerate(self.target_names) if state >> i & 1)


@dataclasses.dataclass(frozen=True)
class GraphPuzzle(Graphed, BitPuzzle):
    """Base class of puzzles whose targets form a DAG of dependencies with one goal. Subclasses add names and rules."""

    count: Annotated[int, Range(1, 64)] = 1
    """Number of targets, and of bits in the state."""
    edge_list: tuple[tuple[ButtonNumber, ButtonNumber], ...] = ()
    """Dependencies between targets, as (parent, child) pairs of their numbers."""
    goal: ButtonNumber = 0
    """Number of the target that opens the exit, from 0."""

    def check(self) -> None:
        """Check the limits that relate several fields."""
        compute_order(self.count, self.edge_list)
        if self.goal >= self.count:
            raise ConfigError("puzzle.goal", self.goal, f"a number from 0 to {self.count - 1}")

    @cached_property
    def parent_masks(self) -> tuple[int, ...]:
        """Bits of the parents of each target."""
        return mask_parents(self.edge_list, self.count)

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Dependencies between targets, as (parent, child) pairs of their numbers."""
        return self.edge_list

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Index of the target that opens the exit, as a tuple of one."""
        return (self.goal,)

    def is_solved(self, state: int) -> bool:
        """Return whether the goal target is on."""
        return bool(state >> self.goal & 1)

    def compute_progress(self, state: int) -> float:
        """Return the fraction, in [0, 1], of the goal and its ancestors that are on."""
        wanted = self._wanted
        return (state & wanted).bit_count() / wanted.bit_count()

    @cached_property
    def _wanted(self) -> int:
        return sum(1 << target for target in find_ancestors(self.edge_list, (self.goal,)))

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: one operator per target, applicable while its parents are on and it is off."""
        fact = [f"on({name})" for name in self.target_names]
        operators = []
        for i, name in enumerate(self.target_names):
            parents = frozenset(fact[parent] for parent, child in self.edge_list if child == i)
            own = frozenset({fact[i]})
            operators.append(Operator(f"press-{name}", name, "press", parents, own, own))
        return SymbolicModel(tuple(fact), tuple(operators), frozenset({fact[self.goal]}))
