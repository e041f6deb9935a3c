"""The joint lattice of an arm: its halves, tables of the fewest joint steps to hand positions, and touching postures.

A lattice of seven joints has too many configurations to list, but each is a first half followed by a last half: the
placements of the first and the hand points of the last are listed, and pairs of them enumerated in the order of their
joint steps (meet in the middle), so that the first is the cheapest. Tables are lower bounds, exact up to the size of
their cells. Searches for touching postures are exact: first halves are tried one by one, last halves by a grid of their
hand points. Importing this module imports numba.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.kernels import kernel, kernel_part

NEVER = 32767
"""Cost that stands for an impossible touch, the largest int16."""

UNLIMITED = 1 << 60
"""Budget of pairs of halves that stands for no limit."""

GRID = 12
"""Cells along each side of the grid of hand points."""


class Halves(NamedTuple):
    """The lattice of an arm as first and last halves of its configurations."""

    first: NDArray[np.float64]  # placements of the last link of each first half in the base, rows (n, 12) of 3 x 4
    last: NDArray[np.float64]  # hand points of each last half in that link, (m, 3), m
    first_steps: NDArray[np.int64]  # their joint steps, (n, k), int64
    last_steps: NDArray[np.int64]
    """Their joint steps, (m, moving joints - k), int64. Last joints whose axis passes through the hand never move it
    and are left out."""
    complete_to: int
    """Joint steps from the central configuration up to which every configuration is a pair of these; NEVER if all
    are."""


class ArmLattice(NamedTuple):
    """`Halves` ordered by their joint steps from one configuration."""

    first: NDArray[np.float64]  # as in `Halves`
    last: NDArray[np.float64]  # as in `Halves`
    first_costs: NDArray[np.int64]  # joint steps of each first half, (n,), int64, ascending
    last_costs: NDArray[np.int64]  # joint steps of each last half, (m,), int64, ascending
    first_starts: NDArray[np.int64]  # index of the first first half of each cost, ending with n
    last_starts: NDArray[np.int64]  # index of the first last half of each cost, ending with m
    longest: float  # longest distance from the first half's link to the hand, m
    low: NDArray[np.float64]  # corner of a grid round the last halves' hand points, (3,), m
    size: NDArray[np.float64]  # sides of its cells, (3,), m
    starts: NDArray[np.int64]  # start of each cell's points in `items`, row by row, (cells + 1,)
    items: NDArray[np.int64]  # last halves by cell, in each cell those of the fewest steps first, (m,)


def make_halves(tables: list[NDArray[np.float64]], hand: NDArray[np.float64], low: tuple[int, ...],
                at: tuple[int, ...], most: int) -> Halves:
    """Split an arm's lattice into halves of at most `most` configurations each.

    A half that has more keeps those with the fewest steps from `at`, and for the rest a coarser
    lattice through `at` that spans all of it.

    Args:
        tables: placements of each joint's link in the one before, (steps, 4, 4) each.
        hand: the hand in the last link, (3,), m.
        low: fewest steps of each joint.
        at: the central configuration, near which the lattice is complete.
        most: most configurations of a half.
    """
    tables, counts = list(tables), [len(table) for table in tables]
    while len(tables) > 1:
        points = tables[-1][:, :3, :3] @ hand + tables[-1][:, :3, 3]
        if np.ptp(points, axis=0).max() > 1e-9:
            break
        hand = points[0]
        tables.pop()
    joints = len(tables)
    sizes = [(12 * math.prod(counts[:k]) + 3 * math.prod(counts[k:joints]), k) for k in range(joints)]
    middle = min(sizes)[1]
    high = [least + count - 1 for least, count in zip(low, counts, strict=True)]
    first_steps, first_complete = _choose_steps(low[:middle], high[:middle], at[:middle], most)
    last_steps, last_complete = _choose_steps(low[middle:joints], high[middle:joints], at[middle:joints], most)
    first = np.broadcast_to(np.eye(4), (len(first_steps), 4, 4))
    for joint in range(middle):
        first = first @ tables[joint][first_steps[:, joint] - low[joint]]
    last = np.broadcast_to(hand, (len(last_steps), 3))
    for joint in reversed(range(middle, joints)):
        placements = tables[joint][last_steps[:, joint - middle] - low[joint]]
        last = np.einsum("nij,nj->ni", placements[:, :3, :3], last) + placements[:, :3, 3]
    rows = np.ascontiguousarray(first[:, :3, :]).reshape(-1, 12)
    complete_to = min(first_complete, last_complete)
    return Halves(rows, np.ascontiguousarray(last), first_steps, last_steps, complete_to)


def _choose_steps(low: tuple[int, ...], high: list[int], at: tuple[int, ...], most: int
                  ) -> tuple[NDArray[np.int64], int]:
    """All joint steps within limits, or the nearest and a coarse lattice, (n, joints); and the complete radius."""
    ranges = [np.arange(a, b + 1) for a, b in zip(low, high, strict=True)]
    if math.prod(map(len, ranges)) <= most:
        return _combine(ranges), NEVER
    costs = [np.abs(values - centre) for values, centre in zip(ranges, at, strict=True)]
    levels = np.ones(1)
    for cost in costs:
        levels = np.convolve(levels, np.bincount(cost).astype(np.float64))
    radius = int(np.searchsorted(np.cumsum(levels), most / 2, side="right")) - 1
    near, spent = np.zeros((1, 0), dtype=np.int64), np.zeros(1, dtype=np.int64)
    for values, cost in zip(ranges, costs, strict=True):
        total = spent[:, None] + cost
        i, j = np.nonzero(total <= radius)
        near, spent = np.concatenate([near[i], values[j, None]], axis=1), total[i, j]
    stride = 2
    while True:
        coarse = [v[(v - centre) % stride == 0] for v, centre in zip(ranges, at, strict=True)]
        if math.prod(map(len, coarse)) <= most / 2:
            return np.concatenate([near, _combine(coarse)]), radius
        stride += 1


def _combine(values: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    if not values:
        return np.zeros((1, 0), dtype=np.int64)
    return np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, len(values))


def make_lattice(halves: Halves, at: tuple[int, ...]) -> tuple[ArmLattice, NDArray[np.int64], NDArray[np.int64]]:
    """Order halves by their joint steps from a configuration; also the indices of first (n,) and last (m,) ones."""
    middle = halves.first_steps.shape[1]
    orders, costs, starts = [], [], []
    for steps, centre in ((halves.first_steps, at[:middle]), (halves.last_steps, at[middle:])):
        cost = np.abs(steps - np.array(centre[: steps.shape[1]], dtype=np.int64)).sum(axis=1)
        orders.append(np.argsort(cost, kind="stable"))
        costs.append(cost[orders[-1]])
        starts.append(np.searchsorted(costs[-1], np.arange(cost.max() + 2)))
    last = halves.last[orders[1]]
    low, size = last.min(axis=0), np.maximum(np.ptp(last, axis=0) / GRID, 1e-6)
    cells = np.minimum((last - low) // size, GRID - 1).astype(np.int64) @ (GRID * GRID, GRID, 1)
    items = np.argsort(cells, kind="stable")
    bounds = np.searchsorted(cells[items], np.arange(GRID**3 + 1))
    longest = math.sqrt(float(np.max(np.sum(last**2, axis=1))))
    lattice = ArmLattice(halves.first[orders[0]], last, costs[0], costs[1], starts[0], starts[1], longest, low, size,
                         bounds, items)
    return lattice, orders[0], orders[1]


# --- tables and touching postures ------------------------------------------------------

@kernel
def map_hands(lattice, z_low, z_high, cell, half_cells, budget):
    """Fewest joint steps that bring the hand into each cell of the floor, at heights within a window.

    Heights are from `z_low` to `z_high`, m. Cells have the side `cell`, m, and there are `half_cells` from the base's
    axis to each edge of the map. Beyond `budget` pairs of halves no further cost is begun.

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
    ahead, left = np.nonzero(hands != NEVER)
    size, count = hands.shape[0], len(ahead)
    plane = np.empty((columns, rows), dtype=np.int16)
    for h in range(headings.shape[0]):
        cos, sin = math.cos(headings[h]), math.sin(headings[h])
        blur = 0.5 * hand_cell * (abs(cos) + abs(sin))
        wide, deep = half_x + blur, half_y + blur
        columns_each, rows_each = int(2.0 * wide / cell) + 1, int(2.0 * deep / cell) + 1
        plane[:] = NEVER
        for n in range(count):
            u, v = (ahead[n] + 0.5 - size / 2) * hand_cell, (left[n] + 0.5 - size / 2) * hand_cell
            x, y, steps = sin * v - cos * u, -sin * u - cos * v, hands[ahead[n], left[n]]
            i0, j0 = int(math.floor((x - wide) / cell)), int(math.floor((y - deep) / cell))
            i1, j1 = int(math.floor((x + wide) / cell)), int(math.floor((y + deep) / cell))
            # cells from i0 to i1: as many as each window has, or one more
            for i in range(i0, i1 - columns_each + 2):
                for j in range(j0, j1 - rows_each + 2):
                    if plane[i + columns // 2, j + rows // 2] > steps:
                        plane[i + columns // 2, j + rows // 2] = steps
        _lower_windows(plane, columns_each)
        _lower_windows(plane.T, rows_each)
        for i in range(columns):
            for j in range(rows):
                costs[i, j, h] = plane[i, j] if plane[i, j] != NEVER else -1
    return costs


@kernel_part
def _lower_windows(plane, count):
    """Let each cell lower as many in its column, itself the first; by doubling, in place."""
    width = 1
    while width < count:
        step = min(width, count - width)
        for i in range(plane.shape[0] - 1, step - 1, -1):
            for j in range(plane.shape[1]):
                plane[i, j] = min(plane[i, j], plane[i - step, j])
        width += step


def bound_costs(hands: NDArray[np.int16], hand_cell: float, headings: NDArray[np.float64], yaw: float, half_x: float,
                half_y: float, cell: float) -> NDArray[np.int16]:
    """Tabulate the joint steps to touch a rectangle along the room's axes: see `lower_costs`.

    Half sizes are along the rectangle's own axes; its yaw and the base's headings are rad.

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

    For each first half the target is transformed into the frame of its link, where the grid holds the hand points of
    all last halves.

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
    """Distance, m, from the hand's centre (base frame) to a box; pose and box as of `find_touching`."""
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
