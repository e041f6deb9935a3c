"""Drawing of the dependencies between a puzzle's targets in layers: roots on top, children below."""

from __future__ import annotations

import re
from collections.abc import Hashable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch

from hrl_escape.env.pictures import palette
from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.env.puzzles.cues import compute_depths
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin

_ROWS_A_COLUMN, _NODES_A_ROW = 12, 8
_LARGEST_CELL = 38.0  # points
_SWEEPS = 8


def compute_layout(count: int, edges: Sequence[tuple[int, int]]) -> list[tuple[float, float]]:
    """Compute a position for each node: roots on top, children below, few crossings; y grows downwards.

    Returns:
        (x, y) per node, in units of the distance between neighbours. Layers of more than 8 nodes take several rows.
        After 12 rows the layout continues in the next column, upwards and downwards in turn.
    """
    depths = compute_depths(count, edges)
    layers = [[n for n in range(count) if depths[n] == depth] for depth in range(max(depths, default=0) + 1)]
    _reduce_crossings(layers, edges)
    rows = [layer[i : i + _NODES_A_ROW] for layer in layers for i in range(0, len(layer), _NODES_A_ROW)]
    columns = [rows[i : i + _ROWS_A_COLUMN] for i in range(0, len(rows), _ROWS_A_COLUMN)]
    places = [(0.0, 0.0)] * count
    left = 0.0
    for number, column in enumerate(columns):
        width = max(map(len, column))
        for place, row in enumerate(column):
            y = _ROWS_A_COLUMN - 1 - place if number % 2 else place
            for i, node in enumerate(row):
                places[node] = (left + (width - len(row)) / 2 + i, float(y))
        left += width
    return places


def _reduce_crossings(layers: list[list[int]], edges: Sequence[tuple[int, int]]) -> None:
    """Order each layer by the mean position of its neighbours, down and up in turn (Sugiyama et al. 1981)."""
    for sweep in range(_SWEEPS):
        down = sweep % 2 == 0
        place = {node: i - len(layer) / 2 for layer in layers for i, node in enumerate(layer)}
        for layer in layers if down else reversed(layers):
            near = {n: [place[a if down else b] for a, b in edges if n == (b if down else a)] for n in layer}
            mean = {n: sum(near[n]) / len(near[n]) if near[n] else place[n] for n in layer}
            layer.sort(key=mean.__getitem__)
            place |= {node: i - len(layer) / 2 for i, node in enumerate(layer)}


def shorten(name: str) -> str:
    """Return the short form of a name for small nodes: `12` for `button-12`."""
    number = re.fullmatch(r".*-(\d+)", name)
    return number[1] if number else name


def draw_graph(axes: Axes, puzzle: Puzzle, state: Hashable) -> None:
    """Draw the dependencies between a puzzle's targets, coloured by state. Dots mark locks; the goal has two rings."""
    graph = get_mixin(puzzle, Graphed)
    places = compute_layout(len(puzzle.target_names), graph.edges)
    right, bottom = (max((p[i] for p in places), default=0.0) for i in (0, 1))
    inches = np.array((axes.bbox.width, axes.bbox.height)) / axes.figure.dpi
    cell = min(_LARGEST_CELL, 72 * inches[0] / (right + 1), 72 * inches[1] / (bottom + 1))  # points between nodes
    wide, high = 72 * inches / cell
    axes.set(xlim=(-0.5, wide - 0.5), ylim=(high - 0.5, -0.5), aspect="equal")
    axes.set_axis_off()
    radius, size = 0.32, min(9.0, 0.36 * cell)
    for parent, child in graph.edges:
        axes.add_patch(
            FancyArrowPatch(places[parent], places[child], arrowstyle="-|>", mutation_scale=min(9.0, 0.3 * cell),
                            shrinkA=radius * cell, shrinkB=radius * cell + 1, linewidth=min(1.1, 0.04 * cell),
                            color=palette.MUTED, zorder=1)
        )
    for locking, locked in graph.locks_between:
        axes.add_patch(
            FancyArrowPatch(places[locking], places[locked], arrowstyle="-[,widthB=0.35,lengthB=0", linestyle="dotted",
                            mutation_scale=min(9.0, 0.3 * cell), connectionstyle="arc3,rad=0.25", shrinkA=radius * cell,
                            shrinkB=radius * cell + 2, linewidth=min(1.1, 0.04 * cell), color=palette.LOCK, zorder=1)
        )
    for node, (x, y) in enumerate(places):
        fill, edge, ink = palette.get_target_look(puzzle, state, node)
        axes.add_patch(Circle((x, y), radius, facecolor=fill, edgecolor=edge, linewidth=1.0, zorder=2))
        if node in graph.goal_targets:
            axes.add_patch(Circle((x, y), radius + 0.09, fill=False, edgecolor=edge, linewidth=1.2, zorder=2))
        axes.text(x, y, shorten(puzzle.target_names[node]), fontsize=size, color=ink,
                  ha="center", va="center_baseline", zorder=3)
