"""Compiled loops of smooth cost-to-go fields: where primitives lead from grid places, and value iteration over that.

A primitive's end lies between four cells and is worth their interpolated value, so that the
value at any exact pose can be had the same way and compared (Munos and Moore 2002, section 3). Arrays in,
arrays out; what they mean is `prices.py`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hrl_escape.options.lattice.sweeps import get_shape, measure_distance, sweep

__all__ = ["FAR", "relax", "trace_moves"]

FAR = 10_000.0
"""Worth of places from which the goal cannot be reached."""


@njit
def _touch(x, y, targets, reaches):
    """Bits of the targets that the body touches at a place."""
    bits = np.uint64(0)
    for k in range(targets.shape[0]):
        if measure_distance(x, y, get_shape(targets[k])) <= reaches[k]:
            bits |= np.uint64(1) << np.uint64(k)
    return bits


@njit(cache=True)
def trace_moves(scene, points, standing, rows, low, size, moves, targets, reaches, way_out):
    """Where every move leads from every cell's representative place.

    Args:
        scene: the room.
        points: a representative place in each cell, shape (cells, 2), m.
        standing: whether the body fits there, shape (cells,).
        rows: cells along y; a cell's index is i * rows + j.
        low: corner of the grid, shape (2,), m.
        size: side of a cell, m.
        moves: displacements, shape (classes, 4, 2), m.
        targets: rows of `stack_footprints`, shape (targets, 7).
        reaches: distance at which each is touched, shape (targets,), m.
        way_out: x_min, x_max, y_min, y_max of the exit, m.

    Returns:
        corners (links,), int32: lowest of the four cells round the end of link (cell * classes + class) * 4 + move, -1
        where there is none; weights (links, 4), float32: theirs, lower row first; touched (links,), uint64: bits of
        the targets touched there; outside (links,): whether that is not in the exit; here (cells,), uint64: bits of
        the targets touched at the places themselves.
    """
    cells, classes = points.shape[0], moves.shape[0]
    columns = cells // rows
    corners = np.full(cells * classes * 4, -1, dtype=np.int32)
    weights = np.zeros((cells * classes * 4, 4), dtype=np.float32)
    touched = np.zeros(cells * classes * 4, dtype=np.uint64)
    outside = np.ones(cells * classes * 4, dtype=np.bool_)
    here = np.zeros(cells, dtype=np.uint64)
    length = math.hypot(moves[0, 0, 0], moves[0, 0, 1])
    for cell in range(cells):
        if not standing[cell]:
            continue
        x, y = points[cell, 0], points[cell, 1]
        here[cell] = _touch(x, y, targets, reaches)
        for c in range(classes):
            for m in range(4):
                dx, dy = moves[c, m, 0], moves[c, m, 1]
                fraction = sweep(scene, x, y, dx, dy, length)
                if fraction * length < 0.01:
                    continue
                ex, ey = x + fraction * dx, y + fraction * dy
                link = (cell * classes + c) * 4 + m
                touched[link] = _touch(ex, ey, targets, reaches)
                outside[link] = not (way_out[0] <= ex <= way_out[1] and way_out[2] <= ey <= way_out[3])
                u, v = (ex - low[0]) / size - 0.5, (ey - low[1]) / size - 0.5
                i, j = min(max(int(math.floor(u)), 0), columns - 2), min(max(int(math.floor(v)), 0), rows - 2)
                a, b = min(max(u - i, 0.0), 1.0), min(max(v - j, 0.0), 1.0)
                total = 0.0
                for k in range(4):
                    corner = (i + k // 2) * rows + j + k % 2
                    weight = (a if k // 2 else 1.0 - a) * (b if k % 2 else 1.0 - b)
                    if standing[corner]:
                        weights[link, k] = weight
                        total += weight
                if total > 1e-6:
                    corners[link] = i * rows + j
                    for k in range(4):
                        weights[link, k] /= total
    return corners, weights, touched, outside, here


@njit(cache=True)
def relax(values, order, corners, weights, touched, outside, here, rows, target, leaves, penalty, tolerance, most):
    """Improve values until none changes, in place: value iteration (Gauss-Seidel) from the goal outwards.

    Args:
        values: primitives to the goal, shape (cells, classes), float32; `FAR` where unknown.
        order: states cell * classes + class, those near the goal first.
        corners: from `trace_moves`.
        weights: from `trace_moves`.
        touched: from `trace_moves`.
        outside: from `trace_moves`.
        here: from `trace_moves`.
        rows: cells along y.
        target: which target is to be pressed; -1 for the exit.
        leaves: whether being in the exit ends the episode without the goal.
        penalty: what beginning to touch another target costs.
        tolerance: change that no longer matters.
        most: sweeps at most.

    Returns:
        Whether nothing changes any more.
    """
    classes = values.shape[1]
    own = np.uint64(1) << np.uint64(max(target, 0)) if target >= 0 else np.uint64(0)
    for _ in range(most):
        change = 0.0
        for n in range(order.shape[0]):
            cell = order[n] // classes
            c = order[n] - cell * classes
            left, right = c + 1 if c + 1 < classes else 0, c - 1 if c > 0 else classes - 1
            best = 1.0 + min(values[cell, left], values[cell, right])
            for m in range(4):
                link = order[n] * 4 + m
                corner = corners[link]
                if corner < 0:
                    continue
                begun = touched[link] & ~here[cell]
                if (target >= 0 and begun & own) or (target < 0 and not outside[link]):
                    worth = 1.0
                elif leaves and not outside[link]:
                    continue
                else:
                    worth = 1.0
                    for k in range(4):
                        if weights[link, k] > 0.0:
                            worth += weights[link, k] * values[corner + (k // 2) * rows + k % 2, c]
                if begun & ~own:
                    worth += penalty
                best = min(best, worth)
            best = min(best, FAR)
            change = max(change, abs(best - values[cell, c]))
            values[cell, c] = best
        if change < tolerance:
            return True
    return False
