"""Wrappers that change rewards: below options they act on every primitive, above and between they are refused."""

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import ClipReward, NormalizeReward, RecordEpisodeStatistics, TimeLimit, TransformReward

from hrl_escape import OptionsEnv, train
from hrl_escape.agents.agent import make_transition, set_option_discount
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.errors import StepContractError
from hrl_escape.options import ScriptedOption
from hrl_escape.options.options_env import make_options_env
from hrl_escape.sets.goals import GoalsEnv

GAMMA = 0.9
WRAPPERS = {
    "clip": lambda env: ClipReward(env, -1, 1),
    "normalize": lambda env: NormalizeReward(env, gamma=GAMMA),
    "transform": lambda env: TransformReward(env, lambda reward: 0.01 * reward),
}
each_wrapper = pytest.mark.parametrize("wrap", WRAPPERS.values(), ids=WRAPPERS)


class Line(gymnasium.Env):
    """Twelve steps; the step to a place pays 1 + its number."""

    observation_space = gymnasium.spaces.Discrete(13)
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 0
        return 0, {}

    def step(self, action):
        self.place += 1
        return self.place, 1.0 + self.place, self.place == 12, False, {}


def make_lower(env=None, **arguments):
    return OptionsEnv(Line() if env is None else env, [ScriptedOption("three", [1, 1, 1])], discount=GAMMA, **arguments)


def make_upper(env, **arguments):
    return OptionsEnv(env, [ScriptedOption("two-of-three", [2, 2])], discount=GAMMA, **arguments)


def train_on(env, gamma=GAMMA, **arguments):
    return train("smdp-q-learning+primitives", env, primitives=40, settings={"gamma": gamma},
                 **{"eval_episodes": 0, **arguments})


@each_wrapper
def test_a_reward_wrapper_above_options_is_refused_with_the_advice_to_put_it_below(wrap):
    with pytest.raises(StepContractError, match=r"a wrapper above OptionsEnv changed it.* below, as in OptionsEnv\("):
        train_on(wrap(make_lower()))


@each_wrapper
def test_it_is_refused_in_an_evaluation_too(wrap):
    agent = train_on(make_lower()).agent
    with pytest.raises(StepContractError, match="a wrapper above OptionsEnv"):
        evaluate(agent, wrap(make_lower()), 1)


@each_wrapper
@pytest.mark.parametrize("action", [0, 2], ids=["a primitive", "an option"])
def test_it_is_refused_at_the_first_decision_whose_reward_it_changes(wrap, action):
    env = wrap(make_lower(include_primitives=True))
    observation, info = env.reset(seed=0)
    with pytest.raises(StepContractError, match=f"the reward of action {action} is "):
        make_transition(observation, action, info["action_mask"] != 0, env.step(action), GAMMA)


@each_wrapper
@pytest.mark.parametrize("action", [0, 2, 3], ids=["a primitive", "an option", "an option of options"])
def test_between_two_levels_it_is_refused_by_the_level_above(wrap, action):
    env = make_upper(wrap(make_lower()))
    env.reset(seed=0)
    with pytest.raises(StepContractError, match="of a step below OptionsEnv .* Put the wrapper below"):
        env.step(action)


def test_a_wrapper_that_changes_some_rewards_is_refused_when_it_first_does():
    env = make_upper(TransformReward(make_lower(), lambda reward: min(reward, 9.0)))
    env.reset(seed=0)
    assert env.step(2)[1] == 2 + 3 + 4, "unchanged"
    with pytest.raises(StepContractError, match="is 9, but its primitives paid 18"):
        env.step(2)


@each_wrapper
@pytest.mark.parametrize("discounted", [False, True])
def test_below_it_scales_every_primitive_at_every_level(wrap, discounted):
    flat, one = wrap(Line()), make_lower(wrap(Line()), discounted_reward=discounted)
    two = make_upper(make_lower(wrap(Line()), discounted_reward=discounted), discounted_reward=discounted)
    for env in (flat, one, two):
        env.reset(seed=0)
    rewards = [float(flat.step(1)[1]) for _ in range(6)]
    of_options = [make_transition(0, 2, np.ones(3, bool), one.step(2), GAMMA) for _ in range(2)]
    of_levels = make_transition(0, 3, np.ones(4, bool), two.step(3), GAMMA)
    for start, transition in zip((0, 3), of_options, strict=True):
        own = rewards[start : start + 3]
        assert transition.reward == own[0] + GAMMA * (own[1] + GAMMA * own[2]), "exactly"
        assert transition.summed_reward == sum(own)
    assert of_levels.reward == pytest.approx(sum(GAMMA**i * r for i, r in enumerate(rewards)), abs=1e-12)
    assert of_levels.summed_reward == sum(rewards) and of_levels.duration == 6


@each_wrapper
def test_without_options_the_wrapped_reward_is_what_agents_learn_from(wrap):
    class Seen(gymnasium.Wrapper):
        rewards = []

        def step(self, action):
            shown = self.env.step(action)
            self.rewards.append(float(shown[1]))
            return shown

    env = Seen(wrap(Line()))
    result = train("q-learning", env, primitives=12, eval_episodes=0)
    assert result.episodes[0].episode_return == pytest.approx(sum(env.rewards[:12]))


@pytest.mark.parametrize("wrap", [lambda env: TimeLimit(env, 3), RecordEpisodeStatistics,
                                  lambda env: TransformReward(env, np.float32)])
def test_wrappers_above_that_change_no_reward_are_welcome(wrap):
    assert train_on(wrap(make_lower())).primitives >= 40
    assert train_on(make_upper(wrap(make_lower()))).primitives >= 40


# --- the discount ----------------------------------------------------------------------------


def test_training_sets_the_discount_of_all_levels_to_the_agents():
    env = make_upper(TimeLimit(make_lower(), 100))
    train_on(env, gamma=0.5)
    assert (env.gamma, env.get_wrapper_attr("env").env.gamma) == (0.5, 0.5)
    env.reset(seed=0)
    assert env.step(2)[4]["discounted_reward"] == 2 + 0.5 * 3 + 0.25 * 4


def test_evaluating_sets_it_to_that_of_the_agent_that_is_evaluated():
    agents = [train_on(make_lower(), gamma=gamma).agent for gamma in (0.5, 0.8)]
    env = make_lower()
    for agent in agents:
        evaluate(agent, env, 1)
        assert env.gamma == agent.gamma


def test_an_environment_with_a_gamma_of_its_own_keeps_it():
    env = NormalizeReward(Line(), gamma=0.3)
    train("q-learning", env, primitives=24, eval_episodes=0)
    assert env.gamma == 0.3


def test_an_impossible_discount_is_refused():
    with pytest.raises(ValueError, match=r"OptionsEnv.discount = 1.5"):
        set_option_discount(make_lower(), 1.5)


# --- wrappers that pay otherwise and say so -----------------------------------------------------


@pytest.mark.parametrize("action", [1, 6], ids=["a primitive", "an option"])
def test_goals_pay_their_own_reward_by_the_contract(action):
    env = GoalsEnv(make_options_env("paper-one-button", discount=GAMMA, trace=True))
    observation, info = env.reset(seed=0)
    step = env.step(action)
    transition = make_transition(observation, action, info["action_mask"] != 0, step, 0.5)
    assert transition.summed_reward == step[1] and transition.reward == 0.5 ** (transition.duration - 1) * step[1]


def test_the_sum_is_told_for_every_kind_of_decision():
    env = make_lower()
    _, info = env.reset(seed=0)
    assert info["summed_reward"] == 0
    assert [env.step(action)[4]["summed_reward"] for action in (0, 2)] == [2, 3 + 4 + 5]
    env = make_lower(discounted_reward=True)
    env.reset(seed=0)
    _, reward, *_, info = env.step(2)
    assert (info["summed_reward"], reward) == (9, info["discounted_reward"])
