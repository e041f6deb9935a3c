"""The button puzzle (paper, section 5.2): binary buttons that depend on each other along a DAG.

A press turns a button on only if all its parents are on. One button is the goal: while
it is on, the exit is open. The state is an integer whose bit i is button i.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Annotated, Literal

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Panels, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.bits import BitPuzzle
from hrl_escape.env.puzzles.graphs import ButtonNumber, GraphConfig, compute_order, sample_graph
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

__all__ = ["ButtonsConfig", "ButtonsPuzzle"]

ViolationRule = Literal["ignore", "reset"]
"""Answer to a press with unmet parents: ignore it, or turn all buttons off."""


@dataclasses.dataclass(frozen=True)
class ButtonsConfig(PuzzleConfig):
    """Schematic of the button puzzle."""

    kind = "buttons"
    _takes_ranges = True
    count: Annotated[int, Range(1, 64)] = 2
    """Number of buttons."""
    graph: GraphConfig = GraphConfig()
    """Dependencies between buttons."""
    on_violation: ViolationRule = "ignore"
    """A press with unmet parents is ignored, or turns all buttons off."""
    allow_off: bool = False
    """Pressing a button that is on turns it off."""
    goal: ButtonNumber | None = None
    """Number of the goal button from 0, before `graph.relabel` (None: last in topological order)."""
    buttons: Panels = Panels()
    """Sizes and places."""

    def check(self) -> None:
        """Check what spans several fields."""
        if self.goal is not None and self.goal >= self.count:
            raise ConfigError("puzzle.goal", self.goal, f"a button from 0 to {self.count - 1}")
        if self.graph.kind == "edges":
            compute_order(self.count, self.graph.edges)
        self.buttons.check_places(self.count)

    @property
    def panels(self) -> Panels:
        """Sizes and places of the buttons."""
        return self.buttons

    def make_puzzle(self, rng: np.random.Generator) -> ButtonsPuzzle:
        """Sample the dependency graph, then shuffle the buttons' numbers if the graph is to be relabelled."""
        edges = sample_graph(self.graph, self.count, rng)
        goal = compute_order(self.count, edges)[-1] if self.goal is None else self.goal
        if self.graph.relabel and self.graph.kind != "edges":
            label = rng.permutation(self.count).tolist()
            edges = tuple(sorted((label[parent], label[child]) for parent, child in edges))
            goal = label[goal]
        return ButtonsPuzzle(self.count, edges, goal, self.on_violation, self.allow_off)


@dataclasses.dataclass(frozen=True)
class ButtonsPuzzle(BitPuzzle):
    """A concrete button puzzle. Button i is called `button-<i+1>`."""

    kind = "buttons"
    count: Annotated[int, Range(1, 64)] = 1
    """Number of buttons."""
    edge_list: tuple[tuple[ButtonNumber, ButtonNumber], ...] = ()
    """Dependencies (parent, child)."""
    goal: ButtonNumber = 0
    """Number of the goal button from 0."""
    on_violation: ViolationRule = "ignore"
    """Answer to a press with unmet parents."""
    allow_off: bool = False
    """Pressing a button that is on turns it off."""

    def check(self) -> None:
        """Check what spans several fields."""
        compute_order(self.count, self.edge_list)
        if self.goal >= self.count:
            raise ConfigError("puzzle.goal", self.goal, f"a button from 0 to {self.count - 1}")

    @cached_property
    def parent_masks(self) -> tuple[int, ...]:
        """For each button, the bits of its parents."""
        masks = [0] * self.count
        for parent, child in self.edge_list:
            masks[child] |= 1 << parent
        return tuple(masks)

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Dependencies (parent, child)."""
        return self.edge_list

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """The goal button."""
        return (self.goal,)

    @property
    def target_names(self) -> tuple[str, ...]:
        """`button-1` to `button-<count>`."""
        return tuple(f"button-{i + 1}" for i in range(self.count))

    def update(self, state: int, contacts: Contacts) -> int:
        """Apply presses in index order."""
        for button in contacts.pressed:
            bit = 1 << button
            if state & bit:
                if self.allow_off:
                    state &= ~bit
            elif self.parent_masks[button] & ~state == 0:
                state |= bit
            elif self.on_violation == "reset":
                state = 0
        return state

    def is_solved(self, state: int) -> bool:
        """The goal button is on."""
        return bool(state >> self.goal & 1)

    def make_symbolic_model(self) -> SymbolicModel:
        """One operator a button, applicable when its parents are on and it is off."""
        fact = [f"on({name})" for name in self.target_names]
        operators = []
        for i, name in enumerate(self.target_names):
            parents = frozenset(fact[p] for p, child in self.edge_list if child == i)
            operators.append(Operator(f"press-{name}", name, "press", parents, frozenset({fact[i]}),
                                      frozenset({fact[i]}), frozenset()))
        return SymbolicModel(tuple(fact), tuple(operators), frozenset({fact[self.goal]}))


register_puzzle(ButtonsConfig, ButtonsPuzzle)
