"""Deep Sea against a grid of its own, with its optimum, random play and what a greedy learner gets, all exact."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.checks import check_puzzle
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.deep_sea import DeepSeaConfig, DeepSeaPuzzle


@given(st.integers(2, 20), st.data())
def test_presses_do_what_bsuites_moves_do(size, data):
    puzzle = DeepSeaPuzzle(size)
    mapping = np.random.RandomState(42).binomial(1, 0.5, [size, size])
    state, row, column, over = puzzle.make_state(), 0, 0, False
    for action in data.draw(st.lists(st.integers(0, 1), min_size=size, max_size=size)):
        before, contacts = state, Contacts((action,))
        state = puzzle.update(state, contacts)
        right = action == mapping[row, column]
        reward = (column == size - 1 and right) - 0.01 / size * right
        over = bool(column == size - 1 and right)
        column = min(column + 1, size - 1) if right else max(column - 1, 0)
        row += 1
        assert puzzle.compute_reward(before, state, contacts) == pytest.approx(reward)
        assert puzzle.is_solved(state) == over
        assert puzzle.is_failed(state) == (row == size and not over)
        seen = puzzle.observe(state)
        assert seen[size:].index(1.0) == column and (row == size or seen[:size].index(1.0) == row)
        assert puzzle.is_state(state)
    assert puzzle.update(state, Contacts((0, 1))) == state


@pytest.mark.parametrize("size", [2, 10, 20, 50])
def test_the_best_return_is_0_99_and_random_presses_escape_once_in_2_to_the_n(size):
    puzzle = DeepSeaConfig(size=size).make_puzzle(np.random.default_rng(0))
    best: dict[int, float] = {}
    chance: dict[int, float] = {}
    states = [state for state in range((size + 1) << 6) if puzzle.is_state(state)]
    for state in sorted(states, reverse=True):
        if puzzle.is_failed(state):
            best[state], chance[state] = 0.0, 0.0
            continue
        returns, escapes = [], []
        for action in range(2):
            contacts = Contacts((action,))
            after = puzzle.update(state, contacts)
            solved = puzzle.is_solved(after)
            returns.append(puzzle.compute_reward(state, after, contacts) + (0.0 if solved else best[after]))
            escapes.append(1.0 if solved else chance[after])
        best[state], chance[state] = max(returns), sum(escapes) / 2
    assert best[0] == pytest.approx(0.99)
    assert chance[0] == pytest.approx(2.0**-size)


def test_seas_keep_the_contract():
    check_puzzle(DeepSeaPuzzle(5), steps=100)
    assert len({DeepSeaPuzzle(6, seed).rights for seed in range(20)}) == 20
