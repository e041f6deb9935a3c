"""Vector environments in training: rewards and wrappers above, masks of some copies, and all kinds of reset."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorRewardWrapper, VectorWrapper
from gymnasium.wrappers import ClipReward, NormalizeReward, TransformReward
from gymnasium.wrappers import vector as many

from hrl_escape import OptionsEnv, train
from hrl_escape.agents.training.many_envs import make_many_envs
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import AgentSettingsError, DiscountMismatchError, StepContractError
from hrl_escape.options import ScriptedOption
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.options.batched.vector_env import OptionsVectorEnv

GAMMA = 0.9
SMALL = {"rollout": 4, "epochs": 1, "batch_size": 8, "hidden": (8,), "gamma": GAMMA}
each_vector = pytest.mark.parametrize("vector", [
    SyncVectorEnv, pytest.param(AsyncVectorEnv, marks=pytest.mark.nightly)])  # each starts two interpreters
each_mode = pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)


class Line(gymnasium.Env):
    """Some steps, each of which pays 1 + the number of its place."""

    observation_space = spaces.Box(0, 100, (1,), np.float32)
    action_space = spaces.Discrete(2)

    def __init__(self, length=5, tells=lambda place: {}, reward=lambda place: 1.0 + place):
        self.length, self.tells, self.reward = length, tells, reward

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 0
        return self._show(), self.tells(0)

    def step(self, action):
        self.place += 1
        return self._show(), self.reward(self.place), self.place >= self.length, False, self.tells(self.place)

    def _show(self):
        return np.array([self.place], np.float32)


def make_options(env=None, **arguments):
    return OptionsEnv(env or Line(), [ScriptedOption("three", [1, 1, 1])], **arguments)


def walk(envs, actions, gamma=GAMMA):
    """Outcomes of the decisions that the same action begins in every copy."""
    streams = make_many_envs(envs, gamma)
    try:
        streams.reset(0)
        return [streams.step(torch.full((streams.count,), action)) for action in actions]
    finally:
        envs.close()


# --- wrappers of rewards -----------------------------------------------------------------------

INSIDE = {"clip": lambda env: ClipReward(env, -1, 1), "normalize": lambda env: NormalizeReward(env, gamma=GAMMA),
          "transform": lambda env: TransformReward(env, lambda reward: 0.01 * reward)}
ABOVE = {"clip": lambda envs: many.ClipReward(envs, -1, 1), "normalize": lambda envs: many.NormalizeReward(envs, GAMMA),
         "transform": lambda envs: many.TransformReward(envs, lambda reward: 0.01 * reward)}


@each_vector
@pytest.mark.parametrize("wrap", INSIDE.values(), ids=INSIDE)
@pytest.mark.parametrize("action", [0, 2], ids=["a primitive", "an option"])
def test_a_reward_wrapper_above_the_options_of_each_copy_is_refused(vector, wrap, action):
    with pytest.raises(StepContractError, match="the reward of environment 0 is .* Put the wrapper below"):
        walk(vector([lambda: wrap(make_options())] * 2), [action])


@each_vector
@pytest.mark.parametrize("wrap", ABOVE.values(), ids=ABOVE)
@pytest.mark.parametrize("action", [0, 2], ids=["a primitive", "an option"])
def test_one_above_all_copies_is_refused_too(vector, wrap, action):
    with pytest.raises(StepContractError, match="the reward of environment 0 is .* Put the wrapper below"):
        walk(wrap(vector([make_options] * 2)), [action])


@each_mode
def test_it_is_refused_in_training_with_each_kind_of_reset(mode):
    envs = many.ClipReward(SyncVectorEnv([make_options] * 2, autoreset_mode=mode), -1, 1)
    with pytest.raises(StepContractError, match="a wrapper above OptionsEnv changed it"):
        train("smdp-ppo+primitives", envs, primitives=50, settings=SMALL, eval_env=make_options(), eval_episodes=0)


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP], ids=lambda mode: mode.value)
def test_it_is_refused_at_the_last_decision_of_an_episode(mode):
    def change_last(reward):
        return np.where(reward == 5.0 + 6.0, 0.0, reward)

    envs = many.TransformReward(
        SyncVectorEnv([lambda: make_options(Line(5))], autoreset_mode=mode), change_last)
    with pytest.raises(StepContractError, match="is 0, but its primitives paid 11"):
        walk(envs, [2, 2])


@each_vector
@each_mode
@pytest.mark.parametrize("wrap", INSIDE.values(), ids=INSIDE)
def test_below_the_options_of_each_copy_it_scales_every_primitive(vector, mode, wrap):
    flat = wrap(Line())
    flat.reset(seed=0)
    rewards = [float(flat.step(1)[1]) for _ in range(5)]
    first, last = walk(vector([lambda: make_options(wrap(Line()))] * 2, autoreset_mode=mode), [2, 2])
    for outcome, own in ((first, rewards[:3]), (last, rewards[3:])):
        discounted = sum(GAMMA**i * reward for i, reward in enumerate(own))
        assert outcome.reward.tolist() == pytest.approx([sum(own)] * 2, rel=1e-6)
        assert outcome.discounted_reward.tolist() == pytest.approx([discounted] * 2, rel=1e-6)
        assert outcome.duration.tolist() == [len(own)] * 2
    assert last.terminated.all()


@pytest.mark.parametrize("wrap", ABOVE.values(), ids=ABOVE)
def test_above_copies_without_options_the_wrapped_reward_counts(wrap):
    envs = wrap(SyncVectorEnv([Line] * 2))
    (outcome,) = walk(envs, [0])
    assert outcome.reward.tolist() == outcome.discounted_reward.tolist()
    assert outcome.reward.tolist() != [2.0, 2.0]


def test_an_environment_that_resets_is_not_held_to_its_sums():
    class Added(VectorRewardWrapper):
        def rewards(self, rewards):
            return np.where(rewards == 0, 7.0, rewards)

    outcomes = walk(Added(SyncVectorEnv([lambda: make_options(Line(3))])), [2, 2, 2])
    assert [outcome.where.tolist() for outcome in outcomes] == [[True], [False], [True]]


def test_a_discounted_reward_is_summed_without_the_discount_for_returns():
    (outcome,) = walk(SyncVectorEnv([lambda: make_options(discounted_reward=True)]), [2])
    assert outcome.reward.tolist() == [9.0]
    assert outcome.discounted_reward.tolist() == pytest.approx([2 + 0.9 * 3 + 0.81 * 4])


@each_vector
def test_training_sets_the_discount_of_every_copy(vector):
    (outcome,) = walk(vector([lambda: make_options(discount=0.5)] * 2), [2])
    assert outcome.discounted_reward.tolist() == pytest.approx([2 + 0.9 * 3 + 0.81 * 4] * 2)


def test_a_discount_that_cannot_be_set_must_be_the_agents():
    half = {"duration": 2, "discount": 0.25, "discounted_reward": 1.5, "summed_reward": 2.0}
    envs = [lambda: Line(tells=lambda place: half, reward=lambda place: 2.0)] * 2
    with pytest.raises(DiscountMismatchError, match="gamma is 0.9 but the environment discounts by 0.5"):
        walk(SyncVectorEnv(envs), [0])
    (outcome,) = walk(SyncVectorEnv(envs), [0], gamma=0.5)
    assert outcome.discounted_reward.tolist() == [1.5, 1.5]


def test_copies_with_and_without_options_learn_each_from_its_own_reward():
    class Plain(gymnasium.ActionWrapper):
        def __init__(self, env):
            super().__init__(env)
            self.action_space = spaces.Discrete(3)

        def action(self, action):
            return min(action, 1)

    (outcome,) = walk(SyncVectorEnv([lambda: make_options(), lambda: Plain(Line())]), [2])
    assert outcome.duration.tolist() == [3, 1]
    assert outcome.discounted_reward.tolist() == pytest.approx([2 + 0.9 * 3 + 0.81 * 4, 2.0])


# --- keys that mean something else -----------------------------------------------------------------


@pytest.mark.parametrize("info", [
    {"duration": 0.04}, {"duration": None}, {"duration": "long"}, {"rewards": {"speed": 0.5}}, {"discount": 0.5},
    {"discounted_reward": 9.0}, {"summed_reward": 9.0}, {"option": "call"}, {"option": {"strike": 3}},
    {"action_mask": None}, {"is_success": None}, {"trace": np.zeros(3)},
    {"action_mask": [True, False]},
], ids=str)
def test_keys_that_the_environments_use_for_something_else_are_left_alone(info):
    outcomes = walk(SyncVectorEnv([lambda: Line(2, lambda place: dict(info))] * 2), [0, 0])
    for place, outcome in enumerate(outcomes, 1):
        assert outcome.duration.tolist() == [1, 1]
        assert outcome.discounted_reward.tolist() == outcome.reward.tolist() == [1.0 + place] * 2
    assert (outcomes[1].success == -1).all(), "no environment reports success"


@pytest.mark.parametrize(("info", "message"), [
    ({"duration": 3}, r"infos\['duration'\] is \[3, 3\].* rename the key in a wrapper"),
    ({"duration": 0, "discounted_reward": 0.0, "discount": 1.0}, r"took \[0, 0\] primitives"),
    ({"action_mask": np.zeros(2, np.int8)}, "all zero for an environment"),
    ({"action_mask": np.ones(3, np.int8)}, r"has shape \(2, 3\)"),
    ({"action_mask": "all"}, "must have a number for each action"),
    ({"success": np.nan}, r"info\['success'\] is np.float64\(nan\) at the last step"),
    ({"success": "no"}, r"info\['success'\] is 'no' at the last step .* True, False, 1 or 0"),
    ({"success": [1, 2]}, r"info\['success'\] is \[1, 2\] at the last step"),
    ({"is_success": 0.5}, r"info\['is_success'\] is np.float64\(0.5\)"),
], ids=str)
def test_keys_that_cannot_be_read_are_refused_in_words(info, message):
    with pytest.raises(StepContractError, match=message):
        walk(SyncVectorEnv([lambda: Line(1, lambda place: dict(info))] * 2), [0, 0])


@pytest.mark.parametrize("rewards", [np.ones((2, 3)), np.array([1.0, np.nan]), np.array([np.inf, 0.0])])
def test_rewards_must_be_one_finite_number_a_copy(rewards):
    class Paying(VectorWrapper):
        def step(self, actions):
            observation, _, *rest = self.env.step(actions)
            return observation, rewards, *rest

    with pytest.raises(StepContractError, match=r"rewards have shape \(2, 3\)|a reward is (nan|inf)"):
        walk(Paying(SyncVectorEnv([Line] * 2)), [0])


# --- masks -----------------------------------------------------------------------------------


def make_masked(length, has_mask=True):
    """Action 1 is legal at even places, and an illegal action breaks the environment."""
    def tell(place):
        return {"action_mask": np.array([1, place % 2 == 0], np.int8)} if has_mask else {}

    class Strict(Line):
        def step(self, action):
            assert not has_mask or action == 0 or self.place % 2 == 0, "illegal"
            return super().step(action)

    return Strict(length, tell)


@each_vector
@each_mode
@pytest.mark.parametrize("which", [(True, True), (True, False), (False, True), (False, False)], ids=str)
def test_masks_are_those_of_the_copies_that_give_one_in_each_kind_of_reset(vector, mode, which):
    lengths = (3, 5)
    envs = vector([lambda length=length, has=has: make_masked(length, has)
                   for length, has in zip(lengths, which, strict=True)], autoreset_mode=mode)
    streams = make_many_envs(envs, GAMMA)
    try:
        streams.reset(0)
        places, was_over = [0, 0], [False, False]
        for _ in range(20):
            expected = [[True, not has or place % 2 == 0] for place, has in zip(places, which, strict=True)]
            assert streams.action_mask.tolist() == expected
            outcome = streams.step(torch.zeros(2, dtype=torch.int64))
            for i, length in enumerate(lengths):
                if was_over[i]:
                    places[i], was_over[i] = 0, False
                    continue
                places[i] += 1
                assert outcome.next_action_mask[i].tolist() == [True, not which[i] or places[i] % 2 == 0]
                if places[i] == length:
                    assert outcome.terminated[i]
                    was_over[i] = mode == AutoresetMode.NEXT_STEP
                    places[i] = places[i] if was_over[i] else 0
    finally:
        envs.close()


@pytest.mark.nightly_for(
    "batch of rooms-SameStep", "batch of rooms-Disabled", "some masks-SameStep", "some masks-NextStep",
    "options-NextStep", "options-Disabled")
@each_mode
@pytest.mark.parametrize("make_envs", [
    lambda mode: SyncVectorEnv([lambda: make_masked(3), lambda: make_masked(5, False)], autoreset_mode=mode),
    lambda mode: SyncVectorEnv([lambda: OptionsEnv(make_masked(4), [ScriptedOption("wait", [0, 0])])] * 2,
                               autoreset_mode=mode),
    lambda mode: OptionsVectorEnv(2, "paper-one-button", autoreset_mode=mode, discount=GAMMA),
], ids=["some masks", "options", "batch of rooms"])
def test_training_goes_on_through_every_kind_of_reset(mode, make_envs):
    envs = make_envs(mode)
    single = envs.make_single_env() if isinstance(envs, OptionsVectorEnv) else envs.envs[0]
    name = "ppo" if isinstance(single, Line) else "smdp-ppo+primitives"
    result = train(name, envs, primitives=120, settings=SMALL, eval_env=single, eval_episodes=0)
    assert result.primitives >= 120


def test_a_copy_with_an_empty_mask_is_refused_also_after_a_reset():
    def tell(place):
        return {"action_mask": np.array([place > 0, 0], np.int8)}

    envs = SyncVectorEnv([lambda: Line(2, tell), lambda: Line(9)], autoreset_mode=AutoresetMode.DISABLED)
    with pytest.raises(StepContractError, match="all zero"):
        walk(envs, [0])


# --- wrappers above batches of rooms ---------------------------------------------------------------


class Spy(VectorWrapper):
    """Counts its calls, and doubles observations."""

    def __init__(self, env):
        super().__init__(env)
        self.resets = self.steps = 0
        self.longest = 0

    def reset(self, **arguments):
        self.resets += 1
        observation, infos = self.env.reset(**arguments)
        return 2 * observation, infos

    def step(self, actions):
        self.steps += 1
        observation, *rest, infos = self.env.step(actions)
        self.longest = max(self.longest, int(infos["duration"].max()))
        return 2 * observation, *rest, infos


@pytest.mark.nightly
def test_a_wrapper_above_a_batch_of_rooms_with_options_is_stepped_through():
    rooms = OptionsVectorEnv(4, "paper-one-button", observation="features")
    spy = Spy(rooms)
    result = train("smdp-ppo+primitives", spy, primitives=150, settings=SMALL, eval_env=rooms.make_single_env(),
                   eval_episodes=0)
    assert spy.resets == 1 and result.decisions / 4 <= spy.steps <= result.decisions
    assert spy.longest > 1, "options ran"
    streams = make_many_envs(spy, GAMMA)
    streams.reset(0)
    assert torch.equal(streams.observation, 2 * torch.as_tensor(rooms._batch.observation))


def test_a_batch_of_rooms_without_wrappers_keeps_its_own_streams():
    streams = make_many_envs(OptionsVectorEnv(2, "paper-one-button", discount=0.99), GAMMA)
    assert isinstance(streams, BatchedOptionsEnv) and streams.gamma == GAMMA


@pytest.mark.parametrize("output", ["numpy", "torch"])
@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)
def test_a_reward_wrapper_above_a_batch_of_rooms_with_options_is_refused(output, mode):
    rooms = OptionsVectorEnv(2, "paper-one-button", output=output, autoreset_mode=mode)
    envs = many.TransformReward(rooms, lambda rewards: rewards / 100)
    assert make_many_envs(rooms, GAMMA) is not None
    with pytest.raises(StepContractError, match="is -0.01, but its primitives paid -1 in sum"):
        walk(envs, [0])


@pytest.mark.parametrize("output", ["numpy", "torch"])
def test_a_wrapped_batch_gives_the_sums_at_the_agents_discount(output):
    envs = many.RecordEpisodeStatistics(OptionsVectorEnv(2, "paper-one-button", output="numpy", discount=0.99))
    *_, last = range(envs.single_action_space.n)
    (outcome,) = walk(envs, [last])
    k = outcome.duration.double()
    assert outcome.reward.tolist() == [-float(each) for each in k]
    torch.testing.assert_close(outcome.discounted_reward.double(), -(1 - GAMMA**k) / (1 - GAMMA), rtol=1e-6, atol=1e-6)


@pytest.mark.nightly
def test_the_environment_of_evaluations_must_be_given_where_wrappers_show_something_else():
    with pytest.raises(AgentSettingsError, match="eval_env = None .* with the effect of Spy"):
        train("smdp-ppo+primitives", Spy(OptionsVectorEnv(2, "paper-one-button")), primitives=50, settings=SMALL)
    envs = many.RecordEpisodeStatistics(OptionsVectorEnv(2, "paper-one-button", observation="features"))
    assert train("smdp-ppo+primitives", envs, primitives=50, settings=SMALL, eval_episodes=0).primitives >= 50


@pytest.mark.parametrize("make_rooms", [
    lambda: EscapeRoomVectorEnv(2, "paper-one-button"), lambda: OptionsVectorEnv(2, "paper-one-button")],
    ids=["primitives", "options"])
def test_streams_go_on_with_the_state_of_their_wrappers(make_rooms):
    streams, again = (make_many_envs(many.NormalizeObservation(make_rooms()), GAMMA) for _ in range(2))
    streams.reset(3)
    for action in (0, 1, 0, 2):
        streams.step(torch.full((2,), action))
    again.reset(3)
    again.load_state_dict(streams.state_dict())
    assert torch.equal(again.observation, streams.observation)
    streams.step(torch.zeros(2, dtype=torch.int64))
    again.step(torch.zeros(2, dtype=torch.int64))
    assert torch.equal(again.observation, streams.observation)
