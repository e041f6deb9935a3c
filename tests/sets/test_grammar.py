"""Rooms by a short text: every form of the grammar, its refusals, and environments over what it names."""

import json
import tracemalloc

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from hypothesis import given
from hypothesis import strategies as some

import hrl_escape
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, EscapeError, FileReadError, UnknownNameError, UnsupportedError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.sets import InstanceSet, SequenceEnv, find_set, load_benchmark, make_room
from hrl_escape.sets.grammar import LARGEST_RANGE, RoomName, find_rooms
from hrl_escape.sets.room_sequence import SEQUENCE_HORIZON, RoomSequence
from hrl_escape.sets.room_spec import renew_room


def list_seeds(text):
    return list(find_set(text).seeds)


@pytest.mark.nightly
def test_presets_take_a_number_a_range_and_arguments():
    assert make_room("clutter") == generate(get_preset("clutter"), 0)
    assert make_room("clutter#3") == generate(get_preset("clutter"), 3)
    assert find_rooms("clutter#3") == make_room("clutter#3"), "one room is a room"
    assert make_room("larg-2019(size=4)") == generate(get_preset("larg-2019", size=4), 0)
    assert make_room(" larg-2019(size=4, seed=3)#7 ") == generate(get_preset("larg-2019", size=4, seed=3), 7)
    assert list_seeds("clutter#0..16") == list(range(16)), "STOP is left out"
    assert list_seeds("clutter#3..5") == [3, 4] and len(find_set("clutter#3..4")) == 1
    assert isinstance(find_rooms("clutter#3..4"), InstanceSet), "a range is a set, though it holds one room"
    assert list_seeds("clutter") == [0]


def test_sets_of_a_benchmark_are_whole_or_in_part():
    train = load_benchmark("ladder-1")["doormat"].train
    assert list_seeds("ladder-1/doormat/train") == list(train.seeds)
    assert list_seeds("ladder-1/doormat/train#2..5") == list(train.seeds[2:5])
    assert make_room("ladder-1/doormat/train#7") == train[7]
    assert find_set("ladder-1/doormat/train#7").name == "ladder-1/doormat/train#7"


def test_names_of_parts_are_texts_that_name_them():
    train = load_benchmark("ladder-1")["doormat"].train
    for part, name in ((train[:3], "#0..3"), (train[2:6], "#2..6"), (train[2:6][1:3], "#3..5")):
        assert part.name == train.name + name and list_seeds(part.name) == list(part.seeds)
    assert train[1:9:2].name == train.name + "[1:9:2]", "which the grammar does not have"
    part = find_set("clutter#10..20")[2:4]
    assert part.name == "clutter#12..14" and list(part.seeds) == [12, 13]


def test_files_hold_a_room_a_set_or_a_configuration(tmp_path):
    train = load_benchmark("ladder-1")["doormat"].train
    train[:4].save(tmp_path / "few.json")
    assert find_set(f"{tmp_path}/few.json").ids == train[:4].ids
    assert make_room(f"{tmp_path}/few.json#2") == train[2]
    make_room("clutter#3").save(tmp_path / "room #1.json")
    assert make_room(f"{tmp_path}/room #1.json") == make_room("clutter#3")
    (tmp_path / "mine.json").write_text(json.dumps(get_preset("clutter").to_dict()))
    (tmp_path / "mine.toml").write_text("horizon = 50")
    assert make_room(f"{tmp_path}/mine.json#3") == make_room("clutter#3")
    assert make_room(f"{tmp_path}/mine.toml#1") == generate(RoomConfig(name="mine", horizon=50), 1)
    assert list_seeds(f"{tmp_path}/mine.toml#2..4") == [2, 3]


@pytest.mark.nightly
def test_each_form_takes_changes(tmp_path):
    make_room("clutter").save(tmp_path / "room.json")
    changes = {"horizon": 77}
    test = load_benchmark("ladder-1")["pair"].test
    assert make_room("clutter#3", changes).horizon == 77
    changed = make_room("ladder-1/pair/test#5", changes)
    assert changed.horizon == 77 and changed.targets == test[5].targets and test[5].horizon != 77
    assert find_set("ladder-1/pair/test#0..3", changes)[2].horizon == 77
    assert make_room("custom#1", {"room.width": 30}).half_width == 15
    assert make_room(get_preset("clutter"), changes).horizon == 77
    with pytest.raises(UnsupportedError, match="holds one finished room"):
        make_room(f"{tmp_path}/room.json", changes)
    with pytest.raises(UnknownNameError, match="room.width"):
        make_room("clutter", {"room.widht": 30})


def test_sequences_repeat_a_set_or_join_several():
    joined = find_rooms("clutter#0..4 + ten-button#0..4")
    assert isinstance(joined, RoomSequence) and [list(rooms.seeds) for rooms in joined.sets] == [[0, 1, 2, 3]] * 2
    repeated = find_rooms("cues-1/latent-codes/test#0..32 x 3")
    assert isinstance(repeated, RoomSequence) and repeated.paired and len(repeated.sets) == 3
    assert joined.name == "clutter#0..4 and 1 more"


@pytest.mark.parametrize(("text", "error", "words"), [
    ("ladder-1/doormat/train[3]", ConfigError, "write ladder-1/doormat/train#3"),
    ("ladder-1/doormat/train[:64]", ConfigError, "write ladder-1/doormat/train#0..64"),
    ("ladder-1/doormat/train[8:]", ConfigError, r"write ladder-1/doormat/train#8..STOP"),
    ("ladder-1/doormat/train#4000", ConfigError, "has 1,000 rooms, numbered from 0 to 999"),
    ("ladder-1/doormat/train#5..5", ConfigError, "leaves STOP out"),
    ("ladder-1/doormat/train#0..1001", ConfigError, "1,000 rooms"),
    ("ladder-1/doormat/train#*", ConfigError, "write ladder-1/doormat/train"),
    ("ladder-1/doormat/trian", UnknownNameError, "did you mean 'train'"),
    ("ladder-1/doormatt/train", UnknownNameError, "did you mean 'doormat'"),
    ("ladder-2019/doormat/train", UnknownNameError, "ladder-1"),
    ("ladder-1/doormat", ConfigError, "write|such as ladder-1/doormat/test#0"),
    ("doormat", UnknownNameError, "write ladder-1/doormat/test#0"),
    ("clutter#5..2", ConfigError, r"clutter#5 is one room, clutter#5..21 are 16"),
    ("clutter#0..1000001", ConfigError, "at most 1,000,000 rooms"),
    ("clutter#0..1000000000000000000000", ConfigError, "at most 18 digits"),
    ("clutter#x", ConfigError, r"clutter#3, clutter#0..16 or 'clutter#\*'"),
    ("clutter#", ConfigError, "after # write"),
    ("clutter(size=4)", ConfigError, "size"),
    ("larg-2019(4)", ConfigError, r"larg-2019\(size=4\)"),
    ("larg-2019(size=4", ConfigError, "write a room such as"),
    ("ladder-1/pair/test(size=4)", ConfigError, "only presets take"),
    ("cluttered", UnknownNameError, "did you mean 'clutter'"),
    ("nowhere.json", FileReadError, "nowhere.json"),
    ("", ConfigError, "such as clutter"),
    ("x" * 10_001, ConfigError, "1 to 10,000 characters"),
    ("clutter x 1000000", ConfigError, "2 to 1,000 rooms"),
    ("clutter + ten-button x 3", ConfigError, "repeats one set"),
])
def test_texts_that_name_no_rooms_are_refused_with_what_would_do(text, error, words):
    with pytest.raises(error, match=words) as refusal:
        find_set(text)
    assert len(str(refusal.value)) < 1_500


@pytest.mark.parametrize(("text", "words"), [
    ("clutter#0..16", "names 16 rooms: write clutter#0"), ("clutter#4..16", "write clutter#4"),
    ("ladder-1/pair/test", "names 100 rooms: write ladder-1/pair/test#0"), ("clutter#*", "write clutter#0"),
    ("clutter + ten-button", "sequences of rooms")])
def test_where_one_room_is_needed_several_are_refused_with_one_of_them(text, words):
    with pytest.raises(ConfigError, match=words):
        make_room(text)


def test_a_range_is_lazy_however_long():
    tracemalloc.start()
    rooms = find_set(f"clutter#7..{LARGEST_RANGE + 7}")
    assert len(rooms) == LARGEST_RANGE and rooms.seeds[-1] == LARGEST_RANGE + 6
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


@pytest.mark.nightly
@given(some.text(some.sampled_from("clutter/ladder-1#*.0123456789x+()[]=, {}'\"\n"), max_size=60))
def test_any_text_is_parsed_or_refused_in_one_message(text):
    try:
        RoomName.parse(text)
        find_rooms(text)
    except EscapeError as error:
        assert str(error)


# --- environments ----------------------------------------------------------------------------


def test_make_env_takes_every_form():
    env = hrl_escape.make_env("clutter#3", observation="features")
    assert env.unwrapped.instance == make_room("clutter#3")
    env.reset(seed=0)
    fresh = hrl_escape.make_env("clutter#*")
    seeds = {fresh.reset(seed=seed)[1] and fresh.unwrapped.instance.seed for seed in range(4)}
    assert len(seeds) == 4
    drawn = hrl_escape.make_env("clutter#0..3", options={"include_primitives": False})
    assert isinstance(drawn, OptionsEnv)
    assert {drawn.reset(seed=seed)[1] and drawn.unwrapped.instance.seed for seed in range(12)} == {0, 1, 2}
    sequence = hrl_escape.make_env("clutter#0..2 + clutter#4..6")
    assert isinstance(sequence, SequenceEnv) and sequence.unwrapped.instance.horizon == SEQUENCE_HORIZON
    assert hrl_escape.make_env(make_room("clutter#3")).unwrapped.instance == make_room("clutter#3")
    assert hrl_escape.make_env("clutter", changes={"horizon": 9}).unwrapped.instance.horizon == 9
    with pytest.raises(UnknownNameError, match="observation"):
        hrl_escape.make_env("clutter", obsrvation="features")
    with pytest.raises(ConfigError, match="a text such as clutter#3"):
        hrl_escape.make_env(3)


@pytest.mark.nightly
def test_make_vec_makes_a_batch_of_one_room_or_of_a_set():
    single = hrl_escape.make_vec("clutter#3", 2, observation="features")
    assert single.unwrapped.instances == (make_room("clutter#3"),)
    envs = hrl_escape.make_vec("ladder-1/pair/train#0..3", 5, options=True, observation="features")
    assert envs.num_envs == 5 and envs.reset(seed=0)[0].shape[0] == 5
    for text, words in (("clutter#*", "clutter#0..256"), ("clutter#0..20000", "at most 10,000"),
                        ("clutter + clutter", "make_env")):
        with pytest.raises(ConfigError, match=words):
            hrl_escape.make_vec(text)


@pytest.mark.parametrize("make", [
    lambda: gymnasium.make("hrl_escape/Ladder-v1", rung="pair", set="valid", slice="0..4", options={"discount": 0.9}),
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
    assert train[2:8].make_env().spec.kwargs["slice"] == "2..8"


def test_the_id_makes_vector_environments_of_a_set_too():
    envs = gymnasium.make_vec("hrl_escape/Ladder-v1", num_envs=3, rung="pair", slice="0..2", observation="features")
    observation, _ = envs.reset(seed=0)
    single = load_benchmark("ladder-1")["pair"].train[:2].make_env(observation="features")
    assert observation.shape == (3, *single.observation_space.shape)
    with pytest.raises(ConfigError, match="1,000 rooms"):
        gymnasium.make("hrl_escape/Ladder-v1", rung="pair", slice="5000")
    with pytest.raises(ConfigError, match=r"write 0..64"):
        gymnasium.make("hrl_escape/Ladder-v1", rung="pair", slice=":64")


@pytest.mark.parametrize(("old", "new"), [
    ("clutter#3", "clutter#3"), ("clutter#0..15", "clutter#0..16"), ("ladder-1/chain/test[3]", "ladder-1/chain/test#3"),
    ("ladder-1/chain/train[:64]", "ladder-1/chain/train#0..64"),
    ("ladder-1/chain/train[:8] x 3", "ladder-1/chain/train#0..8 x 3"),
    ("clutter#0..15 + ten-button#0..15", "clutter#0..16 + ten-button#0..16"),
    ({"preset": "larg-2019", "arguments": {"size": 4}, "config": None, "file": None, "set": None, "seed": 2},
     "larg-2019(size=4)#2"),
    ({"preset": None, "config": {"horizon": 50}, "seed": 4}, {"config": {"horizon": 50}, "instance": 4}),
    ({"file": "room.json"}, "room.json")])
def test_rooms_of_grids_of_version_0_3_have_a_form_in_this_one(old, new):
    assert renew_room(old) == new
