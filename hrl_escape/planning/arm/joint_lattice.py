"""The joint lattice of an arm as first and last halves of its configurations, ordered by joint steps.

A lattice of seven joints has too many configurations to list, but each is a first half
followed by a last half: the placements of the first and the hand points of the last are listed,
and `tables.py` enumerates pairs of them (meet in the middle). Nothing here knows
targets or a room.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    """Order an arm's halves by their joint steps from a configuration.

    Returns:
        The lattice, and the indices in `halves` of its first and last halves, (n,) and (m,).
    """
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
