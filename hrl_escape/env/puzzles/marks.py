"""Marks: a symbol on every target that says something of the hidden graph, by a code that all rooms share.

A symbol is a colour, a shape and a size. The code, part of the room configuration, gives each symbol one class, and a
target shows some symbol of its own class: so what a symbol means can be learned in some rooms and used in others. With
several motifs the classes that symbols stand for are put into one of a few orders, drawn for each room and not shown:
what has been learned says which orders there are, and the first presses which of them holds. Wires are marks too: a
button's colour is its own, and its shape and size, the plug, name by the code the colour of the button that it waits
for; some wires are hidden. Marks never change the rules. Nothing else that can be observed before the first press tells
of the graph.
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
MARK_WORDS = (*COLOURS, *SHAPES, *SIZES)
"""Names of the numbers that a marked target's row has besides: 1 for its colour, its shape and its size."""
PLUGS = len(SHAPES) * len(SIZES)
"""Shapes of all sizes, the plugs of wires."""
MOST_SYMBOLS = len(COLOURS) * PLUGS

Mark: TypeAlias = Annotated[int, Range(0, MOST_SYMBOLS - 1)]
"""Number of a symbol: colour + 8 shape + 32 size."""


def split_mark(mark: int) -> tuple[int, int, int]:
    """Numbers of a symbol's colour, shape and size."""
    rest, colour = divmod(mark, len(COLOURS))
    size, shape = divmod(rest, len(SHAPES))
    return colour, shape, size


def name_mark(mark: int) -> str:
    """Words for a symbol, such as `small red disc`."""
    colour, shape, size = split_mark(mark)
    return f"{SIZES[size]} {COLOURS[colour]} {SHAPES[shape]}"


def make_mark_rows(marks: tuple[int, ...]) -> NDArray[np.float64]:
    """Numbers of each target's mark, (targets, `MARK_WORDS`); (0, 0) where there are no marks."""
    rows = np.zeros((len(marks), len(MARK_WORDS) if marks else 0))
    for row, mark in zip(rows, marks, strict=True):
        colour, shape, size = split_mark(mark)
        row[[colour, len(COLOURS) + shape, len(COLOURS) + len(SHAPES) + size]] = 1.0
    return rows


def compute_depths(count: int, edges: Iterable[tuple[int, int]]) -> list[int]:
    """Longest way to each node of a DAG from one without parents, in edges; at most `count` where there are cycles."""
    parents: list[list[int]] = [[] for _ in range(count)]
    for parent, child in edges:
        parents[child].append(parent)
    depths = [0] * count
    for _ in range(count):
        depths = [max((depths[parent] + 1 for parent in above), default=0) for above in parents]
    return depths


@dataclasses.dataclass(frozen=True)
class MarksConfig(HashedSettings):
    """Marks on targets: what they tell of the graph, and by which code."""

    _section = "marks"
    kind: Literal["none", "rank", "needed", "wires"] = "none"
    """`rank`: a mark tells how many buttons must be on before its own, along the longest way. `needed`: whether the
    goal depends on it. `wires`: which button must be on before, by its colour."""
    levels: Annotated[int, Range(2, 64)] = 8
    """Ranks that marks tell apart; the last stands for all higher ones."""
    symbols: Annotated[int, Range(2, MOST_SYMBOLS)] = 8
    """Number of different symbols: the vocabulary that is to be learned. Up to 8 differ in colour only."""
    truth: Annotated[float, Range(0, 1)] = 1.0
    """Share of marks that are drawn from the target's own class; the others are any symbol. Share of wires that are
    shown; the others look as if there were none."""
    shuffled: bool = False
    """Marks are those of another graph of the room configuration: they look the same and say nothing, for control."""
    code: Annotated[int, Range(0, 2**63 - 1)] = 0
    """Seed of the code, which gives each symbol its class, and of the motifs."""
    motifs: Annotated[int, Range(1, 64)] = 1
    """Orders of the classes, of which each room draws one that nothing shows before the first press; with 1 a symbol
    means the same class in every room."""

    def check(self) -> None:
        """Check that there are symbols for every class."""
        if self.kind == "wires":
            if self.motifs > 1:
                raise ConfigError("marks.motifs", self.motifs, "1 with wires, whose plugs mean the same in every room")
            return
        if self.kind != "none" and self.symbols < self.classes:
            raise ConfigError("marks.symbols", self.symbols, f"at least {self.classes}, one for each class of targets")
        if self.motifs > math.factorial(self.classes):
            raise ConfigError("marks.motifs", self.motifs, f"at most {math.factorial(self.classes)}, the orders of "
                              f"{self.classes} classes")

    @property
    def classes(self) -> int:
        """Number of classes of targets that marks tell apart; with wires, of plugs: none, and one for each colour."""
        return {"needed": 2, "wires": 1 + len(COLOURS)}.get(self.kind, self.levels)

    @cached_property
    def meanings(self) -> NDArray[np.int64]:
        """Class of each symbol, or of each plug, (symbols,): as many of each class as of any other, or one more."""
        symbols = PLUGS if self.kind == "wires" else self.symbols
        return np.random.default_rng([self.code, 3]).permutation(symbols) % self.classes

    @cached_property
    def orders(self) -> NDArray[np.int64]:
        """Class that a symbol of each class stands for under each motif, (motifs, classes); the first changes none."""
        rng, orders = np.random.default_rng([self.code, 4]), [tuple(range(self.classes))]
        while len(orders) < self.motifs:
            order = tuple(rng.permutation(self.classes).tolist())
            orders += [] if order in orders else [order]
        return np.array(orders)

    def classify(self, count: int, edges: Edges, goal: int) -> NDArray[np.int64]:
        """Class of each target of a graph, (count,); with wires 0, or the number of its lowest parent and 1."""
        if self.kind == "wires":
            return np.array([min((parent + 1 for parent, child in edges if child == node), default=0)
                             for node in range(count)])
        if self.kind == "needed":
            needed = find_ancestors(edges, (goal,))
            return np.array([int(node in needed) for node in range(count)])
        return np.minimum(compute_depths(count, edges), self.levels - 1)

    def draw(self, count: int, edges: Edges, goal: int, rng: np.random.Generator) -> tuple[int, ...]:
        """Draw the mark of each target of a graph."""
        if self.kind == "wires":
            return self._draw_wires(self.classify(count, edges, goal), rng)
        order = self.orders[rng.integers(self.motifs) if self.motifs > 1 else 0]
        meanings = order[self.meanings]
        return tuple(int(rng.choice(np.flatnonzero(meanings == own) if rng.random() < self.truth else self.symbols))
                     for own in self.classify(count, edges, goal))

    def _draw_wires(self, classes: NDArray[np.int64], rng: np.random.Generator) -> tuple[int, ...]:
        """Colours, each once, and plugs that name the colour of each target's parent."""
        colours = rng.permutation(len(COLOURS))[: len(classes)]
        named = np.array([0, *(colours + 1)])[np.where(rng.random(len(classes)) < self.truth, classes, 0)]
        alike = [np.flatnonzero(self.meanings == own) for own in named]
        plugs = [int(same[rng.integers(len(same))]) for same in alike]
        return tuple(int(colour) + len(COLOURS) * plug for colour, plug in zip(colours, plugs, strict=True))

    def _compute_wire_likelihood(self, marks: tuple[int, ...], classes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Probability of marks under each graph, (graphs,); classes (graphs, targets)."""
        plugs, colours = np.divmod(np.array(marks), len(COLOURS))
        read = self.meanings[plugs]
        targets = {0: 0} | {colour + 1: target + 1 for target, colour in enumerate(colours.tolist())}
        named = np.array([targets.get(own, -1) for own in read.tolist()])
        own = np.where(classes > 0, self.truth * (named == classes) + (1 - self.truth) * (named == 0), named == 0)
        return np.prod(own / np.bincount(self.meanings, minlength=self.classes)[read], axis=1)

    def compute_likelihood(self, marks: tuple[int, ...], classes: NDArray[np.int64],
                           odds: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Probability of the marks of a room under each of several graphs.

        Args:
            marks: of its targets.
            classes: class of each target under each graph, (graphs, targets).
            odds: probability of each motif, (motifs,); all alike by default.

        Returns:
            float64 (graphs,); all alike where marks say nothing.
        """
        if self.kind == "none" or self.shuffled:
            return np.ones(len(classes))
        return np.average(self.compute_motif_likelihood(marks, classes), axis=0, weights=odds)

    def compute_motif_likelihood(self, marks: tuple[int, ...], classes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Probability of marks that say something under each motif and graph, (motifs, graphs)."""
        if self.kind == "wires":
            return self._compute_wire_likelihood(marks, classes)[None]
        read = self.meanings[list(marks)]
        own = (self.orders[:, None, read] == classes) / np.bincount(self.meanings, minlength=self.classes)[read]
        return np.prod(self.truth * own + (1 - self.truth) / self.symbols, axis=2)

    def find_motif(self, marks: tuple[int, ...], edges: Edges, goal: int) -> int:
        """Number of the motif that the marks of a room follow best."""
        return int(self.compute_motif_likelihood(marks, self.classify(len(marks), edges, goal)[None]).argmax())
