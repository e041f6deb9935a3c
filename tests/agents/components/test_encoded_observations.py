"""Observations of several parts become vectors; parts that cannot are left out and named."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import FilterObservation, FlattenObservation

from hrl_escape.agents import make_agent, train
from hrl_escape.agents.components.networks import ObservationEncoder
from hrl_escape.errors import UnsupportedSpaceError

BIT, WORDS = spaces.Discrete(2), spaces.Sequence(spaces.Discrete(9))


def make_babyai() -> gymnasium.Env:
    pytest.importorskip("minigrid")
    return gymnasium.make("BabyAI-GoToObj-v0")


def test_a_mission_is_left_out_by_name_and_the_other_parts_are_learned_from():
    env = make_babyai()
    with pytest.warns(UserWarning, match=r"'mission' \(BabyAIMissionSpace\)\. .*FilterObservation"):
        result = train("dqn", env, primitives=80, eval_episodes=0, progress=False)
    assert result.primitives >= 80
    with pytest.warns(UserWarning, match="'mission'"):
        encoder = ObservationEncoder(env.observation_space, scale=True)
    seen, _ = env.reset(seed=3)
    one_hot = np.eye(4)[seen["direction"]]
    np.testing.assert_array_equal(encoder.encode(seen), [*one_hot, *seen["image"].ravel()])
    assert encoder.shape == (4 + 7 * 7 * 3,) and sorted(encoder.space) == ["direction", "image"]


def test_what_the_warning_proposes_ends_it():
    env = FilterObservation(make_babyai(), ["image", "direction"])
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        assert train("ppo", env, primitives=40, eval_episodes=0, progress=False).primitives >= 40


def test_a_part_inside_a_part_is_named_by_its_path():
    space = spaces.Dict({"bit": BIT, "task": spaces.Dict({"words": WORDS, "goal": spaces.Box(-1, 1, (2,))})})
    with pytest.warns(UserWarning, match=r"'task\.words' \(Sequence\)"):
        encoder = ObservationEncoder(space, scale=False)
    seen = {"bit": 1, "task": {"words": (3, 4), "goal": np.array([0.5, -0.5], np.float32)}}
    np.testing.assert_array_equal(encoder.encode(seen), [0, 1, 0.5, -0.5])


@pytest.mark.parametrize(("space", "named"), [
    (WORDS, r"Sequence\(Discrete\(9\)"),
    (spaces.Dict({"words": WORDS, "graph": spaces.Graph(BIT, None)}), r"'graph' \(Graph\), 'words' \(Sequence\)"),
    (spaces.Tuple((BIT, WORDS)), r"Tuple\(Discrete\(2\), Sequence"),
])
def test_observations_without_any_vector_form_are_refused_by_name(space, named):
    with pytest.raises(UnsupportedSpaceError, match=named):
        make_agent("dqn", space, spaces.Discrete(3), seed=0)


@pytest.mark.parametrize("space", [
    BIT, spaces.Dict({"bit": BIT, "text": spaces.Text(5)}), spaces.Tuple((BIT, spaces.Box(-1, 1, (2, 2))))])
def test_every_other_space_is_encoded_in_full_and_without_a_warning(space):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        encoder = ObservationEncoder(space, scale=False)
    seen = space.sample()
    np.testing.assert_array_equal(encoder.encode(seen), spaces.flatten(space, seen))


def test_small_pictures_are_refused_with_the_wrapper_that_makes_them_vectors():
    pytest.importorskip("minigrid")
    from minigrid.wrappers import ImgObsWrapper

    env = ImgObsWrapper(gymnasium.make("MiniGrid-Empty-5x5-v0"))
    with pytest.raises(UnsupportedSpaceError, match="7 x 7 .* gymnasium.wrappers.FlattenObservation"):
        make_agent("dqn", env.observation_space, spaces.Discrete(7), seed=0)
    make_agent("dqn", FlattenObservation(env).observation_space, spaces.Discrete(7), seed=0)
