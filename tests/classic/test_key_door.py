"""The key-and-door maze: its optimum by enumeration, and what its observations hide."""

from __future__ import annotations

import numpy as np
import pytest

from tests.classic.exact import find_fewest_primitives, find_values, make_model
from tests.classic.key_door import DOOR, GOAL, GRID, KEY, START, KeyDoor
from tests.classic.tabular import State


def search(start, goal, closed):
    """Moves from one cell to another, by breadth-first search; the door is a wall where it is closed."""
    distances, front = {start: 0}, [start]
    for cell in front:
        for there in GRID.list_neighbours(cell):
            if there not in distances and not (closed and there == DOOR):
                distances[there] = distances[cell] + 1
                front.append(there)
    return distances.get(goal)


def test_the_optimum_fetches_the_key_first():
    tables = KeyDoor().make_tables()
    steps = search(START, KEY, closed=True) + search(KEY, GOAL, closed=False)
    assert search(START, GOAL, closed=True) is None
    assert find_fewest_primitives(tables) @ tables.starts == pytest.approx(steps)
    assert find_values(make_model(tables, 1.0)) @ tables.starts == pytest.approx(500 - 0.1 * (steps - 1))


def test_the_door_opens_with_the_key_alone():
    env = KeyDoor()
    beside = GRID.move(DOOR, 2)
    assert env.outcomes(beside, 3)[0].next_state == beside
    assert env.outcomes(beside + len(GRID), 3)[0].next_state == DOOR + len(GRID)


def test_the_key_is_kept():
    tables = KeyDoor().make_tables()
    assert tables.probability[len(GRID) :, :, : len(GRID)].sum() == 0


def test_neighbours_alone_do_not_tell_what_to_do():
    """Some observation needs different moves before and after the key."""
    env = KeyDoor(aliased=True)
    model = make_model(env.make_tables(), 1.0)
    values = find_values(model)
    good = model.rewards + model.follow @ values >= values[:, None] - 1e-9
    state, path = START, []
    while state % len(GRID) != GOAL:
        path.append(state)
        state = env.outcomes(state, int(good[state].argmax()))[0].next_state
    seen = {env.observe(state) for state in path}
    assert len(seen) < len(path)
    assert any(not good[[state for state in path if env.observe(state) == o]].all(axis=0).any() for o in seen)


def test_a_closed_door_looks_like_a_wall():
    env = KeyDoor(aliased=True)
    beside = GRID.move(DOOR, 2)
    assert env.observe(beside) == env.observe(beside + len(GRID)) | 1 << 3
    env.reset(seed=0)
    env.set_state(State(beside))
    assert env.step(3)[0] == env.observe(beside)
    assert np.isin([env.observe(state) for state in range(env.states)], range(16)).all()
