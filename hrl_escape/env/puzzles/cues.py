"""Cues: a symbol on every target that carries information about the hidden graph, by a code shared by all rooms.

A symbol is a colour, a shape and a size. The code, part of the room configuration, assigns a class to each symbol, and
a target shows a random symbol of its class. Agents can therefore learn the meaning of a symbol in some rooms and use it
in others. With latent codes, each room permutes the classes by a hidden order from a small set; training reveals the
set, and the first presses reveal which order the room has. With dependency cues, every button has its own colour, and
its shape and size, the plug, encode the colour of the button that it waits for. Some of them are hidden. Cues never
change the rules. Before the first press, all other observations are independent of the graph.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from functools import cached_property
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.puzzles.graphs import Edges, find_ancestors
from hrl_escape.env.schema import HashedSettings
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

COLOURS = ("red", "blue", "green", "yellow", "purple", "cyan", "orange", "black")
SHAPES = ("disc", "square", "triangle", "star")
SIZES = ("small", "medium", "large")
CUE_WORDS = (*COLOURS, *SHAPES, *SIZES)
"""Names of the additional numbers in the row of a target with a cue: 1 for its colour, its shape and its size."""
PLUGS = len(SHAPES) * len(SIZES)
"""Shapes in each size: the plugs of dependency cues."""
MOST_SYMBOLS = len(COLOURS) * PLUGS

Cue: TypeAlias = Annotated[int, Range(0, MOST_SYMBOLS - 1)]
"""Number of a symbol: colour + 8 shape + 32 size."""


def split_cue(cue: int) -> tuple[int, int, int]:
    """Return the numbers of a symbol's colour, shape and size."""
    rest, colour = divmod(cue, len(COLOURS))
    size, shape = divmod(rest, len(SHAPES))
    return colour, shape, size


def name_cue(cue: int) -> str:
    """Return a symbol in words, such as `small red disc`."""
    colour, shape, size = split_cue(cue)
    return f"{SIZES[size]} {COLOURS[colour]} {SHAPES[shape]}"


def make_cue_rows(cues: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the observation numbers of each target's cue, (targets, `CUE_WORDS`); shape (0, 0) without cues."""
    rows = np.zeros((len(cues), len(CUE_WORDS) if cues else 0))
    for row, cue in zip(rows, cues, strict=True):
        colour, shape, size = split_cue(cue)
        row[[colour, len(COLOURS) + shape, len(COLOURS) + len(SHAPES) + size]] = 1.0
    return rows


def compute_depths(count: int, edges: Iterable[tuple[int, int]]) -> list[int]:
    """Return the longest path to each node of a DAG from a root, in edges; at most `count` if there are cycles."""
    parents: list[list[int]] = [[] for _ in range(count)]
    for parent, child in edges:
        parents[child].append(parent)
    depths = [0] * count
    for _ in range(count):
        depths = [max((depths[parent] + 1 for parent in above), default=0) for above in parents]
    return depths


@dataclasses.dataclass(frozen=True)
class CuesConfig(HashedSettings):
    """Cues on targets: what they encode about the graph, and the code."""

    _section = "cues"
    kind: Literal["none", "rank", "needed", "dependencies"] = "none"
    """Meaning of a cue. `rank`: the number of buttons that must be on before its button, along the longest path.
    `needed`: whether the goal depends on the button. `dependencies`: the colour of the button that must be on before
    it."""
    levels: Annotated[int, Range(2, 64)] = 8
    """Number of ranks that cues distinguish; the last class includes all higher ranks. More of them reveal more."""
    symbols: Annotated[int, Range(2, MOST_SYMBOLS)] = 8
    """Number of different symbols. More symbols take longer to learn. Up to 8 differ in colour only."""
    truth: Annotated[float, Range(0, 1)] = 1.0
    """Share of cues drawn from the class of their target; the others are random symbols. For dependencies, the share
    that is visible; the others look like absent dependencies. Lower values make cues less reliable."""
    shuffled: bool = False
    """If true, cues belong to another graph of the room configuration: same appearance, no information
    (control)."""
    code: Annotated[int, Range(0, 2**63 - 1)] = 0
    """Seed of the latent codes and of the code that assigns a class to each symbol."""
    latent_codes: Annotated[int, Range(1, 64)] = 1
    """Number of orders of the classes. Each room draws one, which is hidden before the first press. With 1, a symbol
    has the same class in every room."""

    def check(self) -> None:
        """Check that every class has a symbol."""
        if self.kind == "dependencies":
            if self.latent_codes > 1:
                raise ConfigError("cues.latent_codes", self.latent_codes, "1 with dependencies: plugs mean the "
                                  "same in every room")
            return
        if self.kind != "none" and self.symbols < self.classes:
            raise ConfigError("cues.symbols", self.symbols, f"at least {self.classes}, one per class of targets")
        if self.latent_codes > math.factorial(self.classes):
            raise ConfigError("cues.latent_codes", self.latent_codes, f"at most {math.factorial(self.classes)}, the "
                              f"number of orders of {self.classes} classes")

    @property
    def classes(self) -> int:
        """Number of classes that cues distinguish; with dependencies, of plugs: no plug, and one per colour."""
        return {"needed": 2, "dependencies": 1 + len(COLOURS)}.get(self.kind, self.levels)

    @cached_property
    def meanings(self) -> NDArray[np.int64]:
        """Class of each symbol, or of each plug, (symbols,). Classes are equally frequent, up to one."""
        symbols = PLUGS if self.kind == "dependencies" else self.symbols
        return np.random.default_rng([self.code, 3]).permutation(symbols) % self.classes

    @cached_property
    def orders(self) -> NDArray[np.int64]:
        """Class that a symbol of each class encodes under each latent code, (codes, classes); the identity first."""
        rng, orders = np.random.default_rng([self.code, 4]), [tuple(range(self.classes))]
        while len(orders) < self.latent_codes:
            order = tuple(rng.permutation(self.classes).tolist())
            orders += [] if order in orders else [order]
        return np.array(orders)

    def classify(self, count: int, edges: Edges, goal: int) -> NDArray[np.int64]:
        """Return the class of each target of a graph, (count,); with dependencies, 0 or 1 + its first parent."""
        if self.kind == "dependencies":
            return np.array([min((parent + 1 for parent, child in edges if child == node), default=0)
                             for node in range(count)])
        if self.kind == "needed":
            needed = find_ancestors(edges, (goal,))
            return np.array([int(node in needed) for node in range(count)])
        return np.minimum(compute_depths(count, edges), self.levels - 1)

    def draw(self, count: int, edges: Edges, goal: int, rng: np.random.Generator) -> tuple[int, ...]:
        """Draw the cue of each target of a graph."""
        if self.kind == "dependencies":
            return self._draw_dependencies(self.classify(count, edges, goal), rng)
        order = self.orders[rng.integers(self.latent_codes) if self.latent_codes > 1 else 0]
        meanings = order[self.meanings]
        return tuple(int(rng.choice(np.flatnonzero(meanings == own) if rng.random() < self.truth else self.symbols))
                     for own in self.classify(count, edges, goal))

    def _draw_dependencies(self, classes: NDArray[np.int64], rng: np.random.Generator) -> tuple[int, ...]:
        """Colours, each used once, and plugs that encode the colour of each target's parent."""
        colours = rng.permutation(len(COLOURS))[: len(classes)]
        named = np.array([0, *(colours + 1)])[np.where(rng.random(len(classes)) < self.truth, classes, 0)]
        alike = [np.flatnonzero(self.meanings == own) for own in named]
        plugs = [int(same[rng.integers(len(same))]) for same in alike]
        return tuple(int(colour) + len(COLOURS) * plug for colour, plug in zip(colours, plugs, strict=True))

    def _compute_dependency_likelihood(self, cues: tuple[int, ...], classes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Probability of the cues under each graph, (graphs,); classes has shape (graphs, targets)."""
        plugs, colours = np.divmod(np.array(cues), len(COLOURS))
        read = self.meanings[plugs]
        targets = {0: 0} | {colour + 1: target + 1 for target, colour in enumerate(colours.tolist())}
        named = np.array([targets.get(own, -1) for own in read.tolist()])
        own = np.where(classes > 0, self.truth * (named == classes) + (1 - self.truth) * (named == 0), named == 0)
        return np.prod(own / np.bincount(self.meanings, minlength=self.classes)[read], axis=1)

    def compute_likelihood(self, cues: tuple[int, ...], classes: NDArray[np.int64],
                           odds: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Return the probability of a room's cues under each of several graphs.

        Args:
            cues: cues of the targets of the room.
            classes: class of each target under each graph, (graphs, targets).
            odds: probability of each latent code, (codes,); uniform by default.

        Returns:
            float64 (graphs,); constant if cues carry no information.
        """
        if self.kind == "none" or self.shuffled:
            return np.ones(len(classes))
        return np.average(self.compute_code_likelihood(cues, classes), axis=0, weights=odds)

    def compute_code_likelihood(self, cues: tuple[int, ...], classes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the probability of informative cues under each latent code and graph, (codes, graphs)."""
        if self.kind == "dependencies":
            return self._compute_dependency_likelihood(cues, classes)[None]
        read = self.meanings[list(cues)]
        own = (self.orders[:, None, read] == classes) / np.bincount(self.meanings, minlength=self.classes)[read]
        return np.prod(self.truth * own + (1 - self.truth) / self.symbols, axis=2)

    def find_code(self, cues: tuple[int, ...], edges: Edges, goal: int) -> int:
        """Return the number of the latent code that fits the cues of a room best."""
        return int(self.compute_code_likelihood(cues, self.classify(len(cues), edges, goal)[None]).argmax())
