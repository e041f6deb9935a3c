"""Exploring policies: exact probabilities, nothing illegal, streams of one's own."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import special

from hrl_escape.agents.components.exploration import (
    ExplorationSettings,
    OrnsteinUhlenbeck,
    compute_choice_entropy,
    compute_epsilon,
    compute_epsilon_greedy,
    compute_exploration,
    compute_exploration_entropy,
    compute_policy,
    make_rng,
    measure_conduct,
    sample_action,
    sample_index,
)

KINDS = st.sampled_from(["epsilon-greedy", "boltzmann"])
VALUES = hnp.arrays(np.float64, 6, elements=st.floats(-1e6, 1e6))
MASKS = hnp.arrays(np.bool_, 6).filter(lambda mask: mask.any())


@pytest.mark.nightly
@given(values=VALUES, mask=MASKS, kind=KINDS, steps=st.integers(0, 10_000), seed=st.integers(0, 99))
def test_trap_11_exploration_never_draws_an_illegal_action(values, mask, kind, steps, seed):
    settings = ExplorationSettings(exploration=kind)
    rng = np.random.default_rng(seed)
    assert all(mask[sample_action(values, mask, settings, steps, rng)] for _ in range(20))


@given(values=VALUES, mask=MASKS, kind=KINDS, steps=st.integers(0, 10_000))
def test_probabilities_are_zero_where_illegal_and_sum_to_one(values, mask, kind, steps):
    policy = compute_policy(values, mask, ExplorationSettings(exploration=kind), steps)
    assert (policy[~mask] == 0).all() and (policy >= 0).all()
    assert policy.sum() == pytest.approx(1)


@given(values=VALUES, mask=MASKS, kind=KINDS, steps=st.integers(0, 10_000))
def test_entropy_is_that_of_scipy(values, mask, kind, steps):
    settings = ExplorationSettings(exploration=kind, epsilon_end=0.0)
    policy = compute_policy(values, mask, settings, steps)
    assert compute_choice_entropy(policy) == pytest.approx(special.entr(policy).sum(), abs=1e-12)
    assert compute_exploration_entropy(values, mask, settings, steps) == pytest.approx(
        special.entr(policy).sum(), abs=1e-12)


def test_the_best_of_options_is_chosen_but_for_epsilon():
    """Any may be drawn then, the best among them; of equals the first is the best."""
    policy = compute_epsilon_greedy(np.array([1.0, 3.0, 2.0, 3.0]), 0.2)
    assert policy == pytest.approx([0.05, 0.85, 0.05, 0.05])
    assert compute_epsilon_greedy(np.array([1.0, 3.0]), 0.0).tolist() == [0.0, 1.0]


def test_epsilon_greedy_probabilities_by_hand():
    settings = ExplorationSettings(epsilon_start=0.3, epsilon_end=0.3)
    values, mask = np.array([[5.0, 9.0, 1.0, 7.0]]), np.array([[True, False, True, True]])
    assert compute_policy(values, mask, settings, 0)[0] == pytest.approx([0.1, 0, 0.1, 0.8])


def test_boltzmann_probabilities_by_hand():
    settings = ExplorationSettings(exploration="boltzmann", temperature=2.0)
    values, mask = np.array([2.0, 100.0, 0.0]), np.array([True, False, True])
    e = np.exp(1.0)
    assert compute_policy(values, mask, settings, 0) == pytest.approx([e / (e + 1), 0, 1 / (e + 1)])


@given(
    values=VALUES,
    mask=MASKS,
    temperature=st.floats(0.01, 1e3),
    shift=st.sampled_from([0.0, 1e4, -1e4]),
)
def test_boltzmann_is_the_exact_softmax_however_large_the_values(values, mask, temperature, shift):
    settings = ExplorationSettings(exploration="boltzmann", temperature=temperature)
    policy = compute_policy(values + shift, mask, settings, 0)
    expected = special.softmax(np.where(mask, (values + shift) / temperature, -np.inf))
    assert policy == pytest.approx(expected, rel=1e-9, abs=1e-300)


def test_boltzmann_with_keras_rls_clip_cannot_tell_values_beyond_it_apart():
    values, mask = np.array([-900.0, 600.0, 700.0]), np.ones(3, np.bool_)
    clipped, exact = (
        compute_policy(values, mask, ExplorationSettings(exploration="boltzmann", boltzmann_clip=clip), 0)
        for clip in (500.0, 0.0)
    )
    assert clipped == pytest.approx([0, 0.5, 0.5])
    assert exact == pytest.approx([0, 0, 1])


@pytest.mark.nightly_for("boltzmann")
@pytest.mark.parametrize("kind", ["epsilon-greedy", "boltzmann"])
def test_samples_follow_the_probabilities(kind):
    settings = ExplorationSettings(exploration=kind, epsilon_start=0.5, epsilon_end=0.5)
    values, mask = np.array([0.3, 1.0, -0.4, 0.9]), np.array([True, True, False, True])
    rng = np.random.default_rng(0)
    counts = np.bincount([sample_action(values, mask, settings, 0, rng) for _ in range(20_000)], minlength=4)
    # Five standard deviations of a binomial share over 20,000 draws are at most 0.018.
    assert counts / 20_000 == pytest.approx(compute_policy(values, mask, settings, 0), abs=0.018)


def test_epsilon_falls_linearly_and_stays():
    settings = ExplorationSettings(epsilon_start=1.0, epsilon_end=0.2, epsilon_steps=100)
    assert [compute_epsilon(settings, steps) for steps in (0, 50, 100, 10_000)] == pytest.approx([1, 0.6, 0.2, 0.2])


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8).filter(lambda weights: sum(weights) > 0), st.integers(0, 999))
def test_an_index_of_probability_zero_is_never_drawn(weights, seed):
    probabilities = np.array(weights)
    assert probabilities[sample_index(probabilities, np.random.default_rng(seed))] > 0


def test_ornstein_uhlenbeck_noise_has_its_stationary_variance():
    noise, rng = OrnsteinUhlenbeck(2_000, theta=0.15, sigma=0.3, dt=0.1), np.random.default_rng(0)
    for _ in range(600):
        state = noise.sample(rng)
    # x' = (1 - theta dt) x + sigma sqrt(dt) n has variance sigma^2 dt / (1 - (1 - theta dt)^2).
    assert state.var() == pytest.approx(0.3**2 * 0.1 / (1 - (1 - 0.015) ** 2), rel=0.2)


def test_streams_of_one_seed_differ_and_repeat():
    assert make_rng(3, "actions").random() == make_rng(3, "actions").random()
    assert make_rng(3, "actions").random() != make_rng(3, "replay").random()


@pytest.mark.parametrize("library", [np, torch])
def test_conduct_is_the_same_for_each_row_alone_and_absent_without_rows(library):
    values, mask = np.float32([[1.0, 3.0, 2.0], [0.0, 5.0, 1.0]]), np.array([[True, True, False], [True, False, True]])
    make = np.asarray if library is np else torch.as_tensor
    policy, action = compute_exploration(make(values), make(mask), epsilon=0.2), make(np.array([1, 0]))
    both = measure_conduct(policy, make(values), make(mask), action)
    alone = [measure_conduct(policy[n : n + 1], make(values)[n : n + 1], make(mask)[n : n + 1], action[n : n + 1])
             for n in range(2)]
    assert both["greedy"] == 0.5 and both["entropy"] == pytest.approx(-0.9 * np.log(0.9) - 0.1 * np.log(0.1))
    assert both == pytest.approx({name: (alone[0][name] + alone[1][name]) / 2 for name in both})
    assert measure_conduct(policy[:0], make(values)[:0], make(mask)[:0], action[:0]) == {}
