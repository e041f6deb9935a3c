"""How a decision ends, what its discount may be, and what an episode of decisions is worth undiscounted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hrl_escape.agents import SMDPTransition, make_transition, train
from hrl_escape.env import EscapeRoomEnv
from hrl_escape.errors import DiscountMismatchError
from hrl_escape.options import OptionsEnv

GAMMA = 0.9


def read(info: dict[str, Any], **ends: bool) -> SMDPTransition:
    step = (0, -float(info["duration"]), ends.get("terminated", False), ends.get("truncated", False), info)
    return make_transition(0, 1, np.ones(3, np.bool_), step, GAMMA)


@pytest.mark.parametrize("duration", [2, 5, 20])
@pytest.mark.parametrize("off", [-1e-2, -1e-5, 1e-5, 1e-2])
def test_a_discount_of_another_gamma_is_refused(duration: int, off: float):
    info = {"duration": duration, "discounted_reward": -1.5, "discount": GAMMA**duration * (1 + off)}
    with pytest.raises(DiscountMismatchError):
        read(info)


@pytest.mark.parametrize("duration", [2, 5, 20])
def test_a_discount_multiplied_step_by_step_is_taken(duration: int):
    """It differs from the power in its last bits."""
    discount = 1.0
    for _ in range(duration):
        discount *= GAMMA
    transition = read({"duration": duration, "discounted_reward": -1.5, "discount": discount})
    assert transition.discount == pytest.approx(discount) and transition.reward == -1.5


@pytest.mark.parametrize("ended", ["reached", "timeout", "planning-failed", "interrupted"])
@pytest.mark.parametrize("duration", [1, 4])
def test_an_option_that_ends_by_itself_is_not_cut_even_at_the_horizon(ended: str, duration: int):
    info = {"duration": duration, "rewards": [-1.0] * duration, "option": {"ended": ended}}
    assert not read(info).cut and not read(info, truncated=True).cut and not read(info, terminated=True).cut
    stopped = info | {"option": {"ended": "episode-over"}}
    assert read(stopped, truncated=True).cut and not read(stopped, terminated=True).cut


@pytest.mark.parametrize("discounted", [False, True])
def test_returns_are_sums_of_primitive_rewards_also_where_steps_give_discounted_ones(discounted: bool):
    """-1 a primitive and 100 at the exit, whatever the options' step returns."""
    env = OptionsEnv(EscapeRoomEnv("paper-one-button", observation="features"), include_primitives=False,
                     discounted_reward=discounted)
    result = train("random-options", env, primitives=60, eval_every=60, eval_episodes=1)
    whole = [episode for episode in result.episodes if episode.end == "terminated"]
    assert len(whole) > 2
    for episode in whole:
        assert episode.episode_return == 100 - episode.length
    final = result.evaluations[-1]
    assert final.returns == tuple(100 - length for length in final.lengths)
    env.close()
