"""Deep SARSA converges to the exact values of a chain, with a linear network."""

import numpy as np
import pytest
import torch

from hrl_escape.agents.algorithms.sarsa import Sarsa, SarsaSettings
from hrl_escape.agents.components.replay import Experience
from tests.agents.running import interact, learn
from tests.agents.small_envs import ButtonGrid, Outcome, SmdpEnv

GAMMA = 0.9
REWARDS = (-2.0, -3.0, 10.0)
CHAIN = [[[Outcome(1.0, i + 1, (reward,), i == 2)]] for i, reward in enumerate(REWARDS)] + [[[Outcome(1.0, 0, (0.0,))]]]


def learn_chain(horizon=100, **changes):
    env = SmdpEnv(CHAIN, one_hot=True, horizon=horizon)
    settings = {
        "gamma": GAMMA,
        "hidden": (),
        "warmup": 0,
        "learning_rate": 0.01,
        "loss": "squared",
        "reward_scale": 1.0,
    }
    online = {"replay_capacity": 0, "target_rate": 1.0, "expected": False}
    agent = Sarsa(env.observation_space, env.action_space, 0, SarsaSettings(**(settings | online | changes)))
    learn(agent, env, 1_500)
    return [float(agent.compute_values(row)[0]) for row in np.eye(4, dtype=np.float32)]


@pytest.mark.nightly
@pytest.mark.nightly_for("False")
@pytest.mark.parametrize("expected", [False, True])
def test_sarsa_learns_the_chains_values(expected):
    q0, q1, q2, _ = learn_chain(expected=expected)
    assert q2 == pytest.approx(10, abs=0.1)
    assert q1 == pytest.approx(-3 + GAMMA * 10, abs=0.1)
    assert q0 == pytest.approx(-2 + GAMMA * (-3 + GAMMA * 10), abs=0.1)


@pytest.mark.nightly
def test_with_the_late_terminal_the_last_but_one_sees_nothing_and_the_last_goes_on():
    q0, q1, q2, after = learn_chain(late_terminal=True)
    assert q1 == pytest.approx(-3, abs=0.1)
    assert q0 == pytest.approx(-2 + GAMMA * -3, abs=0.1)
    assert q2 == pytest.approx(10 + GAMMA * after, abs=0.1)


@pytest.mark.nightly
def test_trap_3_a_cut_episode_still_has_a_future():
    """Cut after two decisions, s2 is only ever reached, never left: s1 is worth -3 + gamma Q(s2) nevertheless."""
    _, q1, q2, _ = learn_chain(horizon=2)
    assert q1 == pytest.approx(-3 + GAMMA * q2, abs=0.1)
    _, q1, _, _ = learn_chain(horizon=2, bootstrap_on_truncation=False)
    assert q1 == pytest.approx(-3, abs=0.1)


@pytest.mark.nightly
def test_online_sarsa_takes_the_very_action_it_bootstrapped_from():
    env = ButtonGrid(horizon=40)
    settings = SarsaSettings(replay_capacity=0, expected=False, warmup=0, hidden=(8,))
    agent = Sarsa(env.observation_space, env.action_space, 0, settings)
    promised = None
    for transition in interact(agent, env, 200):
        assert promised in (None, transition.action)
        promised = agent.state_dict()["next_action"]
        assert (promised is None) == (transition.terminated or transition.truncated)


def test_the_sampled_next_action_follows_the_policy_and_its_mask():
    """The mean of targets with a sampled action is the target with the expectation."""
    env, count = ButtonGrid(), 4_000
    sampled, expected = (Sarsa(env.observation_space, env.action_space, 0, SarsaSettings(expected=expected))
                         for expected in (False, True))
    actions = env.action_space.n
    mask = torch.arange(actions).expand(count, -1) > 0  # without the first action
    seen = torch.zeros(count, *env.observation_space.shape)
    batch = Experience(seen, mask, torch.zeros(count, dtype=torch.int64), torch.zeros(count), torch.ones(count), seen,
                       mask)
    with torch.no_grad():
        found, exact = sampled.compute_targets(batch), expected.compute_targets(batch)[0]
    assert found.mean().item() == pytest.approx(exact.item(), abs=4 * found.std().item() / count**0.5 + 1e-6)
    values = sampled.values.target(batch.next_observation[:1])[0]
    assert {round(each, 5) for each in found.tolist()} == {round(each, 5) for each in values[1:].tolist()}
