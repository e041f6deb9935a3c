"""Taxi: its four dynamics, their optima, and what its task graph costs."""

from __future__ import annotations

from functools import cache

import gymnasium
import numpy as np
import pytest

from tests.classic.exact import (
    count_primitives,
    evaluate,
    find_greedy_policy,
    find_polled_policy,
    find_recursive_optimum,
    find_values,
    make_model,
    make_policy_matrix,
    make_uniform_policy,
)
from tests.classic.taxi import DEPOTS, IN_TAXI, JUST_PICKED_UP, PUT_DOWN, Ride, Taxi, decode, encode, make_task_graph

DYNAMICS = pytest.mark.parametrize("noisy", [False, True], ids=["certain", "noisy"])
PASSENGERS = pytest.mark.parametrize("fickle", [False, True], ids=["steady", "fickle"])


@cache
def solve(noisy, fickle, anywhere=False):
    tables = Taxi(noisy, fickle, anywhere).make_tables()
    return tables, find_values(make_model(tables, 1.0))


def test_numbers_and_states_correspond():
    states = [decode(number) for number in range(600)]
    assert len(set(states)) == 600
    assert [encode(ride) for ride in states] == list(range(600))


# --- dynamics --------------------------------------------------------------------------


def stack_gymnasium(rows):
    """Tables of Gymnasium's `P`: probabilities and expected rewards."""
    probability, rewards = np.zeros((500, 6, 500)), np.zeros((500, 6))
    for state in range(500):
        for action in range(6):
            for share, there, reward, _ in rows[state][action]:
                probability[state, action, there] += share
                rewards[state, action] += share * reward
    return probability, rewards


@DYNAMICS
def test_the_rules_are_those_of_gymnasium_where_they_agree_with_the_paper(noisy):
    theirs = stack_gymnasium(gymnasium.make("Taxi-v4", is_rainy=noisy).unwrapped.P)
    tables, _ = solve(noisy, False)
    same = np.isclose(tables.probability, theirs[0]).all(axis=2) & np.isclose(tables.rewards, theirs[1])
    differs = np.zeros((500, 6), bool)
    for number in range(500):
        ride = decode(number)
        depot = (ride.row, ride.column) in DEPOTS and (ride.row, ride.column) != DEPOTS[ride.destination]
        differs[number, PUT_DOWN] = ride.riding and depot  # set down elsewhere: legal there, illegal in the paper
        if noisy:  # no slip there where the intended way is blocked
            blocked = [theirs[0][number, action, number] > 0.99 for action in range(4)]
            slips = [(tables.probability[number, action, number] < 0.99) for action in range(4)]
            differs[number, :4] = np.logical_and(blocked, slips)
    np.testing.assert_array_equal(~same, differs)
    assert differs[:, PUT_DOWN].sum() == 4 * 3
    assert differs[:, :4].any() == noisy


def test_a_noisy_move_slips_to_both_sides():
    tables, _ = solve(True, False)
    north_from_middle = tables.probability[encode(Ride(2, 2, 0, 1)), 1]
    expected = {(1, 2): 0.8, (2, 1): 0.1, (2, 3): 0.1}
    for (row, column), share in expected.items():
        assert north_from_middle[encode(Ride(row, column, 0, 1))] == pytest.approx(share)


@DYNAMICS
def test_a_fickle_passenger_changes_once_on_the_first_step_away(noisy):
    tables, _ = solve(noisy, True)
    for row, column in DEPOTS:
        picked_up = encode(Ride(row, column, JUST_PICKED_UP, 0))
        for action in range(4):
            moved = tables.probability[picked_up, action]
            rides = {decode(int(there)): moved[there] for there in np.flatnonzero(moved)}
            stayed = sum(share for ride, share in rides.items() if (ride.row, ride.column) == (row, column))
            changed = sum(share for ride, share in rides.items() if ride.destination != 0)
            assert all(ride.passenger == IN_TAXI for ride in rides if (ride.row, ride.column) != (row, column))
            assert changed == pytest.approx(0.3 * (1 - stayed))
    settled = [number for number in range(600) if decode(number).passenger != JUST_PICKED_UP]
    destinations = np.array([decode(number).destination for number in range(600)])
    for number in settled:
        reached = tables.probability[number].sum(axis=0) > 0
        assert (destinations[reached] == destinations[number]).all()


# --- optima ----------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.parametrize(
    "noisy, anywhere, mean, least, most, steps",
    [
        (False, False, 7.93, 3, 15, 13.07),
        (False, True, 9.555, 3, 19, 11.445),
        (True, False, 3.9546, -2.895, 13.730, 17.045),
        (True, True, 6.1485, -2.895, 19, None),
    ],
)
def test_the_optimum_of_a_steady_passenger(noisy, anywhere, mean, least, most, steps):
    tables, values = solve(noisy, False, anywhere)
    first = values[tables.starts > 0]
    assert values @ tables.starts == pytest.approx(mean, abs=5e-5)
    assert (first.min(), first.max()) == (pytest.approx(least, abs=5e-4), pytest.approx(most, abs=5e-4))
    policy = make_policy_matrix(find_greedy_policy(make_model(tables, 1.0), values), 6)
    if steps is not None:
        counted = evaluate(make_model(count_primitives(tables), 1.0), policy) @ tables.starts
        assert counted == pytest.approx(steps, abs=5e-4)


@DYNAMICS
def test_the_random_walk_is_the_same_with_and_without_noise(noisy):
    tables, _ = solve(noisy, False)
    model = make_model(tables, 1.0)
    walk = make_uniform_policy(model)
    assert evaluate(model, walk) @ tables.starts == pytest.approx(-3353.7, abs=0.05)
    assert evaluate(make_model(count_primitives(tables), 1.0), walk) @ tables.starts == pytest.approx(848.2, abs=0.05)


@DYNAMICS
@PASSENGERS
def test_the_optimal_policy_earns_its_value_when_run(noisy, fickle):
    tables, values = solve(noisy, fickle)
    policy = find_greedy_policy(make_model(tables, 1.0), values)
    env = Taxi(noisy, fickle)
    env.reset(seed=0)
    returns = []
    for _ in range(3_000):
        state, total, over = env.reset()[0], 0.0, False
        while not over:
            state, reward, over, _, _ = env.step(int(policy[state]))
            total += reward
        returns.append(total)
    error = np.std(returns) / np.sqrt(len(returns))
    assert np.mean(returns) == pytest.approx(values @ tables.starts, abs=4 * error)


@DYNAMICS
def test_a_change_of_mind_costs_nothing_but_way(noisy):
    """With no change to come, the values are those of a steady passenger."""
    _, steady = solve(noisy, False)
    _, fickle = solve(noisy, True)
    riding = [number for number in range(500) if decode(number).passenger == IN_TAXI]
    np.testing.assert_allclose(fickle[riding], steady[riding], atol=1e-9)


# --- the price of the task graph -------------------------------------------------------


@pytest.mark.nightly
@DYNAMICS
def test_the_task_graph_costs_nothing_for_a_steady_passenger(noisy):
    tables, values = solve(noisy, False)
    solution = find_recursive_optimum(tables, make_task_graph(500), 1.0)
    np.testing.assert_allclose(solution.values["root"], values, atol=1e-8)


@pytest.mark.nightly
@DYNAMICS
def test_the_task_graph_costs_a_fickle_passenger_his_detour_which_polling_avoids(noisy):
    """A navigation once begun goes to its end, though the destination has changed."""
    tables, values = solve(noisy, True)
    root = make_task_graph(600)
    solution = find_recursive_optimum(tables, root, 1.0)
    nested = solution.values["root"] @ tables.starts
    model = make_model(tables, 1.0)
    polled = evaluate(model, make_policy_matrix(find_polled_policy(root, solution), 6)) @ tables.starts
    assert nested < values @ tables.starts - 2
    assert values @ tables.starts - 0.01 < polled < values @ tables.starts + 1e-9


@pytest.mark.nightly
@DYNAMICS
def test_the_nested_policy_earns_its_value_when_run_as_a_stack(noisy):
    tables, _ = solve(noisy, True)
    root = make_task_graph(600)
    solution = find_recursive_optimum(tables, root, 1.0)
    env = Taxi(noisy, fickle=True)
    env.reset(seed=1)
    returns = []
    for _ in range(2_000):
        (state, _), total, over, stack = env.reset(), 0.0, False, [root]
        while not over:
            while len(stack) > 1 and stack[-1].over[state]:
                stack.pop()
            child = stack[-1].children[solution.choices[stack[-1].name][state]]
            if isinstance(child, int):
                state, reward, over, _, _ = env.step(child)
                total += reward
                while any(task.over[state] for task in stack):
                    stack.pop()
            else:
                stack.append(child)
        returns.append(total)
    error = np.std(returns) / np.sqrt(len(returns))
    assert np.mean(returns) == pytest.approx(solution.values["root"] @ tables.starts, abs=4 * error)
