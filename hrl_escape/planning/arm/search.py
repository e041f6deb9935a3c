"""Compiled searches of an arm's lattice for configurations that touch a target from given places.

Exact: no configuration of the lattice is missed. The first halves are tried one by one, the last
halves by a grid of their hand points. Importing this module imports numba.
"""

from __future__ import annotations

import math

import numpy as np

from hrl_escape.kernels import kernel, kernel_part
from hrl_escape.planning.arm.joint_lattice import GRID, NEVER


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
