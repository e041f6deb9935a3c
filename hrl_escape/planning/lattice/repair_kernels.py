"""Repair of a cost-to-go field after its grid has changed in some cells (Ramalingam and Reps 1996).

`forget_changed` finds all states whose cost-to-go rested on changed cells, and the costs by which
Dijkstra's search of `dijkstra_kernels.py` goes on from the rest. The repaired field is the one that a
search from nothing would give: all costs are positive, so there is only one. Kernels are compiled on
first use and kept on disk.
"""

from __future__ import annotations

import numpy as np

from hrl_escape.kernels import kernel, kernel_part
from hrl_escape.planning.lattice.dijkstra_kernels import UNREACHED

__all__ = ["forget_changed"]


@kernel_part
def _find_least(field, gone, landing, link_cost, classes, headings, translations, cell, heading):
    """Least cost-to-go by way of a successor that is not gone."""
    least = UNREACHED
    for turn in (1, headings - 1):
        after = cell * headings + (heading + turn) % headings
        if not gone[after] and field[after] + 1 < least:
            least = field[after] + 1
    at = (cell * classes + heading % classes) * translations
    for m in range(translations):
        if landing[at + m] >= 0:
            after = landing[at + m] * headings + heading
            if not gone[after] and field[after] + link_cost[at + m] < least:
                least = field[after] + link_cost[at + m]
    return least


@kernel
def forget_changed(starts, sources, costs, landing, link_cost, classes, headings, changed, standing, seeds, seed_costs,
                   field):
    """Forget the cost-to-go of states in changed cells, and of all states that have no other support.

    Args:
        starts: links of the new grid, from `link_cells`.
        sources: links of the new grid, from `link_cells`.
        costs: links of the new grid, from `link_cells`.
        landing: moves of the new grid, from `find_landings`.
        link_cost: moves of the new grid, from `find_landings`.
        classes: heading classes of the links.
        headings: headings of the field.
        changed: cells whose moves, or whose place, differ from the old grid, shape (n,).
        standing: True where the body fits, shape (cells,).
        seeds: states with a cost-to-go of their own, the same in both grids, shape (seeds,).
        seed_costs: their cost-to-go, shape (seeds,).
        field: the old field, shape (cells * headings,), int16; unreached and forgotten states become `UNREACHED`.

    Returns:
        States that have been forgotten but have a successor or seed that has not, (n,) int64, and their cost-to-go by
        way of it, (n,) int64.
    """
    translations = landing.shape[0] // (standing.shape[0] * classes)
    own = np.full(field.shape[0], UNREACHED, dtype=np.int16)
    for k in range(seeds.shape[0]):
        own[seeds[k]] = min(own[seeds[k]], seed_costs[k])
    gone = np.zeros(field.shape[0], dtype=np.bool_)
    heads, links = np.full(UNREACHED + 1, -1, dtype=np.int64), np.full(field.shape[0], -1, dtype=np.int64)
    for cell in range(standing.shape[0]):
        for heading in range(headings):
            state = cell * headings + heading
            if field[state] < 0:
                field[state] = UNREACHED
            if not standing[cell]:
                field[state] = UNREACHED  # it held the least of its neighbours
    for k in range(changed.shape[0]):
        for heading in range(headings):
            state = changed[k] * headings + heading
            if not gone[state]:
                gone[state] = True
                links[state], heads[field[state]] = heads[field[state]], state
    count = 0
    for level in range(UNREACHED):
        while heads[level] >= 0:
            state = heads[level]
            heads[level] = links[state]
            count += 1
            cell = state // headings
            heading = state - cell * headings
            known = cell * classes + heading % classes
            for k in range(starts[known] - 2, starts[known + 1]):
                if k < starts[known]:  # the two turns that lead here
                    turn = 1 if k == starts[known] - 1 else headings - 1
                    source, cost = cell, 1
                    before = cell * headings + (heading + turn) % headings
                else:
                    source, cost = sources[k], costs[k]
                    before = source * headings + heading
                if gone[before] or field[before] != level + cost or own[before] == field[before]:
                    continue
                least = _find_least(field, gone, landing, link_cost, classes, headings, translations, source,
                                    before - source * headings)
                if least > field[before]:
                    gone[before] = True
                    links[before], heads[field[before]] = heads[field[before]], before
    states, values = np.empty(field.shape[0], dtype=np.int64), np.empty(field.shape[0], dtype=np.int64)
    count = 0
    for state in range(field.shape[0]):
        cell = state // headings
        if gone[state] and standing[cell]:
            least = min(own[state], _find_least(field, gone, landing, link_cost, classes, headings, translations, cell,
                                                state - cell * headings))
            if least < UNREACHED:
                states[count], values[count] = state, least
                count += 1
    for state in range(field.shape[0]):
        if gone[state]:
            field[state] = UNREACHED
    return states[:count], values[:count]
