"""Expected escapes under noise and slip, against what probability says and what rooms really take."""

import dataclasses
import math

import numpy as np
import pytest

from hrl_escape.env.config import DynamicsConfig
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.noise import draw_episode
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.best_known import Replanner, compute_expected_escape, find_best_known


def make_room(**dynamics: float):
    config = get_preset("paper-two-button")
    return generate(dataclasses.replace(config, dynamics=DynamicsConfig(**dynamics)), seed=0)


def start(room):
    return Kinematics(room).make_state(room.starts[0])


@pytest.mark.nightly
def test_without_noise_the_expectation_is_the_best_known():
    room = make_room()
    best = find_best_known(room, start(room))
    expected = compute_expected_escape(room, start(room), rollouts=2)
    assert expected == (best.value, best.primitives)


@pytest.mark.nightly
def test_with_slip_alone_an_escape_takes_the_plan_s_length_over_the_chance_to_move():
    """A slip leaves the robot where the plan has it, so the length is negative binomial."""
    room, slip, rollouts = make_room(slip=0.2), 0.2, 200
    best = find_best_known(room, start(room)).primitives
    assert best is not None
    expected = compute_expected_escape(room, start(room), rollouts)
    error = math.sqrt(best * slip / rollouts) / (1 - slip)
    assert abs(expected.primitives - best / (1 - slip)) < 3 * error
    assert expected.value == pytest.approx(room.reward.exit - expected.primitives), "each primitive costs 1"


@pytest.mark.nightly
def test_the_expectation_is_what_the_planner_takes_with_other_noise():
    room, rollouts = make_room(noise=0.1, slip=0.05), 8
    expected, rules, lengths = compute_expected_escape(room, start(room), rollouts), Kinematics(room), []
    for number in range(rollouts):
        state, policy, terminated, length = start(room)._replace(noise_key=draw_episode(7, number, 1)[1]), \
            Replanner(room), False, 0
        while not terminated:
            primitive = policy.choose(state, length == 0)
            assert primitive is not None
            step = rules.step(state, primitive)
            state, terminated, length = step.state, step.terminated, length + 1
        lengths.append(length)
    error = np.std(lengths) * math.sqrt(2 / rollouts)
    assert np.std(lengths) > 0 and abs(np.mean(lengths) - expected.primitives) < 3 * error
    assert expected == compute_expected_escape(room, start(room), rollouts), "the same rollouts every time"


@pytest.mark.nightly
def test_hands_that_noise_leads_astray_press_one_button_after_the_other():
    """Where no joint plan says what comes next, the order of buttons is found anew after every press."""
    config = get_preset("arm-two-button")
    room = generate(dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, noise=0.1)), seed=0)
    best = find_best_known(room, start(room)).primitives
    assert best is not None
    assert compute_expected_escape(room, start(room), rollouts=2).primitives < 1.5 * best


@pytest.mark.nightly
def test_a_room_that_is_too_short_to_escape_counts_with_its_horizon():
    room = dataclasses.replace(make_room(slip=0.5), horizon=5)
    expected = compute_expected_escape(room, start(room), rollouts=3)
    assert expected.primitives == 5 and expected.value == 5 * room.reward.step
