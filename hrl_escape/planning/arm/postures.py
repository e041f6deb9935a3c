"""Postures whose hand gets to the height of a target: the cheapest in each cell of the floor round the base.

These are the postures behind the costs of `tables.py`, as a library for presses without a search. One
posture a cell is enough, as cells are smaller than the reach of a touch. Importing this module imports numba.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_escape.planning.arm.joint_lattice import NEVER, UNLIMITED, make_halves, make_lattice
from hrl_escape.planning.arm.reacher import QUICK, Reacher
from hrl_escape.planning.arm.tables import map_hands

__all__ = ["list_postures"]

_CELL = 0.1
"""Side of the cells of hand positions, m."""
_MOST_HALVES = 60_000


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
    window = goal.z - height, goal.z + height
    costs, found, _ = map_hands(lattice, *window, _CELL, half_cells + 1, QUICK)
    if (costs == NEVER).all():
        costs, found, _ = map_hands(lattice, *window, _CELL, half_cells + 1, UNLIMITED)
    cells = np.argwhere(costs < NEVER)
    cells = cells[np.argsort(costs[cells[:, 0], cells[:, 1]], kind="stable")]
    i, j = found[cells[:, 0], cells[:, 1]].T
    steps = np.zeros((len(cells), len(home)), dtype=np.int64)
    middle = halves.first_steps.shape[1]
    steps[:, :middle] = halves.first_steps[firsts[i]]
    steps[:, middle : middle + halves.last_steps.shape[1]] = halves.last_steps[lasts[j]]
    rows = lattice.first[i].reshape(-1, 3, 4)
    return steps, np.einsum("nij,nj->ni", rows[:, :, :3], lattice.last[j]) + rows[:, :, 3]
