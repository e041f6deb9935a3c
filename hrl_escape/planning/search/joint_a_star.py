"""A* over primitives, exact poses and puzzle states, compiled: whole escapes through all orders of presses at once.

It shares frontier and motions with `a_star.py`. There a search leads to one goal; here a press
leads to the next state of the puzzle, which has a cost-to-go field of its own. `joint_search.py` states the query
and verifies the proposals.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.floor.sweeps import Presser
from hrl_escape.kernels import kernel_in_place, kernel_part
from hrl_escape.planning.search.a_star import (
    BEATEN,
    GOAL,
    OPEN,
    find_slot,
    find_touched,
    move_base,
    push,
    take_cheapest,
)


class JointQuery(NamedTuple):
    """Start, puzzle, heuristic and bins of a joint search, as arrays."""

    x: float  # x of the start, m
    y: float  # y of the start, m
    heading: int  # heading of the start, in turn steps
    touched: np.uint64  # bits of the targets touched at the start
    puzzle: int  # number of the start's puzzle state
    turns: NDArray[np.float64]  # see `a_star.SearchQuery`, as for the next nine
    turn_step: float  # angle between two headings, rad
    moves: NDArray[np.float64]  # displacement of each translation at each heading, shape (headings, translations, 2), m
    lengths: NDArray[np.float64]  # length of each translation, shape (translations,), m
    turn_steps: NDArray[np.int64]  # turn steps of each turn, shape (turns,), int64
    stays: bool  # a blocked move is not made at all
    presser: NDArray[np.float64]  # zeros, shape (headings, 2), m
    targets: NDArray[np.float64]  # footprints of the targets, shape (n, 7)
    reaches: NDArray[np.float64]  # distance at which the base touches each target, or -1, shape (n,), m
    pressers: NDArray[np.bool_]  # True where the outline of `base` must touch the target, bool, shape (n,)
    base: Presser  # the base whose outline presses
    presses: NDArray[np.int64]
    """Number of the puzzle state after a press of each target, shape (puzzles, n), int64; -1 for one from which no
    field leads on."""
    solved: NDArray[np.bool_]  # True for the puzzle states in which the exit is open, bool, shape (puzzles,)
    exit: NDArray[np.float64]  # rectangle (x_min, x_max, y_min, y_max), shape (4,), m
    fields: NDArray[np.int16]
    """Cost-to-go of (cell, layer) in each field, shape (fields, cells * layers), int16; -1 where pruned."""
    field_of: NDArray[np.int64]  # field of each puzzle state, shape (puzzles,), int64
    layers: int  # headings that the fields distinguish
    shift: int  # whole turn steps by which the fields' headings lag behind the query's
    low: NDArray[np.float64]  # corner of the fields' grid, shape (2,), m
    size: float  # side of its cells, m
    rows: int  # its cells along y
    offset: int  # primitives subtracted from the cost-to-go
    bin_size: float  # poses closer than this, in one puzzle state, count as one, m
    bin_headings: int  # headings that bins distinguish
    one_leg: bool  # the first change of the puzzle is the goal, too, at the cost-to-go of where it ends


@kernel_part
def _add(query, frontier, x, y, heading, puzzle, touching, spent, parent, action, has_escaped):
    """Add a state to the frontier unless its bin holds one at most as expensive; an escape always."""
    node, headings = frontier.counts[0], query.moves.shape[0]
    estimate, is_goal = spent, has_escaped
    if not has_escaped:
        i, j = int(math.floor((x - query.low[0]) / query.size)), int(math.floor((y - query.low[1]) / query.size))
        columns = query.fields.shape[1] // (query.rows * query.layers)
        if not (0 <= i < columns and 0 <= j < query.rows):
            return
        layer = (heading + query.shift) % query.layers
        cost = np.int64(query.fields[query.field_of[puzzle], (i * query.rows + j) * query.layers + layer])
        if cost < 0:
            return
        estimate += max(cost - query.offset, 0)
        is_goal = query.one_leg and puzzle != query.puzzle
    if not is_goal:
        i = np.int64(math.floor(x / query.bin_size)) + (1 << 21)
        j = np.int64(math.floor(y / query.bin_size)) + (1 << 21)
        sector = heading % query.bin_headings
        key = (((((puzzle << 22) + i) << 22) + j) << 11) + (sector << 1) + (touching != 0)
        slot = find_slot(frontier, key)
        known = frontier.keys[slot] == key
        if known:
            if frontier.facts[frontier.owners[slot], 1] <= spent:
                return
            frontier.facts[frontier.owners[slot], 4] = BEATEN
        frontier.keys[slot], frontier.owners[slot] = key, node
    frontier.places[node, 0], frontier.places[node, 1] = x, y
    facts = frontier.facts[node]
    facts[0], facts[1], facts[2], facts[3] = puzzle * headings + heading, spent, parent, action
    facts[4] = GOAL if is_goal else OPEN
    frontier.touching[node] = touching
    frontier.counts[0] += 1
    push(frontier, node, estimate)


@kernel_part
def _expand(shut, opened, query, frontier, node):
    x, y = frontier.places[node, 0], frontier.places[node, 1]
    headings = query.moves.shape[0]
    heading, puzzle = np.int64(frontier.facts[node, 0]) % headings, np.int64(frontier.facts[node, 0]) // headings
    spent, touching = np.int64(frontier.facts[node, 1]) + 1, frontier.touching[node]
    for action in range(query.moves.shape[1] + query.turn_steps.shape[0]):
        if query.solved[puzzle]:
            dx, dy, to_heading = move_base(opened, query, x, y, heading, action)
        else:
            dx, dy, to_heading = move_base(shut, query, x, y, heading, action)
        if to_heading < 0:
            continue
        to_x, to_y, after = x + dx, y + dy, puzzle
        now = find_touched(query, to_x, to_y, to_heading)
        begun = now & ~touching
        if begun:
            for target in range(query.presses.shape[1]):
                if after >= 0 and (begun >> np.uint64(target)) & np.uint64(1) == np.uint64(1):
                    after = query.presses[after, target]
            if after < 0:
                continue
        area = query.exit
        escapes = query.solved[after] and area[0] <= to_x <= area[1] and area[2] <= to_y <= area[3]
        _add(query, frontier, to_x, to_y, to_heading, after, now, spent, node, action, escapes)


@kernel_in_place
def expand_until_escape(shut, opened, query, frontier, expansions):
    """Expand nodes until an escape is cheapest.

    Args:
        shut: the room with its exit door shut.
        opened: the room with it open.
        query: the query.
        frontier: nodes so far (none at first); changed in place. The first fact of a node is the number of its puzzle
            state times the number of headings, plus its heading.
        expansions: total number of expanded nodes at which to stop.

    Returns:
        The node of the escape, which is taken out of the frontier; or `EXHAUSTED`, `BUDGET` or `GROW`.
    """
    most = max(16, query.moves.shape[1] + query.turn_steps.shape[0])  # nodes that one expansion may add
    if frontier.counts[0] == 0:
        none = np.int64(-1)  # with literals numba would compile `_add` again
        _add(query, frontier, query.x, query.y, np.int64(query.heading), np.int64(query.puzzle), query.touched,
             np.int64(0), none, none, np.bool_(False))
    while True:
        node = take_cheapest(frontier, most, expansions)
        if node < 0 or frontier.facts[node, 4] == GOAL:
            return node
        _expand(shut, opened, query, frontier, node)
