"""Exact solvers against sums that need no solver."""

from __future__ import annotations

import numpy as np
import pytest

from tests.classic.catalogue import ENVIRONMENTS
from tests.classic.chain import Chain
from tests.classic.exact import (
    NestedTask,
    TabularOption,
    compute_choice_values,
    count_primitives,
    evaluate,
    find_greedy_policy,
    find_polled_policy,
    find_recursive_optimum,
    find_values,
    make_model,
    make_option_model,
    make_policy_matrix,
    make_primitive_options,
    model_option,
)
from tests.classic.four_rooms import HALLWAYS, NORTH_HALLWAY, WEST_HALLWAY, FourRooms, make_hallway_options


def unroll(tables, policy, gamma, steps=3_000):
    """Values of a policy as a sum over time."""
    values = np.zeros(len(tables.rewards))
    for _ in range(steps):
        values = (policy * (tables.rewards + gamma * tables.continuing @ values)).sum(axis=1)
    return values


def unroll_option(tables, option, gamma, steps=500):
    """Reward and discounted ends of an option as sums over time, from each of its first states."""
    rewards = (option.policy * tables.rewards).sum(axis=1)
    follow = gamma * np.einsum("sa,sat->st", option.policy, tables.continuing)
    alive = np.eye(len(rewards))
    total, ends = np.zeros(len(rewards)), np.zeros_like(follow)
    for _ in range(steps):
        total += alive @ rewards
        arrived = alive @ follow
        ends += arrived * option.termination
        alive = arrived * (1 - option.termination)
    return total, ends


@pytest.mark.parametrize("name", ["four-rooms-direction", "chain",
                                  pytest.param("taxi-noisy-fickle", marks=pytest.mark.slow)])
def test_a_linear_solve_is_the_sum_over_time(name):
    tables = ENVIRONMENTS[name]().make_tables()
    policy = np.random.default_rng(0).dirichlet(np.ones(tables.rewards.shape[1]), len(tables.rewards))
    np.testing.assert_allclose(evaluate(make_model(tables, 0.95), policy), unroll(tables, policy, 0.95, 800), atol=1e-9)


@pytest.mark.parametrize("name", sorted(set(ENVIRONMENTS) - {"chain-position", "key-door-aliased"}))
def test_optimal_values_are_those_of_their_greedy_policy_and_no_choice_improves_them(name):
    model = make_model(ENVIRONMENTS[name]().make_tables(), 0.97)
    values = find_values(model)
    policy = make_policy_matrix(find_greedy_policy(model, values), model.rewards.shape[1])
    np.testing.assert_allclose(evaluate(model, policy), values, atol=1e-8)
    assert (compute_choice_values(model, values) <= values[:, None] + 1e-9).all()


def test_sweeps_are_synchronous():
    tables = FourRooms(slip="none").make_tables()
    model = make_model(tables, 0.9)
    values = np.zeros(104)
    for sweeps in range(1, 6):
        values = compute_choice_values(model, values).max(axis=1)
        np.testing.assert_array_equal(find_values(model, sweeps=sweeps), values)


def test_primitive_options_are_the_primitives():
    tables = FourRooms().make_tables()
    model, options = make_model(tables, 0.9), make_option_model(tables, make_primitive_options(104, 4), 0.9)
    np.testing.assert_allclose(options.rewards, model.rewards, atol=1e-12)
    np.testing.assert_allclose(options.follow, model.follow, atol=1e-12)


@pytest.mark.parametrize("slip", ["none", "extra", "neighbour", "direction"])
def test_option_models_are_sums_over_time(slip):
    tables = FourRooms(slip=slip).make_tables()
    for option in make_hallway_options(slip)[::3]:
        rewards, follow = model_option(tables, option, 0.9)
        total, ends = unroll_option(tables, option, 0.9)
        np.testing.assert_allclose(rewards, total, atol=1e-9)
        np.testing.assert_allclose(follow, ends, atol=1e-9)


def test_options_that_stop_by_chance_are_sums_over_time():
    tables = Chain().make_tables()
    rng = np.random.default_rng(1)
    option = TabularOption("any", np.ones(12, bool), rng.dirichlet([1, 1], 12), rng.random(12))
    rewards, follow = model_option(tables, option, 0.9)
    total, ends = unroll_option(tables, option, 0.9)
    np.testing.assert_allclose(rewards, total, atol=1e-12)
    np.testing.assert_allclose(follow, ends, atol=1e-12)


def test_durations_of_options_are_means_of_runs():
    tables = count_primitives(FourRooms(None).make_tables())
    option = make_hallway_options()[0]
    expected, follow = model_option(tables, option, 1.0)
    env = FourRooms(None, horizon=None)
    env.reset(seed=0)
    start = int(np.flatnonzero(option.initiation)[0])
    durations, ends = [], np.zeros(104)
    for _ in range(4_000):
        env.set_state(env.get_state()._replace(number=start, elapsed=0))
        while True:
            state, *_ = env.step(int(option.policy[env.get_state().number].argmax()))
            if option.termination[state]:
                break
        durations.append(env.get_state().elapsed)
        ends[state] += 1
    assert np.mean(durations) == pytest.approx(expected[start], abs=4 * np.std(durations) / np.sqrt(4_000))
    np.testing.assert_allclose(ends / 4_000, follow[start], atol=0.03)


@pytest.mark.parametrize("depth", [1, 2, 4])
def test_a_chain_of_one_child_tasks_is_the_flat_problem(depth):
    tables = FourRooms().make_tables()
    never = np.zeros(104, bool)
    task = NestedTask("0", range(4), never)
    for level in range(1, depth):
        task = NestedTask(str(level), [task], never)
    solution = find_recursive_optimum(tables, task, 0.9)
    flat = make_model(tables, 0.9)
    np.testing.assert_allclose(solution.values[task.name], find_values(flat), atol=1e-9)
    np.testing.assert_array_equal(find_polled_policy(task, solution), find_greedy_policy(flat, find_values(flat)))


def test_pseudo_rewards_change_what_a_task_does_but_not_its_value_in_the_environment():
    tables = count_primitives(FourRooms(None, slip="none").make_tables(), price=-1.0)
    hallways = np.isin(np.arange(104), HALLWAYS)
    start = 0  # cell (1, 1)
    pseudo = np.where(np.arange(104) == NORTH_HALLWAY, 50.0, -100.0)
    plain = find_recursive_optimum(tables, NestedTask("out", range(4), hallways), 1.0)
    paid = find_recursive_optimum(tables, NestedTask("out", range(4), hallways, pseudo), 1.0)
    assert plain.follow["out"][start, WEST_HALLWAY] == pytest.approx(1)  # it is 6 moves away
    assert plain.values["out"][start] == pytest.approx(-6)
    assert paid.follow["out"][start, NORTH_HALLWAY] == pytest.approx(1)  # it is 7 moves away
    assert paid.values["out"][start] == pytest.approx(-7)
