"""SAC and TD3: exact targets of decisions of any duration, with cuts, in one environment and in many."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch.distributions import Independent, Normal, TanhTransform, TransformedDistribution

from hrl_escape.agents.algorithms.continuous.sac import SAC
from hrl_escape.agents.algorithms.continuous.td3 import TD3
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.errors import UnsupportedSpaceError

SEEN, ACTIONS, GAMMA = spaces.Box(-1.0, 1.0, (4,), np.float32), spaces.Box(-3.0, 5.0, (2,), np.float32), 0.9
CPU = torch.device("cpu")


def make(kind, **settings):
    return kind(SEEN, ACTIONS, 0, kind.Settings(gamma=GAMMA, hidden=(16,), warmup=10**6, **settings))


def draw_decisions(rng, count, gamma=GAMMA):
    duration = rng.integers(1, 9, count)
    terminated = rng.random(count) < 0.3
    arrays = (np.arange(count), rng.uniform(-1, 1, (count, 4)).astype(np.float32), np.ones((count, 0), bool),
              rng.uniform(-3, 5, (count, 2)).astype(np.float32), rng.normal(size=count).astype(np.float32),
              rng.normal(size=count).astype(np.float32), duration, (gamma**duration).astype(np.float32),
              rng.uniform(-1, 1, (count, 4)).astype(np.float32), np.ones((count, 0), bool), terminated,
              ~terminated & (rng.random(count) < 0.4))
    return Decisions(*map(torch.from_numpy, arrays))


@pytest.mark.parametrize("kind", [SAC, TD3])
def test_replay_holds_the_backups_of_decisions_and_points_of_the_cube(kind):
    agent, batch = make(kind, reward_scale=0.5), draw_decisions(np.random.default_rng(0), 64)
    agent.begin_episodes(64, CPU)
    agent.observe(batch)
    stored = agent.replay.take(torch.arange(64))
    assert torch.allclose(stored.reward, 0.5 * batch.reward)
    assert torch.allclose(stored.bootstrap, batch.discount * ~batch.terminated), "a cut still has a next state"
    assert (stored.bootstrap[batch.truncated] > 0).all() and batch.truncated.any()
    assert torch.allclose(stored.action, (batch.action - 1) / 4, atol=1e-6)


def test_sac_s_targets_are_soft_values_of_the_smaller_critic():
    agent, rng = make(SAC, alpha=0.3), np.random.default_rng(1)
    reward, bootstrap = torch.from_numpy(rng.normal(size=(2, 32)).astype(np.float32))
    bootstrap[:8] = 0.0
    seen = torch.from_numpy(rng.uniform(-1, 1, (32, 4)).astype(np.float32))
    before = agent._noise.get_state()
    found = agent.compute_targets(reward, bootstrap, seen)
    agent._noise.set_state(before)
    mean, log_std = agent.actor(seen).chunk(2, dim=1)
    policy = TransformedDistribution(Independent(Normal(mean, log_std.exp()), 1), TanhTransform(cache_size=1))
    raw = mean + log_std.exp() * torch.randn((32, 2), generator=agent._noise)
    points = raw.tanh()
    values = [target(torch.cat((seen, points), 1)).squeeze(1) for target in agent._targets]
    assert not torch.allclose(*values)
    exact = reward + bootstrap * (torch.minimum(*values) - 0.3 * policy.log_prob(points))
    assert torch.allclose(found, exact, atol=1e-3) and torch.equal(found[:8], reward[:8])


def test_td3_s_targets_smooth_the_target_action_and_take_the_smaller_critic():
    agent, rng = make(TD3, target_noise=3.0, target_noise_clip=0.25), np.random.default_rng(2)
    networks = agent.networks
    networks.target_actor.weights.mul_(3.0)
    reward, bootstrap = torch.from_numpy(rng.normal(size=(2, 32)).astype(np.float32))
    seen = torch.from_numpy(rng.uniform(-1, 1, (32, 4)).astype(np.float32))
    before = networks._noise.get_state()
    found = networks.compute_targets(reward, bootstrap, seen)
    networks._noise.set_state(before)
    noise = (3.0 * torch.randn((32, 2), generator=networks._noise)).clamp(-0.25, 0.25)
    points = (networks.target_actor(seen).tanh() + noise).clamp(-1, 1)
    values = [target(torch.cat((seen, points), 1)).squeeze(1) for target in networks.target_critics]
    assert torch.allclose(found, reward + bootstrap * torch.minimum(*values), atol=1e-6)
    assert (noise.abs() == 0.25).any() and not torch.allclose(*values)


def test_td3_delays_actor_and_targets():
    agent, rng = make(TD3, policy_delay=3), np.random.default_rng(3)
    networks, seen = agent.networks, torch.from_numpy(rng.uniform(-1, 1, (16, 4)).astype(np.float32))
    given = seen, torch.zeros(16, 2), torch.ones(16), torch.zeros(16), seen
    before = [networks.actor.weights.clone(), networks.target_critics[0].weights.clone()]
    for _ in range(2):
        networks.update(*given)
    assert torch.equal(before[0], networks.actor.weights)
    assert torch.equal(before[1], networks.target_critics[0].weights)
    networks.update(*given)
    assert not torch.equal(before[0], networks.actor.weights)
    moved = before[1].lerp(networks.critics[0].weights, 0.005)
    assert torch.allclose(networks.target_critics[0].weights, moved, atol=1e-7)


@pytest.mark.parametrize("kind", [SAC, TD3])
def test_actions_are_in_the_box_before_and_after_the_warm_up_and_greedy_ones_are_repeatable(kind):
    agent = kind(SEEN, ACTIONS, 0, kind.Settings(hidden=(16,), warmup=5))
    moment = Moments(np.zeros(1, np.int64), (np.full(4, 0.5, np.float32),), np.ones((1, 0), bool))
    for steps in (0, 6):
        agent._schedule.steps = steps
        drawn = np.array([agent.act(moment)[0] for _ in range(40)])
        assert drawn.shape == (40, 2) and all(map(ACTIONS.contains, drawn))
        assert len({each.tobytes() for each in drawn}) > 9
    policy = agent.make_policy()
    policy.begin_episode(np.random.default_rng(0))
    first = policy.choose(moment.observation[0], moment.action_mask[0])
    assert ACTIONS.contains(first) and np.array_equal(first, policy.choose(
        moment.observation[0], moment.action_mask[0]))


@pytest.mark.parametrize("kind", [SAC, TD3])
def test_discrete_actions_are_refused_with_the_agents_that_take_them(kind):
    with pytest.raises(UnsupportedSpaceError, match="ppo, dqn, rainbow or torchrl-sac"):
        kind(SEEN, spaces.Discrete(3), 0)
