"""Goals as a Dict view: the convention of goal-conditioned learners, held by their own checks and replay buffer."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import hrl_escape
from hrl_escape.agents import make_transition
from hrl_escape.env import ButtonsConfig, RoomConfig, generate
from hrl_escape.env.config import Between
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.puzzles.lights_out import list_flips
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.options import OptionsEnv
from hrl_escape.planning import RoomPlanner
from hrl_escape.sets import GoalsEnv

assert hrl_escape  # registers the environments


def make_goals(name: str = "FourButtonChain", **arguments) -> GoalsEnv:
    return GoalsEnv(gymnasium.make(f"hrl_escape/{name}-v1"), **arguments)


def test_the_view_keeps_gymnasiums_contract():
    check_env(make_goals(), skip_render_check=True)


def test_goals_of_a_chain_are_beginnings_of_it():
    env = make_goals()
    room = env.unwrapped.instance
    order = []
    while len(order) < 4:
        order += [i for i in range(4) if i not in order and all(a in order for a, b in room.puzzle.edges if b == i)]
    seen = {tuple(env.reset(seed=seed)[0]["desired_goal"].tolist()) for seed in range(40)}
    assert seen == {(*(float(i in order[:n]) for i in range(4)), 0.0) for n in range(1, 5)}


def test_goals_of_lights_out_are_sums_of_flips():
    env = make_goals("LightsOut")
    flips = list_flips(9, 3)
    reachable = {0}
    for word in flips:
        reachable |= {each ^ word for each in reachable}
    for seed in range(10):
        desired = env.reset(seed=seed)[0]["desired_goal"]
        assert sum(1 << i for i, on in enumerate(desired) if on) in reachable and desired.any()


@pytest.mark.nightly
def test_the_goal_ends_the_episode_and_the_reward_is_that_of_the_two_goals():
    env = GoalsEnv(OptionsEnv(gymnasium.make("hrl_escape/FourButtonChain-v1"), include_primitives=False))
    ended = 0
    for seed in range(6):
        seen, info = env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        for _ in range(200):
            seen, reward, terminated, truncated, info = env.step(int(rng.choice(np.flatnonzero(info["action_mask"]))))
            achieved = bool((seen["achieved_goal"] == seen["desired_goal"]).all())
            assert info["is_success"] == achieved == (reward == 0.0) and info["room_reward"] < 0
            assert reward == env.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
            if terminated or truncated:
                break
        ended += info["is_success"]
    assert ended >= 3


def test_rewards_of_many_pairs_of_goals_are_computed_at_once():
    env = make_goals()
    achieved, desired = np.eye(4, dtype=np.float32), np.tile(np.eye(4, dtype=np.float32)[1], (4, 1))
    assert env.compute_reward(achieved, desired, [{}] * 4).tolist() == [-1.0, 0.0, -1.0, -1.0]


def test_the_same_seed_draws_the_same_goal_and_goals_differ():
    draws = [[make_goals().reset(seed=seed)[0]["desired_goal"].tolist() for seed in range(8)] for _ in range(2)]
    assert draws[0] == draws[1] and len({tuple(goal) for goal in draws[0]}) > 2


def test_rooms_of_different_sizes_share_one_goal_space():
    config = RoomConfig(puzzle=ButtonsConfig(count=Between(2, 5)))
    rooms = [generate(config, seed) for seed in range(3)]
    env = GoalsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", instances=rooms))
    for seed in range(5):
        seen, _ = env.reset(seed=seed)
        assert env.observation_space.contains(seen) and seen["desired_goal"].shape == (6,)


def escape(env: gymnasium.Env, seed: int) -> list[tuple]:
    """Choose at random among presses and the exit until the episode ends; the steps."""
    info, rng, steps = env.reset(seed=seed)[1], np.random.default_rng(seed), []
    while not (steps and (steps[-1][2] or steps[-1][3])):
        steps.append(env.step(int(rng.choice(np.flatnonzero(info["action_mask"])))))
        info = steps[-1][4]
    return steps


@pytest.mark.nightly
def test_the_exit_is_one_goal_whatever_is_lit_there():
    env = GoalsEnv(OptionsEnv(gymnasium.make("hrl_escape/FourButtonChain-v1"), include_primitives=False), exits=1.0)
    reached = 0
    for seed in range(4):
        assert env.reset(seed=seed)[0]["desired_goal"].tolist() == [0, 0, 0, 0, 1]
        *steps, (seen, reward, terminated, _, info) = escape(env, seed)
        assert all(step[0]["achieved_goal"][-1] == 0 and step[1] == -1 for step in steps)
        assert max(step[0]["achieved_goal"].sum() for step in steps) == 4, "patterns are achieved on the way"
        assert terminated == info["room_success"] == info["is_success"] == (reward == 0.0)
        assert not terminated or seen["achieved_goal"].tolist() == [0, 0, 0, 0, 1]
        reached += terminated
    assert reached >= 2


def test_leaving_the_room_achieves_no_pattern_and_ends_the_episode():
    room = generate(RoomConfig(puzzle=ButtonsConfig(count=2, graph=GraphConfig(kind="edges"), goal=0)), 0)
    env = GoalsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=room), operators=1)
    seed = next(seed for seed in range(40) if env.reset(seed=seed)[0]["desired_goal"].tolist() == [0, 1, 0])
    env.reset(seed=seed)
    plan = RoomPlanner(room).solve(env.unwrapped.get_state())
    *_, (seen, reward, terminated, truncated, info) = [env.step(action) for action in plan.primitives]
    assert (reward, terminated, truncated, info["is_success"], info["room_success"]) == (-1.0, True, False, False, True)
    assert seen["achieved_goal"].tolist() == [0, 0, 1]


def test_a_share_of_the_episodes_asks_for_the_exit():
    env = make_goals(exits=0.25)
    asked = [bool(env.reset(seed=seed)[0]["desired_goal"][-1]) for seed in range(200)]
    assert 30 <= sum(asked) <= 70
    assert not any(make_goals().reset(seed=seed)[0]["desired_goal"][-1] for seed in range(40))


def test_learners_over_options_are_paid_for_the_goal_and_not_for_the_room():
    env = GoalsEnv(OptionsEnv(gymnasium.make("hrl_escape/FourButtonChain-v1"), include_primitives=False), exits=1.0)
    steps = escape(env, 0)
    for seen, reward, *ends, info in steps:
        made = make_transition(seen, 0, np.ones(5, bool), (seen, reward, *ends, info), 0.99)
        assert made.summed_reward == reward and made.duration == info["duration"]
        assert made.reward == pytest.approx(0.99 ** (info["duration"] - 1) * reward) == info["discounted_reward"]
    assert any(step[4]["duration"] > 1 for step in steps)


@pytest.mark.slow  # ten seconds: pytest -m slow tests/sets/test_goals.py
def test_hindsight_replay_of_stable_baselines3_learns_from_the_view():
    sb3 = pytest.importorskip("stable_baselines3")
    env = GoalsEnv(OptionsEnv(gymnasium.make("hrl_escape/FourButtonChain-v1"), include_primitives=False))
    model = sb3.DQN("MultiInputPolicy", env, replay_buffer_class=sb3.HerReplayBuffer, learning_starts=60,
                    buffer_size=2000, seed=0, policy_kwargs={"net_arch": [16]})
    model.learn(150)
    batch = model.replay_buffer.sample(64)
    relabelled = batch.next_observations["achieved_goal"] == batch.observations["desired_goal"]
    assert (batch.rewards.squeeze(1) == relabelled.all(1).float() - 1).all() and relabelled.all(1).any()


def test_impossible_goals_are_refused():
    with pytest.raises(ConfigError, match="operators"):
        GoalsEnv(gymnasium.make("hrl_escape/FourButtonChain-v1"), operators=0)
    with pytest.raises(UnsupportedError, match="no goals to draw"):
        make_goals("PushBlock").reset(seed=0)
    for share in (-0.1, 1.5, True):
        with pytest.raises(ConfigError, match="exits"):
            make_goals(exits=share)
