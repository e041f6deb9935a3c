"""Masks inside observations: for policies that read them there, flat and with options."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from hrl_escape.agents.training.env_description import describe_env, make_described_env
from hrl_escape.errors import ConfigError, UnsupportedSpaceError
from hrl_escape.options import MaskedObservation, OptionsEnv


def test_the_mask_in_the_observation_is_the_one_of_the_next_decision():
    env = MaskedObservation(OptionsEnv(gymnasium.make("hrl_escape/PaperTwoButton-v1"), include_primitives=False))
    rng = np.random.default_rng(0)
    seen, info = env.reset(seed=0)
    masks = set()
    for _ in range(30):
        assert env.observation_space.contains(seen)
        np.testing.assert_array_equal(seen["action_mask"], info["action_mask"])
        masks.add(tuple(seen["action_mask"]))
        before = seen["action_mask"].copy()
        later, _, terminated, truncated, info = env.step(int(rng.choice(np.flatnonzero(seen["action_mask"]))))
        np.testing.assert_array_equal(seen["action_mask"], before)  # what was handed out stays as it was
        seen = later
        if terminated or truncated:
            seen, info = env.reset()
    assert len(masks) > 1


def test_without_a_mask_every_action_is_legal_and_both_keys_can_be_chosen():
    env = MaskedObservation(gymnasium.make("CartPole-v1"), key="obs", mask_key="mask")
    seen, _ = env.reset(seed=3)
    assert set(seen) == set(env.observation_space) == {"obs", "mask"}
    assert seen["mask"].tolist() == [1, 1] and seen["obs"].shape == (4,)
    described = make_described_env(describe_env(env))
    assert isinstance(described, MaskedObservation) and (described.key, described.mask_key) == ("obs", "mask")


def test_one_key_for_both_is_refused():
    with pytest.raises(ConfigError, match="mask_key = 'mask'.*another key than that of the observation"):
        MaskedObservation(gymnasium.make("CartPole-v1"), key="mask", mask_key="mask")


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")
def test_gymnasiums_own_checker_accepts_it():
    check_env(MaskedObservation(gymnasium.make("hrl_escape/PaperOneButton-v1")), skip_render_check=True)


def test_continuous_actions_have_no_mask():
    with pytest.raises(UnsupportedSpaceError, match="needs Discrete actions, not Box"):
        MaskedObservation(gymnasium.make("Pendulum-v1"))
