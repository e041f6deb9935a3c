"""Compiled tables of the fewest joint steps: to hand positions over the floor, and by place of the base.

Pairs of half configurations are enumerated in the order of their joint steps, so the first is the
cheapest. Tables are lower bounds, exact up to the size of their cells; single configurations are
found by `search.py`. Importing this module imports numba.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_escape.kernels import kernel, kernel_part
from hrl_escape.planning.arm.joint_lattice import NEVER


@kernel
def map_hands(lattice, z_low, z_high, cell, half_cells, budget):
    """Fewest joint steps that bring the hand into each cell of the floor, at heights within a window.

    Args:
        lattice: the arm's configurations.
        z_low: m.
        z_high: m.
        cell: side of a cell, m.
        half_cells: cells from the base's axis to each edge of the map.
        budget: pairs of halves beyond which no further cost is begun.

    Returns:
        costs (cells, cells), int16, x ahead first; first and last half of the first configuration found at that cost,
        (cells, cells, 2), int32; and the largest cost that is complete, or NEVER if the whole lattice was enumerated.
    """
    halves = np.zeros((2 * half_cells, 2 * half_cells, 2), dtype=np.int32)
    costs = np.full((2 * half_cells, 2 * half_cells), NEVER, dtype=np.int16)
    firsts, lasts = lattice.first_starts.shape[0] - 1, lattice.last_starts.shape[0] - 1
    pairs = 0
    for cost in range(min(firsts + lasts - 1, NEVER)):
        if pairs > budget:
            return costs, halves, cost - 1
        for spent in range(max(0, cost - lasts + 1), min(cost + 1, firsts)):
            begin, end = lattice.last_starts[cost - spent], lattice.last_starts[cost - spent + 1]
            for i in range(lattice.first_starts[spent], lattice.first_starts[spent + 1]):
                row = lattice.first[i]
                if row[11] + lattice.longest < z_low or row[11] - lattice.longest > z_high:
                    continue
                pairs += end - begin
                for j in range(begin, end):
                    u, v, w = lattice.last[j, 0], lattice.last[j, 1], lattice.last[j, 2]
                    z = row[8] * u + row[9] * v + row[10] * w + row[11]
                    if z_low <= z <= z_high:
                        x = row[0] * u + row[1] * v + row[2] * w + row[3]
                        y = row[4] * u + row[5] * v + row[6] * w + row[7]
                        a, b = int(math.floor(x / cell)) + half_cells, int(math.floor(y / cell)) + half_cells
                        if costs[a, b] > cost:
                            costs[a, b] = cost
                            halves[a, b, 0], halves[a, b, 1] = i, j
    return costs, halves, NEVER


@kernel
def lower_costs(hands, hand_cell, headings, half_x, half_y, cell, columns, rows):
    """Lower bound of the joint steps to touch a rectangle, from each cell round it and each heading.

    A base at b with heading h touches with the hand at u (base frame) where b + R(h) u lies in
    the rectangle, so each map cell with a cost lowers all of `rectangle - R(h) u`.

    Args:
        hands: of `map_hands`.
        hand_cell: side of its cells, m.
        headings: rad, in the rectangle's frame, shape (headings,).
        half_x: half size of the rectangle with its margin of touch, m.
        half_y: half size of the rectangle with its margin of touch, m.
        cell: side of a cell of the result, m.
        columns: cells along x; the rectangle's centre is the corner in the middle.
        rows: cells along y.

    Returns:
        Shape (columns, rows, headings), int16; -1 where out of reach.
    """
    costs = np.empty((columns, rows, headings.shape[0]), dtype=np.int16)
    size = hands.shape[0]
    ahead, left = np.empty(size * size), np.empty(size * size)
    steps = np.empty(size * size, dtype=np.int16)
    count = 0
    for i in range(size):
        for j in range(size):
            if hands[i, j] != NEVER:
                ahead[count], left[count] = (i + 0.5 - size / 2) * hand_cell, (j + 0.5 - size / 2) * hand_cell
                steps[count] = hands[i, j]
                count += 1
    plane = np.empty((columns, rows), dtype=np.int16)
    for h in range(headings.shape[0]):
        cos, sin = math.cos(headings[h]), math.sin(headings[h])
        blur = 0.5 * hand_cell * (abs(cos) + abs(sin))
        wide, deep = half_x + blur, half_y + blur
        columns_each, rows_each = int(2.0 * wide / cell) + 1, int(2.0 * deep / cell) + 1
        plane[:] = NEVER
        for n in range(count):
            x, y = sin * left[n] - cos * ahead[n], -sin * ahead[n] - cos * left[n]
            i0, j0 = int(math.floor((x - wide) / cell)), int(math.floor((y - deep) / cell))
            i1, j1 = int(math.floor((x + wide) / cell)), int(math.floor((y + deep) / cell))
            # cells from i0 to i1: as many as each window has, or one more
            for i in range(i0, i1 - columns_each + 2):
                for j in range(j0, j1 - rows_each + 2):
                    if plane[i + columns // 2, j + rows // 2] > steps[n]:
                        plane[i + columns // 2, j + rows // 2] = steps[n]
        _lower_windows(plane, columns_each, rows_each)
        for i in range(columns):
            for j in range(rows):
                costs[i, j, h] = plane[i, j] if plane[i, j] != NEVER else -1
    return costs


@kernel_part
def _lower_windows(plane, columns, rows):
    """Let each cell lower a window of columns and rows that begins with it; by doubling, in place."""
    width = 1
    while 2 * width <= columns:
        for i in range(plane.shape[0] - 1, width - 1, -1):
            for j in range(plane.shape[1]):
                plane[i, j] = min(plane[i, j], plane[i - width, j])
        width *= 2
    for i in range(plane.shape[0] - 1, columns - width - 1, -1):
        for j in range(plane.shape[1]):
            plane[i, j] = min(plane[i, j], plane[i - (columns - width), j])
    width = 1
    while 2 * width <= rows:
        for i in range(plane.shape[0]):
            for j in range(plane.shape[1] - 1, width - 1, -1):
                plane[i, j] = min(plane[i, j], plane[i, j - width])
        width *= 2
    for i in range(plane.shape[0]):
        for j in range(plane.shape[1] - 1, rows - width - 1, -1):
            plane[i, j] = min(plane[i, j], plane[i, j - (rows - width)])


def bound_costs(hands: NDArray[np.int16], hand_cell: float, headings: NDArray[np.float64], yaw: float, half_x: float,
                half_y: float, cell: float) -> NDArray[np.int16]:
    """Tabulate the joint steps to touch a rectangle along the room's axes: see `lower_costs`.

    Args:
        hands: of `map_hands`.
        hand_cell: side of its cells, m.
        headings: of the base, rad, shape (headings,).
        yaw: of the rectangle, rad.
        half_x: half size of the rectangle with its margin of touch, along its own x, m.
        half_y: half size of the rectangle with its margin of touch, along its own y, m.
        cell: side of a cell of the result, m.

    Returns:
        Shape (columns, rows, headings), int16; -1 where out of reach. The rectangle's centre is the corner
        in the middle.
    """
    quarters = round(yaw / (math.pi / 2))
    askew = yaw - quarters * math.pi / 2
    if quarters % 2:
        half_x, half_y = half_y, half_x
    reach = hands.shape[0] / 2 * hand_cell
    columns, rows = (2 * (math.ceil((reach + half) / cell) + 2) for half in (half_x, half_y))
    costs = lower_costs(hands, hand_cell, headings - askew, half_x, half_y, cell, columns, rows)
    return costs if abs(askew) < 1e-9 else _turn_costs(costs, askew)


def _turn_costs(costs: NDArray[np.int16], askew: float) -> NDArray[np.int16]:
    """Rotate a table from a rectangle's own axes to the room's: each cell takes the least of its neighbours."""
    columns, rows, headings = costs.shape
    half = math.ceil(math.hypot(columns, rows) / 2) + 1
    centres = np.moveaxis(np.indices((2 * half, 2 * half)), 0, -1) - half + 0.5
    cos, sin = math.cos(askew), math.sin(askew)
    own = np.floor(centres @ np.array([[cos, -sin], [sin, cos]]) + (columns / 2, rows / 2)).astype(int)
    padded = np.full((columns + 4, rows + 4, headings), NEVER, dtype=np.int16)
    padded[2:-2, 2:-2] = np.where(costs < 0, NEVER, costs)
    least = padded.copy()
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            np.minimum(least, np.roll(padded, (i, j), axis=(0, 1)), out=least)
    i, j = np.clip(own + 2, 0, (columns + 3, rows + 3)).transpose(2, 0, 1)
    turned = least[i, j]
    return np.where(turned == NEVER, -1, turned).astype(np.int16)
