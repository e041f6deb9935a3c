"""Sets of rooms: sequences, parts that are the same everywhere, and environments over them."""

import hashlib
import json
import pickle

import numpy as np
import pytest
import torch

from hrl_escape.agents import train
from hrl_escape.agents.training.env_description import describe_env, make_described_env
from hrl_escape.env.presets import get_preset
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.options.meta_actions import list_goals
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.sets import InstanceSet
from hrl_escape.sets.benchmark import Benchmark, load_benchmark
from tests.covering import thin
from tests.sets.small import make_manifest


@pytest.fixture(scope="module")
def rooms():
    return Benchmark(make_manifest())["five"].train


def test_a_set_is_a_sequence_of_rooms(rooms):
    assert len(rooms) == 12 and rooms[0].id == rooms[-12].id and rooms[3] is rooms[3]
    assert [room.digest for room in rooms] == list(rooms.ids)
    assert rooms[2:5].ids == rooms.ids[2:5]
    with pytest.raises(IndexError):
        rooms[12]


def test_a_split_is_whole_keyed_and_nested(rooms):
    few, rest = rooms.split(0.25, key=1)
    assert len(few) == 3 and sorted(few.ids + rest.ids) == sorted(rooms.ids)
    assert set(few.ids) <= set(rooms.split(0.5, key=1)[0].ids)
    assert few.ids == rooms.split(0.25, key=1)[0].ids != rooms.split(0.25, key=2)[0].ids
    assert [len(part) for part in rooms.split(0.0)] == [0, 12]
    with pytest.raises(ConfigError, match="from 0 to 1"):
        rooms.split(1.5)


def test_a_split_goes_by_the_rooms_seeds_wherever_they_stand():
    """By SHA-256 of key and seed, the smallest first; in another order of the rooms the parts hold the same ones."""
    seeds = [int(seed) for seed in np.random.default_rng(0).integers(2**62, size=40)]
    ranked = sorted(seeds, key=lambda seed: hashlib.sha256(f"3/{seed}".encode()).hexdigest())
    for order in (seeds, seeds[::-1], sorted(seeds)):
        few, rest = InstanceSet("some", get_preset("paper-two-button"), order).split(0.3, key=3)
        assert list(few.seeds) == [seed for seed in order if seed in ranked[:12]], "in their order"
        assert list(rest.seeds) == [seed for seed in order if seed in ranked[12:]]
    longer = InstanceSet("more", get_preset("paper-two-button"), [7, 8, 9, *seeds]).split(0.5, key=3)[0]
    assert set(ranked[:12]) <= set(longer.seeds), "rooms that come first do not move the others"


def test_a_filter_keeps_what_it_says(rooms):
    four = rooms.filter(lambda room: len(room.targets) == 4)
    assert 0 < len(four) < 12 and all(len(room.targets) == 4 for room in four)


@pytest.mark.parametrize("options", [False, True, {"include_primitives": False}])
def test_resets_draw_rooms_by_the_episodes_seed(rooms, options):
    env = rooms.make_env(options=options, observation="features")
    assert isinstance(env, OptionsEnv) == bool(options)
    space, seen, told, copy = env.observation_space, [], {}, None
    for _ in range(2):
        env.reset(seed=0)
        seen.append([])
        for _ in range(12):
            number = env.reset()[1]["instance"]
            seen[-1].append(env.unwrapped.instance.id)
            assert told.setdefault(seen[-1][-1], number) == number, "a room keeps its number"
            assert isinstance(number, (int, np.integer)), "a number names no room"
            copy = pickle.loads(pickle.dumps(env)) if len(told) == 3 and copy is None else copy
        assert env.observation_space == space
    assert seen[0] == seen[1] and 4 < len(set(seen[0])) and set(seen[0]) <= {room.id for room in rooms}
    assert len(set(told.values())) == len(told)
    env.reset(options={"instance_index": 7})
    assert env.unwrapped.instance.id == rooms[7].id
    assert copy.reset(options={"instance_index": 7})[1]["instance"] <= 3, "a copy knows the rooms seen before"
    with pytest.raises(ConfigError, match="12 instances"):
        env.reset(options={"instance_index": 12})
    env.close()


def test_an_argument_that_belongs_to_the_options_is_refused_in_words(rooms):
    with pytest.raises(UnknownNameError, match=r"OptionsEnv's go into options=\{...\}\) 'include_primitives'"):
        rooms.make_env(options=True, include_primitives=False)
    with pytest.raises(UnknownNameError, match="did you mean 'observation'"):
        rooms.make_env(observations="features")
    with pytest.raises(UnknownNameError, match="argument of OptionsEnv 'include_primitive'"):
        rooms.make_env(options={"include_primitive": False})


def test_an_environment_over_a_set_is_made_again_from_its_description(rooms):
    env = rooms.split(0.5)[0].make_env(options=True, observation="features")
    description = json.loads(json.dumps(describe_env(env)))
    assert len(json.dumps(description)) < 5_000
    again = make_described_env(description)
    for seed in range(5):
        (seen, info), (other, same) = env.reset(seed=seed), again.reset(seed=seed)
        assert np.array_equal(seen, other) and info["instance"] == same["instance"]
    env.close()
    again.close()


def test_a_set_and_its_environment_survive_pickling(rooms):
    assert pickle.loads(pickle.dumps(rooms)).ids == rooms.ids
    env = rooms.make_env()
    assert pickle.loads(pickle.dumps(env)).reset(seed=3)[1]["instance"] == env.reset(seed=3)[1]["instance"]


@pytest.mark.nightly
def test_a_batch_holds_every_room_of_the_set(rooms):
    batch = rooms.make_vec(64, observation="features")
    assert isinstance(batch, EscapeRoomVectorEnv)
    _, infos = batch.reset(seed=0)
    assert [room.id for room in batch.instances] == [room.id for room in rooms]
    assert set(infos["instance"].tolist()) == set(range(len(rooms)))
    decisions = rooms[:3].make_vec(8, options={"include_primitives": False})
    assert isinstance(decisions, BatchedOptionsEnv)
    decisions.reset(torch.arange(8))
    assert decisions.action_names[-1] == "go-to-exit" and decisions.actions == 7


@pytest.mark.nightly_for("house", "clutter")
@pytest.mark.parametrize("rung", thin([rung.name for rung in load_benchmark("ladder-1")], 3))
def test_rooms_of_a_rung_offer_the_same_goals_in_the_same_order(rung):
    """Else no learner of options could go from one to the next."""
    rooms = load_benchmark("ladder-1")[rung].train
    goals = [list_goals(rooms[index]) for index in range(4)]
    assert all(other == goals[0] for other in goals)


@pytest.mark.parametrize("option_set", ["press", "press-with-ancestors"])
def test_options_over_rooms_of_two_and_three_blocks_are_learned_from_and_the_missing_ones_are_masked(option_set):
    rooms = load_benchmark("ladder-1")["freight"].train[:4]
    assert {len(room.targets) for room in rooms} == {2, 3}
    env = rooms.make_env(options={"include_primitives": False, "option_set": option_set})
    for seed in range(6):
        _, info = env.reset(seed=seed)
        missing = [index for index, goal in enumerate(list_goals(env.unwrapped.instance))
                   if getattr(goal, "target", 0) >= len(env.unwrapped.instance.targets)]
        assert len(missing) in (0, 3) and not info["action_mask"][missing].any() and info["action_mask"].any()
    result = train("smdp-q-learning", env, primitives=300, eval_episodes=0, progress=False)
    assert result.primitives >= 300
