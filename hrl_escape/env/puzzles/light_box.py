"""LightBox (Vigorito and Barto 2010): lights that depend on each other, where a mistake turns all of them off.

A press turns a light on if all its parents are on; otherwise every light goes off. Pressing a light that is on turns it
off with all lights that depend on it. With probability 1 - `success` a press has no effect. The published graph has
twenty lights. `graph.kind="random"` gives the randomly generated factored domains of Menashe and Stone (2015).
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Annotated

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Panels, PuzzleConfig, Success, register_puzzle
from hrl_escape.env.puzzles.bits import GraphPuzzle
from hrl_escape.env.puzzles.graphs import GraphConfig, compute_order, sample_relabelled
from hrl_escape.settings import Range

_PARENTS = {9: (0, 3, 6), 10: (1, 4), 11: (2, 5), 12: (1, 2), 13: (4, 5), 14: (6, 7, 8), 15: (9, 10), 16: (10, 11),
            17: (12, 13), 18: (13, 14), 19: (16, 17)}
LIGHT_BOX = tuple((parent, child) for child, parents in _PARENTS.items() for parent in parents)
"""Dependencies (parent, child) of the published box."""

LightCount = Annotated[int, Range(1, 63)]


@dataclasses.dataclass(frozen=True)
class LightBoxConfig(PuzzleConfig):
    """Configuration of LightBox, one wall panel per light."""

    kind = "light-box"
    count: LightCount = 20
    """Number of lights, each with a panel."""
    graph: GraphConfig = GraphConfig(kind="edges", edges=LIGHT_BOX)
    """Dependencies between lights; by default the graph of the published box."""
    success: Success = 0.9
    """Probability that a press has its effect; otherwise it has none."""
    lights: Panels = Panels(width=0.8)
    """Sizes and places of the lights' panels."""

    def check(self) -> None:
        """Check the limits that relate several fields."""
        if self.graph.kind == "edges":
            compute_order(self.count, self.graph.edges)
        super().check()

    def make_puzzle(self, rng: np.random.Generator) -> LightBoxPuzzle:
        """Sample the dependencies, and relabel the lights of a generated graph if configured."""
        edges, goal = sample_relabelled(self.graph, self.count, rng)
        return LightBoxPuzzle(self.count, edges, goal, self.success)


@dataclasses.dataclass(frozen=True)
class LightBoxPuzzle(GraphPuzzle):
    """A concrete box. The name of light i is `light-<i+1>`."""

    kind, word = "light-box", "light"
    count: LightCount = 1
    """Number of lights, each with a panel."""
    success: Success = 1.0
    """Probability that a press has its effect."""

    @cached_property
    def family_masks(self) -> tuple[int, ...]:
        """Bits of each light and of all lights that depend on it."""
        masks = [1 << light for light in range(self.count)]
        for light in reversed(compute_order(self.count, self.edge_list)):
            for parent, child in self.edge_list:
                if parent == light:
                    masks[light] |= masks[child]
        return tuple(masks)

    def update(self, state: int, contacts: Contacts) -> int:
        """Apply presses in index order; one random number decides for all presses of a primitive."""
        if contacts.uniform >= self.success:
            return state
        for light in contacts.pressed:
            if state >> light & 1:
                state &= ~self.family_masks[light]
            elif self.parent_masks[light] & ~state == 0:
                state |= 1 << light
            else:
                state = 0
        return state


register_puzzle(LightBoxConfig, LightBoxPuzzle)
