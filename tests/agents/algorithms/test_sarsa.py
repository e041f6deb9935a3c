"""Deep SARSA converges to the exact values of a chain, with a linear network."""

import numpy as np
import pytest

from hrl_escape.agents.algorithms.sarsa import Sarsa, SarsaSettings
from hrl_escape.agents.components.exploration import compute_policy
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
    env = SmdpEnv(CHAIN, one_hot=True)
    agent = Sarsa(env.observation_space, env.action_space, 0, SarsaSettings(expected=False))
    values, mask = np.float32([[1.0, 2.0, 3.0]]), np.array([[True, True, False]])
    weights = [agent._compute_weights(values, mask, None)[0] for _ in range(4_000)]
    policy = compute_policy(values / agent.settings.reward_scale, mask, agent.settings, 0)[0]
    assert np.mean(weights, axis=0) == pytest.approx(policy, abs=0.04)
