"""LightBox (Vigorito and Barto 2010): lights that depend on each other, where a mistake costs all of them.

A press turns a light on if all its parents are on; otherwise every light goes off. A press of a light that is on turns
it off, and all that depends on it. With probability 1 - `success` a press does nothing. The published graph has twenty
lights; with `graph.kind="random"` it is one of the randomly generated factored domains after Menashe and Stone (2015).
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Annotated

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Panels, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.bits import BitPuzzle
from hrl_escape.env.puzzles.graphs import ButtonNumber, GraphConfig, compute_order, sample_graph
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

__all__ = ["LIGHT_BOX", "LightBoxConfig", "LightBoxPuzzle"]

_PARENTS = {9: (0, 3, 6), 10: (1, 4), 11: (2, 5), 12: (1, 2), 13: (4, 5), 14: (6, 7, 8), 15: (9, 10), 16: (10, 11),
            17: (12, 13), 18: (13, 14), 19: (16, 17)}
LIGHT_BOX = tuple((parent, child) for child, parents in _PARENTS.items() for parent in parents)
"""Dependencies (parent, child) of the published box."""

Success = Annotated[float, Range(0, 1, open_low=True)]


@dataclasses.dataclass(frozen=True)
class LightBoxConfig(PuzzleConfig):
    """Schematic of LightBox."""

    kind = "light-box"
    count: Annotated[int, Range(1, 63)] = 20
    """Number of lights."""
    graph: GraphConfig = GraphConfig(kind="edges", edges=LIGHT_BOX)
    """Dependencies between lights; those of the published box by default."""
    success: Success = 0.9
    """Probability that a press has its effect; else it has none."""
    lights: Panels = Panels(width=0.8)
    """Sizes and places of the lights' panels."""

    def check(self) -> None:
        """Check what spans several fields."""
        if self.graph.kind == "edges":
            compute_order(self.count, self.graph.edges)
        self.lights.check_places(self.count)

    @property
    def panels(self) -> Panels:
        """Sizes and places of the lights' panels."""
        return self.lights

    def make_puzzle(self, rng: np.random.Generator) -> LightBoxPuzzle:
        """Sample the dependencies, then shuffle the lights' numbers if a generated graph is to be relabelled."""
        edges = sample_graph(self.graph, self.count, rng)
        goal = compute_order(self.count, edges)[-1]
        if self.graph.relabel and self.graph.kind != "edges":
            label = rng.permutation(self.count).tolist()
            edges, goal = tuple(sorted((label[a], label[b]) for a, b in edges)), label[goal]
        return LightBoxPuzzle(self.count, edges, goal, self.success)


@dataclasses.dataclass(frozen=True)
class LightBoxPuzzle(BitPuzzle):
    """A concrete box. Light i is called `light-<i+1>`."""

    kind = "light-box"
    count: Annotated[int, Range(1, 63)] = 1
    """Number of lights."""
    edge_list: tuple[tuple[ButtonNumber, ButtonNumber], ...] = ()
    """Dependencies (parent, child)."""
    goal: ButtonNumber = 0
    """Number of the light that opens the exit, from 0."""
    success: Success = 1.0
    """Probability that a press has its effect."""

    def check(self) -> None:
        """Check what spans several fields."""
        compute_order(self.count, self.edge_list)
        if self.goal >= self.count:
            raise ConfigError("puzzle.goal", self.goal, f"a light from 0 to {self.count - 1}")

    @cached_property
    def parent_masks(self) -> tuple[int, ...]:
        """For each light, the bits of its parents."""
        masks = [0] * self.count
        for parent, child in self.edge_list:
            masks[child] |= 1 << parent
        return tuple(masks)

    @cached_property
    def family_masks(self) -> tuple[int, ...]:
        """For each light, the bits of itself and of all that depends on it."""
        masks = [1 << light for light in range(self.count)]
        for light in reversed(compute_order(self.count, self.edge_list)):
            for parent, child in self.edge_list:
                if parent == light:
                    masks[light] |= masks[child]
        return tuple(masks)

    @property
    def is_random(self) -> bool:
        """A press may have no effect."""
        return self.success < 1.0

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Dependencies (parent, child)."""
        return self.edge_list

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """The light that opens the exit."""
        return (self.goal,)

    @property
    def target_names(self) -> tuple[str, ...]:
        """`light-1` to `light-<count>`."""
        return tuple(f"light-{i + 1}" for i in range(self.count))

    def update(self, state: int, contacts: Contacts) -> int:
        """Apply presses in index order; one chance decides for all presses of a primitive."""
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

    def is_solved(self, state: int) -> bool:
        """The goal's light is on."""
        return bool(state >> self.goal & 1)

    def make_symbolic_model(self) -> SymbolicModel:
        """One operator a light, applicable when its parents are on and it is off; other presses help nobody."""
        fact = [f"on({name})" for name in self.target_names]
        operators = []
        for light, name in enumerate(self.target_names):
            parents = frozenset(fact[parent] for parent, child in self.edge_list if child == light)
            own = frozenset({fact[light]})
            operators.append(Operator(f"press-{name}", name, "press", parents, own, own, frozenset()))
        return SymbolicModel(tuple(fact), tuple(operators), frozenset({fact[self.goal]}))


register_puzzle(LightBoxConfig, LightBoxPuzzle)
