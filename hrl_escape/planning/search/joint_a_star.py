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

__all__ = ["JointQuery", "expand_until_escape"]


class JointQuery(NamedTuple):
    """Start, puzzle, heuristic and bins of a joint search, as arrays.

    Attributes:
        x: x of the start, m.
        y: y of the start, m.
        heading: heading of the start, in turn steps.
        touched: bits of the targets touched at the start.
        puzzle: number of the start's puzzle state.
        turns: see `a_star.SearchQuery`, as for the next nine.
        turn_step: angle between two headings, rad.
        moves: displacement of each translation at each heading, shape (headings, translations, 2), m.
        lengths: length of each translation, shape (translations,), m.
        turn_steps: turn steps of each turn, shape (turns,), int64.
        stays: a blocked move is not made at all.
        presser: zeros, shape (headings, 2), m.
        targets: footprints of the targets, shape (n, 7).
        reaches: distance at which the base touches each target, or -1, shape (n,), m.
        pressers: True where the outline of `base` must touch the target, bool, shape (n,).
        base: the base whose outline presses.
        presses: number of the puzzle state after a press of each target, shape (puzzles, n), int64; -1 for one from
            which no field leads on.
        solved: True for the puzzle states in which the exit is open, bool, shape (puzzles,).
        exit: rectangle (x_min, x_max, y_min, y_max), shape (4,), m.
        fields: cost-to-go of (cell, layer) in each field, shape (fields, cells * layers), int16; -1 where pruned.
        field_of: field of each puzzle state, shape (puzzles,), int64.
        layers: headings that the fields distinguish.
        shift: whole turn steps by which the fields' headings lag behind the query's.
        low: corner of the fields' grid, shape (2,), m.
        size: side of its cells, m.
        rows: its cells along y.
        offset: primitives subtracted from the cost-to-go.
        bin_size: poses closer than this, in one puzzle state, count as one, m.
        bin_headings: headings that bins distinguish.
        one_leg: the first change of the puzzle is the goal, too, at the cost-to-go of where it ends.
    """

    x: float
    y: float
    heading: int
    touched: np.uint64
    puzzle: int
    turns: NDArray[np.float64]
    turn_step: float
    moves: NDArray[np.float64]
    lengths: NDArray[np.float64]
    turn_steps: NDArray[np.int64]
    stays: bool
    presser: NDArray[np.float64]
    targets: NDArray[np.float64]
    reaches: NDArray[np.float64]
    pressers: NDArray[np.bool_]
    base: Presser
    presses: NDArray[np.int64]
    solved: NDArray[np.bool_]
    exit: NDArray[np.float64]
    fields: NDArray[np.int16]
    field_of: NDArray[np.int64]
    layers: int
    shift: int
    low: NDArray[np.float64]
    size: float
    rows: int
    offset: int
    bin_size: float
    bin_headings: int
    one_leg: bool


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
