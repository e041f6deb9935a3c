"""The flat environment through Gymnasium's own doors: checkers, wrappers, vectors, processes."""

import dataclasses
import json
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st

from hrl_escape.env.config import DynamicsConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.observations.base import list_observations
from hrl_escape.env.presets import PRESETS, get_preset, make_env_name
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import (
    ActionError,
    ClosedError,
    ConfigError,
    EscapeError,
    FileReadError,
    GenerationError,
    ResetNeededError,
    UnknownNameError,
)
from tests.command_line import run_here
from tests.covering import cover, thin
from tests.env.rooms import EXTREMES
from tests.forks import run_fork

IDS = ["hrl_escape/EscapeRoom-v1", *(f"hrl_escape/{make_env_name(name)}-v1" for name in PRESETS)]
KINDS = sorted(observation.name for observation in list_observations())


def test_every_preset_has_an_id():
    assert {f"hrl_escape/{name}-v1" for name in (
        "PaperOneButton", "PaperTwoButton", "PaperRandom", "Larg2019", "FourButtonChain", "ArmTwoButton", "Clutter",
        "TenButton", "TwentyButton", "BitFlip", "PushBlock")} <= set(IDS)
    assert set(IDS) <= set(gymnasium.registry)


CHECKED = sorted({(name, "features") for name in IDS} | {
    (f"hrl_escape/{name}-v1", kind) for kind in KINDS
    for name in ("PaperTwoButton", "ArmTwoButton", "PushBlock", "DoorKey", "Taxi")})
"""Every room, and every observation in rooms of each kind."""


@pytest.mark.parametrize(("name", "kind"), thin(CHECKED, 4))
def test_gymnasiums_checker_finds_nothing(name, kind):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(name, observation=kind, disable_env_checker=True)
        check_env(env.unwrapped, skip_render_check=True)
        env.close()


@pytest.mark.parametrize(("name", "kind"), thin(CHECKED, 8, 1))
def test_stable_baselines3s_checker_finds_nothing(name, kind):
    from stable_baselines3.common import env_checker as checker  # brings torch, which only this test needs
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        if kind == "state":  # the paper's vector has natural units; the checker would like them normalised
            warnings.filterwarnings("ignore", message=".*normalized.*")
        env = gymnasium.make(name, observation=kind)
        checker.check_env(env, skip_render_check=True)
        env.close()


@pytest.mark.nightly_for("hrl_escape/PuddleWorld-v1-egocentric", "hrl_escape/PuddleWorld-v1-state")
@pytest.mark.parametrize(("name", "kind"), cover(IDS, KINDS))
def test_observations_are_as_documented(name, kind):
    env = gymnasium.make(name, observation=kind)
    instance = env.unwrapped.instance
    joints, puzzle = instance.robot.joints, len(instance.puzzle.bounds)
    size = {"state": (6 + puzzle + joints,), "features": (4 + puzzle + joints,),
            "objects": (12 * (len(instance.targets) + len(instance.props) + 1) + joints,),
            "egocentric": (4 * len(instance.targets) + 3 * (len(instance.props) + 1) + joints + 16,),
            "pixels": (84, 84, 3)}[kind]
    observation, _ = env.reset(seed=0)
    assert observation.shape == size
    assert observation.dtype == (np.uint8 if kind == "pixels" else np.float32)
    if kind == "state":
        state = env.unwrapped.get_state()
        assert np.allclose(observation[:2], state[:2])
        assert np.isclose(observation[3], env.unwrapped.rules.get_heading(state))
    env.close()


def roll(env, actions):
    """Everything that happens under a sequence of actions, until the episode ends."""
    seen = []
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        pressed = info["pressed"].tolist()
        seen.append((observation.tobytes(), reward, terminated, truncated, info["primitives"], pressed))
        if terminated or truncated:
            break
    return seen


@settings(max_examples=25)
@given(st.sampled_from(["clutter", "larg-2019", "arm-two-button", "noisy", "door"]), st.integers(0, 2**31), st.data())
def test_set_state_continues_exactly(name, seed, data):
    env = EscapeRoomEnv(EXTREMES.get(name) or name, instance_seed=seed % 3)
    env.reset(seed=seed)
    draw = np.random.default_rng(seed).integers(env.action_space.n, size=40)
    roll(env, draw[: data.draw(st.integers(0, 20))])
    state = env.get_state()
    first = roll(env, draw[20:])
    env.reset(seed=seed + 1)
    env.set_state(state)
    assert env.get_state() == state
    assert roll(env, draw[20:]) == first
    env.close()


TRAJECTORY = """
import sys, json, hashlib, gymnasium, numpy as np, hrl_escape
env = gymnasium.make(sys.argv[1], **json.loads(sys.argv[2]))
digest = hashlib.sha256()
actions = np.random.default_rng(0)
for episode in range(10):
    observation, info = env.reset(seed=7 if episode == 0 else None)
    digest.update(observation.tobytes()); digest.update(info["instance"].encode())
    for _ in range(30):
        observation, reward, terminated, truncated, info = env.step(actions.integers(env.action_space.n))
        digest.update(observation.tobytes() + np.float64(reward).tobytes())
        if terminated or truncated: break
print(digest.hexdigest())
"""


@pytest.mark.nightly_for(
    "hrl_escape/Clutter-v1-arguments0", "hrl_escape/EscapeRoom-v1-arguments3",
    "hrl_escape/FourButtonChain-v1-arguments2")
@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("hrl_escape/Clutter-v1", {}),
        ("hrl_escape/ArmTwoButton-v1", {"observation": "egocentric"}),
        ("hrl_escape/FourButtonChain-v1", {"resample_instance": True}),
        ("hrl_escape/EscapeRoom-v1", {"config": EXTREMES["noisy"].to_dict()}),
    ],
)
def test_ten_resets_of_a_once_seeded_environment_repeat_in_another_process(name, arguments):
    assert run_here(TRAJECTORY, name, json.dumps(arguments)) == run_fork(TRAJECTORY, name, json.dumps(arguments),
                                                                         check=True).stdout


def test_resampling_draws_new_instances_from_the_episode_stream():
    env = gymnasium.make("hrl_escape/FourButtonChain-v1", resample_instance=True)
    seen = [env.reset(seed=3 if n == 0 else None)[1]["instance"] for n in range(5)]
    again = [env.reset(seed=3 if n == 0 else None)[1]["instance"] for n in range(5)]
    assert len(set(seen)) == 5
    assert seen == again
    fixed = gymnasium.make("hrl_escape/FourButtonChain-v1")
    assert len({fixed.reset()[1]["instance"] for _ in range(3)}) == 1
    assert fixed.reset(options={"instance_seed": 9})[1]["instance"] == generate(get_preset("four-button-chain"), 9).id
    env.close()
    fixed.close()


def test_info_tells_what_happened():
    env = gymnasium.make("hrl_escape/PaperOneButton-v1")
    _, info = env.reset(seed=0)
    flags = info["pressed"].tolist(), info["buttons_on"].tolist()
    assert (info["primitives"], info["is_success"], *flags) == (0, False, [0], [0])
    for _ in range(9):
        _, reward, terminated, _, info = env.step(2)
    assert (reward, terminated) == (99, True)
    flags = info["pressed"].tolist(), info["buttons_on"].tolist()
    assert (info["primitives"], info["is_success"], *flags) == (9, True, [1], [1])
    env.close()


def test_wrappers_of_gymnasium_work(tmp_path):
    env = gymnasium.make("hrl_escape/PaperOneButton-v1", render_mode="rgb_array", render_size=(160, 120))
    env = gymnasium.wrappers.TimeLimit(env, 20)
    env = gymnasium.wrappers.RecordEpisodeStatistics(env)
    env.reset(seed=0)
    for _ in range(9):
        *_, info = env.step(2)
    assert info["episode"]["r"] == 91
    assert info["episode"]["l"] == 9
    env.reset()
    assert [env.step(4)[3] for _ in range(20)] == [False] * 19 + [True]
    env.close()


@pytest.mark.nightly
def test_recording_a_video_works(tmp_path):
    env = gymnasium.make("hrl_escape/PaperOneButton-v1", render_mode="rgb_array", render_size=(160, 120))
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path), episode_trigger=lambda episode: True)
    env.reset(seed=0)
    for _ in range(9):
        env.step(2)
    env.close()
    assert [f.stat().st_size > 1000 for f in tmp_path.glob("*.mp4")] == [True]


@pytest.mark.nightly_for("async")
@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vector_environments_match_single_ones(mode):
    rooms = gymnasium.make_vec("hrl_escape/Clutter-v1", num_envs=2, vectorization_mode=mode)
    single = gymnasium.make("hrl_escape/Clutter-v1")
    try:
        first, _ = rooms.reset(seed=[5, 6])
        assert np.array_equal(first[1], single.reset(seed=6)[0])
        for action in (0, 4, 2, 2, 1):
            batch = rooms.step(np.array([action, action]))
            one = single.step(action)
            assert np.array_equal(batch[0][1], one[0])
            assert batch[1][1] == one[1]
    finally:
        rooms.close()
        single.close()


def test_environments_pickle_and_start_the_same_room():
    env = EscapeRoomEnv("clutter", instance_seed=4, observation="features")
    copy = pickle.loads(pickle.dumps(env))
    assert copy.instance == env.instance
    assert np.array_equal(copy.reset(seed=1)[0], env.reset(seed=1)[0])
    assert roll(copy, [0, 4, 2, 3]) == roll(env, [0, 4, 2, 3])
    env.close()
    copy.close()


def test_an_instance_can_be_given_as_object_or_file(tmp_path):
    instance = generate(get_preset("clutter"), 2)
    instance.save(tmp_path / "room.json")
    for source in (instance, tmp_path / "room.json", str(tmp_path / "room.json")):
        env = EscapeRoomEnv(instance=source)
        assert env.instance == instance
        env.close()
    with pytest.raises(ConfigError, match="resample_instance"):
        EscapeRoomEnv(instance=instance, resample_instance=True)


@pytest.mark.nightly
def test_many_rooms_live_in_one_process_and_all_is_freed():
    import pybullet

    config = get_preset("clutter")
    moved = dataclasses.replace(config, dynamics=DynamicsConfig(kind="physics"))
    rooms = [EscapeRoomEnv(moved) for _ in range(6)]
    clients = {env.room.physics.client for env in rooms}
    assert len(clients) == 6
    for env in rooms:
        env.reset(seed=0)
    rooms[0].step(0)
    assert rooms[1].get_state().primitives == 0
    for env in rooms:
        env.close()
        env.close()
    assert not any(pybullet.isConnected(client) for client in clients)


@pytest.mark.parametrize("action", [-1, 6, 99, 1.5, "forward", None, np.float64(2), [1]])
def test_an_action_outside_the_space_is_refused(action):
    env = EscapeRoomEnv("paper-one-button")
    env.reset(seed=0)
    with pytest.raises(ActionError, match="0 to 5"):
        env.step(action)
    env.close()


def test_calls_out_of_order_are_refused():
    env = EscapeRoomEnv("paper-one-button")
    with pytest.raises(ResetNeededError, match="reset"):
        env.step(0)
    with pytest.raises(ResetNeededError):
        env.get_state()
    env.reset(seed=0)
    for _ in range(9):
        env.step(2)
    with pytest.raises(ResetNeededError, match="ended"):
        env.step(2)
    env.close()
    for call in (lambda: env.step(0), env.reset, env.get_state, lambda: env.set_state(None)):
        with pytest.raises(ClosedError, match="closed"):
            call()


@pytest.mark.nightly_for("arguments7-GenerationError-button")
@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"config": "papper-one-button"}, UnknownNameError, "did you mean 'paper-one-button'"),
        ({"observation": "pixel"}, UnknownNameError, "did you mean 'pixels'"),
        ({"camera": "behind"}, UnknownNameError, "chase"),
        ({"render_mode": "ascii"}, ConfigError, "rgb_array"),
        ({"config": {"horizon": 0}}, ConfigError, "horizon"),
        ({"config": 7}, ConfigError, "config"),
        ({"instance": "/nowhere/room.json"}, FileReadError, "/nowhere/room.json"),
        ({"config": {"room": {"width": 5, "depth": 5}, "robot": {"body_radius": 2.2},
                     "puzzle": {"count": 40}}}, GenerationError, "button"),
    ],
)
def test_bad_arguments_give_one_clear_error(arguments, error, words):
    with pytest.raises(error, match=words) as caught:
        EscapeRoomEnv(**arguments)
    assert isinstance(caught.value, EscapeError)


def test_unknown_reset_options_are_refused():
    env = EscapeRoomEnv("paper-one-button")
    with pytest.raises(ConfigError, match="instance_seed"):
        env.reset(options={"instance": 3})
    env.close()


def test_start_poses_come_from_the_episode_seed():
    config = dataclasses.replace(EXTREMES["noisy"])
    env = EscapeRoomEnv(config)
    starts = {tuple(env.reset(seed=n)[0][:2]) for n in range(30)}
    assert len(starts) > 10
    assert tuple(env.reset(seed=4)[0][:2]) == tuple(env.reset(seed=4)[0][:2])
    env.close()
