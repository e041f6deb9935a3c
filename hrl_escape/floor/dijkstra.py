"""Kernels of cost-to-go fields: representative places, links between cells, and Dijkstra's search.

Arrays in, arrays out; `cost_to_go.py` gives them their meaning and keeps them. Kernels are compiled on first use and
kept on disk. Each takes columns or cells of a grid of (columns, rows) from `first` to before `last`; `low` is the
grid's corner, `size` the side of a cell, m.

| array | shape | meaning |
|---|---|---|
| `points` | (cells, 2) | a representative place in each cell, m |
| `standing` | (cells,) | whether the body fits there, perhaps at some headings only |
| `turns` | (classes + 1, 2) | cosine and sine of each heading class, and of the next one after the last |
| `fits` | (cells,) or (cells * classes,) | whether the body fits, at a heading where that matters |
| `can_turn` | (cells * classes,) | whether it can turn from a class to the next one and back |
"""

from __future__ import annotations

import math

import numpy as np

from hrl_escape.floor.sweeps import can_turn_body, does_fit, get_shape, is_touched, measure_clearance, sweep_body
from hrl_escape.kernels import kernel, kernel_in_place, kernel_part

UNREACHED = 32_000


@kernel_part
def _find_cell(points, fits, layers, layer, columns, rows, i, j, x, y):
    """The cell (i, j) if the body fits there, else its neighbour whose place is nearest; -1 if none."""
    if 0 <= i < columns and 0 <= j < rows and fits[(i * rows + j) * layers + layer]:
        return i * rows + j
    best, nearest = -1, 1e18
    for near_i in range(max(i - 1, 0), min(i + 2, columns)):
        for near_j in range(max(j - 1, 0), min(j + 2, rows)):
            other = near_i * rows + near_j
            if fits[other * layers + layer]:
                away = (points[other, 0] - x) ** 2 + (points[other, 1] - y) ** 2
                if away < nearest:
                    best, nearest = other, away
    return best


@kernel_in_place
def choose_points(scene, low, size, rows, first, last, within, points, standing):
    """Fill in `points` and `standing` of the cells `within` some columns; the others count as blocked.

    The place is the cell's centre if the body fits there, else the one of 5 x 5 with the most clearance. A rectangular
    base counts as fitting where the largest disc within it does.
    """
    for i in range(first, last):
        for j in range(rows):
            x, y = low[0] + (i + 0.5) * size, low[1] + (j + 0.5) * size
            if not within[i * rows + j]:
                points[i * rows + j, 0], points[i * rows + j, 1] = x, y
                continue
            best_x, best_y, widest = x, y, measure_clearance(scene, x, y)
            if widest < scene.radius and widest + size > scene.inner:
                for k in range(25):
                    try_x, try_y = x + (k // 5 - 2) * size / 5, y + (k % 5 - 2) * size / 5
                    clearance = measure_clearance(scene, try_x, try_y)
                    if clearance > widest:
                        best_x, best_y, widest = try_x, try_y, clearance
            cell = i * rows + j
            points[cell, 0], points[cell, 1] = best_x, best_y
            standing[cell] = widest >= scene.inner


@kernel_in_place
def choose_headings(scene, points, standing, turns, turn_step, first, last, fits, can_turn):
    """Fill in the headings of a rectangular base that fit in some cells, and the turns on the spot that it can make."""
    classes = turns.shape[0] - 1
    for cell in range(first, last):
        if not standing[cell]:
            continue
        x, y = points[cell, 0], points[cell, 1]
        for c in range(classes):
            fits[cell * classes + c] = does_fit(scene, x, y, turns[c])
        for c in range(classes):
            can_turn[cell * classes + c] = (
                fits[cell * classes + c] and fits[cell * classes + (c + 1) % classes]
                and can_turn_body(scene, x, y, turns[c], turns[c + 1], turn_step))


@kernel_in_place
def find_landings(scene, points, fits, turns, cells_a_row, low, size, moves, steps, first, last, landing, link_cost):
    """Fill in the cells, or -1, where moves from some cells end, and their costs: by cell, class and translation.

    `moves` are displacements, (classes, translations, 2), m; a whole one costs its `steps` primitives.
    """
    ends = moves.shape[0] * moves.shape[1]
    for cell in range(first, last):
        _land(scene, points, fits, turns, cells_a_row, low, size, moves, steps, cell, cell * ends, landing, link_cost)


@kernel_part
def _land(scene, points, fits, turns, cells_a_row, low, size, moves, steps, cell, first, landing, link_cost):
    """Fill in, from `first` on, the cells where the moves from one cell end, and their costs."""
    classes, translations = moves.shape[0], moves.shape[1]
    columns = points.shape[0] // cells_a_row
    layers = fits.shape[0] // points.shape[0]
    x, y = points[cell, 0], points[cell, 1]
    for c in range(classes):
        layer = c % layers
        if not fits[cell * layers + layer]:
            continue
        for m in range(translations):
            dx, dy = moves[c, m, 0], moves[c, m, 1]
            fraction = sweep_body(scene, x, y, turns[c], dx, dy, math.hypot(moves[0, m, 0], moves[0, m, 1]))
            ex, ey = x + fraction * dx, y + fraction * dy
            i, j = int(math.floor((ex - low[0]) / size)), int(math.floor((ey - low[1]) / size))
            best = _find_cell(points, fits, layers, layer, columns, cells_a_row, i, j, ex, ey)
            if best >= 0 and best != cell:
                at = first + c * translations + m
                landing[at] = best
                link_cost[at] = max(1, int(math.ceil(fraction * steps - 1e-9)))


@kernel
def link_cells(landing, link_cost, classes, translations):
    """Reverse the moves of `find_landings`: starts (cells * classes + 1,), sources (links,) and costs (links,).

    State s, a (cell, class), is entered from the cells `sources[starts[s]:starts[s + 1]]`, same class, at those costs.
    """
    cells = landing.shape[0] // (classes * translations)
    starts = np.zeros(cells * classes + 1, dtype=np.int32)
    for at in range(landing.shape[0]):
        if landing[at] >= 0:
            starts[landing[at] * classes + (at // translations) % classes + 1] += 1
    for s in range(cells * classes):
        starts[s + 1] += starts[s]
    sources = np.empty(starts[-1], dtype=np.int32)
    costs = np.empty(starts[-1], dtype=np.int16)
    fill = starts[:-1].copy()
    for cell in range(cells):
        for c in range(classes):
            for m in range(translations):
                at = (cell * classes + c) * translations + m
                if landing[at] >= 0:
                    state = landing[at] * classes + c
                    sources[fill[state]] = cell
                    costs[fill[state]] = link_cost[at]
                    fill[state] += 1
    return starts, sources, costs


@kernel
def find_last_moves(scene, points, fits, turns, candidates, moves, steps, goal, reach, presser):
    """Cost of the displacement from each cell that ends in the goal, 0 if none does; shape (candidates, classes)."""
    classes, translations = moves.shape[0], moves.shape[1]
    link_cost = np.zeros((candidates.shape[0], classes), dtype=np.int32)
    shape, layers = get_shape(goal), fits.shape[0] // points.shape[0]
    for n in range(candidates.shape[0]):
        x, y = points[candidates[n], 0], points[candidates[n], 1]
        for c in range(classes):
            if not fits[candidates[n] * layers + c % layers]:
                continue
            for m in range(translations):
                dx, dy = moves[c, m, 0], moves[c, m, 1]
                fraction = sweep_body(scene, x, y, turns[c], dx, dy, math.hypot(moves[0, m, 0], moves[0, m, 1]))
                if is_touched(x + fraction * dx, y + fraction * dy, turns[c], presser, shape, reach):
                    cost = max(1, int(math.ceil(fraction * steps - 1e-9)))
                    if link_cost[n, c] == 0 or cost < link_cost[n, c]:
                        link_cost[n, c] = cost
    return link_cost


@kernel
def find_touching_cells(points, turns, candidates, goal, reach, presser):
    """Return whether a presser touches a goal from each cell at each heading class; shape (candidates, classes)."""
    classes, shape = turns.shape[0] - 1, get_shape(goal)
    touching = np.zeros((candidates.shape[0], classes), dtype=np.bool_)
    for n in range(candidates.shape[0]):
        for c in range(classes):
            x, y = points[candidates[n], 0], points[candidates[n], 1]
            touching[n, c] = is_touched(x, y, turns[c], presser, shape, reach)
    return touching


@kernel
def run_dijkstra(starts, sources, costs, classes, headings, turn_steps, can_turn, allowed, seeds, seed_costs, best,
                 buckets, filled, counts, most):
    """Fewest primitives from every (cell, heading) to the nearest seed, by Dijkstra's search with buckets (Dial 1969).

    Each call takes up `most` states and then ends its level; the search is over when `counts[0]` is negative.
    `headings` are a multiple of `classes` or equal to it, each turn advances by one of `turn_steps`, and an empty
    `can_turn` always can. `seeds` are states cell * headings + heading in the order of their costs. `best`, of each
    state, is `UNREACHED` at first, -1 in the end where no seed is reached. `buckets` (levels, any), which are returned,
    hold the states of the next levels, each as many as `filled` says. `counts` are level, seeds used, states in the
    fullest bucket, and most links of a state.
    """
    wide = filled.shape[0]
    level, used, fullest, most_links = counts[0], counts[1], counts[2], counts[3]
    taken = 0
    while level < UNREACHED - wide:
        if taken >= most:
            counts[0], counts[1], counts[2] = level, used, fullest
            return buckets
        slot = level % wide
        while used < seeds.shape[0] and seed_costs[used] <= level:
            if fullest == buckets.shape[1]:
                buckets = _widen(buckets, filled)
            state = seeds[used]
            if allowed[state // headings] and level < best[state]:
                best[state] = level
                buckets[slot, filled[slot]] = state
                filled[slot] += 1
                fullest = max(fullest, filled[slot])
            used += 1
        if filled[slot] == 0:
            waiting = 0
            for k in range(wide):
                waiting += filled[k]
            if waiting > 0:
                level += 1
            elif used < seeds.shape[0]:
                level = seed_costs[used]
            else:
                break
            continue
        at = 0
        while at < filled[slot]:
            if fullest + turn_steps.shape[0] + most_links > buckets.shape[1]:
                buckets = _widen(buckets, filled)
            state = buckets[slot, at]
            at += 1
            taken += 1
            if best[state] != level:
                continue
            cell = state // headings
            heading = state - cell * headings
            cost = level + 1
            to = cost % wide
            first = filled[to]
            for k in range(turn_steps.shape[0]):
                turn = turn_steps[k]
                before = state - turn
                if heading < turn:
                    before += headings
                elif heading - turn >= headings:
                    before -= headings
                if cost < best[before] and (
                        can_turn.shape[0] == 0 or _is_turn_free(can_turn, cell * classes, classes, heading, turn)):
                    best[before] = cost
                    buckets[to, first] = before
                    first += 1
            filled[to] = first
            fullest = max(fullest, first)
            known = cell * classes + (heading if headings == classes else heading % classes)
            for k in range(starts[known], starts[known + 1]):
                before, cost = sources[k] * headings + heading, level + costs[k]
                if cost < best[before] and allowed[sources[k]]:
                    best[before] = cost
                    to = cost % wide
                    buckets[to, filled[to]] = before
                    filled[to] += 1
                    fullest = max(fullest, filled[to])
        filled[slot] = 0
        level += 1
    for state in range(best.shape[0]):
        if best[state] == UNREACHED:
            best[state] = -1
    counts[0] = -1
    return buckets


@kernel_part
def _is_turn_free(can_turn, first, classes, heading, turn):
    """Return whether all steps of a turn to a heading are free, in the cell whose classes begin at `first`."""
    low, high = (heading - turn, heading) if turn > 0 else (heading, heading - turn)
    for step in range(low, high):
        if not can_turn[first + (step + classes) % classes]:
            return False
    return True


@kernel
def _widen(buckets, filled):
    """Copy the buckets into ones for twice as many states."""
    wider = np.empty((buckets.shape[0], 2 * buckets.shape[1]), dtype=np.int32)
    for row in range(buckets.shape[0]):  # slices of two dimensions take numba seconds to compile
        for k in range(filled[row]):
            wider[row, k] = buckets[row, k]
    return wider


@kernel
def fill_gaps(field, known, headings, rows):
    """Give cells that are not `known`, by cell or (cell, class), the least of their neighbours; changes `field`."""
    layers = known.shape[0] * headings // field.shape[0]
    columns = known.shape[0] // (rows * layers)
    for i in range(columns):
        for j in range(rows):
            cell = i * rows + j
            if layers == 1 and known[cell]:
                continue
            for heading in range(headings):
                layer = heading % layers
                if known[cell * layers + layer]:
                    continue
                least = -1
                for near_i in range(max(i - 1, 0), min(i + 2, columns)):
                    for near_j in range(max(j - 1, 0), min(j + 2, rows)):
                        other = near_i * rows + near_j
                        cost = field[other * headings + heading]
                        if known[other * layers + layer] and cost >= 0 and (least < 0 or cost < least):
                            least = cost
                field[cell * headings + heading] = least
    return field


# --- what is cut off --------------------------------------------------------------------

TILE = 8
"""Cells along each side of a block whose links are found together."""
CUT_OFF, JOINED, UNDECIDED = 0, 1, 2


@kernel_part
def _visit(marks, queue, count, state):
    """Queue a state that is not seen yet; returns how many are queued now, or -1 if it is one that is looked for.

    `marks` are 1 at states that are looked for and 2 at those that were seen.
    """
    if marks[state] == 1:
        return -1
    if marks[state] == 0:
        marks[state] = 2
        queue[count] = state
        count += 1
    return count


@kernel
def grow_back(scene, points, fits, turns, rows, low, size, moves, turn_steps, can_turn, headings, allowed, seeds,
              wanted, far, most):
    """Grow the states that lead to some seeds, as `run_dijkstra` would, and find links on the way.

    `seeds` and `wanted` are states cell * headings + heading, and a move leads at most `far` cells along each axis.
    Returns `CUT_OFF` if no wanted state leads to a seed, `JOINED` if one does, and `UNDECIDED` once the links of `most`
    cells are found.
    """
    classes, translations, cells = moves.shape[0], moves.shape[1], points.shape[0]
    ends, columns, across = classes * translations, cells // rows, (rows + TILE - 1) // TILE
    landing, link_cost = np.empty(ends, dtype=np.int32), np.empty(ends, dtype=np.int16)
    is_known = np.zeros((columns + TILE - 1) // TILE * across, dtype=np.bool_)
    heads = np.zeros(cells * classes, dtype=np.int32)  # 1 + the last link found into each (cell, class), 0 for none
    room = (most + TILE * TILE) * ends + 1
    sources, others = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.int32)
    marks = np.zeros(cells * headings, dtype=np.int8)
    queue = np.empty(cells * headings, dtype=np.int32)
    count, found, taken = 0, 0, 0
    for state in wanted:
        marks[state] = 1
    for state in seeds:
        if allowed[state // headings]:
            count = _visit(marks, queue, count, state)
            if count < 0:
                return JOINED
    while taken < count:
        state = np.int64(queue[taken])
        taken += 1
        cell = state // headings
        heading, i, j = state - cell * headings, cell // rows, cell % rows
        for a in range(max(i - far, 0) // TILE, min(i + far, columns - 1) // TILE + 1):
            for b in range(max(j - far, 0) // TILE, min(j + far, rows - 1) // TILE + 1):
                if is_known[a * across + b]:
                    continue
                is_known[a * across + b] = True
                for near_i in range(a * TILE, min((a + 1) * TILE, columns)):
                    for near_j in range(b * TILE, min((b + 1) * TILE, rows)):
                        before, known = near_i * rows + near_j, found
                        landing[:] = -1
                        _land(scene, points, fits, turns, rows, low, size, moves, 1, before, 0, landing, link_cost)
                        for k in range(ends):
                            if landing[k] >= 0:
                                found += 1
                                to = landing[k] * classes + k // translations
                                sources[found], others[found] = before, heads[to]
                                heads[to] = found
                        most -= found > known
                if most < 0:
                    return UNDECIDED
        for turn in turn_steps:
            before = cell * headings + (heading - turn + headings) % headings
            if marks[before] != 2 and (
                    can_turn.shape[0] == 0 or _is_turn_free(can_turn, cell * classes, classes, heading, turn)):
                count = _visit(marks, queue, count, before)
                if count < 0:
                    return JOINED
        link = heads[cell * classes + heading % classes]
        while link > 0:
            before = np.int64(sources[link]) * headings + heading
            if marks[before] != 2 and allowed[sources[link]]:
                count = _visit(marks, queue, count, before)
                if count < 0:
                    return JOINED
            link = others[link]
    return CUT_OFF


@kernel
def grow_on(scene, points, fits, turns, rows, low, size, moves, turn_steps, can_turn, headings, allowed, seeds, wanted,
            most):
    """Grow the states that the wanted ones lead to; arguments and result as in `grow_back`."""
    classes, translations, cells = moves.shape[0], moves.shape[1], points.shape[0]
    marks = np.zeros(cells * headings, dtype=np.int8)
    queue = np.empty(cells * headings, dtype=np.int32)
    is_known, ends = np.zeros(cells, dtype=np.bool_), classes * translations
    landing, link_cost = np.empty(cells * ends, dtype=np.int32), np.empty(cells * ends, dtype=np.int16)
    count, taken = 0, 0
    for state in seeds:
        if allowed[state // headings]:
            marks[state] = 1
    for state in wanted:
        count = _visit(marks, queue, count, state)
        if count < 0:
            return JOINED
    while taken < count:
        state = np.int64(queue[taken])
        taken += 1
        cell = state // headings
        heading = state - cell * headings
        first = cell * ends
        if not is_known[cell]:
            is_known[cell] = True
            most -= 1
            if most < 0:
                return UNDECIDED
            landing[first : first + ends] = -1
            _land(scene, points, fits, turns, rows, low, size, moves, 1, cell, first, landing, link_cost)
        first += heading % classes * translations
        for k in range(turn_steps.shape[0] + translations):
            after = np.int64(-1)
            if k >= turn_steps.shape[0]:
                best = np.int64(landing[first + k - turn_steps.shape[0]])
                if best >= 0 and allowed[cell]:
                    after = best * headings + heading
            else:
                to = (heading + turn_steps[k] + headings) % headings
                if can_turn.shape[0] == 0 or _is_turn_free(can_turn, cell * classes, classes, to, turn_steps[k]):
                    after = cell * headings + to
            if after >= 0:
                count = _visit(marks, queue, count, after)
                if count < 0:
                    return JOINED
    return CUT_OFF
