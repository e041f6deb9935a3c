"""A step of an environment as a learner reads it: rewards, discounts, masks, ends."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.agents.agent import (
    LearningSettings,
    check_observation,
    compute_backup,
    make_transition,
    read_action_mask,
)
from hrl_escape.errors import DiscountMismatchError, StepContractError

MASK = np.ones(3, np.bool_)


def read(info, reward=0.0, terminated=False, truncated=False, gamma=0.9):
    return make_transition("s", 1, MASK, ("s'", reward, terminated, truncated, info), gamma)


def test_a_plain_gymnasium_step_is_a_transition_of_one_primitive():
    transition = read({}, reward=-2.5)
    assert (transition.reward, transition.summed_reward, transition.duration) == (-2.5, -2.5, 1)
    assert transition.discount == 0.9
    assert transition.next_action_mask.tolist() == [True, True, True]


def test_trap_1_an_option_of_k_primitives_at_minus_one_is_worth_the_geometric_sum():
    transition = read({"duration": 16, "rewards": [-1.0] * 16}, reward=-16.0, terminated=True)
    reward, bootstrap = compute_backup(transition, LearningSettings(gamma=0.9))
    assert reward == pytest.approx(-(1 - 0.9**16) / (1 - 0.9), abs=1e-12)
    assert bootstrap == 0
    assert transition.summed_reward == -16.0


def test_trap_3_a_cap_inside_an_option_counts_what_ran_and_still_bootstraps():
    transition = read({"duration": 5, "rewards": [-1.0] * 5}, reward=-5.0, truncated=True)
    reward, bootstrap = compute_backup(transition, LearningSettings(gamma=0.9))
    assert reward == pytest.approx(-(1 - 0.9**5) / 0.1, abs=1e-12)
    assert bootstrap == pytest.approx(0.9**5, abs=1e-15)


def test_trap_4_an_exit_inside_an_option_keeps_its_bonus_at_gamma_to_the_k_minus_1():
    transition = read({"duration": 4, "rewards": [-1, -1, -1, 99]}, reward=96.0, terminated=True)
    reward, bootstrap = compute_backup(transition, LearningSettings(gamma=0.9))
    assert reward == pytest.approx(-1 - 0.9 - 0.9**2 + 99 * 0.9**3, abs=1e-12)
    assert bootstrap == 0


def test_trap_14_an_action_that_costs_no_primitive_is_refused():
    with pytest.raises(StepContractError, match="took 0 primitives"):
        read({"duration": 0, "rewards": []})


def test_trap_10_a_mask_without_a_legal_action_is_refused():
    with pytest.raises(StepContractError, match="all zero"):
        read_action_mask({"action_mask": np.zeros(3, np.int8)}, 3)


@pytest.mark.parametrize("reward", [float("nan"), float("inf")])
def test_a_reward_that_is_no_number_is_refused(reward):
    with pytest.raises(StepContractError, match="reward of action 1 is"):
        read({}, reward=reward)


@pytest.mark.parametrize("info", [
    {"duration": 2, "rewards": [0.0, float("nan")]},
    {"duration": 2, "discounted_reward": float("inf"), "discount": 0.81},
    {"duration": 2, "discounted_reward": 0.0, "discount": 0.81, "summed_reward": "none"},
    {"duration": 2, "rewards": np.zeros((2, 3))},
])
def test_rewards_inside_an_option_must_be_numbers_too(info):
    with pytest.raises(StepContractError, match="the reward of action 1 is"):
        read(info)


@pytest.mark.parametrize("duration", [float("nan"), float("inf"), "two", 0.04, None, True])
def test_a_duration_that_is_no_whole_number_is_refused_beside_rewards_and_else_the_environments_own(duration):
    with pytest.raises(StepContractError, match=r"info\['duration'\] of action 1 is .* whole number of primitives"):
        read({"duration": duration, "rewards": [1.0]}, reward=1.0)
    assert read({"duration": duration}, reward=1.0)[3:6] == (1.0, 1.0, 1)


def test_keys_of_this_contract_that_an_environment_uses_for_something_else_are_left_alone():
    info = {"rewards": {"speed": 0.5}, "discount": 0.2, "summed_reward": 40.0,
            "option": {"strike": 3}, "trace": np.zeros(3), "duration": 0.04}
    transition = read(info, reward=-2.0, truncated=True)
    assert (transition.reward, transition.summed_reward, transition.duration, transition.discount) == (-2, -2, 1, 0.9)
    assert transition.trace == () and not transition.cut


@pytest.mark.parametrize("option", ["call", 7, {"strike": 3}, {"ended": "at noon"}, {"ended": np.zeros(2)},
                                    {"name": 3, "ended": "episode-over"}])
def test_the_option_of_another_contract_says_nothing_of_a_cut(option):
    info = {"duration": 2, "rewards": [0, 0], "option": option}
    assert read(info, truncated=True).cut, "as without it"
    assert not read({"option": option}, truncated=True).cut


@pytest.mark.parametrize(("info", "reward"), [
    ({"duration": 1, "rewards": [3.0]}, 1.5),
    ({"duration": 3, "rewards": [3.0] * 3}, 1.0),
    ({"duration": 3, "rewards": [-1.0, 1.0, 0.5]}, 0.5001),
    ({"duration": 3, "discounted_reward": 8.13, "discount": 0.729, "summed_reward": 9.0}, 4.5),
    ({"duration": 1, "discounted_reward": 3.0, "discount": 0.9}, 1.5),
    ({"duration": 2, "rewards": [0.0, 0.0]}, 1e-9),
])
def test_a_reward_that_a_wrapper_changed_above_the_options_is_refused(info, reward):
    with pytest.raises(StepContractError, match=r"the reward of action 1 is .* Put the wrapper below, as in"):
        read(info, reward=reward)


@given(st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=200))
def test_a_sum_held_in_float32_is_still_that_of_the_primitives(rewards):
    narrow = np.float32(0)
    for reward in rewards:
        narrow += np.float32(reward)
    transition = read({"duration": len(rewards), "rewards": rewards}, reward=narrow)
    assert transition.summed_reward == sum(rewards)


def test_the_discounted_sum_may_stand_for_the_reward():
    rewards = [1.0, 2.0, 4.0]
    info = {"duration": 3, "discounted_reward": 1 + 0.9 * 2 + 0.81 * 4, "discount": 0.729, "rewards": rewards}
    transition = read(info, reward=info["discounted_reward"])
    assert (transition.reward, transition.summed_reward) == (info["discounted_reward"], 7.0)


@pytest.mark.parametrize("reward", [None, "much", [1, 2], np.ones(2), {"speed": 1.0}])
def test_a_reward_of_another_kind_is_refused(reward):
    with pytest.raises(StepContractError, match="must be numbers"):
        read({}, reward=reward)


@pytest.mark.parametrize(("observation", "words"), [
    (np.array([0, np.nan, np.inf], np.float32), "has nan at index 1"),
    (np.array([[0.0], [-np.inf]]), r"has -inf at index \(1, 0\)"),
    (float("inf"), "is inf"),
    ({"door": np.ones(2), "arm": np.array([np.nan])}, "'arm', has nan at index 0"),
    ((np.ones(2), np.array([np.nan])), "has nan at index 0"),
])
def test_an_observation_that_is_no_number_is_refused_by_name(observation, words):
    with pytest.raises(StepContractError, match=f"the observation after action 1.* {words}"):
        make_transition("s", 1, MASK, (observation, 0.0, False, False, {}), 0.9)


@pytest.mark.parametrize(("observation", "shape"), [
    (np.ones(2), r"\(2,\)"), (np.ones((1, 3)), r"\(1, 3\)"), (None, r"\(\)")])
def test_an_observation_of_another_shape_than_the_last_is_refused(observation, shape):
    with pytest.raises(StepContractError, match=rf"after action 1 has shape {shape}; the one before it has \(3,\)"):
        make_transition(np.ones(3), 1, MASK, (observation, 0.0, False, False, {}), 0.9)


def test_pictures_integers_and_large_numbers_are_observations():
    for observation in (np.zeros((4, 4, 3), np.uint8), 3, np.array([1e300, -1e300]), {"a": (1, 2.5)}, "s"):
        check_observation(observation, "at the start")


def test_a_mask_of_the_wrong_length_is_refused():
    with pytest.raises(StepContractError, match=r"shape \(2,\)"):
        read_action_mask({"action_mask": np.ones(2, np.int8)}, 3)


def test_the_papers_treatment_sums_rewards_discounts_once_and_ends_at_the_cap():
    transition = read({"duration": 5, "rewards": [-1.0] * 5}, reward=-5.0, truncated=True)
    settings = LearningSettings(gamma=0.9, discounting="decision", bootstrap_on_truncation=False)
    assert compute_backup(transition, settings) == (-5.0, 0.0)
    assert compute_backup(transition._replace(truncated=False), settings) == (-5.0, 0.9)


def test_a_discounted_reward_is_taken_where_primitive_rewards_are_not_given():
    info = {"duration": 3, "discounted_reward": -2.71, "discount": 0.9**3}
    assert read(info, reward=-3.0).reward == -2.71


def test_a_discounted_reward_of_another_gamma_is_refused_with_both_gammas():
    info = {"duration": 3, "discounted_reward": -2.9, "discount": 0.99**3}
    with pytest.raises(DiscountMismatchError, match=r"gamma is 0.9 but the environment discounts by 0.99"):
        read(info, reward=-3.0)


def test_a_long_action_of_unknown_discounted_reward_is_refused():
    with pytest.raises(StepContractError, match="'rewards'"):
        read({"duration": 3}, reward=-3.0)


def test_rewards_that_do_not_match_the_duration_are_refused():
    with pytest.raises(StepContractError, match="2 entries for a duration of 3"):
        read({"duration": 3, "rewards": [-1, -1]}, reward=-2.0)


@given(
    rewards=st.lists(st.floats(-100, 100), min_size=2, max_size=40),
    cut=st.integers(1, 39),
    gamma=st.floats(0, 1),
    value=st.floats(-100, 100),
)
def test_trap_2_cutting_an_option_in_two_does_not_change_its_value(rewards, cut, gamma, value):
    cut = min(cut, len(rewards) - 1)
    settings = LearningSettings(gamma=gamma)

    def back_up(part, value):
        info = {"duration": len(part), "rewards": part}
        reward, bootstrap = compute_backup(read(info, reward=sum(part), gamma=gamma), settings)
        return reward + bootstrap * value

    in_two = back_up(rewards[:cut], back_up(rewards[cut:], value))
    assert back_up(rewards, value) == pytest.approx(in_two, rel=1e-9, abs=1e-9)
