"""The chain of h-DQN: what the visited bit is worth."""

from __future__ import annotations

import numpy as np
import pytest

from tests.classic.chain import FIRST, LAST, LEFT, LENGTH, RIGHT, START, Chain
from tests.classic.exact import evaluate, find_values, make_model, make_policy_matrix, make_uniform_policy
from tests.classic.tabular import State

VISITED = LENGTH
"""Added to a position once the last one was visited."""


@pytest.fixture(scope="module")
def tables():
    return Chain().make_tables()


@pytest.mark.parametrize("gamma, optimum", [(1.0, 0.20800), (0.99, 0.18532), (0.975, 0.15622), (0.95, 0.11819)])
def test_the_optimum(tables, gamma, optimum):
    assert find_values(make_model(tables, gamma)) @ tables.starts == pytest.approx(optimum, abs=5e-6)


def test_the_optimum_is_that_of_the_gambler(tables):
    """From the second position a fair walk comes to the last before the first once in five times."""
    assert find_values(make_model(tables, 1.0))[START] == pytest.approx(1 / 5 + 4 / 5 * 0.01, abs=1e-9)


def test_the_random_walk_earns_little_more_than_the_way_straight_back(tables):
    model = make_model(tables, 1.0)
    assert evaluate(model, make_uniform_policy(model)) @ tables.starts == pytest.approx(0.01818, abs=5e-6)
    left = make_policy_matrix(np.full(2 * LENGTH, LEFT), 2)
    assert evaluate(model, left) @ tables.starts == pytest.approx(0.01)


def find_best_without_bit(tables, gamma):
    """The best of all 64 policies of the position alone."""
    model = make_model(tables, gamma)
    policies = [[(number >> position) & 1 for position in range(LENGTH)] * 2 for number in range(2**LENGTH)]
    return max(evaluate(model, make_policy_matrix(np.array(policy), 2)) @ tables.starts for policy in policies)


def test_always_right_is_optimal_undiscounted_so_acting_well_needs_no_visited_bit(tables):
    model = make_model(tables, 1.0)
    right = make_policy_matrix(np.full(2 * LENGTH, RIGHT), 2)
    assert evaluate(model, right) @ tables.starts == pytest.approx(0.208)
    assert find_best_without_bit(tables, 1.0) == pytest.approx(find_values(model) @ tables.starts)


@pytest.mark.parametrize("gamma", [0.99, 0.95])
def test_discounted_the_bit_is_worth_the_quick_way_back(tables, gamma):
    optimum = find_values(make_model(tables, gamma)) @ tables.starts
    assert 0.01 < find_best_without_bit(tables, gamma) < optimum - 0.005


def test_the_value_of_a_position_depends_on_the_bit(tables):
    """A learner that sees positions alone backs up values of two states as one."""
    values = find_values(make_model(tables, 1.0))
    assert (values[FIRST + 1 + VISITED : LAST + VISITED] > 0.99).all()
    assert (values[FIRST + 1 : LAST] < 0.85).all()


def test_the_last_position_is_left_at_once_and_sets_the_bit():
    env = Chain(visited=True)
    env.reset(seed=0)
    for action in (LEFT, RIGHT):
        env.set_state(State(LAST + VISITED))
        assert env.step(action)[0] == LAST - 1 + VISITED
    assert {outcome.next_state for outcome in env.outcomes(LAST - 1, RIGHT)} == {LAST - 2, LAST + VISITED}


def test_the_reward_depends_on_the_bit_alone():
    env = Chain()
    assert env.outcomes(FIRST + 1, LEFT)[0].reward == 0.01
    assert env.outcomes(FIRST + 1 + VISITED, LEFT)[0].reward == 1.0


def test_the_position_alone_hides_the_bit():
    env = Chain(visited=False)
    assert env.observation_space.n == LENGTH
    assert env.observe(3) == env.observe(3 + VISITED) == 3
