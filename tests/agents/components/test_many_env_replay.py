"""Replay and exploration of many streams: row for row what one environment's would be."""

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from hrl_escape.agents import train
from hrl_escape.agents.algorithms.dqn import DQNSettings
from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.exploration import ExplorationSettings, compute_exploration
from hrl_escape.agents.components.replay import Experience, Replay, list_batch_sizes
from tests.agents.small_envs import Outcome, SmdpEnv, solve

ACTIONS = 3
CPU = torch.device("cpu")


def make_replay(capacity, device, n_step=1, num_envs=1):
    return Replay(Arrays(np.random.default_rng(0), device), capacity, (2,), np.float32, ACTIONS, (), n_step, num_envs)


def make_backup(rng, count):
    """Random backups (count, ...), told apart by their rewards."""
    return Experience(*map(torch.from_numpy, (
        rng.standard_normal((count, 2)).astype(np.float32), rng.random((count, ACTIONS)) < 0.7,
        rng.integers(ACTIONS, size=count), rng.standard_normal(count).astype(np.float32),
        (0.9 ** rng.integers(1, 9, count)).astype(np.float32), rng.standard_normal((count, 2)).astype(np.float32),
        rng.random((count, ACTIONS)) < 0.7)))


def list_rows(experience):
    return [tuple(np.asarray(field, np.float32).tobytes() for field in row) for row in zip(*experience, strict=True)]


@pytest.mark.nightly_for("2-64")
@pytest.mark.parametrize(("n", "streams"), [(1, 6), (2, 64), (3, 1), (5, 6)])
def test_backups_of_n_decisions_are_those_of_every_stream_alone(n, streams):
    rng = np.random.default_rng(n)
    many = make_replay(10_000, CPU, n, streams)
    alone = [make_replay(10_000, None, n) for _ in range(streams)]
    for _ in range(60):  # some streams at a time, in any order
        rows = rng.permutation(streams)[: rng.integers(1, streams + 1)]
        experience, over = make_backup(rng, len(rows)), rng.random(len(rows)) < 0.15
        many.add(experience, torch.from_numpy(rows), torch.from_numpy(over))
        for at, row in enumerate(rows):
            one = Experience(*(field[at : at + 1].numpy() for field in experience))
            alone[row].add(one, np.zeros(1, np.int64), over[at : at + 1])
    found = sorted(list_rows(many.take(torch.arange(len(many)))))
    assert found == sorted(row for each in alone for row in list_rows(each.take(np.arange(len(each)))))


@pytest.mark.parametrize("device", [None, CPU])
def test_a_full_ring_joins_no_decision_with_one_that_took_another_s_place(device):
    rng, replay = np.random.default_rng(0), make_replay(7, device, 3, 4)
    to_own = torch.from_numpy if device else np.asarray
    for _ in range(200):
        rows = rng.permutation(4)[: rng.integers(1, 5)]
        backup = make_backup(rng, len(rows))
        backup = backup._replace(reward=torch.tensor([float(10 ** row) for row in rows]),
                                 bootstrap=torch.ones(len(rows)))
        replay.add(backup if device else Experience(*(field.numpy() for field in backup)), to_own(rows),
                   to_own(rng.random(len(rows)) < 0.2))
        found = np.asarray(replay.take(to_own(np.arange(len(replay)))).reward)
        assert all(each in [count * 10.0 ** row for row in range(4) for count in (1, 2, 3)] for each in found)


@pytest.mark.parametrize("device", [None, CPU])
def test_replay_keeps_the_latest_and_draws_them_all(device):
    rng, replay = np.random.default_rng(0), make_replay(20, device)
    added = []
    for count in (7, 1, 30, 5, 9):
        batch = make_backup(rng, count)
        replay.add(batch if device else Experience(*(field.numpy() for field in batch)))
        added += list_rows(batch)
    assert set(list_rows(replay.sample(2_000))) == set(added[-20:])


@pytest.mark.parametrize("settings", [
    ExplorationSettings(epsilon_start=0.4, epsilon_end=0.2, epsilon_steps=100),
    ExplorationSettings(exploration="boltzmann", temperature=0.7),
    ExplorationSettings(exploration="boltzmann", temperature=0.5, boltzmann_clip=1.0),
])
def test_draws_have_the_probabilities_of_the_policy(settings):
    values, mask = np.array([0.3, 1.1, -0.4, 2.0]), np.array([True, True, True, False])
    rows = 40_000
    chances = {"epsilon": 0.3, "temperature": settings.temperature if settings.exploration == "boltzmann" else 0.0,
               "clip": settings.boltzmann_clip}
    for device in (None, CPU):
        arrays, to_own = Arrays(np.random.default_rng(1), device), torch.from_numpy if device else np.asarray
        policy = compute_exploration(to_own(np.tile(values, (rows, 1))), to_own(np.tile(mask, (rows, 1))), **chances)
        assert np.asarray(policy[0]) == pytest.approx(by_hand(values, mask, **chances))
        found = np.bincount(np.asarray(arrays.draw_choices(policy)), minlength=4) / rows
        assert found == pytest.approx(by_hand(values, mask, **chances), abs=0.012) and found[3] == 0


def by_hand(values, mask, epsilon, temperature, clip):
    """Probabilities of the exploring policy, action by action."""
    legal = [action for action in range(len(values)) if mask[action]]
    if temperature:
        bounded = {a: np.clip(values[a] / temperature, -clip, clip) if clip else values[a] / temperature for a in legal}
        total = sum(np.exp(value) for value in bounded.values())
        return [np.exp(bounded[a]) / total if a in bounded else 0.0 for a in range(len(values))]
    best = max(legal, key=lambda action: values[action])
    return [(epsilon / len(legal) if a in legal else 0.0) + (1 - epsilon) * (a == best) for a in range(len(values))]


CHAIN = [  # a step, and a leap of three primitives that may fall short; state 4 is left for good
    [[Outcome(1.0, at + 1, (-1.0,), at == 3)],
     [Outcome(0.5, min(at + 2, 4), (-1.0, 0.0, -0.2), at >= 2), Outcome(0.5, at, (-1.0, -1.0))] if at % 2 else []]
    for at in range(4)] + [[[Outcome(1.0, 4, (0.0,))], []]]


def evaluate_uniform(table, gamma):
    """Q of the policy that draws evenly among legal actions, by iteration over outcomes; NaN where none is legal."""
    values = np.zeros((len(table), 2))
    legal = np.array([[bool(outcomes) for outcomes in row] for row in table])
    for _ in range(500):
        means = (values * legal).sum(axis=1) / legal.sum(axis=1)
        for state, row in enumerate(table):
            for action, outcomes in enumerate(row):
                values[state, action] = sum(one.probability * (
                    sum(gamma**i * reward for i, reward in enumerate(one.rewards))
                    + gamma ** len(one.rewards) * means[one.next_state] * (not one.terminated)) for one in outcomes)
    return np.where(legal, values, np.nan)


DEEP = {"hidden": (32,), "learning_rate": 3e-3, "reward_scale": 1.0, "warmup": 100, "target_every": 20,
        "epsilon_end": 0.5, "batch_size": 32, "loss": "squared"}
EXACT = {
    "dqn": (DEEP | {"n_step": 1}, 0.15, solve),
    "sarsa": (DEEP | {"epsilon_start": 1.0, "epsilon_end": 1.0, "target_rate": 1.0,
                      "average_rate": 0.005}, 0.15, evaluate_uniform),
    "q-learning": ({"learning_rate": 1.0, "learning_rate_power": 0.8, "epsilon_end": 0.5}, 0.15, solve),
    "r-max": ({"visits": 250}, 0.15, solve),
}


@pytest.mark.nightly_for("q-learning-8000", "r-max-16000", "sarsa-16000", "q-learning-16000")
@pytest.mark.parametrize(("name", "primitives"), [
    pytest.param("dqn", 16_000, marks=pytest.mark.slow), ("sarsa", 16_000), ("q-learning", 16_000), ("r-max", 16_000),
    ("q-learning", 8_000)])
def test_values_of_decisions_of_any_duration_are_exact_in_many_environments_at_once(name, primitives):
    def make():
        return SmdpEnv(CHAIN, start=None, one_hot=True, infos="discounted", gamma=0.9, horizon=30)

    settings, error, compute = EXACT[name]
    many = SyncVectorEnv([make] * 16, autoreset_mode=AutoresetMode.SAME_STEP)
    agent = train(name, many, primitives=primitives, eval_env=make(), eval_episodes=0,
                  settings=settings | {"gamma": 0.9}).agent
    exact = compute(CHAIN, 0.9)
    for state in range(4):
        legal = np.isfinite(exact[state])
        assert agent.compute_values(np.eye(5, dtype=np.float32)[state])[legal] == pytest.approx(
            exact[state][legal], abs=error)


@pytest.mark.nightly
def test_as_many_updates_as_in_one_environment_follow_a_step_of_many_up_to_a_limit():
    def make():
        return SmdpEnv(CHAIN, start=None, one_hot=True, infos="discounted", gamma=0.9, horizon=30)

    counts = []
    for settings in ({"max_updates": 1}, {"max_updates": 4}, {}):
        many = SyncVectorEnv([make] * 16, autoreset_mode=AutoresetMode.SAME_STEP)
        agent = train("dqn", many, primitives=1_000, eval_env=make(), eval_episodes=0,
                      settings=DEEP | settings | {"gamma": 0.9}).agent
        counts.append(agent.values.learner.updates)
    assert counts[2] == pytest.approx(0.25 * (1_000 - 100), abs=10), "a quarter of the primitives after the warm-up"
    assert counts[1] == pytest.approx(4 * counts[0], rel=0.05) and counts[1] < 0.95 * counts[2]


def test_minibatches_of_many_environments_grow_up_to_a_limit():
    settings = DQNSettings(batch_size=64, max_updates=16, max_batch_size=2_048)
    assert list_batch_sizes(settings, 3, is_many=True) == [64] * 3
    assert list_batch_sizes(settings, 512, is_many=True) == [2_048] * 16
    assert list_batch_sizes(settings, 1_024, is_many=True) == [2_048] * 16
    assert list_batch_sizes(settings, 1_024, is_many=False) == [64] * 1_024


@pytest.mark.nightly
def test_ddpg_prefers_the_best_action_of_every_state_in_many_environments_at_once():
    def make():
        return SmdpEnv(CHAIN, start=None, one_hot=True, infos="discounted", gamma=0.9, horizon=30)

    many = SyncVectorEnv([make] * 16, autoreset_mode=AutoresetMode.SAME_STEP)
    agent = train("ddpg", many, primitives=16_000, eval_env=make(), eval_episodes=0, settings={
        "gamma": 0.9, "hidden": (32,), "learning_rate": 3e-3, "reward_scale": 1.0, "warmup": 100, "batch_size": 32,
        "epsilon_end": 0.5, "actor_warmup": 500, "target_rate": 0.02, "entropy_weight": 0.02}).agent
    exact = solve(CHAIN, 0.9)
    rng = np.random.default_rng(0)
    for state in range(4):
        assert agent.act_greedy(np.eye(5, dtype=np.float32)[state], np.isfinite(exact[state]), rng) == int(
            np.nanargmax(np.where(np.isfinite(exact[state]), exact[state], np.nan)))
