"""FeUdal Networks: sums, pay and losses by hand over episodes of any length; what has a gradient and what has none."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from gymnasium import spaces

from hrl_escape.agents.algorithms.options.fun import Fun, FunSettings, pay_for_following, sum_directions
from hrl_escape.agents.components.policy_gradient import Rollout
from hrl_escape.checks import check_agent
from tests.agents.algorithms.options.test_option_networks import make_rollout
from tests.agents.running import interact
from tests.agents.small_envs import ButtonGrid

C, UNITS = 3, 4
SPACES = spaces.Box(-np.inf, np.inf, (5,), np.float32), spaces.Discrete(4)


def cosine(a, b):
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-8))


def make_ways(seed):
    """States, states reached, directions, and where episodes begin."""
    rng = np.random.default_rng(seed)
    is_fresh = rng.random(20) < 0.25
    is_fresh[0] = True
    return *rng.standard_normal((3, 20, UNITS)).astype(np.float32), is_fresh


def list_lags(is_fresh, row, most):
    """Lags i >= 0 for which the decision i before a row is in its episode."""
    lags = []
    for lag in range(min(most, row) + 1):
        lags.append(lag)
        if is_fresh[row - lag]:
            break
    return lags


@pytest.mark.parametrize("horizon", [1, 3, 30])
def test_directions_are_summed_and_paid_within_episodes(horizon):
    states, reached, directions, is_fresh = make_ways(horizon)
    summed = [sum(directions[row - lag] for lag in list_lags(is_fresh, row, horizon)) for row in range(20)]
    paid = [sum(cosine(reached[row] - states[row - lag], directions[row - lag])
                for lag in list_lags(is_fresh, row, horizon - 1)) / horizon for row in range(20)]
    given = list(map(torch.from_numpy, (states, reached, directions, is_fresh)))
    assert sum_directions(given[2], given[3], horizon).numpy() == pytest.approx(np.array(summed), abs=1e-5)
    assert pay_for_following(*given, horizon).numpy() == pytest.approx(np.array(paid), abs=1e-5)


def make():
    """An agent far from its even start, and a rollout as it keeps them."""
    settings = FunSettings(gamma=0.9, hidden=(8,), horizon=C, direction_units=UNITS, rollout=10, reward_scale=1.0)
    agent = Fun(*SPACES, 0, settings)
    agent.layers.act.weight.data *= 100
    rollout, *_ = make_rollout()
    *_, directions, _ = make_ways(0)
    is_fresh = np.append(True, rollout.over.numpy()[:-1])
    memory = np.column_stack([np.resize(directions, (len(is_fresh), UNITS)), is_fresh]).astype(np.float32)
    return agent, rollout._replace(memory=torch.from_numpy(memory))


def add_up(pay, rollout, values, after):
    """Advantages with lambda 1: what follows in the rollout, bootstrapped at its end and where episodes are cut."""
    returns = np.zeros(len(pay))
    for row in reversed(range(len(pay))):
        goes_on = row + 1 < len(pay) and not rollout.over[row]
        returns[row] = pay[row] + float(rollout.bootstrap[row]) * (returns[row + 1] if goes_on else after[row])
    return returns - values


def test_the_loss_is_that_of_its_equations():
    agent, rollout = make()
    first, count = 6, len(rollout.action)
    with torch.no_grad():
        parts = {name: float(part) for name, part in agent.compute_loss(rollout, first).items()}
        layers = agent.layers
        percept, states, aimed = layers.see(rollout.observation)
        after, reached, _ = layers.see(rollout.next_observation)
        directions, is_fresh = rollout.memory[:, :-1], rollout.memory[:, -1] > 0
        pay = pay_for_following(states, reached, directions, is_fresh, C).numpy()
        logits = layers.compute_logits(percept, sum_directions(directions, is_fresh, C)).double().numpy()
        critics = {name: (critic(percept)[:, 0].numpy(), critic(after)[:, 0].numpy())
                   for name, critic in (("manager", layers.manager_value), ("worker", layers.worker_value))}
    reward = rollout.reward.numpy()
    manager = add_up(reward, rollout, *critics["manager"])
    worker = add_up(reward + 0.5 * pay, rollout, *critics["worker"])
    logits[~rollout.mask.numpy()] = -np.inf
    log_policy = logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))
    rows = np.arange(first, count)
    assert parts["policy_loss"] == pytest.approx(
        -np.mean(log_policy[rows, rollout.action.numpy()[rows]] * worker[rows]), rel=1e-4)
    expected = 0.0
    for row in range(first - C, count - C):
        if not is_fresh[row + 1 : row + C + 1].any():
            expected -= manager[row] * cosine((states[row + C] - states[row]).numpy(), aimed[row].numpy())
    assert parts["manager_loss"] == pytest.approx(expected / 10, rel=1e-4)
    errors = np.mean(manager[rows] ** 2) + np.mean(worker[rows] ** 2)
    assert parts["loss"] == pytest.approx(parts["manager_loss"] + parts["policy_loss"] - 0.01 * parts["entropy"]
                                          + 0.5 * 0.5 * errors, rel=1e-4)


def test_the_manager_turns_its_directions_and_leaves_states_where_they_are():
    agent, rollout = make()
    layers = agent.layers
    layers.direct.weight.data.zero_()  # directions are those of the bias, wherever the state is
    layers.direct.bias.data.copy_(torch.tensor([1.0, -2.0, 0.5, 0.3]))
    agent.compute_loss(rollout, 6)["manager_loss"].backward()
    assert layers.direct.bias.grad.abs().sum() > 0
    assert layers.state.weight.grad.abs().sum() == 0
    layers.direct.bias.grad.zero_()
    agent.compute_loss(rollout, 6)["policy_loss"].backward()
    assert layers.direct.bias.grad.abs().sum() == 0 < layers.embed.weight.grad.abs().sum()


def test_decisions_are_learned_from_as_they_were_made():
    """The directions that are kept are those that were followed, the random ones too."""
    env = ButtonGrid(trace=True, horizon=9)
    agent = Fun(env.observation_space, env.action_space, 0,
                FunSettings(hidden=(8,), horizon=C, rollout=12, random_directions=0.5))
    seen, compute_loss = [], agent.compute_loss
    agent.compute_loss = lambda rollout, first: seen.append((rollout, first)) or compute_loss(rollout, first)
    followed = []
    for _ in interact(agent, env, 40):
        followed.append(agent._asked[-1])
    assert [first for _, first in seen] == [0, C, C]
    assert all(isinstance(rollout, Rollout) for rollout, _ in seen)
    assert np.concatenate([rollout.memory[first:, :-1].numpy() for rollout, first in seen]) == pytest.approx(
        np.array(followed[:36]))


def test_it_keeps_the_contract_of_agents():
    check_agent(Fun, FunSettings(hidden=(8,), rollout=10, horizon=C), decisions=100)
