"""The Gymnasium `VectorEnv`: the registered door, its reset modes, outputs, infos and refusals."""

import dataclasses
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

import hrl_escape
from hrl_escape.env.presets import PRESETS, get_preset, make_env_name
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import ActionError, BatchError, ClosedError, ConfigError, UnsupportedError
from tests.covering import thin

LEFT = 2


def short_room(horizon=4):
    return dataclasses.replace(generate(get_preset("paper-one-button"), 0), horizon=horizon)


def to_list(value):
    return value.tolist() if hasattr(value, "tolist") else list(value)


@pytest.mark.parametrize("name", thin(sorted(set(PRESETS) - {"push-block"}), 6))
def test_make_vec_gives_the_batched_engine_for_every_preset(name):
    env = gymnasium.make_vec(f"hrl_escape/{make_env_name(name)}-v1", num_envs=5)
    assert isinstance(env.unwrapped, EscapeRoomVectorEnv)
    one = gymnasium.make(f"hrl_escape/{make_env_name(name)}-v1")
    assert env.single_observation_space == one.observation_space
    assert env.single_action_space == one.action_space
    seen, infos = env.reset(seed=3)
    assert env.observation_space.contains(seen)
    env.action_space.seed(0)
    for _ in range(20):
        seen, reward, terminated, truncated, infos = env.step(env.action_space.sample())
        assert env.observation_space.contains(seen)
    assert reward.shape == terminated.shape == truncated.shape == (5,)
    assert infos["buttons_on"].shape == (5, len(env.unwrapped.instances[0].targets))
    one.close()
    env.close()


@pytest.mark.nightly
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_it_does_what_gymnasiums_own_vector_of_rooms_does(mode):
    instance = short_room(horizon=12)
    ours = EscapeRoomVectorEnv(3, instance=instance, autoreset_mode=mode, observation="features")
    theirs = SyncVectorEnv([lambda: hrl_escape.EscapeRoomEnv(instance=instance, observation="features")] * 3,
                           autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] == mode
    (mine, _), (other, _) = ours.reset(seed=0), theirs.reset(seed=0)
    assert np.abs(mine - other).max() < 1e-6
    rng = np.random.default_rng(1)
    for number in range(60):
        actions = rng.integers(6, size=3)
        if number % 7 == 3:
            actions[:] = LEFT
        mine, other = ours.step(actions), theirs.step(actions)
        assert np.abs(mine[0] - other[0]).max() < 1e-6
        for a, b in zip(mine[1:4], other[1:4], strict=True):
            assert a.tolist() == b.tolist()
        for key in ("primitives", "is_success", "buttons_on"):
            assert to_list(mine[4][key]) == to_list(other[4][key])
            assert to_list(mine[4][f"_{key}"]) == to_list(other[4][f"_{key}"])
        ended = mine[2] | mine[3]
        assert ("final_obs" in mine[4]) == (mode == AutoresetMode.SAME_STEP and ended.any())
        if ended.any() and mode == AutoresetMode.SAME_STEP:
            assert mine[4]["_final_obs"].tolist() == other[4]["_final_obs"].tolist() == ended.tolist()
            for i in np.flatnonzero(ended):
                assert np.abs(mine[4]["final_obs"][i] - other[4]["final_obs"][i]).max() < 1e-6
                for key in ("primitives", "is_success"):
                    assert mine[4]["final_info"][key][i] == other[4]["final_info"][key][i]
        if ended.any() and mode == AutoresetMode.DISABLED:
            mine, _ = ours.reset(options={"reset_mask": ended})
            other, _ = theirs.reset(options={"reset_mask": ended})
            assert np.abs(mine - other).max() < 1e-6
    theirs.close()


def test_torch_output_is_tensors_and_equals_numpy_output():
    envs = [EscapeRoomVectorEnv(4, "clutter", num_instances=2, output=output) for output in ("numpy", "torch")]
    for (array, infos), (tensor, more) in [tuple(env.reset(seed=1) for env in envs)]:
        assert isinstance(tensor, torch.Tensor)
        assert np.array_equal(array, tensor.numpy())
        assert infos["instance"].tolist() == more["instance_index"].tolist() == [0, 1, 0, 1]
    steps = [env.step(np.array([0, 1, 2, 3])) for env in envs]
    assert all(np.array_equal(a, b.numpy()) for a, b in zip(steps[0][:4], steps[1][:4], strict=True))
    assert torch.equal(envs[1].step(torch.tensor([0, 1, 2, 3]))[0], torch.from_numpy(envs[0].step([0, 1, 2, 3])[0]))


def test_torch_output_can_be_learnt_from():
    env = EscapeRoomVectorEnv(4, output="torch")
    seen, _ = env.reset(seed=0)
    network = torch.nn.Linear(seen.shape[1], 1)
    network(env.step(torch.zeros(4, dtype=torch.int64))[0]).sum().backward()
    assert network.weight.grad is not None


def test_observations_once_given_do_not_change():
    env = EscapeRoomVectorEnv(2)
    first, infos = env.reset(seed=0)
    kept, counted = first.copy(), infos["primitives"].copy()
    for _ in range(5):
        env.step([LEFT, LEFT])
    assert np.array_equal(first, kept)
    assert np.array_equal(infos["primitives"], counted)
    with pytest.raises(ValueError, match="read-only"):
        env.step([LEFT, LEFT])[4]["primitives"][0] = 0


def test_seeds_are_those_of_the_rooms():
    env = EscapeRoomVectorEnv(4, "clutter", instance_seed=5)
    together, _ = env.reset(seed=10)
    listed, _ = EscapeRoomVectorEnv(4, "clutter", instance_seed=5).reset(seed=[10, 11, 12, 13])
    assert np.array_equal(together, listed)
    env.reset()  # goes on with the streams: another episode, and no error
    fresh = EscapeRoomVectorEnv(2)
    fresh.reset()  # never seeded: takes some entropy
    assert len(set(fresh.room.state.seed.tolist())) == 2


def test_gymnasium_wrappers_read_its_infos():
    env = RecordEpisodeStatistics(EscapeRoomVectorEnv(3, instance=short_room(), autoreset_mode="NextStep"))
    env.reset(seed=0)
    lengths = []
    for _ in range(12):
        infos = env.step(np.array([LEFT] * 3))[4]
        if "episode" in infos:
            lengths += infos["episode"]["l"][infos["_episode"]].tolist()
    assert lengths == [4] * 6
    listed = DictInfoToList(EscapeRoomVectorEnv(2))
    _, infos = listed.reset(seed=0)
    assert [info["primitives"] for info in infos] == [0, 0]


def test_instances_can_be_given_and_drawn(tmp_path):
    rooms = [generate(get_preset("four-button-chain"), seed) for seed in range(3)]
    rooms[2].save(tmp_path / "room.json")
    env = EscapeRoomVectorEnv(7, instance=[rooms[0], rooms[1], tmp_path / "room.json"])
    assert [instance.id for instance in env.instances] == [room.id for room in rooms]
    _, infos = env.reset(seed=0)
    assert infos["instance"].tolist() == [0, 1, 2, 0, 1, 2, 0], "numbers, by which no room's graph can be looked up"
    drawn = EscapeRoomVectorEnv(60, instance=rooms, resample_instance=True)
    _, infos = drawn.reset(seed=0)
    assert set(infos["instance"].tolist()) == {0, 1, 2}


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"observation": "pixels"}, UnsupportedError, "vectorization_mode='sync'"),
        ({"render_mode": "human"}, UnsupportedError, "vectorization_mode='sync'"),
        ({"render_mode": "rgb_array", "camera": "chase"}, UnsupportedError, "'robot' or 'overhead'"),
        ({"render_mode": "rgb_array", "render_size": 84}, ConfigError, "a pair"),
        ({"render_mode": "rgb_array", "config": "arm-two-button"}, UnsupportedError, "cannot draw an arm"),
        ({"config": "push-block"}, UnsupportedError, "physics"),
        ({"output": "jax"}, ConfigError, "'numpy' or 'torch'"),
        ({"autoreset_mode": "never"}, ConfigError, "'NextStep', 'SameStep', 'Disabled'"),
        ({"num_instances": 0}, ConfigError, "at least 1"),
        ({"num_envs": 0}, ConfigError, "at least 1"),
        ({"device": "nowhere"}, ConfigError, "device"),
    ],
)
def test_a_wrong_argument_gets_one_clear_error(settings, error, words):
    with pytest.raises(error, match=words):
        EscapeRoomVectorEnv(**{"num_envs": 2} | settings)


def test_a_wrong_call_gets_one_clear_error():
    env = EscapeRoomVectorEnv(2, autoreset_mode="Disabled")
    with pytest.raises(ConfigError, match="reset_mask"):
        env.reset(seed=0, options={"state": 1})
    with pytest.raises(ConfigError, match="2 of them"):
        env.reset(seed=[1, 2, 3])
    env.reset(seed=0)
    with pytest.raises(BatchError, match=r"\(3,\)"):
        env.reset(options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(ConfigError, match="at least one room"):
        env.reset(options={"reset_mask": np.array([False, False])})
    with pytest.raises(BatchError, match="float64"):
        env.step(np.array([0.0, 1.0]))
    with pytest.raises(ActionError, match="7 is not one of 0 to 5"):
        env.step([7, 0])
    env.close()
    env.close()
    with pytest.raises(ClosedError):
        env.step([0, 0])


def test_importing_the_package_does_not_load_torch():
    make = "gymnasium.make('hrl_escape/PaperOneButton-v1')"
    code = f"import sys, hrl_escape, gymnasium; {make}; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
