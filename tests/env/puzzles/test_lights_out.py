"""Lights Out against a board of bools and against breadth-first search."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.checks import check_puzzle
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.lights_out import TASKS, LightsOutConfig, LightsOutPuzzle, find_fewest_presses
from hrl_escape.errors import ConfigError


def press_by_hand(board, light):
    row, column = divmod(light, board.shape[1])
    after = board.copy()
    for i, j in np.ndindex(board.shape):
        after[i, j] ^= abs(i - row) + abs(j - column) <= 1
    return after


@given(st.integers(1, 6), st.integers(1, 6), st.data())
def test_presses_flip_a_light_and_its_neighbours(rows, columns, data):
    puzzle = LightsOutConfig(rows=rows, columns=columns).make_puzzle(np.random.default_rng(0))
    state, board = puzzle.make_state(), np.zeros((rows, columns), dtype=bool)
    for light in data.draw(st.lists(st.integers(0, rows * columns - 1), max_size=20)):
        state, board = puzzle.update(state, Contacts((light,))), press_by_hand(board, light)
        assert puzzle.get_lit(state) == tuple(board.ravel())
        assert puzzle.is_solved(state) == board.all()


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (2, 2), (2, 3), (3, 3), (1, 5), (3, 4)])
def test_fewest_presses_are_those_of_breadth_first_search(rows, columns):
    """3 x 3 has one solution a pattern, 1 x 5 and 3 x 4... some have none or several."""
    count = rows * columns
    puzzle = LightsOutPuzzle(count, columns, 0, 0)
    distances, layer = {0: 0}, [0]
    for distance in itertools.count(1):
        layer = list({after for state in layer for light in range(count)
                      if (after := puzzle.update(state, Contacts((light,)))) not in distances})
        if not layer:
            break
        distances |= dict.fromkeys(layer, distance)
    for state in range(1 << count):
        presses = find_fewest_presses(count, columns, state)
        assert (presses is None) == (state not in distances)
        assert presses is None or presses.bit_count() == distances[state]


@pytest.mark.parametrize(("size", "fewest"), [((3, 3), [2, 5, 8, 9, 7]), ((4, 4), [4, 6, 6, 6, 7])])
def test_ogbenchs_tasks_take_the_fewest_presses_that_others_found(size, fewest):
    """Of its published start and goal patterns, solved by others with exact search."""
    found = []
    for task in range(1, len(TASKS[size]) + 1):
        puzzle = LightsOutConfig(rows=size[0], columns=size[1], task=task).make_puzzle(np.random.default_rng(0))
        presses = find_fewest_presses(puzzle.count, puzzle.columns, puzzle.start ^ puzzle.goal)
        assert presses is not None
        found.append(presses.bit_count())
    assert found == fewest


@pytest.mark.nightly_for("size2", "size3")
@pytest.mark.parametrize("size", TASKS)
def test_tasks_keep_the_contract(size):
    for task in (1, 5):
        check_puzzle(LightsOutConfig(rows=size[0], columns=size[1], task=task).make_puzzle(np.random.default_rng(0)))


def test_scrambled_goals_differ_by_instance_and_take_at_most_so_many_presses():
    goals = set()
    for seed in range(20):
        puzzle = LightsOutConfig(rows=4, columns=4, scramble=5).make_puzzle(np.random.default_rng(seed))
        presses = find_fewest_presses(16, 4, puzzle.goal)
        assert presses is not None and presses.bit_count() <= 5
        assert puzzle.observe(0)[16:] == tuple(float(puzzle.goal >> i & 1) for i in range(16)), "the goal is seen"
        goals.add(puzzle.goal)
    assert len(goals) > 15


def test_what_presses_cannot_reach_is_no_state_and_no_goal():
    puzzle = LightsOutConfig(rows=4, columns=4).make_puzzle(np.random.default_rng(0))
    assert puzzle.is_state(0) and not puzzle.is_state(1), "1 in 16 patterns can be reached"
    assert sum(puzzle.is_state(state) for state in range(2**16)) == 2**12
    with pytest.raises(ConfigError, match="puzzle.goal = 1"):
        LightsOutPuzzle(16, 4, 0, 1)
    with pytest.raises(ConfigError, match="3 x 3, 4 x 4"):
        LightsOutConfig(rows=2, columns=3, task=1)
    with pytest.raises(ConfigError, match="divisor"):
        LightsOutPuzzle(9, 2, 0, 0)


@pytest.mark.parametrize("scramble", [2, 5, 9])
def test_a_scrambled_board_needs_as_many_different_presses_as_were_drawn(scramble):
    """Of 3 x 3 lights every board has one set of presses; two equal ones would undo each other."""
    for seed in range(20):
        puzzle = LightsOutConfig(scramble=scramble).make_puzzle(np.random.default_rng(seed))
        presses = find_fewest_presses(puzzle.count, puzzle.columns, puzzle.start ^ puzzle.goal)
        assert presses is not None and presses.bit_count() == scramble
