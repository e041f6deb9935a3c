"""Every textbook environment keeps the contract of Gymnasium, and samples from its tables."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy.stats import chisquare

from tests.classic.catalogue import ENVIRONMENTS
from tests.classic.tabular import State

every_environment = pytest.mark.parametrize("name", ENVIRONMENTS)


def walk(env, seed, steps):
    """Observations, rewards and ends of a random walk that starts anew after each end."""
    rng = np.random.default_rng(seed)
    seen = [env.reset(seed=seed)]
    for _ in range(steps):
        seen.append(env.step(int(rng.integers(env.actions))))
        if seen[-1][2] or seen[-1][3]:
            seen.append(env.reset())
    return seen


@every_environment
def test_environments_satisfy_gymnasium(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # only errors count: no render modes, no spec
        check_env(ENVIRONMENTS[name](), skip_render_check=True)


@every_environment
def test_probabilities_sum_to_one_and_ends_are_a_part_of_them(name):
    tables = ENVIRONMENTS[name]().make_tables()
    np.testing.assert_allclose(tables.probability.sum(axis=2), 1)
    assert (tables.ending >= 0).all() and (tables.continuing >= 0).all()
    assert tables.starts.sum() == pytest.approx(1)


@every_environment
def test_steps_are_drawn_from_the_tables(name):
    env = ENVIRONMENTS[name]()
    tables = env.make_tables()
    rng = np.random.default_rng(0)
    env.reset(seed=1)
    branching = np.argwhere((tables.probability > 0).sum(axis=2) > 1)
    pairs = np.argwhere(np.ones(tables.rewards.shape)) if not len(branching) else branching
    draws = 1 if not len(branching) else 1_000
    for state, action in rng.permutation(pairs)[: 300 if draws == 1 else 25]:
        counts, ends, paid = np.zeros(env.states), np.zeros(env.states), []
        for _ in range(draws):
            env.set_state(State(int(state)))
            _, reward, terminated, _, info = env.step(int(action))
            counts[info["state"]] += 1
            ends[info["state"]] += terminated
            paid.append(reward)
        possible = tables.probability[state, action] > 0
        assert counts[~possible].sum() == 0
        np.testing.assert_array_equal(ends > 0, (tables.ending[state, action] > 0) & (counts > 0))
        assert abs(np.mean(paid) - tables.rewards[state, action]) < 5 * (np.std(paid) + 1e-9) / np.sqrt(draws) + 1e-9
        if draws > 1:
            expected = tables.probability[state, action, possible] * draws
            assert chisquare(counts[possible], expected).pvalue > 1e-5


@every_environment
def test_first_states_are_drawn_from_the_tables(name):
    env = ENVIRONMENTS[name]()
    starts = env.make_tables().starts
    env.reset(seed=2)
    counts = np.bincount([env.reset()[1]["state"] for _ in range(5_000)], minlength=env.states)
    assert counts[starts == 0].sum() == 0
    if (starts > 0).sum() > 1:
        assert chisquare(counts[starts > 0], starts[starts > 0] * 5_000).pvalue > 1e-5


@every_environment
def test_a_seed_gives_one_walk(name):
    first, second, other = (walk(ENVIRONMENTS[name](horizon=50), seed, 300) for seed in (3, 3, 4))
    assert first == second
    assert first != other


@every_environment
def test_observations_lie_in_their_space_and_agree_with_the_state(name):
    env = ENVIRONMENTS[name](horizon=50)
    for observation, *_, info in walk(env, 5, 300):
        assert observation in env.observation_space
        assert observation == env.observe(info["state"])


@every_environment
def test_the_horizon_truncates_in_the_state_reached(name):
    env = ENVIRONMENTS[name](horizon=1)
    tables = env.make_tables()
    for seed in range(10):
        _, info = env.reset(seed=seed)
        first, action = info["state"], seed % env.actions
        observation, _, terminated, truncated, info = env.step(action)
        assert truncated != terminated
        assert tables.probability[first, action, info["state"]] > 0
        assert observation == env.observe(info["state"])


@every_environment
def test_a_restored_state_continues_alike(name):
    env = ENVIRONMENTS[name](horizon=20)
    env.reset(seed=6)
    env.step(0)
    saved, generator = env.get_state(), env.np_random.bit_generator.state
    taken = [env.step(action % env.actions)[:4] for action in range(5)]
    env.set_state(saved)
    env.np_random.bit_generator.state = generator
    assert [env.step(action % env.actions)[:4] for action in range(5)] == taken


@every_environment
def test_terminal_states_end_at_once_without_reward(name):
    tables = ENVIRONMENTS[name]().make_tables()
    terminal = np.flatnonzero((tables.ending.sum(axis=2) == 1).all(axis=1))
    assert (tables.rewards[terminal] == 0).all()
    if not name.startswith("taxi"):  # where a delivery ends in a state that others start from
        arrived = np.flatnonzero(tables.ending.sum(axis=(0, 1)))
        np.testing.assert_array_equal(arrived, terminal)
        assert tables.continuing[:, :, terminal].sum() == 0
