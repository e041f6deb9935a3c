"""The button puzzle (paper, section 5.2): binary buttons that depend on each other along a DAG.

A press turns a button on only if all its parents are on. One button is the goal: while
it is on, the exit is open. The state is an integer whose bit i is button i.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Literal

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Panels, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.bits import GraphPuzzle
from hrl_escape.env.puzzles.graphs import ButtonNumber, GraphConfig, compute_order, sample_relabelled
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
        edges, goal = sample_relabelled(self.graph, self.count, rng, self.goal)
        return ButtonsPuzzle(self.count, edges, goal, self.on_violation, self.allow_off)


@dataclasses.dataclass(frozen=True)
class ButtonsPuzzle(GraphPuzzle):
    """A concrete button puzzle. Button i is called `button-<i+1>`."""

    kind = "buttons"
    on_violation: ViolationRule = "ignore"
    """Answer to a press with unmet parents."""
    allow_off: bool = False
    """Pressing a button that is on turns it off."""

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


register_puzzle(ButtonsConfig, ButtonsPuzzle)
