"""Environments whose own `info` has keys to which this package gives a meaning, and rewards of other shapes."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from hrl_escape import OptionsEnv, train
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.errors import StepContractError
from hrl_escape.options import ScriptedOption
from tests.covering import thin


class Six(gymnasium.Env):
    """Six steps that pay 1 each."""

    observation_space = spaces.Box(0, 1, (2,), np.float32)
    action_space = spaces.Discrete(2)

    def __init__(self, info=None, reward=1.0):
        self.info, self.reward = info or {}, reward

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time = 0
        return np.zeros(2, np.float32), dict(self.info)

    def step(self, action):
        self.time += 1
        return np.zeros(2, np.float32), self.reward, self.time >= 6, False, dict(self.info)


KINDS = {
    "flat": ("q-learning", lambda env: env),
    "options": ("smdp-q-learning+primitives", lambda env: OptionsEnv(env, [ScriptedOption("both", [1, 1])])),
    "two levels": ("smdp-q-learning+primitives", lambda env: OptionsEnv(
        OptionsEnv(env, [ScriptedOption("both", [1, 1])]), [ScriptedOption("twice", [2, 2])])),
}
each_kind = pytest.mark.parametrize("kind", KINDS)


def run(kind, info=None, reward=1.0):
    agent, wrap = KINDS[kind]
    return train(agent, wrap(Six(info, reward)), primitives=24, eval_every=24, eval_episodes=1)


@each_kind
@pytest.mark.parametrize("info", thin([
    {"duration": 0.04}, {"duration": None}, {"duration": 1}, {"rewards": {"speed": 0.5}}, {"rewards": 3.0},
    {"discount": 0.5}, {"discounted_reward": 9.0}, {"summed_reward": 9.0}, {"option": "call"}, {"option": None},
    {"option": {"strike": 3}}, {"option": 7}, {"action_mask": None}, {"action_mask": [True, False]},
    {"success": np.array([1])}, {"is_success": None}, {"primitives": 1000},
    {"pressed": [1, 2]}, {"trace": "long"}, {"trace": np.zeros(3)}, {"trace": [(1, 2)]}, {"calls": 3},
    {"progress": "half"}, {"progress": None}, {"instance": 4},
], 3), ids=str)
def test_they_are_left_alone_and_the_numbers_are_right(kind, info):
    result = run(kind, info)
    (evaluation, *_) = result.evaluations
    success = True if "success" in info else None
    assert (evaluation.returns, evaluation.lengths, evaluation.successes) == ((6.0,), (6,), (success,))
    assert {(episode.episode_return, episode.length) for episode in result.episodes} == {(6.0, 6)}


@each_kind
@pytest.mark.parametrize(("info", "message"), [
    ({"duration": 3}, r"info\['duration'\] .* is 3, but info has neither 'rewards' nor .* rename the key"),
    ({"duration": 3, "rewards": {"a": 1, "b": 2, "c": 3}}, r"info\['duration'\] .* is 3, but"),
    ({"duration": 2, "rewards": ["much", "more"]}, "rewards must be numbers"),
    ({"action_mask": np.zeros(3)}, r"shape \(3,\); the action space needs \(2,\)"),
    ({"success": np.nan}, r"info\['success'\] is nan at the last step .* True, False, 1 or 0"),
    ({"success": "no"}, r"info\['success'\] is 'no' at the last step"),
    ({"success": {"a": 1}}, r"info\['success'\] is \{'a': 1\} at the last step"),
    ({"is_success": 0.7}, r"info\['is_success'\] is 0.7"),
    ({"progress": 37}, r"info\['progress'\] is 37; it must be a number from 0 to 1"),
    ({"progress": np.nan}, r"info\['progress'\] is nan"),
], ids=str)
def test_where_they_cannot_be_read_one_error_says_so(kind, info, message):
    with pytest.raises(StepContractError, match=message):
        run(kind, info)


@each_kind
@pytest.mark.parametrize("reward", [np.array([1.0, 2.0]), [1.0, 2.0], {"speed": 1.0}, None, "much"], ids=str)
def test_a_reward_of_several_numbers_is_refused_with_the_advice_to_weigh_them(kind, reward):
    with pytest.raises(StepContractError, match="rewards must be numbers, one a step. .* weigh them in a wrapper"):
        run(kind, reward=reward)


@each_kind
@pytest.mark.parametrize("reward", [np.nan, np.inf])
def test_a_reward_that_is_not_finite_is_refused(kind, reward):
    with pytest.raises(StepContractError, match=f"is {reward}; rewards must be finite numbers"):
        run(kind, reward=reward)


@each_kind
@pytest.mark.parametrize("reward", [1, True, np.float32(1), np.int64(1), np.array(1.0), np.array([1.0])], ids=repr)
def test_one_number_of_any_type_is_a_reward(kind, reward):
    assert run(kind, reward=reward).evaluations[0].returns == (6.0,)


def test_a_trace_of_the_environment_below_is_not_taken_for_that_of_the_decision():
    lower = OptionsEnv(Six({"trace": [(1, 2, 3, 4)], "calls": (5,)}), [ScriptedOption("both", [1, 1])], trace=True)
    env = OptionsEnv(lower, [ScriptedOption("twice", [2, 2])])
    env.reset(seed=0)
    info = env.step(3)[4]
    assert info["duration"] == 4 and "trace" not in info and "calls" not in info
    agent = run("flat").agent
    assert evaluate(agent, Six({"trace": [(1, 2, 3, 4)] * 2}), 1).returns == (6.0,)
