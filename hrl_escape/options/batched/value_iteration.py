"""Kernels of smooth cost-to-go fields: ends of primitives on a grid, and value iteration over them.

The end of a primitive lies between four cells and has their interpolated value; the value of any
exact pose is interpolated in the same way (Munos and Moore 2002, section 3). Arrays in, arrays
out; `cost_to_go.py` gives them their meaning.
"""

from __future__ import annotations

import math

import numpy as np

from hrl_escape.kernels import kernel, kernel_part
from hrl_escape.planning.lattice.sweep_kernels import get_shape, measure_distance, sweep

__all__ = ["UNREACHABLE", "iterate_values", "trace_moves"]

UNREACHABLE = 10_000.0
"""Cost-to-go of places from which the goal cannot be reached."""


@kernel_part
def _find_touched(x, y, targets, reaches):
    """Bits of the targets that the body touches at a place."""
    bits = np.uint64(0)
    for k in range(targets.shape[0]):
        if measure_distance(x, y, get_shape(targets[k])) <= reaches[k]:
            bits |= np.uint64(1) << np.uint64(k)
    return bits


@kernel
def trace_moves(scene, points, standing, rows, low, size, moves, targets, reaches, way_out):
    """End of every move from every cell's representative place.

    Args:
        scene: the room.
        points: a representative place in each cell, shape (cells, 2), m.
        standing: True where the body fits, shape (cells,).
        rows: cells along y; a cell's index is i * rows + j.
        low: corner of the grid, shape (2,), m.
        size: side of a cell, m.
        moves: displacements, shape (classes, translations, 2), m.
        targets: rows of `stack_footprints`, shape (targets, 7).
        reaches: distance at which each is touched, shape (targets,), m.
        way_out: x_min, x_max, y_min, y_max of the exit, m.

    Returns:
        corners (links,), int32: lowest of the four cells round the end of each link, -1 where there is none; link
        (cell * classes + class) * translations + move; weights (links, 4), float32: theirs, lower row first; touched
        (links,), uint64: bits of the targets touched there; outside (links,): true unless that is in the exit; here
        (cells,), uint64: bits of the targets touched at the places themselves.
    """
    cells, classes, translations = points.shape[0], moves.shape[0], moves.shape[1]
    links = cells * classes * translations
    columns = cells // rows
    corners = np.full(links, -1, dtype=np.int32)
    weights = np.zeros((links, 4), dtype=np.float32)
    touched = np.zeros(links, dtype=np.uint64)
    outside = np.ones(links, dtype=np.bool_)
    here = np.zeros(cells, dtype=np.uint64)
    length = math.hypot(moves[0, 0, 0], moves[0, 0, 1])
    for cell in range(cells):
        if not standing[cell]:
            continue
        x, y = points[cell, 0], points[cell, 1]
        here[cell] = _find_touched(x, y, targets, reaches)
        for c in range(classes):
            for m in range(translations):
                dx, dy = moves[c, m, 0], moves[c, m, 1]
                fraction = sweep(scene, x, y, dx, dy, length)
                if fraction * length < 0.01:
                    continue
                ex, ey = x + fraction * dx, y + fraction * dy
                link = (cell * classes + c) * translations + m
                touched[link] = _find_touched(ex, ey, targets, reaches)
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


@kernel
def iterate_values(values, order, corners, weights, touched, outside, here, rows, target, leaves, penalty, tolerance,
                   most, is_near):
    """Gauss-Seidel value iteration from the goal outwards, in place, until no value changes.

    After the first sweep only states are backed up from which one primitive leads to a state that has changed since.

    Args:
        values: cost-to-go, shape (cells, classes), float32; `UNREACHABLE` where unknown.
        order: states cell * classes + class, those near the goal first.
        corners: from `trace_moves`.
        weights: from `trace_moves`.
        touched: from `trace_moves`.
        outside: from `trace_moves`.
        here: from `trace_moves`.
        rows: cells along y.
        target: index of the target to press; -1 for the exit.
        leaves: True if entering the exit ends the episode without the goal.
        penalty: cost of touching another target.
        tolerance: largest change that counts as none.
        most: most sweeps, at most 250.
        is_near: the values are those of the same goal with the exit free to enter; then the first sweep backs up only
            the states from which one primitive leads into it.

    Returns:
        True if no value changes any more.
    """
    classes = values.shape[1]
    translations = corners.shape[0] // values.size
    own = np.uint64(1) << np.uint64(max(target, 0)) if target >= 0 else np.uint64(0)
    # number of the last sweep in which a state changed, and in which one of the four cells from a corner on did
    changed = np.zeros(values.shape, dtype=np.uint8)
    changed_near = np.zeros(values.shape, dtype=np.uint8)
    for number in range(1, most + 1):
        is_done = True
        for n in range(order.shape[0]):
            cell = order[n] // classes
            c = order[n] - cell * classes
            left, right = c + 1 if c + 1 < classes else 0, c - 1 if c > 0 else classes - 1
            first = order[n] * translations
            if number > 1 or is_near:
                last = number - 1
                is_stale = last > 0 and (changed[cell, left] >= last or changed[cell, right] >= last)
                for link in range(first, first + translations):
                    if corners[link] >= 0:
                        is_stale |= changed_near[corners[link], c] >= last if last else not outside[link]
                if not is_stale:
                    continue
            best = 1.0 + min(values[cell, left], values[cell, right])
            for link in range(first, first + translations):
                corner = corners[link]
                if corner < 0:
                    continue
                begun = touched[link] & ~here[cell]
                if (target >= 0 and begun & own) or (target < 0 and not outside[link]):
                    cost = 1.0
                elif leaves and not outside[link]:
                    continue
                else:
                    cost = 1.0
                    for k in range(4):
                        if weights[link, k] > 0.0:
                            cost += weights[link, k] * values[corner + (k // 2) * rows + k % 2, c]
                if begun & ~own:
                    cost += penalty
                best = min(best, cost)
            best = min(best, UNREACHABLE)
            if abs(best - values[cell, c]) >= tolerance:
                is_done = False
                changed[cell, c] = number
                for near in (cell, cell - 1, cell - rows, cell - rows - 1):
                    changed_near[max(near, 0), c] = number
            values[cell, c] = best
        if is_done:
            return True
    return False
