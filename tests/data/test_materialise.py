"""Replays of recordings are what the environments showed, to the bit."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from hrl_escape.data.export import to_torch
from hrl_escape.data.materialise import load_data
from hrl_escape.data.recording import Recording
from hrl_escape.errors import ConfigError, FileReadError, UnknownNameError
from hrl_escape.options.degraded import OptionDegradation
from tests.data.small import make_recording, save_small


@pytest.mark.nightly_for("play-objects-0.99", "noisy-features-0.7")
@pytest.mark.parametrize("gamma", [0.99, 0.7])
@pytest.mark.parametrize(("kind", "observation"), [("play", "objects"), ("noisy", "features")])
def test_a_run_of_options_and_its_replay_agree_to_the_bit(gamma, kind, observation):
    recording: Recording = make_recording(kind)
    data = load_data(recording, observation=observation, gamma=gamma).read()
    options = {"include_primitives": False, "discount": gamma}
    if kind == "noisy":
        options["options"] = OptionDegradation(failure=0.2)
    env = recording.rooms.make_env(options, observation=observation)
    row = 0
    for seed, room, count in zip(recording.episode_seed, recording.room, recording.decisions, strict=True):
        seen, info = env.reset(seed=int(seed), options={"instance_index": int(room)})
        for _ in range(count):
            assert np.array_equal(seen, data.observation[row])
            assert np.array_equal(info["action_mask"] != 0, data.mask[row])
            seen, reward, terminated, _, info = env.step(int(data.action[row]))
            assert (info["duration"], info["discount"]) == (data.duration[row], data.discount[row])
            assert (info["discounted_reward"], reward) == (data.reward[row], data.summed_reward[row])
            assert np.array_equal(seen, data.next_observation[row])
            assert np.array_equal(info["action_mask"] != 0, data.next_mask[row])
            assert terminated == data.terminated[row]
            row += 1
    assert row == len(data.action)


@pytest.mark.parametrize("rung", ["pair", pytest.param("freight", marks=pytest.mark.slow),
                                  pytest.param("code", marks=pytest.mark.slow)])
def test_primitives_and_their_replay_agree_to_the_bit(rung):
    recording = make_recording("play", rung, 1_000)
    data = load_data(recording, observation="state").read_primitives()
    env = recording.rooms.make_env(observation="state")
    first = np.flatnonzero(np.concatenate([[True], data.last[:-1]]))
    assert len(first) == len(recording.episode_seed)
    ends = [*first[1:], len(data.action)]
    for seed, room, begin, end in zip(recording.episode_seed, recording.room, first, ends, strict=True):
        seen, _ = env.reset(seed=int(seed), options={"instance_index": int(room)})
        for row in range(begin, end):
            assert np.array_equal(seen, data.observation[row])
            seen, reward, terminated, _, _ = env.step(int(data.action[row]))
            assert (reward, terminated) == (data.reward[row], data.terminated[row])
            assert np.array_equal(seen, data.next_observation[row])
    assert np.array_equal(data.option[data.begins], recording.option)
    assert data.begins.sum() == len(recording.option)


@pytest.mark.nightly_for("decisions")
@pytest.mark.parametrize("level", ["decisions", "primitives"])
def test_blocks_of_any_size_join_to_the_whole_and_hold_few_episodes_each(level):
    data = load_data(make_recording("stitch"), observation="features", level=level)
    whole = data.read()
    parts = list(data.blocks(size=300))
    assert len(parts) > 3
    for name, field in whole._asdict().items():
        assert np.array_equal(np.concatenate([getattr(part, name) for part in parts]), field), name
    counts = [part.duration.sum() if level == "decisions" else len(part.action) for part in parts]
    assert max(counts) < 300 + 1_000  # the horizon


def test_stitched_trajectories_have_one_or_two_decisions_and_never_lead_from_start_to_exit():
    data = load_data(make_recording("stitch"), observation="features").read()
    lengths = np.bincount(data.trajectory)
    assert set(lengths) == {1, 2}
    assert not data.terminated[~data.last].any()
    assert (data.last & ~data.terminated).sum() > 4 * data.terminated.sum() > 0


@pytest.mark.nightly
def test_pictures_are_replayed_by_the_engine_that_took_them():
    recording = make_recording("expert", primitives=100)
    data = load_data(recording, observation="pixels").read()
    env = recording.rooms.make_env({"include_primitives": False}, observation="pixels")
    seen, _ = env.reset(seed=int(recording.episode_seed[0]), options={"instance_index": int(recording.room[0])})
    assert np.array_equal(seen, data.observation[0])
    seen, *_ = env.step(int(recording.option[0]))
    assert np.array_equal(seen, data.next_observation[0])


def test_one_is_tested_with_the_actions_that_the_recording_was_recorded_with():
    for kind, count in (("play", 3), ("explore", 6)):
        env = load_data(make_recording(kind), observation="features").make_env(True, 0.99)
        assert env.action_space.n == count
        env.close()


def test_the_length_of_a_data_set_is_that_of_its_level():
    recording = make_recording()
    counts = [len(load_data(recording, level=level)) for level in ("decisions", "primitives")]
    assert counts[0] == len(load_data(recording)) < counts[1]
    assert counts == [len(recording.option), len(recording.action)]


def test_tensors_hold_the_same_numbers():
    data = load_data(make_recording(), observation="features").read()
    tensors = to_torch(data)
    assert type(tensors) is type(data) and tensors.mask.dtype.is_floating_point is False
    for mine, theirs in zip(data, tensors, strict=True):
        assert np.array_equal(mine, theirs.numpy())


def test_a_recording_whose_episodes_end_elsewhere_here_is_refused_with_the_episode():
    recording = make_recording()
    flipped = recording.action.copy()
    flipped[: int(recording.duration[: recording.decisions[0]].sum())] = 4  # turns on the spot
    wrong = dataclasses.replace(recording, action=flipped)
    with pytest.raises(FileReadError, match="episode 0 ends cut.*recorded as terminated"):
        load_data(wrong, observation="features").read()


@pytest.mark.parametrize("changed", [1, -1])
def test_a_recording_whose_episode_is_longer_or_shorter_than_what_was_recorded_is_refused(changed):
    """One primitive more after the end, which the replay never comes to, or one fewer, after which it goes on."""
    recording = make_recording()
    decision = int(recording.decisions[0]) - 1
    length = int(recording.duration[: decision + 1].sum())
    assert recording.end[0] == 1 and recording.duration[decision] > 1
    action = np.insert(recording.action, length, 0) if changed == 1 else np.delete(recording.action, length - 1)
    duration = recording.duration.copy()
    duration[decision] = length + changed - duration[:decision].sum()
    words = (rf"episode 0 ends terminated after {length} .* recorded as terminated after {length + 1}" if changed == 1
             else rf"episode 0 ends cut after {length - 1} .* recorded as terminated after {length - 1}")
    for level in ("decisions", "primitives"):
        with pytest.raises(FileReadError, match=words):
            load_data(dataclasses.replace(recording, action=action, duration=duration), "features", level).read()


@pytest.mark.parametrize("level", ["decisions", "primitives"])
def test_an_episode_that_the_horizon_ends_is_a_trajectorys_last_and_does_not_terminate(level):
    """In two rooms of `pair`, explored for a horizon each."""
    whole = make_recording("explore")
    assert whole.end.tolist() == [2, 2] and len(whole.action) == 2 * whole.rooms[0].horizon
    data = load_data(whole, observation="features", level=level).read()
    assert np.flatnonzero(data.last).tolist() == [999, 1999] and not data.terminated.any()
    assert np.flatnonzero(np.diff(data.trajectory)).tolist() == [999]


@pytest.mark.parametrize(("arguments", "error"), [
    ({"level": "options"}, ConfigError), ({"gamma": 1.5}, ConfigError), ({"observation": "smell"}, UnknownNameError),
    ({"rooms": "nonsense"}, UnknownNameError), ({"gamma": math.nan}, ConfigError)])
def test_impossible_arguments_are_refused(arguments, error):
    with pytest.raises(error):
        load_data(save_small(), **arguments)


@pytest.mark.parametrize("read", [
    lambda data: data.read_decisions(gamma=5), lambda data: data.blocks(gamma=math.nan),
    lambda data: data.blocks(size=0), lambda data: data.blocks("x"), lambda data: data.blocks(size=True)])
def test_impossible_ways_to_read_are_refused_before_anything_is_replayed(read):
    with pytest.raises(ConfigError):
        read(load_data(save_small()))
    names = {load_data(save_small(), rooms=rooms).test_rooms.name for rooms in ("own", "train", "test")}
    assert len(names) == 3


def test_unknown_and_unrecorded_data_sets_are_told_with_the_next_step(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnknownNameError, match="pair-play-v1"):
        load_data("pair-plya-v1")
    with pytest.raises(FileReadError, match="hrl-escape data make pair-play-10m-v1"):
        load_data("pair-play-10m-v1")
