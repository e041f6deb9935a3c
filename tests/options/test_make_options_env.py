"""Gymnasium ids of rooms with options: one SMDP a preset."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from hrl_escape.env.presets import PRESETS, make_env_name
from hrl_escape.errors import UnknownNameError
from hrl_escape.options.options_env import make_options_env
from tests.covering import thin

IDS = ["hrl_escape/EscapeRoomOptions-v1", *(f"hrl_escape/{make_env_name(name)}Options-v1" for name in PRESETS)]


@pytest.mark.nightly_for("hrl_escape/PuddleWorldOptions-v1", "hrl_escape/FactoredOptions-v1")
@pytest.mark.parametrize("name", thin(IDS, 6))
def test_every_preset_has_an_id_whose_environment_passes_the_checker(name):
    env = gymnasium.make(name, disable_env_checker=True, observation="features")
    try:
        _, info = env.reset(seed=0)
        inner = env.get_wrapper_attr("action_names")
        assert inner[-1] == "go-to-exit"
        assert env.action_space.n == len(inner) == len(info["action_mask"])
        if not name.startswith("hrl_escape/PushBlock"):  # its options take minutes of physics under random choice
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.filterwarnings("ignore", message=".*different from the unwrapped version")
                check_env(env, skip_render_check=True)
    finally:
        env.close()


def test_arguments_reach_the_room_and_the_wrapper():
    env = gymnasium.make("hrl_escape/PaperTwoButtonOptions-v1", observation="features", option_features=True,
                         include_primitives=False, discount=0.5)
    observation, _ = env.reset(seed=0)
    assert observation.shape == (4 + 2 + 2 * 3,)
    *_, info = env.step(0)
    assert info["discount"] == 0.5 ** info["duration"]
    env.close()


def test_vector_environments_step_decisions_of_different_durations():
    rooms = gymnasium.make_vec("hrl_escape/PaperTwoButtonOptions-v1", num_envs=2, vectorization_mode="sync")
    rooms.reset(seed=0)
    _, rewards, _, _, infos = rooms.step(np.array([0, 6]))
    assert infos["duration"].tolist() == [1, -int(rewards[1])]
    assert infos["duration"][1] > 5
    rooms.close()


def test_options_plan_by_the_method_that_is_named():
    env = make_options_env("paper-two-button", planner="RRTConnect", include_primitives=False)
    assert [option._planner.routes.method for option in env.options] == ["RRTConnect"] * 3
    env.reset(seed=0)
    assert env.step(0)[4]["option"]["ended"] == "reached"
    with pytest.raises(UnknownNameError, match="RRTConnect"):
        make_options_env("paper-two-button", planner="RRTConect")
