"""Sets of rooms by a short text."""

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, FileReadError, UnknownNameError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.room_sets import parse_room_set


def test_texts_name_the_rooms_of_rungs_presets_and_files(tmp_path):
    train = load_benchmark("ladder-1")["doormat"].train
    assert list(parse_room_set("ladder-1/doormat/train").seeds) == list(train.seeds)
    assert list(parse_room_set("ladder-1/doormat/train[2:5]").seeds) == list(train.seeds[2:5])
    assert list(parse_room_set("ladder-1/doormat/train[:3]").seeds) == list(train.seeds[:3])
    for part, name in ((train[:3], "[0:3]"), (train[2:4], "[2:4]"), (train[1:9:2], "[1:9:2]")):
        assert part.name == train.name + name
    assert list(parse_room_set(train[2:4].name).seeds) == list(train[2:4].seeds)
    assert list(parse_room_set("ladder-1/doormat/train[250:]").seeds) == list(train.seeds[250:])
    (room,) = parse_room_set("ladder-1/doormat/train[7]")
    assert room == train[7]
    rooms = [generate(get_preset("clutter"), seed) for seed in (3, 4)]
    assert list(parse_room_set("clutter#3..4")) == rooms
    assert list(parse_room_set("clutter").seeds) == [0]
    train[:4].save(tmp_path / "few.json")
    assert parse_room_set(str(tmp_path / "few.json"))[:4].ids == train[:4].ids


@pytest.mark.parametrize(("text", "error", "words"), [
    ("ladder-1/doormat/train[]", ConfigError, "train\\[:64\\]"),
    ("ladder-1/doormat/train[4000]", ConfigError, "1000 rooms"),
    ("ladder-1/doormat/train[5:5]", ConfigError, "at least one"),
    ("ladder-1/doormat/trian", UnknownNameError, "train"),
    ("ladder-1/doormatt/train", UnknownNameError, "doormat"),
    ("clutter#5..2", ConfigError, "clutter#0..15"),
    ("cluttered", UnknownNameError, "clutter"),
    ("nowhere.json", FileReadError, "nowhere.json"),
])
def test_texts_that_name_no_rooms_are_refused_with_what_would_do(text, error, words):
    with pytest.raises(error, match=words):
        parse_room_set(text)


@pytest.mark.parametrize("make", [
    lambda: gymnasium.make("hrl_escape/Ladder-v1", rung="pair", set="valid", slice=":4", options={"discount": 0.9}),
    lambda: gymnasium.make("hrl_escape/Ladder-v1", rung="pair", slice="3", observation="features"),
    lambda: load_benchmark("ladder-1")["pair"].valid[1:3].make_env(options=True, observation="objects"),
    lambda: load_benchmark("ladder-1")["pair"].train.make_env(),
])
def test_the_spec_of_a_rungs_environment_survives_json_and_makes_the_same_environment(make):
    env = make()
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.rooms.seeds[:4] == env.unwrapped.rooms.seeds[:4]
    assert (again.observation_space, again.action_space) == (env.observation_space, env.action_space)
    for action in (None, 3, 0):
        first, second = (each.reset(seed=5) if action is None else each.step(action) for each in (env, again))
        np.testing.assert_array_equal(first[0], second[0])


def test_only_rooms_that_the_id_finds_have_a_spec():
    train = load_benchmark("ladder-1")["pair"].train
    assert train[:8].split(0.5)[0].make_env().spec is None
    assert train[:8:2].make_env().spec is None
    assert train[2:8][1:3].make_env().spec is None
    assert train[2:8].make_env().spec.kwargs["slice"] == "2:8"


def test_the_id_makes_vector_environments_of_a_set_too():
    envs = gymnasium.make_vec("hrl_escape/Ladder-v1", num_envs=3, rung="pair", slice=":2", observation="features")
    observation, _ = envs.reset(seed=0)
    single = load_benchmark("ladder-1")["pair"].train[:2].make_env(observation="features")
    assert observation.shape == (3, *single.observation_space.shape)
    with pytest.raises(ConfigError, match="at least one"):
        gymnasium.make("hrl_escape/Ladder-v1", rung="pair", slice="5000")
