"""Kernels of smooth cost-to-go fields: ends of primitives on a grid, and value iteration over them.

The end of a primitive lies between four cells and has their interpolated value, as has any exact pose (Munos and Moore
2002, section 3). All fields of a room are iterated together, their values side by side, and where nothing is near, all
moves at a heading end between the same cells relative to their start: both let the compiler use vector instructions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.floor.sweeps import Presser, get_shape, is_clear_of_all, is_touched, measure_distance, sweep_body
from hrl_escape.kernels import kernel, kernel_part

UNREACHABLE = 10_000.0
"""Cost-to-go of places that cannot reach the goal."""
AT_GOAL = 1e-6
"""Cost-to-go of states that are the goal themselves, which stays as it is."""
_MOST, _GOAL = np.float32(UNREACHABLE), np.float32(AT_GOAL)
_ONE = np.float32(1.0)
_FREE, _ABSENT = -1, -2
BLOCKED = 0.01
"""Moves shorter than this do not count, m."""


class Moves(NamedTuple):
    """Ends of all moves from the representative places of a grid's cells; a state is a (heading class, cell)."""

    rows: int  # cells along y; a cell's index is i * rows + j
    reach: int  # most columns or rows from a cell to one of the four round the end of a move
    offsets: NDArray[np.int64]
    """Index of the lowest of the four, relative to the cell's own, for an unblocked move, int64 (classes,
    translations)."""
    shares: NDArray[np.float32]  # weights of the four there, lower row first, float32 (classes, translations, 4)
    listed: NDArray[np.int32]
    """Row of each state in the following tables, int32 (classes, cells); -1 where all its moves are free, touch no
    target and stay out of the exit, and -2 where the body does not fit."""
    corners: NDArray[np.int32]  # lowest of the four cells, int32 (listed, translations); -1 and -2 likewise, of a move
    weights: NDArray[np.float32]  # their weights, 0 where the body does not fit, float32 (listed, translations, 4)
    special: NDArray[np.int32]
    """Row of each listed state in the last two tables, int32 (listed,); -1 where no move begins to touch a target or
    ends in the exit."""
    begun: NDArray[np.uint64]
    """Bits of the targets that are touched at a move's end and not at its start, uint64 (special, translations)."""
    outside: NDArray[np.bool_]  # True unless the move ends in the exit, bool (special, translations)


class Targets(NamedTuple):
    """Targets that the body presses."""

    shapes: NDArray[np.float64]  # rows of `stack_footprints`, float64 (targets, 7)
    reaches: NDArray[np.float64]  # largest distance of its axis where each is touched, m, float64 (targets,)
    by_base: NDArray[np.bool_]  # True where the `base` must touch it, bool (targets,); else that distance decides
    base: Presser


@kernel_part
def _find_near(x, y, targets, margin):
    """Bits of the targets that the body may touch somewhere within a distance of a place."""
    bits = np.uint64(0)
    for k in range(targets.reaches.shape[0]):
        if measure_distance(x, y, get_shape(targets.shapes[k])) <= targets.reaches[k] + margin:
            bits |= np.uint64(1) << np.uint64(k)
    return bits


@kernel_part
def _find_touched(x, y, turn, targets, near):
    """Bits of the targets of `near` that the body touches at a place and heading."""
    bits = np.uint64(0)
    for k in range(targets.reaches.shape[0]):
        bit = np.uint64(1) << np.uint64(k)
        if near & bit and (is_touched(x, y, turn, targets.base, get_shape(targets.shapes[k]), targets.reaches[k])
                           if targets.by_base[k] else
                           measure_distance(x, y, get_shape(targets.shapes[k])) <= targets.reaches[k]):
            bits |= bit
    return bits


@kernel
def _trace_free(size, rows, moves):
    """`offsets` and `shares` of `Moves`."""
    classes, translations = moves.shape[0], moves.shape[1]
    offsets = np.empty((classes, translations), dtype=np.int64)
    shares = np.empty((classes, translations, 4), dtype=np.float32)
    for c in range(classes):
        for m in range(translations):
            u, v = moves[c, m, 0] / size, moves[c, m, 1] / size
            i, j = int(math.floor(u + 1e-9)), int(math.floor(v + 1e-9))
            a, b = max(u - i, 0.0), max(v - j, 0.0)
            offsets[c, m] = i * rows + j
            for k in range(4):
                shares[c, m, k] = (a if k // 2 else 1.0 - a) * (b if k % 2 else 1.0 - b)
    return offsets, shares


@kernel
def _trace_listed(scene, points, fits, turns, rows, low, size, moves, offsets, shares, targets, way_out, is_whole):
    """`listed`, `corners`, `weights`, `special`, `begun` and `outside` of `Moves`."""
    cells, classes, translations = points.shape[0], moves.shape[0], moves.shape[1]
    columns, layers = cells // rows, fits.shape[1]
    lengths = np.empty(translations)
    for m in range(translations):
        lengths[m] = math.hypot(moves[0, m, 0], moves[0, m, 1])
    length = lengths.max()
    edge = int(math.ceil(length / size)) + 1
    near, here = np.zeros(cells, dtype=np.uint64), np.zeros((cells, layers), dtype=np.uint64)
    listed = np.full((classes, cells), _ABSENT, dtype=np.int32)
    count = specials = 0
    for cell in range(cells):
        if not fits[cell].any():
            continue
        x, y = points[cell, 0], points[cell, 1]
        near[cell] = _find_near(x, y, targets, length + 1e-6)
        for c in range(layers):
            here[cell, c] = _find_touched(x, y, turns[c], targets, near[cell])
        away = max(way_out[0] - x, x - way_out[1], way_out[2] - y, y - way_out[3]) - length - 1e-6
        i, j = cell // rows, cell % rows
        is_inside = edge <= min(i, j, columns - 1 - i, rows - 1 - j)
        if near[cell] == 0 and away > 0.0 and is_inside and is_clear_of_all(scene, x, y, length + 3.0 * size):
            listed[:, cell] = _FREE
        else:
            for c in range(classes):
                listed[c, cell] = 0 if fits[cell, c % layers] else _ABSENT
            count += classes
            specials += classes if near[cell] != 0 or away <= 0.0 else 0
    corners = np.full((count, translations), _ABSENT, dtype=np.int32)
    weights = np.zeros((count, translations, 4), dtype=np.float32)
    special = np.full(count, -1, dtype=np.int32)
    begun = np.zeros((specials, translations), dtype=np.uint64)
    outside = np.ones((specials, translations), dtype=np.bool_)
    at = row = 0
    for n in range(cells * classes):  # column after column, in the order of backups
        i, c, j = n // (classes * rows), n // rows % classes, n % rows
        cell = i * rows + j
        if listed[c, cell] != 0:
            continue
        x, y = points[cell, 0], points[cell, 1]
        is_centre = math.hypot(x - low[0] - (i + 0.5) * size, y - low[1] - (j + 0.5) * size) < 1e-9
        free, is_special = 0, False
        corners[at] = _ABSENT
        for m in range(translations):
            dx, dy = moves[c, m, 0], moves[c, m, 1]
            fraction = sweep_body(scene, x, y, turns[c], dx, dy, lengths[m])
            if fraction * lengths[m] < BLOCKED or (is_whole and fraction < 1.0):
                continue
            ex, ey = x + fraction * dx, y + fraction * dy
            bits = _find_touched(ex, ey, turns[c], targets, near[cell]) & ~here[cell, c % layers]
            is_free = is_centre and fraction == 1.0
            is_out = not (way_out[0] <= ex <= way_out[1] and way_out[2] <= ey <= way_out[3])
            if bits != 0 or not is_out:
                if not is_special:
                    is_special, special[at] = True, row
                    begun[row], outside[row] = 0, True
                is_free = False
                begun[row, m], outside[row, m] = bits, is_out
            u, v = (ex - low[0]) / size - 0.5, (ey - low[1]) / size - 0.5
            to_i = min(max(int(math.floor(u + 1e-9)), 0), columns - 2)
            to_j = min(max(int(math.floor(v + 1e-9)), 0), rows - 2)
            is_free &= to_i * rows + to_j == cell + offsets[c, m]
            a, b = min(max(u - to_i, 0.0), 1.0), min(max(v - to_j, 0.0), 1.0)
            total = 0.0
            for k in range(4):
                weight = (a if k // 2 else 1.0 - a) * (b if k % 2 else 1.0 - b)
                does_fit = fits[(to_i + k // 2) * rows + to_j + k % 2, c % layers]
                weights[at, m, k] = weight if does_fit else 0.0
                total += weight if does_fit else 0.0
                is_free &= abs(weights[at, m, k] - shares[c, m, k]) < 1e-6
            if is_free:
                corners[at, m] = _FREE
                free += 1
            elif total > 1e-6:
                corners[at, m] = to_i * rows + to_j
                for k in range(4):
                    weights[at, m, k] /= total
        if free == translations:
            listed[c, cell] = _FREE
        else:
            listed[c, cell] = at
            at, row = at + 1, row + (1 if is_special else 0)
    return listed, corners[:at], weights[:at], special[:at], begun[:row], outside[:row]


def trace_moves(scene, points, fits, turns, rows, low, size, moves, targets, way_out, is_whole) -> Moves:
    """Find the ends of all moves from every cell's representative place.

    Args:
        scene: the room.
        points: a representative place in each cell, shape (cells, 2), m; the centre where nothing is near.
        fits: True where the body fits at each heading class, shape (cells, classes), or (cells, 1) if that is all one.
        turns: cosine and sine of the heading classes, shape (classes or more, 2).
        rows: cells along y; a cell's index is i * rows + j.
        low: corner of the grid, shape (2,), m.
        size: side of a cell, m.
        moves: displacements, shape (classes, translations, 2), m.
        targets: what the body presses, a `Targets`.
        way_out: x_min, x_max, y_min, y_max of the exit, m.
        is_whole: True where moves are made whole or not at all.
    """
    offsets, shares = _trace_free(size, rows, moves)
    tables = _trace_listed(scene, points, fits, turns, rows, low, size, moves, offsets, shares, targets, way_out,
                           is_whole)
    longest = max(math.hypot(*move) for move in moves[0].tolist())
    return Moves(rows, math.ceil(longest / size) + 1, offsets, shares, *tables)


@kernel
def iterate_values(values, moves, turn_steps, can_turn, own, leaving, penalty, tolerance, most):
    """Value iteration of several fields at once, in place, until no value changes.

    Sweeps go over the grid in turn from each of its corners, tile by tile. The states in a tile's column are backed up
    together, and skipped while no value near enough to matter changes.

    Args:
        values: cost-to-go or more, shape (classes, cells * fields), float32: `UNREACHABLE`, and `AT_GOAL` where the
            goal is a set of states. Costs that are too low would take more sweeps to grow than those to fall.
        moves: from `trace_moves`.
        turn_steps: change of heading class by each turn, shape (turns,); the first two are 1 and -1.
        can_turn: True where each turn is free, shape (turns, classes, cells); (0, ...) if all are.
        own: bit of the target that a move of each field is to touch, 0 for the exit, uint64 (fields,).
        leaving: cost of entering the exit without the goal, float32 (fields,); `UNREACHABLE` where the episode ends.
        penalty: cost of touching another target, float32.
        tolerance: largest change that counts as none, float32.
        most: maximum number of sweeps; values can still change after them.
    """
    fields, classes, cells, rows = own.shape[0], moves.listed.shape[0], moves.listed.shape[1], moves.rows
    columns, side = cells // rows, moves.reach
    wide, high = (columns + side - 1) // side, (rows + side - 1) // side
    changed = np.zeros((columns, high), dtype=np.int64)  # number of the last sweep that changed a tile's column
    fresh = np.empty((classes, side * fields), dtype=np.float32)
    for number in range(1, most + 1):
        is_done = True
        for n in range(wide * side * high):
            i, tj = n // (high * side) * side + n % side, n // side % high
            if number % 2:
                i = wide * side - 1 - i
            if number // 2 % 2:
                tj = high - 1 - tj
            if i >= columns or (number > 1 and not _is_stale(changed, i, tj, side, number - 1)):
                continue
            first, last = tj * side, min(tj * side + side, rows)
            if _back_up(values, moves, turn_steps, can_turn, own, leaving, penalty, tolerance,
                        i * rows + first, last - first, fresh):
                changed[i, tj] = number
                is_done = False
        if is_done:
            break


@kernel_part
def _is_stale(changed, i, tj, side, since):
    """Return whether a value that a tile's column depends on has changed since a sweep."""
    for near_i in range(max(i - side, 0), min(i + side + 1, changed.shape[0])):
        for near_j in range(max(tj - 1, 0), min(tj + 2, changed.shape[1])):
            if changed[near_i, near_j] >= since:
                return True
    return False


@kernel_part
def _back_up(values, moves, turn_steps, can_turn, own, leaving, penalty, tolerance, begin, count, fresh):
    """Back up `count` cells in a row from cell `begin` on; returns True if a value has changed."""
    fields, classes, translations = own.shape[0], moves.listed.shape[0], moves.offsets.shape[1]
    for c in range(classes):
        fresh[c, :count * fields] = _MOST
        for m in range(translations):
            cell = begin
            while cell < begin + count:
                at, corner, end = moves.listed[c, cell], _find_corner(moves, c, cell, m), cell + 1
                while corner == _FREE and end < begin + count and _find_corner(moves, c, end, m) == _FREE:
                    end += 1
                best = fresh[c, (cell - begin) * fields:(end - begin) * fields]
                row = moves.special[at] if corner >= 0 else -1
                if corner == _FREE:
                    _take_less(values[c], cell + moves.offsets[c, m], moves.rows, fields, moves.shares[c, m], best)
                elif row >= 0 and (moves.begun[row, m] != 0 or not moves.outside[row, m]):
                    _take_less_by_goal(values[c], corner, moves.rows, moves.weights[at, m], moves.begun[row, m],
                                       moves.outside[row, m], own, leaving, penalty, best)
                elif corner >= 0:
                    _take_less(values[c], corner, moves.rows, fields, moves.weights[at, m], best)
                cell = end
    length, around = count * fields, classes + classes // 2
    for c in range(classes):
        _keep_goal(values[c, begin * fields:begin * fields + length], fresh[c, :length])
    for t in range(2, turn_steps.shape[0]):  # turns commute: each kind of them, over and over, before the next
        turn = turn_steps[t] % classes
        for k in range(classes):
            c = k
            for _ in range(around if turn else 0):
                source, c = c, (c - turn + classes) % classes
                _take_less_after_turn(fresh, source, c, can_turn, t, begin, count, fields)
    for k in range(around):  # turns to either side, as far round as pays
        _take_less_after_turn(fresh, k % classes, (k + 1) % classes, can_turn, 1, begin, count, fields)
    for k in range(around, 0, -1):
        _take_less_after_turn(fresh, k % classes, (k - 1) % classes, can_turn, 0, begin, count, fields)
    changes = 0
    for c in range(classes):
        new, old = fresh[c, :length], values[c, begin * fields:begin * fields + length]
        for n in range(length):
            changes += abs(new[n] - old[n]) >= tolerance
            old[n] = new[n]
    return changes > 0


@kernel_part
def _find_corner(moves, c, cell, m):
    """Lowest cell at a move's end, `_FREE` or `_ABSENT`."""
    at = moves.listed[c, cell]
    return moves.corners[at, m] if at >= 0 else at


@kernel_part
def _take_less(line, corner, rows, fields, weights, best):
    """Lower `best` to the cost of moves that end between the four cells from `corner` on, or those after it."""
    start, above, length = corner * fields, (corner + rows) * fields, best.shape[0]
    p, q = line[start:start + length], line[start + fields:start + fields + length]
    r, s = line[above:above + length], line[above + fields:above + fields + length]
    wp, wq, wr, ws = weights[0], weights[1], weights[2], weights[3]
    for n in range(length):
        cost = _ONE + wp * p[n] + wq * q[n] + wr * r[n] + ws * s[n]
        best[n] = min(best[n], cost)


@kernel_part
def _take_less_by_goal(line, corner, rows, weights, begun, is_out, own, leaving, penalty, best):
    """As `_take_less`, for a move that may begin to touch targets or end in the exit."""
    fields = own.shape[0]
    for n in range(fields):
        cost = _ONE
        if not (begun & own[n] if own[n] else not is_out):
            if not is_out:
                cost += leaving[n]
            for k in range(4):
                cost += weights[k] * line[(corner + (k // 2) * rows + k % 2) * fields + n]
        if begun & ~own[n]:
            cost += penalty
        best[n] = min(best[n], cost)


@kernel_part
def _keep_goal(old, best):
    """Lower `best` to the cost of states that are the goal themselves."""
    for n in range(best.shape[0]):
        best[n] = _GOAL if old[n] == _GOAL else best[n]


@kernel_part
def _take_less_after_turn(fresh, source, to, can_turn, turn, begin, count, fields):
    """Lower the costs at the heading class `to` to the costs of first turning to `source`, where that is free."""
    if can_turn.shape[0] == 0:
        _take_less_by_one(fresh[source, :count * fields], fresh[to, :count * fields])
        return
    for cell in range(count):
        if can_turn[turn, to, begin + cell]:
            _take_less_by_one(fresh[source, cell * fields:(cell + 1) * fields],
                              fresh[to, cell * fields:(cell + 1) * fields])


@kernel_part
def _take_less_by_one(source, best):
    for n in range(best.shape[0]):
        best[n] = min(best[n], source[n] + _ONE)


@kernel
def encode_values(values, fields):
    """Round `fields` fields to int16 (fields, cells, classes), -1 without a way; and their units, float32 (fields,)."""
    classes, cells = values.shape[0], values.shape[1] // fields
    most = np.ones(fields, dtype=np.float32)
    for c in range(classes):
        for cell in range(cells):
            for n in range(fields):
                value = values[c, cell * fields + n]
                if most[n] < value < _MOST:
                    most[n] = value
    scales = (most / np.float32(32_000)).astype(np.float32)
    found = np.empty((fields, cells, classes), dtype=np.int16)
    for cell in range(cells):
        for c in range(classes):
            for n in range(fields):
                value = values[c, cell * fields + n]
                found[n, cell, c] = int(value / scales[n] + np.float32(0.5)) if value < _MOST else -1
    return found, scales
