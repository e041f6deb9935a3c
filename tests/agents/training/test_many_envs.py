"""Many streams: returns over ragged decisions, automatic resets, budgets, and runs that resume to the same bits."""

import dataclasses

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from hrl_escape.agents import evaluate, load_agent, load_env, make_agent, train
from hrl_escape.agents.algorithms.ppo import PPO, PPOSettings
from hrl_escape.agents.components.bonuses import CountBonus
from hrl_escape.agents.components.policy_gradient import compute_advantages, compute_log_policy, compute_next_values
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.agents.single_env import serve_many
from hrl_escape.agents.training.many_envs import VectorManyEnvs
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.deep_sea import DeepSeaConfig
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import AgentSettingsError, DiscountMismatchError
from hrl_escape.options.batched.env import BatchedOptionsEnv
from tests.agents.small_envs import ButtonGrid
from tests.agents.training.test_resuming import flatten

GAMMA, ACTIONS = 0.9, 3
CPU = torch.device("cpu")
SMALL = {"hidden": (8,), "rollout": 64, "rollout_per_env": 4, "epochs": 2, "batch_size": 16}
SMALL_DQN = {"hidden": (8,), "batch_size": 8, "warmup": 20, "replay_capacity": 100, "replay_per_env": 8}
SMALL_A2OC = {"hidden": (8,), "rollout": 64, "rollout_per_env": 4}
SETTINGS = {**dict.fromkeys(("ppo", "dac", "ppoc", "diayn"), SMALL),
            **dict.fromkeys(("dqn", "sarsa"), SMALL_DQN), "rainbow": SMALL_DQN | {"noise": 0.5},
            "ddpg": SMALL_DQN | {"actor_warmup": 20}, "a2oc": SMALL_A2OC, "q-learning": {}, "r-max": {"visits": 2}}


def decide(gamma, env, observation, mask, action, reward, summed, k, reached, reached_mask, terminated, truncated):
    """Decisions of many environments, with the discount of their durations."""
    return Decisions(env, observation, mask, action, reward, summed, k, gamma ** k.float(), reached, reached_mask,
                     terminated, truncated)


# --- returns over decisions that end each at its own time -----------------------------------------


def make_life(rng, primitives):
    """Decisions of one stream in order: rewards of their primitives, and how each ended."""
    life, left = [], primitives
    while left > 0:
        k = min(int(rng.integers(1, 12)), left)
        left -= k
        life.append((rng.standard_normal(k), rng.choice(["on", "terminated", "truncated"], p=[0.8, 0.1, 0.1])))
    return life


def sum_returns(life, last_value):
    """Return from each decision of a stream, primitive by primitive; `last_value` is that of every state reached."""
    returns = []
    for start in range(len(life)):
        total, weight = 0.0, 1.0
        for rewards, end in life[start:]:
            for reward in rewards:
                total += weight * reward
                weight *= GAMMA
            if end != "on":
                break
        returns.append(total + (0.0 if end == "terminated" else weight * last_value))
    return returns


@pytest.mark.parametrize("count", [1, 8, 64])
def test_returns_of_ragged_decisions_are_those_summed_by_hand_in_every_stream(count):
    settings = PPOSettings(gamma=GAMMA, reward_scale=1.0, gae_lambda=1.0, rollout=10**6, hidden=(4,))
    agent = PPO(gymnasium.spaces.Box(-1, 1, (2,), np.float32), gymnasium.spaces.Discrete(ACTIONS), 0, settings)
    agent.begin_episodes(count, CPU)
    rng = np.random.default_rng(count)
    lives = [make_life(rng, 100) for _ in range(count)]
    ends = [np.cumsum([len(rewards) for rewards, _ in life]) for life in lives]
    made = [0] * count
    legal = torch.ones(count, ACTIONS, dtype=torch.bool)
    agent.act(Moments(torch.arange(count), torch.zeros(count, 2), legal))
    for primitive in range(1, 101):  # every stream at its own pace: rows come in whatever order decisions end
        rows = [i for i in range(count) if primitive in ends[i]]
        if not rows:
            continue
        ended = [lives[i][made[i]] for i in rows]
        for i in rows:
            made[i] += 1
        rewards = torch.tensor([sum(GAMMA**n * r for n, r in enumerate(one)) for one, _ in ended], dtype=torch.float32)
        agent.observe(decide(
            GAMMA, torch.tensor(rows), torch.zeros(len(rows), 2), legal[rows],
            torch.zeros(len(rows), dtype=torch.int64), rewards,
            torch.tensor([one.sum() for one, _ in ended], dtype=torch.float32),
            torch.tensor([len(one) for one, _ in ended]), torch.zeros(len(rows), 2),
            torch.ones(len(rows), ACTIONS, dtype=torch.bool),
            torch.tensor([end == "terminated" for _, end in ended]),
            torch.tensor([end == "truncated" for _, end in ended])))
    rollout = agent.rollout.gather()
    # With lambda = 1 and the same value of every state, the advantage is the return less that value.
    value = torch.full((len(rollout.place),), 0.7)
    found = compute_advantages(rollout, value, value, settings) + value
    for i in range(count):
        own = rollout.stream == i
        assert rollout.place[own].tolist() == list(range(len(lives[i])))
        assert found[own].numpy() == pytest.approx(sum_returns(lives[i], 0.7), abs=1e-4)


def test_a_decision_keeps_the_mask_and_the_probability_that_it_was_chosen_with():
    agent = PPO(gymnasium.spaces.Box(-1, 1, (2,), np.float32), gymnasium.spaces.Discrete(ACTIONS), 0,
                PPOSettings(hidden=(4,), rollout=10**6))
    agent.begin_episodes(2, CPU)
    masks = torch.tensor([[True, False, True], [False, True, False]])
    action = agent.act(Moments(torch.arange(2), torch.tensor([[0.3, -0.2], [0.9, 0.1]]), masks))
    assert action[1] == 1 and action[0] != 1
    agent.act(Moments(torch.tensor([1]), torch.zeros(1, 2), torch.tensor([[True, True, False]])))  # environment 1 again
    one, zero = torch.ones(1), torch.zeros(1, dtype=torch.bool)
    agent.observe(decide(0.99, torch.tensor([0]), torch.tensor([[0.3, -0.2]]), masks[:1], action[:1], one, one,
                         torch.tensor([7]), torch.zeros(1, 2), masks[:1], zero, zero))
    row = agent.rollout.gather()
    assert row.mask.tolist() == masks[:1].tolist() and row.bootstrap.item() == pytest.approx(0.99**7)
    logits = agent.compute_preferences(np.array([0.3, -0.2], np.float32))
    chances = np.where([True, False, True], np.exp(logits), 0.0)
    assert row.log_probability.exp().item() == pytest.approx(chances[int(action[0])] / chances.sum(), rel=1e-5)


def test_a_bonus_is_a_part_of_the_reward_of_every_stream():
    settings = PPOSettings(hidden=(4,), rollout=10**6, bonus_weight=3.0, reward_scale=0.5)
    agent = PPO(gymnasium.spaces.Box(-1, 1, (2,), np.float32), gymnasium.spaces.Discrete(ACTIONS), 0, settings)
    agent.begin_episodes(3, CPU)
    mask, zeros = torch.ones(3, ACTIONS, dtype=torch.bool), torch.zeros(3, dtype=torch.bool)
    action = agent.act(Moments(torch.arange(3), torch.zeros(3, 2), mask))
    reached = torch.tensor([[0.5, 0.5], [-0.5, 0.5], [0.5, 0.5]])  # the first cell is visited twice
    agent.observe(decide(0.99, torch.arange(3), torch.zeros(3, 2), mask, action, -torch.ones(3), -torch.ones(3),
                         torch.ones(3, dtype=torch.int64), reached, mask, zeros, zeros))
    rewards = agent.rollout.gather().reward.numpy()
    assert rewards == pytest.approx([-0.5, -0.5, 0.5 * (-1 - 3 * (1 - 2**-0.5))])


def test_streams_draw_from_the_policy():
    agent = PPO(gymnasium.spaces.Box(-1, 1, (2,), np.float32), gymnasium.spaces.Discrete(ACTIONS), 0)
    agent.policy[-1].weight.data *= 100
    agent.begin_episodes(20_000, CPU)
    seen = torch.tensor([[0.5, -0.5]]).expand(20_000, 2)
    mask = torch.tensor([[True, True, False]]).expand(20_000, ACTIONS)
    action = agent.act(Moments(torch.arange(20_000), seen, mask))
    logits = agent.compute_preferences(np.array([0.5, -0.5], np.float32))[:2].astype(float)
    expected = np.exp(logits) / np.exp(logits).sum()
    found = np.bincount(action.numpy(), minlength=3) / 20_000
    assert found[2] == 0 and found[:2] == pytest.approx(expected, abs=0.015)


# --- automatic resets ---------------------------------------------------------------------------------


class Counting(gymnasium.Env):
    """Shows (episode, step); episode n lasts 2 + n % 3 steps, and every other one is truncated."""

    def __init__(self):
        self.observation_space = gymnasium.spaces.Box(-1.0, 1e4, (2,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(2)
        self.episode = -1

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.episode, self.at = self.episode + 1, 0
        return np.array([self.episode, 0], np.float32), {"action_mask": np.array([1, 1], np.int8)}

    def step(self, action):
        self.at += 1
        over = self.at == 2 + self.episode % 3
        mask = np.array([1, self.at % 2], np.int8)
        return (np.array([self.episode, self.at], np.float32), float(self.at), over and self.episode % 2 == 0,
                over and self.episode % 2 == 1, {"action_mask": mask})


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_trap_13_no_outcome_shows_the_next_episode_whichever_way_the_environment_resets(mode):
    streams = VectorManyEnvs(SyncVectorEnv([Counting] * 3, autoreset_mode=mode), 0.99)
    streams.reset(0)
    seen = []
    for _ in range(40):
        assert streams.observation[streams.is_waiting].shape[1] == 2
        step = streams.step(torch.zeros(3, dtype=torch.int64))
        rows = step.where.nonzero().squeeze(1)
        seen += zip(step.observation[rows].tolist(), step.next_observation[rows].tolist(), step.reward[rows].tolist(),
                    step.next_action_mask[rows].tolist(), (step.terminated | step.truncated)[rows].tolist(),
                    strict=True)
    assert len(seen) > 80
    for before, after, reward, mask, over in seen:
        assert after == [before[0], before[1] + 1] and reward == after[1]
        assert mask == [True, after[1] % 2 == 1]
        assert over == (after[1] == 2 + before[0] % 3)


class Failing(Counting):
    """Of the episodes that terminate, every other one fails; only an episode's end tells of success."""

    def step(self, action):
        *rest, terminated, truncated, info = super().step(action)
        told = {"success": self.episode % 4 == 0} if terminated else {}
        return *rest, terminated, truncated, info | told


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_an_episode_that_ends_in_failure_is_no_success_whichever_way_the_environment_resets(mode):
    streams = VectorManyEnvs(SyncVectorEnv([Failing] * 3, autoreset_mode=mode), 0.99)
    streams.reset(0)
    found = []
    for _ in range(40):
        step = streams.step(torch.zeros(3, dtype=torch.int64))
        rows = (step.where & (step.terminated | step.truncated)).nonzero().squeeze(1)
        found += zip(step.observation[rows, 0].tolist(), step.terminated[rows].tolist(), step.success[rows].tolist(),
                     strict=True)
    assert len(found) > 20 and {terminated for _, terminated, _ in found} == {True, False}
    assert all(success == (episode % 4 == 0 if terminated else -1) for episode, terminated, success in found)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_rooms_of_the_batched_engine_show_the_state_that_their_episode_ended_in(mode):
    room = EscapeRoomVectorEnv(8, "paper-one-button", observation="state", output="torch", autoreset_mode=mode)
    room.room.tables.horizons.fill_(5)
    streams = VectorManyEnvs(room, 0.99)
    streams.reset(3)
    start = streams.observation.clone()
    ends = 0
    for step in range(1, 24):
        done = streams.step(torch.full((8,), 4))  # turn left: away from where the episode began
        over = done.where & done.truncated
        ends += int(over.sum())
        assert not bool((done.next_observation[done.where] == start[done.where]).all(dim=1).any()), step
        assert torch.equal(streams.observation[over], start[over]) or mode == AutoresetMode.NEXT_STEP
    assert ends == 8 * 4


@pytest.mark.nightly
def test_the_next_value_of_a_rollout_is_the_critics_of_the_state_reached(monkeypatch):
    seen = []

    def note(rollout, values, evaluate):
        found = compute_next_values(rollout, values, evaluate)
        seen.append((found, evaluate(torch.arange(len(values))), rollout.over))
        return found

    monkeypatch.setattr("hrl_escape.agents.algorithms.ppo.compute_next_values", note)
    env = BatchedOptionsEnv(8, "paper-one-button", discount=0.99)
    train("smdp-ppo+primitives", env, primitives=1_500, eval_episodes=0, settings=SMALL)
    poles = SyncVectorEnv([lambda: gymnasium.make("CartPole-v1")] * 4)
    train("ppo", poles, primitives=600, eval_env=gymnasium.make("CartPole-v1"), eval_episodes=0, settings=SMALL)
    assert len(seen) >= 6 and any(bool(over.any()) for *_, over in seen)
    for found, expected, _ in seen:
        assert torch.allclose(found, expected, atol=1e-6)


# --- training ---------------------------------------------------------------------------------------------


def make_rooms(count=16):
    return EscapeRoomVectorEnv(count, "paper-one-button", observation="features", output="torch")


class Interrupted:
    """Stops at the n-th step of its life."""

    left = 10**9

    def step(self, actions):
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().step(actions)


class InterruptedRooms(Interrupted, EscapeRoomVectorEnv):
    """Rooms, whose episodes can be written down."""


class InterruptedPoles(Interrupted, SyncVectorEnv):
    """Environments whose episodes cannot be written down."""


def make_interrupted(kind):
    if kind == "rooms":
        return InterruptedRooms(16, "paper-one-button", observation="features", output="torch")
    env = InterruptedPoles([lambda: gymnasium.make("CartPole-v1")] * 4)
    env.spec = gymnasium.spec("CartPole-v1")
    return env


@pytest.mark.nightly_for("ppo-rooms-37", "dqn-rooms-37", "r-max-poles-200", "dac-rooms-37", "ppo-poles-200")
@pytest.mark.parametrize(("name", "kind", "stop"), [
    ("ppo", "rooms", 37), ("ppo", "poles", 200), ("dqn", "rooms", 37), ("dac", "rooms", 37),
    ("q-learning", "rooms", 37), ("r-max", "poles", 200),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ("dac", "poles", 200), ("ppoc", "rooms", 37), ("sarsa", "rooms", 37), ("ddpg", "poles", 200),
        ("a2oc", "rooms", 37), ("diayn", "poles", 200)))])
def test_a_run_cut_off_resumes_to_the_same_bits(tmp_path, name, kind, stop, monkeypatch):
    monkeypatch.setattr("hrl_escape.agents.training.many_envs.SEGMENT_PRIMITIVES", 256)
    arguments = {"primitives": 800 if kind == "rooms" else 1_000, "seed": 1, "eval_every": 250, "eval_episodes": 1,
                 "settings": SETTINGS[name], "checkpoint_seconds": 0.0}
    whole = train(name, make_interrupted(kind), out=tmp_path / "whole", **arguments)
    env = make_interrupted(kind)
    env.left = stop
    with pytest.raises(KeyboardInterrupt):
        train(name, env, out=tmp_path / "cut", **arguments)
    assert (tmp_path / "cut" / "checkpoint.npz").exists()
    resumed = train(name, make_interrupted(kind), out=tmp_path / "cut", **arguments)
    assert resumed == whole and len(whole.segments) >= 3
    assert flatten(resumed.agent.state_dict()) == flatten(whole.agent.state_dict())
    again = load_agent(tmp_path / "cut")
    env = load_env(tmp_path / "cut")
    assert evaluate(again, env, 2) == evaluate(whole.agent, env, 2)


@pytest.mark.nightly
@pytest.mark.nightly_for("200000-1")
@pytest.mark.parametrize(("remade", "begun"), [(200_000, 1), (100, 4)])
def test_episodes_that_cannot_be_written_down_are_made_again_and_begin_anew_after_enough_actions(
    tmp_path, monkeypatch, remade, begun
):
    monkeypatch.setattr("hrl_escape.agents.training.many_envs.REMADE", remade)
    monkeypatch.setattr("hrl_escape.agents.training.many_envs.SEGMENT_PRIMITIVES", 64)
    resets, reset = [], SyncVectorEnv.reset

    def count(self, **given):
        resets.append(given)
        return reset(self, **given)

    monkeypatch.setattr(InterruptedPoles, "reset", count)
    arguments = {"primitives": 800, "seed": 1, "eval_every": 200, "eval_episodes": 1, "settings": SMALL,
                 "checkpoint_seconds": 0.0}
    whole = train("ppo", make_interrupted("poles"), out=tmp_path / "whole", **arguments)
    assert len(resets) == begun, "at an evaluation, and only where too many actions were made since"
    env = make_interrupted("poles")
    env.left = 110
    with pytest.raises(KeyboardInterrupt):
        train("ppo", env, out=tmp_path / "cut", **arguments)
    assert train("ppo", make_interrupted("poles"), out=tmp_path / "cut", **arguments) == whole


@pytest.mark.nightly
def test_environments_that_do_not_do_the_same_again_begin_anew_and_a_warning_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr("hrl_escape.agents.training.many_envs.SEGMENT_PRIMITIVES", 64)
    arguments = {"primitives": 400, "eval_episodes": 0, "settings": SMALL, "checkpoint_seconds": 0.0}
    env = make_interrupted("poles")
    env.left = 60
    with pytest.raises(KeyboardInterrupt):
        train("ppo", env, out=tmp_path / "run", **arguments)
    reset = SyncVectorEnv.reset
    monkeypatch.setattr(InterruptedPoles, "reset", lambda self, **given: reset(self, **(given | {"seed": 77})))
    with pytest.warns(UserWarning, match="all episodes begin again"):
        result = train("ppo", make_interrupted("poles"), out=tmp_path / "run", **arguments)
    assert result.resumed_at > 0 and result.primitives >= 400


@pytest.mark.nightly_for("smdp-ppo", "smdp-dac", "smdp-dqn")
@pytest.mark.parametrize("name", ["smdp-ppo", "smdp-dqn", "smdp-dac"])
def test_the_budget_is_in_primitives_of_all_streams_and_of_every_option(name):
    env = BatchedOptionsEnv(8, "paper-one-button", discount=0.99)
    settings = SMALL_DQN if name == "smdp-dqn" else SMALL
    result = train(f"{name}+primitives", env, primitives=300, seed=0, settings=settings, eval_every=300,
                   eval_episodes=1)
    assert 300 <= result.primitives < 300 + 8 * 60 and result.decisions < result.primitives
    last = result.segments[-1]
    assert (last.primitives, last.decisions) == (result.primitives, result.decisions)
    assert len(result.evaluations) >= 2 and sum(segment.episodes for segment in result.segments) > 0


@pytest.mark.nightly
def test_a_failed_sea_is_logged_as_no_success():
    class Counted(BatchedOptionsEnv):
        ends = successes = 0

        def step(self, action):
            done = super().step(action)
            self.ends += int((done.where & (done.terminated | done.truncated)).sum())
            self.successes += int((done.where & done.success).sum())
            return done

    sea = dataclasses.replace(get_preset("deep-sea"), puzzle=DeepSeaConfig(size=3))
    env = Counted(8, sea, discount=0.99, include_primitives=False)
    segments = train("smdp-ppo", env, primitives=1_500, settings=SMALL, eval_episodes=0).segments
    assert sum(segment.episodes for segment in segments) == env.ends
    assert sum(segment.successes for segment in segments) == env.successes
    assert 0 < env.successes < env.ends


def test_a_rollout_longer_than_the_time_between_evaluations_is_learned_from_and_cut_where_episodes_were_dropped(
    monkeypatch,
):
    monkeypatch.setattr("hrl_escape.agents.training.many_envs.REMADE", 0)
    poles = SyncVectorEnv([lambda: gymnasium.make("CartPole-v1")] * 4)
    poles.spec = gymnasium.spec("CartPole-v1")
    agent = PPO(poles.single_observation_space, poles.single_action_space, 0, PPOSettings(rollout=48, epochs=1))
    learned, improve = [], agent.improve
    agent.improve = lambda rollout: (learned.append(rollout), improve(rollout))[1]
    train(agent, poles, primitives=64 * 6, eval_every=16, eval_episodes=0)
    assert len(learned) >= 2
    for rollout in learned:
        for stream in range(4):
            rows = (rollout.stream == stream).nonzero().squeeze(1)
            apart = ~torch.isclose(rollout.next_observation[rows[:-1]], rollout.observation[rows[1:]]).all(dim=1)
            assert torch.equal(apart, rollout.over[rows[:-1]])
    assert sum(int(rollout.over.sum()) for rollout in learned) > 8, "some were cut"


@pytest.mark.nightly
def test_training_sets_the_discount_of_options_to_the_agents():
    env = BatchedOptionsEnv(4, "paper-one-button", discount=0.9, include_primitives=False)
    train("smdp-ppo", env, primitives=200, settings={**SMALL, "gamma": 0.5}, eval_episodes=0)
    assert env.gamma == 0.5
    env.reset(0)
    ended = env.step(torch.full((4,), env.actions - 2))
    while not bool(ended.where.any()):
        ended = env.step(torch.full((4,), -1))
    k, summed, discounted, discount = (field[ended.where].double() for field in (
        ended.duration, ended.reward, ended.discounted_reward, ended.discount))
    bonus = summed + k  # 100 with the last primitive of an episode that left
    torch.testing.assert_close(discount, 0.5**k, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(discounted, -(1 - 0.5**k) / 0.5 + 0.5 ** (k - 1) * bonus, rtol=1e-5, atol=1e-5)


def test_options_whose_discount_cannot_be_set_to_the_agents_are_refused():
    class Fixed(BatchedOptionsEnv):
        def set_option_discount(self, gamma):
            pass

    env = Fixed(4, "paper-one-button", discount=0.9, include_primitives=False)
    with pytest.raises(DiscountMismatchError):
        train("smdp-ppo", env, primitives=200, settings=SMALL, eval_episodes=0)


def test_what_cannot_train_in_many_environments_says_so():
    with pytest.raises(AgentSettingsError, match="from many environments at once: a2oc, dac, ddpg, "):
        train("intra-option-q", make_rooms(), primitives=10)
    for name, setting in (("sarsa", {"replay_capacity": 0}), ("ddpg", {"relaxation": "linear"}),
                          ("ddpg", {"exploration": "ornstein-uhlenbeck"}), ("dqn", {"hindsight_goals": 1})):
        with pytest.raises(AgentSettingsError, match="in many environments at once|goal"):
            train(name, make_rooms(), primitives=10, settings=setting)
    poles = SyncVectorEnv([lambda: gymnasium.make("CartPole-v1")] * 2)
    poles.spec = None
    with pytest.raises(AgentSettingsError, match="eval_env"):
        train("ppo", poles, primitives=10)


@pytest.mark.nightly
def test_a_run_in_many_environments_ends_with_two_evaluations_that_are_good_enough(monkeypatch):
    monkeypatch.setattr("hrl_escape.agents.training.many_envs.SEGMENT_PRIMITIVES", 64)
    arguments = {"primitives": 600, "settings": SMALL, "eval_every": 100, "eval_episodes": 1}
    ended, whole = (train("ppo", make_rooms(), **arguments, until_return=least) for least in (-1_000, None))
    assert len(ended.evaluations) == 2 < len(whole.evaluations)


@pytest.mark.nightly
def test_ppo_that_learned_from_many_goes_on_in_one_environment_with_the_chances_of_its_own_choices():
    agent = train("ppo", make_rooms(), primitives=300, seed=1, settings=SMALL, eval_episodes=0).agent
    batches, compute_loss = [], agent.compute_loss
    agent.compute_loss = lambda *numbers: (batches.append((agent.policy.weights.clone(), numbers)),
                                           compute_loss(*numbers))[1]
    before = agent.policy.weights.clone()
    train(agent, gymnasium.make("hrl_escape/PaperOneButton-v1", observation="features"),
          primitives=SMALL["rollout"], eval_episodes=0)
    assert len(batches) == SMALL["epochs"] * SMALL["rollout"] // SMALL["batch_size"], "what streams collected is gone"
    weights, (observation, mask, action, old, *_) = batches[0]
    assert torch.equal(weights, before)
    with torch.no_grad():
        agent.policy.weights.copy_(before)
        log_policy = compute_log_policy(agent.policy(observation), mask)
    assert torch.allclose(old, log_policy.gather(1, action[:, None]).squeeze(1), atol=1e-6)


@pytest.mark.nightly
def test_equal_seeds_give_equal_runs_and_others_differ():
    def run(seed):
        result = train("ppo", make_rooms(), primitives=300, seed=seed, settings=SMALL, eval_episodes=0)
        return result.segments, flatten(result.agent.state_dict())

    one = run(1)
    assert one == run(1) and one != run(2)


def test_decisions_of_options_arrive_through_a_vector_environment_with_their_durations():
    class Grid(ButtonGrid):
        def step(self, action):
            *rest, info = super().step(action)
            rewards = info["rewards"]
            info = {"duration": info["duration"], "action_mask": info["action_mask"],
                    "discount": 0.99 ** info["duration"],
                    "discounted_reward": sum(0.99**n * reward for n, reward in enumerate(rewards))}
            return *rest, info

    streams = VectorManyEnvs(SyncVectorEnv([Grid] * 2, autoreset_mode=AutoresetMode.SAME_STEP), 0.99)
    streams.reset(0)
    lengths = set()
    for _ in range(12):
        step = streams.step(streams.action_mask.to(torch.int64).cumsum(1).argmax(1))  # the last legal action
        for k, reward, discounted in zip(step.duration.tolist(), step.reward, step.discounted_reward, strict=True):
            lengths.add(k)
            bonus = float(reward) + k  # 100 with the last primitive of an episode that left
            assert float(discounted) == pytest.approx(-(1 - 0.99**k) / 0.01 + 0.99 ** (k - 1) * bonus, abs=1e-3)
    assert max(lengths) > 3


def test_counts_of_a_batch_are_those_of_one_visit_after_another():
    space = gymnasium.spaces.Box(0.0, 1.0, (2,), np.float32)
    one, many = (CountBonus(space, 3.0, 5, "test") for _ in range(2))
    rng = np.random.default_rng(0)
    for _ in range(3):
        batch = rng.random((50, 2)).astype(np.float32)
        assert many.visit_many(batch) == pytest.approx([one.visit(row) for row in batch])
    assert {key: int(count) for key, count in zip(map(bytes, one.state_dict()["keys"]),
                                                  one.state_dict()["counts"], strict=True)} == {
        key: int(count) for key, count in zip(map(bytes, many.state_dict()["keys"]), many.state_dict()["counts"],
                                              strict=True)}


@pytest.mark.parametrize(("k", "terminated", "is_whole"), [(2, False, False), (1, False, True), (2, True, True)])
def test_an_option_that_a_time_limit_cut_does_not_show_where_it_leads(k, terminated, is_whole):
    agent = make_agent("r-max", gymnasium.spaces.Discrete(3), gymnasium.spaces.Discrete(2), 0)
    served = serve_many(agent)
    served.begin_episodes(1, CPU)
    legal, here = torch.ones(1, 2, dtype=torch.bool), torch.zeros(1, dtype=torch.int64)
    served.act(Moments(here, here, legal))
    last = torch.ones(1, dtype=torch.bool)
    logged = served.observe(Decisions(here, here, legal, here, -torch.ones(1), -torch.ones(1), here + k,
                                      0.99 ** (here + k), here + 1, legal, last & terminated, last))
    assert bool(logged) is is_whole
