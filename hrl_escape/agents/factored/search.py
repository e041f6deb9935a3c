"""Forward search in a compiled model: the best plan to an end of the task, or to an open outcome.

A* over (state, place), where a place is the action that was just done: outcomes depend on the state alone,
durations on the place. It maximises the discounted semi-Markov return with an upper bound as heuristic (Nilsson
1980; SMDP backup of Sutton, Precup and Singh 1999), so states that no plan needs are never enumerated. Importing
this module imports numba.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.factored.compiled_model import ActionModel
from hrl_escape.kernels import kernel

MOST_ACTIONS = 250
_EMPTY = np.uint64(0xFFFFFFFFFFFFFFFF)


class SearchTables(NamedTuple):
    """Models of all actions as arrays: rules and gaps sorted by action, the first of each action, bonuses of rules."""

    rules: NDArray[np.uint64]
    ends: NDArray[np.bool_]
    bonuses: NDArray[np.float64]
    rule_starts: NDArray[np.int64]
    gaps: NDArray[np.uint64]
    gap_starts: NDArray[np.int64]


class ModelPlan(NamedTuple):
    """Result of a search."""

    actions: tuple[int, ...]  # in order; empty if nothing was found
    states: tuple[int, ...]  # the packed state in which each action is to be taken
    value: float  # discounted return expected; -inf if nothing was found


def make_tables(models: Sequence[ActionModel]) -> SearchTables:
    """Arrays of the models of all actions."""
    rules = [rule for model in models for rule in model.rules]
    return SearchTables(
        np.array([rule[:5] for rule in rules], dtype=np.uint64).reshape(-1, 5),
        np.array([rule.over for rule in rules], dtype=np.bool_),
        np.array([rule.bonus for rule in rules], dtype=np.float64),
        np.cumsum([0, *(len(model.rules) for model in models)]),
        np.concatenate([model.gaps for model in models]),
        np.cumsum([0, *(len(model.gaps) for model in models)]),
    )


def find_plan(
    tables: SearchTables,
    state: int,
    legal: NDArray[np.bool_],
    repeatable: NDArray[np.bool_],
    relevant: NDArray[np.bool_],
    durations: NDArray[np.float64],
    places: NDArray[np.int64],
    rate: float,
    gamma: float,
    bonus: float,
    seek_gaps: bool,
    most_nodes: int,
) -> ModelPlan:
    """Search from a state.

    Args:
        tables: the model.
        state: packed.
        legal: bool (actions,), actions that may be the first.
        repeatable: bool (actions,), actions that may follow themselves.
        relevant: bool (actions,), actions that may be taken at all.
        durations: (actions + 1, actions), primitives from the place an action leaves; the last row: from here.
        places: (actions,), the row of `durations` that holds after each action.
        rate: usual reward of a primitive.
        gamma: discount per primitive.
        bonus: upper bound of a single bonus, 0 or more.
        seek_gaps: seek the soonest action with an open outcome, not the best known end.
        most_nodes: bound on expanded states.
    """
    found, actions, states, value = _search(*tables, np.uint64(state), legal, repeatable, relevant, durations, places,
                                            -1.0 if seek_gaps else rate, gamma, 0.0 if seek_gaps else bonus, seek_gaps,
                                            most_nodes)
    return ModelPlan(tuple(actions.tolist()), tuple(states.tolist()), float(value) if found else -np.inf)


@kernel
def _matches_any(patterns, start, stop, state):
    for i in range(start, stop):
        if state & patterns[i, 0] == patterns[i, 1]:
            return True
    return False


@kernel
def _find_slot(keys, key):
    """Slot of a key in an open-addressing table, or the free slot where it belongs."""
    mask = np.uint64(len(keys) - 1)
    slot = (key * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20) & mask
    while keys[slot] != _EMPTY and keys[slot] != key:
        slot = (slot + np.uint64(1)) & mask
    return slot


@kernel
def _search(rules, ends, bonuses, rule_starts, gaps, gap_starts, root, legal, repeatable, relevant, durations, places,
            rate, gamma, bonus, seek_gaps, most_nodes):  # fmt: skip
    actions = len(legal)
    size = 1024
    while size < 4 * most_nodes:
        size *= 2
    keys = np.full(size, _EMPTY, np.uint64)
    lows = np.empty(size)
    worst = min(rate, 0.0) / (1.0 - gamma) if gamma < 1.0 else -1e12
    room = 4096
    state_of, place_of = np.empty(room, np.uint64), np.empty(room, np.int64)
    gain_of, discount_of = np.empty(room), np.empty(room)
    parent_of, action_of = np.empty(room, np.int64), np.empty(room, np.int64)
    state_of[0], place_of[0], gain_of[0], discount_of[0], parent_of[0], action_of[0] = root, actions, 0.0, 1.0, -1, -1
    nodes, expanded, goal = 1, 0, -1
    heap = [(-bonus, 0)]
    while len(heap) > 0:
        _, node = heapq.heappop(heap)
        state, place, gain, discount = state_of[node], place_of[node], gain_of[node], discount_of[node]
        if place < 0:  # an end, popped with its exact value: nothing better is left
            goal = node
            break
        key = state << np.uint64(8) | np.uint64(place)
        slot = _find_slot(keys, key)
        low = gain + discount * worst
        if keys[slot] == key and low <= lows[slot] + 1e-9:
            continue
        if expanded >= most_nodes:
            break
        expanded += keys[slot] != key
        keys[slot], lows[slot] = key, low
        for action in range(actions):
            if not relevant[action] or (node == 0 and not legal[action]):
                continue
            if action == action_of[node] and not repeatable[action]:
                continue
            is_open = _matches_any(gaps, gap_starts[action], gap_starts[action + 1], state)
            if is_open and not seek_gaps:
                continue
            after, over, earned = state, False, 0.0
            if not is_open:
                for i in range(rule_starts[action], rule_starts[action + 1]):
                    if state & rules[i, 0] == rules[i, 1]:
                        after = (after & ~rules[i, 2] | rules[i, 3]) ^ rules[i, 4]
                        over = over or ends[i]
                        earned += bonuses[i]
                if over and seek_gaps or (after == state and not over):
                    continue
            k = durations[place, action]
            factor = gamma**k
            paid = rate * ((1.0 - factor) / (1.0 - gamma) if gamma < 1.0 else k)
            if not seek_gaps and not is_open:
                paid += factor / gamma * earned if gamma > 0.0 else (earned if k <= 1.0 else 0.0)
            if nodes == room:
                room *= 2
                state_of, place_of = _grow(state_of, room), _grow(place_of, room)
                gain_of, discount_of = _grow(gain_of, room), _grow(discount_of, room)
                parent_of, action_of = _grow(parent_of, room), _grow(action_of, room)
            state_of[nodes], gain_of[nodes], discount_of[nodes] = after, gain + discount * paid, discount * factor
            parent_of[nodes], action_of[nodes] = node, action
            value = gain_of[nodes]
            if over or is_open:
                place_of[nodes] = -1
            else:
                place_of[nodes] = places[action]
                value += discount_of[nodes] * bonus
            heapq.heappush(heap, (-value, nodes))
            nodes += 1
    length, node = 0, goal
    while node > 0:
        length, node = length + 1, parent_of[node]
    plan, states = np.empty(length, np.int64), np.empty(length, np.uint64)
    node = goal
    while node > 0:
        length -= 1
        plan[length], states[length] = action_of[node], state_of[parent_of[node]]
        node = parent_of[node]
    return goal >= 0, plan, states, gain_of[goal] if goal >= 0 else 0.0


@kernel
def _grow(array, room):
    grown = np.empty(room, array.dtype)
    grown[: len(array)] = array
    return grown
