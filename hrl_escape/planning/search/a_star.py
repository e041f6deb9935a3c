"""A* over primitives on exact poses, compiled: to one goal, or through all orders of presses to the exit.

The frontier keeps nodes in buckets by estimated cost (Dial 1969) and one node for each bin of poses. It proposes goal
nodes, cheapest first; `primitive_search.py` and `joint_search.py` state the queries and verify the proposals. Kernels
are compiled on first use and kept on disk.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.floor.sweeps import (
    Presser,
    can_turn_body,
    first_contact,
    get_shape,
    is_touched,
    measure_distance,
    sweep_body,
)
from hrl_escape.kernels import kernel_in_place, kernel_part

EXHAUSTED, BUDGET, GROW = -1, -2, -3
MOST_PRIMITIVES = 32_768
MOST_KEPT_NODES = 1 << 15
"""Nodes of the largest frontier that is kept for the next search."""
OPEN, GOAL, BEATEN = 0, 1, 2
"""Kinds of nodes: to be expanded, a goal, or one whose bin holds a cheaper one."""


class Motions(NamedTuple):
    """Motions of a room's robot and its touches of targets at every heading, for searches with one heading offset."""

    turns: NDArray[np.float64]  # cosine and sine of each heading, shape (headings, 2)
    turn_step: float  # angle between two headings, rad
    moves: NDArray[np.float64]  # displacement of each translation at each heading, shape (headings, translations, 2), m
    lengths: NDArray[np.float64]  # length of each translation, shape (translations,), m
    turn_steps: NDArray[np.int64]  # turn steps of each turn, shape (turns,), int64
    stays: bool  # a blocked move is not made at all
    presser: NDArray[np.float64]  # position of the presser relative to the body's axis, shape (headings, 2), m
    targets: NDArray[np.float64]  # footprints of the targets, shape (n, 7)
    reaches: NDArray[np.float64]  # floor distance where the presser touches each target, or -1, shape (n,), m
    pressers: NDArray[np.bool_]  # True where the outline of `base` must touch the target, bool, shape (n,)
    base: Presser  # the base whose outline presses


class SearchQuery(NamedTuple):
    """Start, goal, heuristic and constraints of a search, as arrays."""

    x: float  # x of the start, m
    y: float  # y of the start, m
    heading: int  # heading of the start, in turn steps
    touched: np.uint64  # bits of the targets touched at the start
    motions: Motions
    forbidden: np.uint64  # bits of the targets that must not be touched again
    keep_out: NDArray[np.float64]  # footprints that the body must not meet, shape (n, 7)
    closed: NDArray[np.float64]
    """Rectangle (x_min, x_max, y_min, y_max) that must not be entered; empty if x_min > x_max."""
    target: int  # index of the target to press, or -1
    goal: NDArray[np.float64]  # footprint of the goal (of the target, if one is to be pressed), shape (7,)
    goal_reach: float  # largest distance from `goal` that reaches it, m; negative if none does
    goal_headings: NDArray[np.bool_]  # headings that reach it, shape (headings,), bool
    field: NDArray[np.int16]
    """Cost-to-go of (cell, layer), shape (cells * layers,), int16; poses where it is -1 are pruned."""
    layers: int  # headings that the field distinguishes
    shift: int  # whole turn steps that the field's headings lag behind the query's
    low: NDArray[np.float64]  # corner of the field's grid, shape (2,), m
    size: float  # side of its cells, m
    rows: int  # its cells along y
    offset: int  # primitives subtracted from the cost-to-go; negative to add
    weight: float  # factor of the cost-to-go, as in weighted A*
    table: NDArray[np.int16]
    """Lower bound of the joint steps that complete the press from a pose, or -1, int16, shape (columns, rows,
    headings)."""
    table_low: NDArray[np.float64]  # corner of that table in the room frame, shape (2,), m
    table_size: float  # side of its cells, m
    bin_size: float  # poses closer than this count as one, m
    bin_headings: int  # headings that bins distinguish


class Frontier(NamedTuple):
    """The nodes of a search, its open buckets by estimated cost, and its hash table of poses."""

    places: NDArray[np.float64]  # position of each node, shape (nodes, 2), m
    facts: NDArray[np.int32]  # heading, primitives so far, parent, action, kind; shape (nodes, 5), int32
    touching: NDArray[np.uint64]  # bits of the targets touched, shape (nodes,), uint64
    links: NDArray[np.int32]  # next node in the same bucket, shape (nodes,), int32
    heads: NDArray[np.int32]  # first node of each bucket, shape (estimates,), int32
    keys: NDArray[np.int64]  # pose key in each slot of the hash table, shape (slots,), int64; -1 if empty
    owners: NDArray[np.int32]  # node that holds the pose, shape (slots,), int32
    counts: NDArray[np.int64]  # nodes used, current bucket, expansions; shape (3,), int64

    def list_actions(self, node: int) -> list[int]:
        """List the actions that lead to a node."""
        actions = []
        while self.facts[node, 2] >= 0:
            actions.append(int(self.facts[node, 3]))
            node = int(self.facts[node, 2])
        return actions[::-1]


@kernel_part
def find_touched(motions, x, y, heading):
    """Bits of the targets that the presser touches at a pose, uint64."""
    px, py = x + motions.presser[heading, 0], y + motions.presser[heading, 1]
    touching = np.uint64(0)
    for k in range(motions.targets.shape[0]):
        reach = motions.reaches[k]
        if reach >= 0.0:
            around = reach + motions.targets[k, 5] + motions.targets[k, 6]
            if abs(px - motions.targets[k, 1]) <= around and abs(py - motions.targets[k, 2]) <= around:
                shape = get_shape(motions.targets[k])
                if motions.pressers[k]:
                    touches = is_touched(px, py, motions.turns[heading], motions.base, shape, reach)
                else:
                    touches = measure_distance(px, py, shape) <= reach
                if touches:
                    touching |= np.uint64(1) << np.uint64(k)
    return touching


@kernel_part
def _estimate_cost_to_go(query, x, y, layer):
    """Weighted cost-to-go of a pose, with the layer of its heading; -1 for one to prune."""
    i, j = int(math.floor((x - query.low[0]) / query.size)), int(math.floor((y - query.low[1]) / query.size))
    columns = query.field.shape[0] // (query.rows * query.layers)
    cost = -1
    if 0 <= i < columns and 0 <= j < query.rows:
        cost = query.field[(i * query.rows + j) * query.layers + layer]
    return int(query.weight * max(cost - query.offset, 0)) if cost >= 0 else -1


@kernel_part
def find_slot(frontier, key):
    """Return the slot of the hash table with a key, or the empty slot for it."""
    mask = frontier.keys.shape[0] - 1
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    slot = np.int64(mixed >> np.uint64(32)) & mask
    while frontier.keys[slot] != -1 and frontier.keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@kernel_part
def push(frontier, node, estimate):
    """Put a node first in the bucket of its estimated cost, if there is one."""
    if estimate < frontier.heads.shape[0]:
        frontier.links[node] = frontier.heads[estimate]
        frontier.heads[estimate] = node
        if estimate < frontier.counts[1]:
            frontier.counts[1] = estimate


@kernel_part
def _add(query, frontier, x, y, heading, sector, layer, touching, spent, parent, action, is_goal):
    """Add a pose to the frontier unless its bin holds one at most as expensive.

    Bins use the sector of its heading, the field its layer; both are passed on, as modulo is slow and moves keep them.
    """
    node = frontier.counts[0]
    estimate, slot, key = spent, np.int64(-1), np.int64(-1)
    if not is_goal:
        i = np.int64(math.floor(x / query.bin_size)) + (1 << 22)
        j = np.int64(math.floor(y / query.bin_size)) + (1 << 22)
        key = (((i << 23) + j) << 10) + (sector << 1) + (touching != 0)
        slot = find_slot(frontier, key)
        known = frontier.keys[slot] == key
        if known and frontier.facts[frontier.owners[slot], 1] <= spent:
            return
        more = _estimate_cost_to_go(query, x, y, layer)
        if more < 0:
            return
        estimate += more
        if known:
            frontier.facts[frontier.owners[slot], 4] = BEATEN
        frontier.keys[slot], frontier.owners[slot] = key, node
    frontier.places[node, 0], frontier.places[node, 1] = x, y
    facts = frontier.facts[node]
    facts[0], facts[1], facts[2], facts[3] = heading, spent, parent, action
    facts[4] = GOAL if is_goal else OPEN
    frontier.touching[node] = touching
    frontier.counts[0] += 1
    push(frontier, node, estimate)
    if not is_goal and query.table.shape[0] > 0:
        i = int(math.floor((x - query.table_low[0]) / query.table_size))
        j = int(math.floor((y - query.table_low[1]) / query.table_size))
        if 0 <= i < query.table.shape[0] and 0 <= j < query.table.shape[1]:
            rest = query.table[i, j, heading]
            if rest >= 0:
                last = frontier.counts[0]
                frontier.places[last, 0], frontier.places[last, 1] = x, y
                facts = frontier.facts[last]
                facts[0], facts[1], facts[2], facts[3], facts[4] = heading, spent + rest, node, -1, GOAL
                frontier.touching[last] = touching
                frontier.counts[0] += 1
                push(frontier, last, spent + rest)


@kernel_part
def move_base(scene, motions, x, y, heading, action):
    """Displacement and new heading of the base after a translation or turn; the heading is -1 if it does not move."""
    translations = motions.moves.shape[1]
    if action < translations:
        dx, dy = motions.moves[heading, action, 0], motions.moves[heading, action, 1]
        fraction = sweep_body(scene, x, y, motions.turns[heading], dx, dy, motions.lengths[action])
        if fraction <= 1e-9 or (motions.stays and fraction < 1.0):
            return 0.0, 0.0, np.int64(-1)
        if fraction < 1.0:
            dx, dy = fraction * dx, fraction * dy
        return dx, dy, heading
    turn, headings = motions.turn_steps[action - translations], motions.moves.shape[0]
    to_heading = (heading + headings + turn) % headings
    if can_turn_body(scene, x, y, motions.turns[heading], motions.turns[to_heading], turn * motions.turn_step):
        return 0.0, 0.0, to_heading
    return 0.0, 0.0, np.int64(-1)


@kernel_part
def _expand(scene, query, frontier, node):
    x, y = frontier.places[node, 0], frontier.places[node, 1]
    heading, spent = np.int64(frontier.facts[node, 0]), np.int64(frontier.facts[node, 1]) + 1
    touching, translations = frontier.touching[node], query.motions.moves.shape[1]
    sector, layer = heading % query.bin_headings, (heading + query.shift) % query.layers
    for action in range(translations + query.motions.turn_steps.shape[0]):
        dx, dy, to_heading = move_base(scene, query.motions, x, y, heading, action)
        if to_heading < 0:
            continue
        to_x, to_y, to_sector, to_layer = x + dx, y + dy, sector, layer
        if action < translations:
            blocked = False
            for k in range(query.keep_out.shape[0]):
                blocked = blocked or first_contact(x, y, dx, dy, scene.radius, get_shape(query.keep_out[k])) < 1.0
            if blocked:
                continue
            closed = query.closed
            if closed[0] <= to_x <= closed[1] and closed[2] <= to_y <= closed[3]:
                continue
        else:
            to_sector, to_layer = to_heading % query.bin_headings, (to_heading + query.shift) % query.layers
        now = find_touched(query.motions, to_x, to_y, to_heading)
        begun = now & ~touching
        is_goal = False
        if query.target >= 0:
            is_goal = (begun >> np.uint64(query.target)) & np.uint64(1) == np.uint64(1)
        elif query.goal_headings[to_heading]:
            is_goal = measure_distance(to_x, to_y, get_shape(query.goal)) <= query.goal_reach
        if begun & query.forbidden:
            continue
        _add(query, frontier, to_x, to_y, to_heading, to_sector, to_layer, now, spent, node, action, is_goal)


@kernel_part
def take_cheapest(frontier, most, expansions):
    """Take the cheapest node out of a frontier: a goal, or one to expand, which is counted.

    It is `EXHAUSTED`, `BUDGET` or `GROW` if there is none, `expansions` nodes have been expanded, or `most` more nodes
    would not fit.
    """
    counts = frontier.counts
    while counts[1] < frontier.heads.shape[0]:
        node = np.int64(frontier.heads[counts[1]])
        if node < 0:
            counts[1] += 1
            continue
        if counts[0] + most > frontier.links.shape[0]:
            return np.int64(GROW)
        if counts[2] >= expansions:
            return np.int64(BUDGET)
        frontier.heads[counts[1]] = frontier.links[node]
        if frontier.facts[node, 4] == GOAL:
            return node
        if frontier.facts[node, 4] == OPEN:
            counts[2] += 1
            return node
    return np.int64(EXHAUSTED)


@kernel_in_place
def expand_until_goal(scene, query, frontier, expansions):
    """Expand nodes until a goal node is cheapest.

    Args:
        scene: the room.
        query: the query.
        frontier: nodes so far (none at first); changed in place.
        expansions: maximum total number of expanded nodes.

    Returns:
        The goal node, which is taken out of the frontier; or `EXHAUSTED`, `BUDGET` or `GROW`.
    """
    most = max(16, 2 * (query.motions.moves.shape[1] + query.motions.turn_steps.shape[0]))  # nodes of one expansion
    if frontier.counts[0] == 0:
        none = np.int64(-1)  # with literals numba would compile `_add` again
        sector, layer = query.heading % query.bin_headings, (query.heading + query.shift) % query.layers
        _add(query, frontier, query.x, query.y, query.heading, sector, layer, query.touched, np.int64(0), none, none,
             np.bool_(False))
    while True:
        node = take_cheapest(frontier, most, expansions)
        if node < 0 or frontier.facts[node, 4] == GOAL:
            return node
        _expand(scene, query, frontier, node)


# --- whole escapes ------------------------------------------------------------------------

class JointQuery(NamedTuple):
    """Start, puzzle, heuristic and bins of a joint search, as arrays."""

    x: float  # x of the start, m
    y: float  # y of the start, m
    heading: int  # heading of the start, in turn steps
    touched: np.uint64  # bits of the targets touched at the start
    puzzle: int  # number of the start's puzzle state
    motions: Motions
    presses: NDArray[np.int64]
    """Number of the puzzle state after a press of each target, shape (puzzles, n), int64; -1 without a field there."""
    solved: NDArray[np.bool_]  # True for the puzzle states with an open exit, bool, shape (puzzles,)
    exit: NDArray[np.float64]  # rectangle (x_min, x_max, y_min, y_max), shape (4,), m
    fields: NDArray[np.int16]
    """Cost-to-go of (cell, layer) in each field, shape (fields, cells * layers), int16; -1 where pruned."""
    field_of: NDArray[np.int64]  # field of each puzzle state, shape (puzzles,), int64
    layers: int  # headings that the fields distinguish
    shift: int  # whole turn steps that the fields' headings lag behind the query's
    low: NDArray[np.float64]  # corner of the fields' grid, shape (2,), m
    size: float  # side of its cells, m
    rows: int  # its cells along y
    offset: int  # primitives subtracted from the cost-to-go
    bin_size: float  # poses closer than this, in one puzzle state, count as one, m
    bin_headings: int  # headings that bins distinguish
    one_leg: bool  # the first change of the puzzle is the goal, too, at the cost-to-go of where it ends


@kernel_part
def _add_joint(query, frontier, x, y, heading, puzzle, touching, spent, parent, action, has_escaped):
    """Add a state to the frontier unless its bin holds one at most as expensive; an escape always."""
    node, headings = frontier.counts[0], query.motions.moves.shape[0]
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
def _expand_joint(shut, opened, query, frontier, node):
    x, y = frontier.places[node, 0], frontier.places[node, 1]
    headings = query.motions.moves.shape[0]
    heading, puzzle = np.int64(frontier.facts[node, 0]) % headings, np.int64(frontier.facts[node, 0]) // headings
    spent, touching = np.int64(frontier.facts[node, 1]) + 1, frontier.touching[node]
    for action in range(query.motions.moves.shape[1] + query.motions.turn_steps.shape[0]):
        if query.solved[puzzle]:
            dx, dy, to_heading = move_base(opened, query.motions, x, y, heading, action)
        else:
            dx, dy, to_heading = move_base(shut, query.motions, x, y, heading, action)
        if to_heading < 0:
            continue
        to_x, to_y, after = x + dx, y + dy, puzzle
        now = find_touched(query.motions, to_x, to_y, to_heading)
        begun = now & ~touching
        if begun:
            for target in range(query.presses.shape[1]):
                if after >= 0 and (begun >> np.uint64(target)) & np.uint64(1) == np.uint64(1):
                    after = query.presses[after, target]
            if after < 0:
                continue
        area = query.exit
        escapes = query.solved[after] and area[0] <= to_x <= area[1] and area[2] <= to_y <= area[3]
        _add_joint(query, frontier, to_x, to_y, to_heading, after, now, spent, node, action, escapes)


@kernel_in_place
def expand_until_escape(shut, opened, query, frontier, expansions):
    """Expand nodes until an escape is cheapest.

    Args:
        shut: the room with its exit door shut.
        opened: the room with it open.
        query: the query.
        frontier: nodes so far (none at first); changed in place. The first fact of a node is the number of its puzzle
            state times the number of headings, plus its heading.
        expansions: maximum total number of expanded nodes.

    Returns:
        The node of the escape, which is taken out of the frontier; or `EXHAUSTED`, `BUDGET` or `GROW`.
    """
    most = max(16, query.motions.moves.shape[1] + query.motions.turn_steps.shape[0])  # nodes of one expansion
    if frontier.counts[0] == 0:
        none = np.int64(-1)  # with literals numba would compile `_add_joint` again
        _add_joint(query, frontier, query.x, query.y, np.int64(query.heading), np.int64(query.puzzle),
                   query.touched, np.int64(0), none, none, np.bool_(False))
    while True:
        node = take_cheapest(frontier, most, expansions)
        if node < 0 or frontier.facts[node, 4] == GOAL:
            return node
        _expand_joint(shut, opened, query, frontier, node)


# --- memory ---------------------------------------------------------------------------------


class FrontierPool:
    """Pool of frontiers that searches reuse: clearing one is faster than touching new memory."""

    def __init__(self) -> None:
        self._kept: dict[int, Frontier] = {}

    def take(self, nodes: int, most: int = MOST_PRIMITIVES) -> Frontier:
        """Return an empty frontier for a number of nodes (a power of two), with estimates below `most`."""
        frontier = self._kept.pop(nodes, None)
        if frontier is None:
            frontier = Frontier(
                np.empty((nodes, 2)), np.empty((nodes, 5), dtype=np.int32), np.empty(nodes, dtype=np.uint64),
                np.empty(nodes, dtype=np.int32), np.empty(MOST_PRIMITIVES, dtype=np.int32),
                np.empty(4 * nodes, dtype=np.int64), np.empty(4 * nodes, dtype=np.int32), np.empty(3, dtype=np.int64),
            )
        frontier = frontier._replace(heads=frontier.heads[:most])
        frontier.heads.fill(-1)
        frontier.keys.fill(-1)
        frontier.counts.fill(0)
        return frontier

    def give_back(self, frontier: Frontier) -> None:
        """Return a frontier to the pool, unless it is large; the caller must not read it any more."""
        if len(frontier.links) <= MOST_KEPT_NODES:
            heads = frontier.heads if frontier.heads.base is None else frontier.heads.base
            self._kept[len(frontier.links)] = frontier._replace(heads=heads)

    def enlarge(self, old: Frontier) -> Frontier:
        """Copy a frontier into one with four times the capacity."""
        used = len(old.links)
        new = self.take(4 * used, len(old.heads))
        for name in ("places", "facts", "touching", "links"):
            getattr(new, name)[:used] = getattr(old, name)
        new.heads[:], new.counts[:] = old.heads, old.counts
        copy_owners(old, new)
        self.give_back(old)
        return new


def put_back(frontier: Frontier, node: int, spent: int) -> None:
    """Return a goal node to the frontier at a higher cost."""
    frontier.facts[node, 1] = spent
    if spent >= len(frontier.heads):
        return
    frontier.links[node] = frontier.heads[spent]
    frontier.heads[spent] = node


@kernel_in_place
def copy_owners(old, new):
    """Copy the poses of one hash table into another."""
    for slot in range(old.keys.shape[0]):
        if old.keys[slot] != -1:
            to = find_slot(new, old.keys[slot])
            new.keys[to], new.owners[to] = old.keys[slot], old.owners[slot]
