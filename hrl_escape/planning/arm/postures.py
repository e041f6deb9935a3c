"""Postures whose hand gets to the height of a target: the cheapest in each cell of the floor round the base.

What `tables.py` counts the joint steps of, listed: a library from which presses can be made without a search. One
posture a cell is enough, as cells are smaller than the reach of a touch. Importing this module imports numba.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_escape.kernels import kernel
from hrl_escape.planning.arm.joint_lattice import NEVER, make_halves, make_lattice
from hrl_escape.planning.arm.reacher import QUICK, Reacher

__all__ = ["list_postures"]

_CELL = 0.1
"""Side of the cells of hand positions, m."""
_MOST_HALVES = 60_000


@kernel
def _list_cheapest(lattice, z_low, z_high, cell, half_cells, budget):
    """First and last half of the cheapest posture in each cell, (cells, cells, 2), int64, and its joint steps."""
    halves = np.zeros((2 * half_cells, 2 * half_cells, 2), dtype=np.int64)
    costs = np.full((2 * half_cells, 2 * half_cells), NEVER, dtype=np.int16)
    firsts, lasts = lattice.first_starts.shape[0] - 1, lattice.last_starts.shape[0] - 1
    pairs, is_empty = 0, True
    for cost in range(firsts + lasts - 1):
        if pairs > budget and not is_empty:
            break
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
                        if costs[a, b] == NEVER:
                            costs[a, b] = cost
                            halves[a, b, 0], halves[a, b, 1] = i, j
                            is_empty = False
    return halves, costs


def list_postures(reacher: Reacher, target: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """List postures at the height of a target, by their joint steps from home; one for each place of the hand.

    Args:
        reacher: the arm.
        target: index of the target.

    Returns:
        Joint steps from home (postures, joints), and positions of the hand in the base frame (postures, 3), m. Empty
        where the hand never gets to that height.
    """
    goal, home = reacher.instance.targets[target], (0,) * reacher.instance.robot.joints
    tables, hand = reacher.arm.compute_placements()
    halves = make_halves(tables, hand, reacher.arm.get_ranges(())[0], home, _MOST_HALVES)
    lattice, firsts, lasts = make_lattice(halves, home)
    half_cells = math.ceil((float(np.hypot(lattice.first[:, 3], lattice.first[:, 7]).max()) + lattice.longest) / _CELL)
    height = goal.half_z + reacher.limit
    found, costs = _list_cheapest(lattice, goal.z - height, goal.z + height, _CELL, half_cells + 1, QUICK)
    cells = np.argwhere(costs < NEVER)
    cells = cells[np.argsort(costs[cells[:, 0], cells[:, 1]], kind="stable")]
    i, j = found[cells[:, 0], cells[:, 1]].T
    steps = np.zeros((len(cells), len(home)), dtype=np.int64)
    middle = halves.first_steps.shape[1]
    steps[:, :middle] = halves.first_steps[firsts[i]]
    steps[:, middle : middle + halves.last_steps.shape[1]] = halves.last_steps[lasts[j]]
    rows = lattice.first[i].reshape(-1, 3, 4)
    return steps, np.einsum("nij,nj->ni", rows[:, :, :3], lattice.last[j]) + rows[:, :, 3]
