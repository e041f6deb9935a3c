"""Compiled tables of the fewest joint steps to hand positions, and searches for configurations that touch a target.

Pairs of half configurations are enumerated in the order of their joint steps, so the first is the
cheapest. Tables are lower bounds, exact up to the size of their cells. Searches are exact: first halves are tried one
by one, last halves by a grid of their hand points. Importing this module imports numba.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_escape.kernels import kernel, kernel_part
from hrl_escape.planning.arm.joint_lattice import GRID, NEVER


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


@kernel
def find_heights(lattice):
    """Lowest and highest position of the hand on the lattice, m."""
    lowest, highest = math.inf, -math.inf
    for i in range(lattice.first.shape[0]):
        row = lattice.first[i]
        if row[11] + lattice.longest < highest and row[11] - lattice.longest > lowest:
            continue
        for j in range(lattice.last.shape[0]):
            z = row[8] * lattice.last[j, 0] + row[9] * lattice.last[j, 1] + row[10] * lattice.last[j, 2] + row[11]
            lowest, highest = min(lowest, z), max(highest, z)
    return lowest, highest


@kernel
def find_touching(lattice, pose, boxes, target, limit, avoid, least, most):
    """Configurations with the fewest joint steps whose hand touches a target from one place of the base.

    For each first half the target is transformed into the frame of its link, where the grid holds the
    hand points of all last halves.

    Args:
        lattice: the arm's configurations.
        pose: of the base: x, y, cosine and sine of its heading.
        boxes: the targets, rows (x, y, z, cos, sin, half_x, half_y, half_z).
        target: index of the target.
        limit: largest distance from the hand's centre that touches, m.
        avoid: skip configurations that touch another target as well.
        least: skip configurations of fewer joint steps than this.
        most: most configurations to return.

    Returns:
        Rows (first half, last half), int64, shape (found, 2), all with the same joint steps; and these.
    """
    found = np.empty((most, 2), dtype=np.int64)
    count, best = 0, NEVER
    px, py, cos, sin = pose
    box = boxes[target]
    turn, place = np.empty((3, 3)), np.empty(3)  # from the link to the box's own frame
    begin, end = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    # from the base to the box's own frame
    to_cos, to_sin = box[3] * cos + box[4] * sin, box[3] * sin - box[4] * cos
    to_x = box[3] * (px - box[0]) + box[4] * (py - box[1])
    to_y = box[3] * (py - box[1]) - box[4] * (px - box[0])
    beyond = limit + 0.5 * math.sqrt(lattice.size[0] ** 2 + lattice.size[1] ** 2 + lattice.size[2] ** 2)
    for i in range(lattice.first.shape[0]):
        spent = lattice.first_costs[i]
        if spent > best or (spent == best and count == most):
            break
        row = lattice.first[i]
        place[0] = to_cos * row[3] - to_sin * row[7] + to_x
        place[1] = to_sin * row[3] + to_cos * row[7] + to_y
        place[2] = row[11] - box[2]
        if _exceed(place[0], place[1], place[2], box) > limit + lattice.longest:
            continue
        empty = False
        for k in range(3):
            turn[0, k] = to_cos * row[k] - to_sin * row[4 + k]
            turn[1, k] = to_sin * row[k] + to_cos * row[4 + k]
            turn[2, k] = row[8 + k]
        for k in range(3):
            middle, half = 0.0, 0.0
            for r in range(3):
                middle -= turn[r, k] * place[r]
                half += abs(turn[r, k]) * (box[5 + r] + limit)
            begin[k] = max(int(math.floor((middle - half - lattice.low[k]) / lattice.size[k])), 0)
            end[k] = min(int(math.floor((middle + half - lattice.low[k]) / lattice.size[k])), GRID - 1)
            empty = empty or begin[k] > GRID - 1 or end[k] < 0
        if empty:
            continue
        for a in range(begin[0], end[0] + 1):
            for b in range(begin[1], end[1] + 1):
                for c in range(begin[2], end[2] + 1):
                    cell = (a * GRID + b) * GRID + c
                    first, last = lattice.starts[cell], lattice.starts[cell + 1]
                    if first == last or spent + lattice.last_costs[lattice.items[first]] > best:
                        continue
                    u = lattice.low[0] + (a + 0.5) * lattice.size[0]
                    v = lattice.low[1] + (b + 0.5) * lattice.size[1]
                    w = lattice.low[2] + (c + 0.5) * lattice.size[2]
                    x = turn[0, 0] * u + turn[0, 1] * v + turn[0, 2] * w + place[0]
                    y = turn[1, 0] * u + turn[1, 1] * v + turn[1, 2] * w + place[1]
                    z = turn[2, 0] * u + turn[2, 1] * v + turn[2, 2] * w + place[2]
                    if _exceed(x, y, z, box) > beyond:
                        continue
                    for n in range(first, last):
                        j = lattice.items[n]
                        cost = spent + lattice.last_costs[j]
                        if cost > best or (cost == best and count == most):
                            break
                        if cost < least:
                            continue
                        u, v, w = lattice.last[j, 0], lattice.last[j, 1], lattice.last[j, 2]
                        x = turn[0, 0] * u + turn[0, 1] * v + turn[0, 2] * w + place[0]
                        y = turn[1, 0] * u + turn[1, 1] * v + turn[1, 2] * w + place[1]
                        z = turn[2, 0] * u + turn[2, 1] * v + turn[2, 2] * w + place[2]
                        if _exceed(x, y, z, box) > limit:
                            continue
                        if avoid and _touches_other(x, y, z, boxes, target, limit):
                            continue
                        if cost < best:
                            best, count = cost, 0
                        found[count, 0], found[count, 1] = i, j
                        count += 1
    return found[:count], best


@kernel_part
def _exceed(x, y, z, box):
    """Distance from a point in a box's own frame to the box."""
    qx, qy, qz = max(abs(x) - box[5], 0.0), max(abs(y) - box[6], 0.0), max(abs(z) - box[7], 0.0)
    return math.sqrt(qx * qx + qy * qy + qz * qz)


@kernel
def measure_gap(pose, hand, box):
    """Distance from the hand's centre to a target, m.

    Args:
        pose: of the base: x, y, cosine and sine of its heading.
        hand: in the base frame, m.
        box: (x, y, z, cos, sin, half_x, half_y, half_z).
    """
    dx = pose[0] + pose[2] * hand[0] - pose[3] * hand[1] - box[0]
    dy = pose[1] + pose[3] * hand[0] + pose[2] * hand[1] - box[1]
    return _exceed(box[3] * dx + box[4] * dy, box[3] * dy - box[4] * dx, hand[2] - box[2], box)


@kernel_part
def _touches_other(x, y, z, boxes, target, limit):
    """Return whether a point in a target's own frame is within the limit of another target."""
    box = boxes[target]
    room_x, room_y = box[0] + box[3] * x - box[4] * y, box[1] + box[4] * x + box[3] * y
    for k in range(boxes.shape[0]):
        other = boxes[k]
        if k != target:
            dx, dy = room_x - other[0], room_y - other[1]
            if _exceed(other[3] * dx + other[4] * dy, other[3] * dy - other[4] * dx, box[2] + z - other[2],
                       other) <= limit + 2e-9:
                return True
    return False
