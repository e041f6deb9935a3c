"""Compiled loops of cost-to-go fields: representative places, links between cells, prices spread over them.

Arrays in, arrays out; what they mean and where they are kept is `fields.py`. Kernels are
compiled when first called and kept on disk.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hrl_escape.options.lattice.sweeps import get_shape, measure_clearance, measure_distance, sweep

__all__ = ["fill_gaps", "find_last_moves", "link_cells", "place_points", "spread_costs"]

FAR = 32_000


@njit
def _find_cell(points, standing, columns, rows, i, j, x, y):
    """The cell (i, j) if the body fits there, else its neighbour whose place is nearest; -1 if none."""
    if 0 <= i < columns and 0 <= j < rows and standing[i * rows + j]:
        return i * rows + j
    best, nearest = -1, 1e18
    for near_i in range(max(i - 1, 0), min(i + 2, columns)):
        for near_j in range(max(j - 1, 0), min(j + 2, rows)):
            other = near_i * rows + near_j
            if standing[other]:
                away = (points[other, 0] - x) ** 2 + (points[other, 1] - y) ** 2
                if away < nearest:
                    best, nearest = other, away
    return best


@njit(cache=True)
def place_points(scene, low, size, columns, rows):
    """A representative place in each cell of a grid, and whether the body fits there.

    It is the middle where the body fits, else the roomiest of 5 x 5 places.

    Returns:
        points (columns * rows, 2), m; standing (columns * rows,), bool.
    """
    points = np.empty((columns * rows, 2))
    standing = np.zeros(columns * rows, dtype=np.bool_)
    for i in range(columns):
        for j in range(rows):
            x, y = low[0] + (i + 0.5) * size, low[1] + (j + 0.5) * size
            best_x, best_y, widest = x, y, measure_clearance(scene, x, y)
            if widest < scene.radius and widest + size > scene.radius:
                for k in range(25):
                    try_x, try_y = x + (k // 5 - 2) * size / 5, y + (k % 5 - 2) * size / 5
                    clearance = measure_clearance(scene, try_x, try_y)
                    if clearance > widest:
                        best_x, best_y, widest = try_x, try_y, clearance
            cell = i * rows + j
            points[cell, 0], points[cell, 1] = best_x, best_y
            standing[cell] = widest >= scene.radius
    return points, standing


@njit(cache=True)
def link_cells(scene, points, standing, cells_a_row, low, size, moves, steps):
    """Where moves lead from each cell, turned round: for each state, the states that lead to it.

    Args:
        scene: the room.
        points: a representative place in each cell, shape (cells, 2).
        standing: whether the body fits there, shape (cells,).
        cells_a_row: cells along y; a cell's index is i * cells_a_row + j.
        low: corner of the grid, shape (2,).
        size: side of a cell, m.
        moves: displacements, shape (classes, 4, 2), m.
        steps: primitives that a whole displacement takes.

    Returns:
        starts (cells * classes + 1,), sources (links,), costs (links,): state (cell, class) is
        entered from `sources[starts[s]:starts[s + 1]]` (cells, same class) at those costs.
    """
    cells, classes = points.shape[0], moves.shape[0]
    columns = cells // cells_a_row
    landing = np.full(cells * classes * 4, -1, dtype=np.int32)
    price = np.zeros(cells * classes * 4, dtype=np.int16)
    starts = np.zeros(cells * classes + 1, dtype=np.int32)
    length = math.hypot(moves[0, 0, 0], moves[0, 0, 1])
    for cell in range(cells):
        if not standing[cell]:
            continue
        x, y = points[cell, 0], points[cell, 1]
        for c in range(classes):
            for m in range(4):
                dx, dy = moves[c, m, 0], moves[c, m, 1]
                fraction = sweep(scene, x, y, dx, dy, length)
                ex, ey = x + fraction * dx, y + fraction * dy
                i, j = int(math.floor((ex - low[0]) / size)), int(math.floor((ey - low[1]) / size))
                best = _find_cell(points, standing, columns, cells_a_row, i, j, ex, ey)
                if best >= 0 and best != cell:
                    at = (cell * classes + c) * 4 + m
                    landing[at] = best
                    price[at] = max(1, int(math.ceil(fraction * steps - 1e-9)))
                    starts[best * classes + c + 1] += 1
    for s in range(cells * classes):
        starts[s + 1] += starts[s]
    sources = np.empty(starts[-1], dtype=np.int32)
    costs = np.empty(starts[-1], dtype=np.int16)
    fill = starts[:-1].copy()
    for cell in range(cells):
        for c in range(classes):
            for m in range(4):
                at = (cell * classes + c) * 4 + m
                if landing[at] >= 0:
                    state = landing[at] * classes + c
                    sources[fill[state]] = cell
                    costs[fill[state]] = price[at]
                    fill[state] += 1
    return starts, sources, costs


@njit(cache=True)
def find_last_moves(scene, points, candidates, moves, steps, goal, reach):
    """Cells from which one displacement ends in the goal; shape (candidates, classes), its cost or 0."""
    classes = moves.shape[0]
    price = np.zeros((candidates.shape[0], classes), dtype=np.int32)
    length = math.hypot(moves[0, 0, 0], moves[0, 0, 1])
    shape = get_shape(goal)
    for n in range(candidates.shape[0]):
        x, y = points[candidates[n], 0], points[candidates[n], 1]
        for c in range(classes):
            for m in range(4):
                dx, dy = moves[c, m, 0], moves[c, m, 1]
                fraction = sweep(scene, x, y, dx, dy, length)
                if measure_distance(x + fraction * dx, y + fraction * dy, shape) <= reach:
                    cost = max(1, int(math.ceil(fraction * steps - 1e-9)))
                    if price[n, c] == 0 or cost < price[n, c]:
                        price[n, c] = cost
    return price


@njit(cache=True)
def spread_costs(starts, sources, costs, classes, headings, allowed, seeds, seed_costs):
    """Fewest primitives from every (cell, heading) to the nearest seed: Dijkstra with buckets (Dial 1969).

    Args:
        starts: from `link_cells`.
        sources: from `link_cells`.
        costs: from `link_cells`.
        classes: heading classes of the links.
        headings: headings told apart here, a multiple of `classes` or equal to it.
        allowed: cells that may be used, shape (cells,), bool.
        seeds: states cell * headings + heading, in the order of their costs, shape (seeds,).
        seed_costs: what remains to be paid there, shape (seeds,).

    Returns:
        Shape (cells * headings,), int16; -1 where no seed can be reached.
    """
    cells = (starts.shape[0] - 1) // classes
    best = np.full(cells * headings, FAR, dtype=np.int16)
    wide, most_links = 2, 0
    for k in range(costs.shape[0]):
        wide = max(wide, costs[k] + 1)
    for known in range(starts.shape[0] - 1):
        most_links = max(most_links, starts[known + 1] - starts[known])
    buckets = np.empty((wide, 4096), dtype=np.int32)  # states of the next `wide` levels
    filled = np.zeros(wide, dtype=np.int64)
    level, used, fullest = 0, 0, 0
    while level < FAR - wide:
        slot = level % wide
        while used < seeds.shape[0] and seed_costs[used] <= level:
            if fullest == buckets.shape[1]:
                buckets = _widen(buckets, filled)
            state = seeds[used]
            if allowed[state // headings] and level < best[state]:
                best[state] = level
                buckets[slot, filled[slot]] = state
                filled[slot] += 1
                fullest = max(fullest, filled[slot])
            used += 1
        if filled[slot] == 0:
            waiting = 0
            for k in range(wide):
                waiting += filled[k]
            if waiting > 0:
                level += 1
            elif used < seeds.shape[0]:
                level = seed_costs[used]
            else:
                break
            continue
        at = 0
        while at < filled[slot]:
            if fullest + 2 + most_links > buckets.shape[1]:
                buckets = _widen(buckets, filled)
            state = buckets[slot, at]
            at += 1
            if best[state] != level:
                continue
            cell = state // headings
            heading = state - cell * headings
            cost = level + 1
            to = cost % wide
            first = filled[to]
            for turn in range(2):
                if turn == 0:
                    before = state + 1 if heading + 1 < headings else state + 1 - headings
                else:
                    before = state - 1 if heading > 0 else state - 1 + headings
                if cost < best[before]:
                    best[before] = cost
                    buckets[to, first] = before
                    first += 1
            filled[to] = first
            fullest = max(fullest, first)
            known = cell * classes + (heading if headings == classes else heading % classes)
            for k in range(starts[known], starts[known + 1]):
                before, cost = sources[k] * headings + heading, level + costs[k]
                if cost < best[before] and allowed[sources[k]]:
                    best[before] = cost
                    to = cost % wide
                    buckets[to, filled[to]] = before
                    filled[to] += 1
                    fullest = max(fullest, filled[to])
        filled[slot] = 0
        level += 1
    for state in range(best.shape[0]):
        if best[state] == FAR:
            best[state] = -1
    return best


@njit
def _widen(buckets, filled):
    """The same buckets with room for twice as many states."""
    wider = np.empty((buckets.shape[0], 2 * buckets.shape[1]), dtype=np.int32)
    for row in range(buckets.shape[0]):  # slices of two dimensions take numba seconds to compile
        for k in range(filled[row]):
            wider[row, k] = buckets[row, k]
    return wider


@njit(cache=True)
def fill_gaps(field, known, headings, rows):
    """Give cells that are not `known` the least price among their neighbours; changes `field`."""
    columns = known.shape[0] // rows
    for i in range(columns):
        for j in range(rows):
            cell = i * rows + j
            if known[cell]:
                continue
            for heading in range(headings):
                least = -1
                for near_i in range(max(i - 1, 0), min(i + 2, columns)):
                    for near_j in range(max(j - 1, 0), min(j + 2, rows)):
                        other = near_i * rows + near_j
                        cost = field[other * headings + heading]
                        if known[other] and cost >= 0 and (least < 0 or cost < least):
                            least = cost
                field[cell * headings + heading] = least
    return field
