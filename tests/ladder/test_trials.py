"""Trials: several attempts at one room as one episode, in real rooms."""

import gymnasium
import numpy as np
import pytest

import hrl_escape  # noqa: F401  # registers environments
from hrl_escape.agents.algorithms.random import RandomAgent
from hrl_escape.agents.training.evaluation import evaluate, evaluate_trials
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.errors import ConfigError
from hrl_escape.ladder.instance_set import InstanceSet
from hrl_escape.ladder.trials import TrialsEnv
from hrl_escape.options.memory import MEMORY_WORDS, DecisionMemory
from hrl_escape.options.options_env import OptionsEnv

CONFIG = RoomConfig(
    room=ShapeConfig(width=8, depth=8), robot=RobotConfig(body_radius=0.4, turn_step_deg=30), horizon=120,
    puzzle=ButtonsConfig(count=2, graph=GraphConfig(kind="chain", relabel=False), buttons=Panels(width=1.0)))
ROOMS = InstanceSet("three", CONFIG, [3, 4, 5])
ESCAPE = (0, 1, 2)  # both buttons in order, then the exit


def make_env(trials: int) -> TrialsEnv:
    return TrialsEnv(OptionsEnv(ROOMS.make_env(observation="objects"), include_primitives=False), trials)


def test_an_episode_is_so_many_trials_in_one_room_each_from_its_start():
    env = make_env(3)
    first, begun = env.reset(seed=1, options={"instance_index": 2})
    assert begun["trial"] == 0
    ends = []
    for trial in range(3):
        for number, action in enumerate(ESCAPE):
            observation, _, terminated, truncated, info = env.step(action)
            assert info["trial"] == trial and info["trial_ended"] == (number == 2)
            assert env.unwrapped.instance == ROOMS[2]
        ends.append((terminated, truncated))
        assert info["is_success"]
        if trial < 2:
            np.testing.assert_array_equal(observation, first)
            np.testing.assert_array_equal(info["action_mask"], begun["action_mask"])
    assert ends == [(False, False), (False, False), (True, False)]
    assert env.reset(seed=1)[1]["trial"] == 0, "a new episode begins with its first trial"


def test_a_trial_out_of_time_is_no_success_and_the_last_one_truncates():
    env = make_env(2)
    env.reset(seed=1)
    ended = []
    while len(ended) < 2:
        _, _, terminated, truncated, info = env.step(2)  # at the shut exit, for ever
        if info["trial_ended"]:
            ended.append((info["is_success"], terminated, truncated))
    assert ended == [(False, False, False), (False, False, True)]


def test_a_single_room_can_be_tried_several_times():
    room = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=ROOMS[0], disable_env_checker=True)
    env = TrialsEnv(room, 2)
    env.reset(seed=0)
    done = sum(env.step(0)[4]["trial_ended"] for _ in range(2 * CONFIG.horizon))
    assert done == 2


def test_memories_last_through_trials_and_no_further():
    env = DecisionMemory(make_env(2))
    words = len(env.observation_space.words)

    def read(observation):
        rows = len(env.observation_space.rows)
        return observation[: rows * words].reshape(rows, words)[:, -len(MEMORY_WORDS):]

    env.reset(seed=1)
    for action in (1, *ESCAPE):  # the second button too early
        observation, *_, info = env.step(action)
    assert info["trial_ended"]
    failed, _, rank = read(observation).T
    assert failed[:3].tolist() == [0, 1, 0], "with nothing lit the second button fails, as the first trial showed"
    assert rank[:2].tolist() == [1, 0.5], "and this is the order in which they came on"
    assert not read(env.reset(seed=1)[0]).any()
    for action in ESCAPE:
        observation, *_ = env.step(action)
    assert not read(observation)[:, 0].any(), "an escape fails nothing, though the next trial's exit is shut again"


def test_each_trial_is_evaluated_over_all_episodes():
    env = make_env(2)
    agent = RandomAgent(env.observation_space, env.action_space, seed=0)
    seen = []
    first, second = evaluate_trials(agent, env, 4, 2, seed=7, after_episode=lambda: seen.append(env.unwrapped.instance))
    assert len(seen) == 4 and len(first.lengths) == len(second.lengths) == 4
    assert first.lengths != second.lengths, "chance draws anew in the second trial"
    whole = evaluate(agent, env, 4, seed=7)
    np.testing.assert_array_equal(np.add(first.lengths, second.lengths), whole.lengths)
    np.testing.assert_array_equal(second.successes, whole.successes)
    np.testing.assert_allclose(np.add(first.returns, second.returns), whole.returns)


def test_no_trial_is_refused():
    with pytest.raises(ConfigError, match="trials"):
        make_env(0)
