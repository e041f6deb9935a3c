"""The combination lock against the sequence of presses itself, and random presses against their exact expectation."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.checks import check_puzzle
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.codes import CodeLockConfig, CodeLockPuzzle
from hrl_escape.errors import ConfigError


@given(st.integers(2, 4), st.integers(1, 6), st.integers(0, 50), st.data())
def test_a_sliding_lock_opens_when_the_last_presses_are_the_code(digits, length, seed, data):
    puzzle = CodeLockConfig(digits=digits, length=length, memory="slide").make_puzzle(np.random.default_rng(seed))
    state, history = puzzle.make_state(), ()
    for digit in data.draw(st.lists(st.integers(0, digits - 1), max_size=40)):
        state, history = puzzle.update(state, Contacts((digit,))), (*history, digit)
        assert puzzle.is_solved(state) == (history[-length:] == puzzle.code)
        if puzzle.is_solved(state):
            break


@given(st.integers(0, 50), st.data())
def test_a_wrong_press_loses_everything_where_the_lock_resets(seed, data):
    puzzle = CodeLockConfig(digits=3, length=5).make_puzzle(np.random.default_rng(seed))
    state, entered = puzzle.make_state(), 0
    for digit in data.draw(st.lists(st.integers(0, 2), max_size=40)):
        state = puzzle.update(state, Contacts((digit,)))
        entered = 5 if entered == 5 else entered + 1 if puzzle.code[entered] == digit else 0
        assert state == entered
        assert puzzle.observe(state) == tuple(float(i < entered) for i in range(5))


@pytest.mark.parametrize(("digits", "length"), [(2, 3), (3, 4), (4, 5)])
def test_uniform_presses_need_as_many_as_the_closed_form_says(digits, length):
    """(k^(n + 1) - k) / (k - 1) presses on average, here by a linear system over the lock's own rule."""
    puzzle = CodeLockConfig(digits=digits, length=length).make_puzzle(np.random.default_rng(1))
    system = np.eye(length)
    for state, digit in itertools.product(range(length), range(digits)):
        after = puzzle.update(state, Contacts((digit,)))
        if after < length:
            system[state, after] -= 1 / digits
    expected = np.linalg.solve(system, np.ones(length))
    assert expected[0] == pytest.approx((digits ** (length + 1) - digits) / (digits - 1))


def test_a_hidden_lock_tells_nothing_until_it_is_open():
    puzzle = CodeLockPuzzle(3, (0, 1, 2), "reset", shown=False)
    assert {puzzle.observe(state) for state in range(3)} == {(0.0, 0.0, 0.0)}
    assert {puzzle.get_lit(state) for state in range(3)} == {(False,) * 3}
    assert puzzle.observe(3) == (1.0, 1.0, 1.0) and puzzle.get_lit(3) == (True,) * 3
    assert CodeLockPuzzle(3, (0, 1, 2)).get_lit(2) == (False, True, False)


@pytest.mark.parametrize("memory", ["reset", "slide"])
def test_locks_keep_the_contract(memory):
    check_puzzle(CodeLockConfig(digits=4, length=7, memory=memory).make_puzzle(np.random.default_rng(3)))


def test_codes_that_cannot_be_entered_are_refused():
    with pytest.raises(ConfigError, match="no digit twice in a row"):
        CodeLockPuzzle(3, (0, 1, 1))
    with pytest.raises(ConfigError, match="below puzzle.digits = 3"):
        CodeLockPuzzle(3, (0, 3))
