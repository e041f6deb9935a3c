"""Seeds of any size, sampling that goes on across rooms, limits of steps, and infos that a user may write into."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import hrl_escape
from hrl_escape.agents import train
from hrl_escape.errors import ConfigError, UnsupportedError, UnsupportedSpaceError
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.text import RoomSession
from tests.covering import cover, thin

FLAT, OPTIONS = "hrl_escape/PaperTwoButton-v1", "hrl_escape/PaperTwoButtonOptions-v1"
VELOCITIES = "hrl_escape/EscapeRoomContinuous-v1"

# --- seeds ----------------------------------------------------------------------------------------

LARGE = [2**63 - 1, 2**63, 2**64 - 1, 2**64, 2**70 + 1]
STARTS = {"config": "clutter"}  # its robot starts in many places


@pytest.mark.nightly_for(
    "hrl_escape/EscapeRoomOptions-v1-18446744073709551615", "hrl_escape/EscapeRoomOptions-v1-9223372036854775807")
@pytest.mark.parametrize("seed", thin(LARGE, 2))
@pytest.mark.parametrize("name", ["hrl_escape/EscapeRoom-v1", "hrl_escape/EscapeRoomOptions-v1", VELOCITIES])
def test_a_seed_of_any_size_begins_the_same_episode_alone_and_in_a_batch(name, seed):
    alone = [gymnasium.make(name, **STARTS).reset(seed=seed + room)[0] for room in range(2)]
    batch = gymnasium.make_vec(name, num_envs=2, **STARTS)
    np.testing.assert_allclose(batch.reset(seed=seed)[0], alone, atol=1e-6)
    np.testing.assert_allclose(batch.reset(seed=[seed, seed + 1])[0], alone, atol=1e-6)
    np.testing.assert_allclose(batch.reset(seed=seed)[0], alone, atol=1e-6)


def test_large_seeds_differ_and_small_ones_are_their_own_keys():
    env = gymnasium.make("hrl_escape/EscapeRoom-v1", **STARTS)
    keys = []
    for seed in (*LARGE, 0, 1, 5):
        env.reset(seed=seed)
        keys.append(env.unwrapped.get_state().noise_key)
    assert len(set(keys)) == len(keys)


def test_seeds_of_any_size_reach_text_streams_and_ladder():
    RoomSession(gymnasium.make("hrl_escape/EscapeRoom-v1")).reset(seed=2**64)
    gymnasium.make("hrl_escape/Ladder-v1").reset(seed=2**64)
    rooms = BatchedOptionsEnv(2, "clutter")
    first = rooms.reset(2**64).clone()
    rooms.reset(2**64 + 1)
    np.testing.assert_array_equal(rooms.observation[0], first[1])


@pytest.mark.parametrize("seed", [-1, 0.5, "1", True, [0, -1]])
@pytest.mark.parametrize("name", [FLAT, OPTIONS])
def test_seeds_that_are_none_are_refused(name, seed):
    with pytest.raises(ConfigError, match="a whole number of at least 0"):
        gymnasium.make_vec(name, num_envs=2).reset(seed=seed)


# --- sampling -------------------------------------------------------------------------------------

CHANGES = {
    "drawn anew": ("hrl_escape/Clutter-v1", {"resample_instance": True}, [None] * 3),
    "by seed": ("hrl_escape/Clutter-v1", {}, [{"instance_seed": seed} for seed in range(3)]),
    "of a set": ("hrl_escape/Ladder-v1", {"rung": "pair"}, [None] * 3),
    "velocities": (VELOCITIES, {"config": "clutter"}, [{"instance_seed": seed} for seed in range(3)]),
    "options": ("hrl_escape/ClutterOptions-v1", {"resample_instance": True, "option_features": True}, [None] * 3),
}


@pytest.mark.nightly_for("drawn anew")
@pytest.mark.parametrize("change", CHANGES)
def test_samples_go_on_as_seeded_when_the_room_changes(change):
    name, arguments, resets = CHANGES[change]

    def sample(resets):
        env = gymnasium.make(name, disable_env_checker=True, **arguments)
        env.reset(seed=7)
        env.action_space.seed(3)
        env.observation_space.seed(3)
        drawn, rooms = [], set()
        for options in resets:
            env.reset(options=options)
            rooms.add(env.unwrapped.instance.id)
            drawn += [np.asarray(env.action_space.sample()).tolist() for _ in range(4)]
            drawn.append(env.observation_space.sample().tolist())
        env.close()
        return drawn, rooms

    drawn, rooms = sample(resets)
    assert len(rooms) > 1 and drawn == sample(resets)[0]
    actions, begun = [each for n, each in enumerate(drawn) if n % 5 < 4], gymnasium.make(name, **arguments)
    begun.action_space.seed(3)
    assert actions == [np.asarray(begun.action_space.sample()).tolist() for _ in actions]


def test_a_room_with_other_spaces_goes_on_with_the_same_random_numbers():
    rooms = [hrl_escape.generate(hrl_escape.get_preset(name), 0) for name in ("paper-one-button", "ten-button")]

    def sample():
        env = gymnasium.make("hrl_escape/EscapeRoom-v1", instances=rooms, disable_env_checker=True)
        env.action_space.seed(3)
        env.observation_space.seed(4)
        drawn = []
        for index in (1, 0, 1):
            env.reset(options={"instance_index": index})
            drawn.append((env.action_space.sample(), env.observation_space.sample().tolist()))
        return drawn

    drawn = sample()
    assert drawn == sample() and len(drawn[0][1]) != len(drawn[1][1])


# --- limits ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name, mode", cover([FLAT, OPTIONS, VELOCITIES], list(AutoresetMode)))
def test_a_limit_of_steps_means_the_same_for_many_rooms_as_for_one(name, mode):
    one, many = gymnasium.make(name, max_episode_steps=3), gymnasium.make_vec(
        name, num_envs=2, max_episode_steps=3, autoreset_mode=mode)
    assert one.spec.max_episode_steps == many.spec.max_episode_steps == 3
    one.reset(seed=0)
    many.reset(seed=[0, 0])
    still = one.action_space.sample() * 0
    for _ in range(2):
        for step in range(3):
            truncated = one.step(still)[3]
            cut = many.step(np.stack([still] * 2))[3].tolist()
            assert cut == [truncated] * 2 == [step == 2] * 2
        one.reset()
        if mode == AutoresetMode.NEXT_STEP:
            many.step(np.stack([still] * 2))
        elif mode == AutoresetMode.DISABLED:
            many.reset()


@pytest.mark.nightly_for("hrl_escape/PaperTwoButtonOptions-v1")
@pytest.mark.parametrize("name", [FLAT, OPTIONS])
def test_the_horizon_stays_where_a_limit_is_later_and_the_limit_is_part_of_the_description(name):
    config = {**hrl_escape.get_preset("paper-two-button").to_dict(), "horizon": 2}
    many = gymnasium.make_vec(name, num_envs=1, config=config, max_episode_steps=5)
    many.reset(seed=0)
    assert [many.step([4])[3].tolist() for _ in range(2)] == [[False], [True]]
    assert many.spec.max_episode_steps == 2
    described = [gymnasium.make_vec(name, num_envs=1, **limit).unwrapped.describe()
                 for limit in ({}, {"max_episode_steps": -1}, {"max_episode_steps": 5})]
    assert described[0] == described[1] == {n: v for n, v in described[2].items() if n != "max_episode_steps"}
    for limit in (0, -2, 1.5, True):
        with pytest.raises(ConfigError, match="max_episode_steps"):
            gymnasium.make_vec(name, num_envs=1, max_episode_steps=limit)


def test_training_in_many_rooms_refuses_a_limit_of_decisions():
    rooms = gymnasium.make_vec(OPTIONS, num_envs=2, max_episode_steps=5)
    with pytest.raises(UnsupportedError, match="counts decisions.*set the horizon"):
        train("smdp-ppo+primitives", rooms, primitives=10)


@pytest.mark.parametrize(("name", "steps"), [
    (FLAT, 1000), (OPTIONS, 1000), (VELOCITIES, 10_000),
    pytest.param("hrl_escape/Ladder-v1", 1000, marks=pytest.mark.nightly)])
def test_specifications_give_the_horizon_and_make_the_same_again(name, steps):
    one = gymnasium.make(name)
    assert one.spec.max_episode_steps == steps and gymnasium.make(one.spec).spec == one.spec
    many = gymnasium.make_vec(name, num_envs=2)
    assert many.spec.max_episode_steps == steps and gymnasium.make_vec(many.spec).spec == many.spec
    assert gymnasium.spec(name).max_episode_steps is None


# --- infos and spaces of batches --------------------------------------------------------------------


@pytest.mark.parametrize("output", ["numpy", "torch"])
@pytest.mark.parametrize("name", [FLAT, OPTIONS, VELOCITIES])
def test_the_masks_of_infos_may_be_written_into(name, output):
    env = gymnasium.make_vec(name, num_envs=3, output=output, max_episode_steps=1, autoreset_mode="SameStep")
    _, infos = env.reset(seed=0)
    infos["_is_success"][:] = False
    assert infos["_pressed"].tolist() == [True] * 3 == env.reset(seed=0)[1]["_is_success"].tolist()
    actions = env.action_space.sample() * 0
    if output == "torch":
        actions = env.unwrapped._take(actions)
    *_, truncated, infos = env.step(actions)
    infos["_final_obs"][:] = False
    others = infos["_final_info"], infos["final_info"]["_is_success"], truncated
    assert [each.tolist() for each in others] == [[True] * 3] * 3


@pytest.mark.nightly_for("Ladder", "PaperOneButtonOptions", "LightsOutOptions")
@pytest.mark.parametrize("name", ["PaperOneButton", "PaperOneButtonOptions", "LightsOutOptions", "Ladder",
                                  "EscapeRoomContinuous"])
def test_one_id_has_the_same_observations_for_one_room_and_for_many(name):
    one, many = gymnasium.make(f"hrl_escape/{name}-v1"), gymnasium.make_vec(f"hrl_escape/{name}-v1", num_envs=2)
    assert one.observation_space == many.single_observation_space
    assert one.action_space == many.single_action_space


@pytest.mark.nightly
def test_rooms_of_a_ladder_with_options_are_a_vector_environment():
    many = gymnasium.make_vec("hrl_escape/Ladder-v1", num_envs=2, options={"include_primitives": False}, slice="0..2")
    one = gymnasium.make("hrl_escape/Ladder-v1", options={"include_primitives": False}, slice="0..2")
    assert many.single_observation_space == one.observation_space and many.single_action_space == one.action_space
    many.reset(seed=0)
    assert (many.step(many.action_space.sample() * 0)[4]["duration"] >= 1).all()


WRONG = r"`eval_env` has observations of shape \(5,\), float32,.*trained on observations of shape \(7,\).*observation="


@pytest.mark.parametrize("make", [gymnasium.make, lambda name: gymnasium.make_vec(name, num_envs=2)])
def test_an_evaluation_environment_with_other_observations_is_refused(make):
    other = gymnasium.make("hrl_escape/PaperOneButtonOptions-v1", observation="features")
    with pytest.raises(UnsupportedSpaceError, match=WRONG):
        train("smdp-ppo+primitives", make("hrl_escape/PaperOneButtonOptions-v1"), eval_env=other, primitives=10)


def test_an_evaluation_environment_with_other_bounds_is_accepted():
    wide = gymnasium.make(FLAT, config={**hrl_escape.get_preset("paper-two-button").to_dict(), "horizon": 5})
    wide.observation_space.high[:] += 1
    train("random", gymnasium.make(FLAT), eval_env=wide, primitives=5, eval_episodes=1)
