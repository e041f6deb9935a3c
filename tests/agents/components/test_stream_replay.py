"""Replay and exploration of many streams: row for row what one environment's would be."""

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from hrl_escape.agents import train
from hrl_escape.agents.components.exploration import ExplorationSettings, compute_policy
from hrl_escape.agents.components.replay import Experience, NStep, StreamNStep, StreamReplay, sample_actions
from tests.agents.small_envs import Outcome, SmdpEnv, solve

ACTIONS = 3


def make_backup(rng, count):
    """Random backups (count, ...), told apart by their rewards."""
    return Experience(*map(torch.from_numpy, (
        rng.standard_normal((count, 2)).astype(np.float32), rng.random((count, ACTIONS)) < 0.7,
        rng.integers(ACTIONS, size=count), rng.standard_normal(count).astype(np.float32),
        (0.9 ** rng.integers(1, 9, count)).astype(np.float32), rng.standard_normal((count, 2)).astype(np.float32),
        rng.random((count, ACTIONS)) < 0.7)))


def list_rows(experience):
    return [tuple(np.asarray(field, np.float32).tobytes() for field in row) for row in zip(*experience, strict=True)]


@pytest.mark.parametrize(("n", "streams"), [(1, 6), (2, 64), (3, 1), (5, 6)])
def test_backups_of_n_decisions_are_those_of_every_stream_alone(n, streams):
    rng = np.random.default_rng(n)
    many, alone = StreamNStep(n, streams, torch.zeros(1, 2), ACTIONS), [NStep(n) for _ in range(streams)]
    for _ in range(60):  # some streams at a time, in any order
        rows = rng.permutation(streams)[: rng.integers(1, streams + 1)]
        experience, over = make_backup(rng, len(rows)), rng.random(len(rows)) < 0.15
        found = many.push(torch.from_numpy(rows), experience, torch.from_numpy(over))
        expected = []
        for at, row in enumerate(rows):
            one = Experience(*(field[at].numpy() for field in experience))
            expected += alone[row].push(one, bool(over[at]))
        assert sorted(list_rows(Experience(*(field.numpy() for field in found)))) == sorted(
            tuple(np.asarray(field, np.float32).tobytes() for field in one) for one in expected)


def test_replay_keeps_the_latest_and_draws_them_all():
    rng, replay = np.random.default_rng(0), StreamReplay(20, torch.zeros(1, 2), ACTIONS)
    added = []
    for count in (7, 1, 30, 5, 9):
        batch = make_backup(rng, count)
        replay.add(batch)
        added += list_rows(batch)
    drawn = replay.sample(2_000, torch.Generator().manual_seed(0))
    assert set(list_rows(drawn)) == set(added[-20:])


@pytest.mark.parametrize("settings", [
    ExplorationSettings(epsilon_start=0.4, epsilon_end=0.2, epsilon_steps=100),
    ExplorationSettings(exploration="boltzmann", temperature=0.7),
    ExplorationSettings(exploration="boltzmann", temperature=0.5, boltzmann_clip=1.0),
])
def test_draws_have_the_probabilities_of_the_policy(settings):
    values, mask = np.array([0.3, 1.1, -0.4, 2.0]), np.array([True, True, True, False])
    rows = 40_000
    action = sample_actions(torch.tensor(values).expand(rows, 4), torch.tensor(mask).expand(rows, 4), settings, 50,
                            torch.Generator().manual_seed(1))
    found = np.bincount(action.numpy(), minlength=4) / rows
    assert found == pytest.approx(compute_policy(values, mask, settings, 50), abs=0.012) and found[3] == 0


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


@pytest.mark.nightly_for("r-max", "sarsa")
@pytest.mark.parametrize("name", [pytest.param("dqn", marks=pytest.mark.slow), "sarsa", "q-learning", "r-max"])
def test_values_of_decisions_of_any_duration_are_exact_in_many_environments_at_once(name):
    def make():
        return SmdpEnv(CHAIN, start=None, one_hot=True, infos="discounted", gamma=0.9, horizon=30)

    settings, error, compute = EXACT[name]
    many = SyncVectorEnv([make] * 16, autoreset_mode=AutoresetMode.SAME_STEP)
    agent = train(name, many, primitives=16_000, eval_env=make(), eval_episodes=0, settings=settings | {"gamma": 0.9}
                  ).agent
    exact = compute(CHAIN, 0.9)
    for state in range(4):
        legal = np.isfinite(exact[state])
        assert agent.compute_values(np.eye(5, dtype=np.float32)[state])[legal] == pytest.approx(
            exact[state][legal], abs=error)


def test_as_many_updates_as_in_one_environment_follow_a_step_of_many_up_to_a_limit():
    def make():
        return SmdpEnv(CHAIN, start=None, one_hot=True, infos="discounted", gamma=0.9, horizon=30)

    counts = []
    for settings in ({"stream_updates": 1}, {"stream_updates": 4}, {}):
        many = SyncVectorEnv([make] * 16, autoreset_mode=AutoresetMode.SAME_STEP)
        agent = train("dqn", many, primitives=1_000, eval_env=make(), eval_episodes=0,
                      settings=DEEP | settings | {"gamma": 0.9}).agent
        counts.append(agent.values.learner.updates)
    assert counts[2] == pytest.approx(0.25 * (1_000 - 100), abs=10), "a quarter of the primitives after the warm-up"
    assert counts[1] == pytest.approx(4 * counts[0], rel=0.05) and counts[1] < 0.9 * counts[2]


@pytest.mark.nightly
def test_ddpg_prefers_the_best_action_of_every_state_in_many_environments_at_once():
    def make():
        return SmdpEnv(CHAIN, start=None, one_hot=True, infos="discounted", gamma=0.9, horizon=30)

    many = SyncVectorEnv([make] * 16, autoreset_mode=AutoresetMode.SAME_STEP)
    agent = train("ddpg", many, primitives=8_000, eval_env=make(), eval_episodes=0, settings={
        "gamma": 0.9, "hidden": (32,), "learning_rate": 3e-3, "reward_scale": 1.0, "warmup": 100, "batch_size": 32,
        "epsilon_end": 0.5, "actor_warmup": 500, "target_rate": 0.02, "entropy_weight": 0.02}).agent
    exact = solve(CHAIN, 0.9)
    rng = np.random.default_rng(0)
    for state in range(4):
        assert agent.act_greedy(np.eye(5, dtype=np.float32)[state], np.isfinite(exact[state]), rng) == int(
            np.nanargmax(np.where(np.isfinite(exact[state]), exact[state], np.nan)))
