"""Slow, near-exact reference for the fewest primitives, as a yardstick for planners.

A* over primitives on exact poses in bins of 5 cm, with the straight line as the only, admissible
bound: no field, no grid of clearances, no corridor. It shares nothing with `a_star.py` but the
room's own geometry, and its plans are checked by replay. (Bins of 2.5 cm changed the mean over 200
queries from 15.83 to 15.82 primitives.) For body presses, the exit, regions and places; not for
presses by hand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint, stack_footprints
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.errors import UnsupportedError
from hrl_escape.floor.sweeps import compile_geometry
from hrl_escape.kernels import kernel, kernel_part
from hrl_escape.planning.goals import Goal, PressGoal, is_reached

__all__ = ["find_fewest_primitives"]

_first_contact, _distance = compile_geometry()
BIN_SIZE = 0.05


def find_fewest_primitives(kinematics: Kinematics, state: RoomState, goal: Goal, area: Footprint, reach: float,
                           bins: float = BIN_SIZE, most: int = 20_000_000) -> tuple[int, ...] | None:
    """Search for a plan with the fewest primitives, from a heading on the lattice.

    Args:
        kinematics: the room's kinematics, without noise and slip.
        state: first state; the goal must not be reached or touched there.
        goal: the goal.
        area: footprint of the goal.
        reach: largest distance from it that reaches the goal, m.
        bins: poses closer than this count as one, m.
        most: give up beyond this many poses.

    Returns:
        The primitives, or None if none were found.

    Raises:
        UnsupportedError: the base is not a disc.
    """
    instance = kinematics.instance
    if not instance.robot.base.turns_anywhere:
        raise UnsupportedError(f"the reference search moves a disc, and this base is a {instance.robot.footprint}")
    solids = list(kinematics.footprints)
    if instance.door and not instance.puzzle.is_solved(state.puzzle):
        solids.append(instance.door.footprint)
    angles = kinematics.turn_step * np.arange(kinematics.headings)
    cos, sin = np.round([np.cos(angles), np.sin(angles)], 15)
    moves = kinematics.actions.compute_moves(cos, sin)
    half = np.array([instance.reach_x, instance.reach_y])
    shut = [target.footprint for i, target in enumerate(instance.targets) if i != getattr(goal, "target", -1)]
    touch = instance.robot.outer_radius + instance.dynamics.press_margin if isinstance(goal, PressGoal) else -1.0
    symmetry = kinematics.actions.symmetry
    folds = kinematics.headings // (symmetry if kinematics.headings % symmetry == 0 else 1)
    chain = _search_compiled(
        stack_footprints(solids), instance.robot.outer_radius + 1e-3, moves, half, bins, folds,
        stack_footprints([area])[0], reach + 1e-12, stack_footprints(shut), touch,
        state.x, state.y, state.heading_steps, most, kinematics.actions.turn_steps, kinematics.actions.longest,
    )
    if not len(chain):
        return None
    states = [state]
    for action in chain:
        states.append(kinematics.step(states[-1], int(action)).state)
    assert is_reached(goal, states[-2], states[-1], kinematics), "the reference must be a true plan"
    return tuple(int(action) for action in chain)


@kernel_part
def _shape(row):
    return row[0] > 0.5, row[1], row[2], row[3], row[4], row[5], row[6]


@kernel
def _search_compiled(solids: NDArray, radius: float, moves: NDArray, half: NDArray, bins: float, folds: int,
                     area: NDArray, reach: float, shunned: NDArray, touch: float, x: float, y: float, heading: int,
                     most: int, turns: NDArray, step: float) -> NDArray:
    headings, translations = moves.shape[0], moves.shape[1]
    goal = _shape(area)
    columns, rows = int(2 * half[0] / bins) + 3, int(2 * half[1] / bins) + 3
    seen = np.full(columns * rows * folds, 30_000, dtype=np.int16)
    size = 1 << 16
    place, fact = np.empty((size, 2)), np.empty((size, 4), dtype=np.int32)  # facts: heading, parent, action, next
    heads = np.full(20_000, -1, dtype=np.int64)
    place[0, 0], place[0, 1], fact[0, 0], fact[0, 1], fact[0, 2], fact[0, 3] = x, y, heading, -1, -1, -1
    cost = np.zeros(size, dtype=np.int16)
    used, level = 1, 0
    heads[0] = 0
    while level < 20_000:
        node = heads[level]
        if node < 0:
            level += 1
            continue
        heads[level] = fact[node, 3]
        if fact[node, 2] >= 100:  # a goal
            length = cost[node]
            chain = np.empty(length, dtype=np.int32)
            for k in range(length - 1, -1, -1):
                chain[k] = fact[node, 2] % 100
                node = fact[node, 1]
            return chain
        x, y, heading = place[node, 0], place[node, 1], fact[node, 0]
        for action in range(translations + turns.shape[0]):
            to_x, to_y, to_heading = x, y, heading
            if action < translations:
                dx, dy = moves[heading, action, 0], moves[heading, action, 1]
                share = 1.0
                for k in range(solids.shape[0]):
                    row = solids[k]
                    around = radius + step + row[5] + row[6]
                    if abs(x - row[1]) <= around and abs(y - row[2]) <= around:
                        share = min(share, _first_contact(x, y, dx, dy, radius, _shape(row)))
                if share < 1.0:
                    dx, dy = share * dx, share * dy
                to_x, to_y = x + dx, y + dy
            else:
                to_heading = (heading + headings + turns[action - translations]) % headings
            bad = False
            for k in range(shunned.shape[0]):
                bad = bad or _distance(to_x, to_y, _shape(shunned[k])) <= touch
            i, j = int((to_x + half[0]) / bins) + 1, int((to_y + half[1]) / bins) + 1
            if bad or not (0 <= i < columns and 0 <= j < rows):
                continue
            away = _distance(to_x, to_y, goal)
            won = away <= reach
            spent = cost[node] + 1
            key = (i * rows + j) * folds + to_heading % folds
            if not won:
                if seen[key] <= spent:
                    continue
                seen[key] = spent
            if used == size:
                if size >= most:
                    return np.empty(0, dtype=np.int32)
                size *= 2
                wider, longer, dearer = np.empty((size, 2)), np.empty((size, 4), np.int32), np.empty(size, np.int16)
                wider[:used], longer[:used], dearer[:used] = place, fact, cost
                place, fact, cost = wider, longer, dearer
            estimate = spent + (0 if won else int(np.ceil((away - reach) / step - 1e-9)))
            place[used, 0], place[used, 1], cost[used] = to_x, to_y, spent
            fact[used, 0], fact[used, 1] = to_heading, node
            fact[used, 2], fact[used, 3] = action + (100 if won else 0), heads[estimate]
            heads[estimate] = used
            used += 1
    return np.empty(0, dtype=np.int32)
