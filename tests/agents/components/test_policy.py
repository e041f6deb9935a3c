"""Greedy policies: legal actions, an episode's memory of their own, one environment and many alike."""

import gymnasium
import numpy as np
import pytest
import torch

from hrl_escape.agents import make_agent
from hrl_escape.agents.components.policy import Memory
from hrl_escape.agents.decisions import Moments

SPACES = gymnasium.spaces.Box(-1, 1, (4,), np.float32), gymnasium.spaces.Discrete(5)
AGENTS = [("dqn", {}), ("ppo", {}), ("ppo", {"memory": "gru", "memory_units": 4}), ("ddpg", {})]


def make(name, settings):
    agent = make_agent(name, *SPACES, 0, hidden=(8,), **settings)
    return agent, np.random.default_rng(1)


@pytest.mark.parametrize(("name", "settings"), AGENTS)
def test_a_policy_chooses_alike_in_one_environment_and_in_many(name, settings):
    agent, rng = make(name, settings)
    lives = rng.uniform(-1, 1, (6, 7, 4)).astype(np.float32)  # 7 steps of 6 environments
    masks = rng.random((6, 7, 5)) < 0.4
    masks[..., 2] = True
    alone = []
    for life, legal in zip(lives, masks, strict=True):
        policy = agent.make_policy()
        policy.begin_episode(np.random.default_rng(0))
        alone.append([policy.choose(seen, mask) for seen, mask in zip(life, legal, strict=True)])
    many = agent.make_policy()
    many.begin_episode(np.random.default_rng(0), num_envs=6)
    together = [many.act(Moments(torch.arange(6), torch.from_numpy(lives[:, step]), torch.from_numpy(masks[:, step])))
                for step in range(7)]
    assert torch.stack(together, dim=1).tolist() == alone
    assert np.take_along_axis(masks, np.array(alone)[..., None], axis=2).all()


def test_policies_of_one_agent_run_episodes_side_by_side():
    agent, rng = make("ppo", {"memory": "gru", "memory_units": 4})
    agent._memory.network.weights.mul_(8.0)
    agent.policy.weights.mul_(50.0)
    lives, every = rng.uniform(-1, 1, (2, 30, 4)).astype(np.float32), np.ones(5, np.bool_)
    alone = []
    for life in lives:
        policy = agent.make_policy()
        policy.begin_episode(rng)
        alone.append([policy.choose(seen, every) for seen in life])
    in_turn = [agent.make_policy(), agent.make_policy()]
    for policy in in_turn:
        policy.begin_episode(rng)
    chosen = [[policy.choose(life[step], every) for policy, life in zip(in_turn, lives, strict=True)]
              for step in range(30)]
    assert np.array(chosen).T.tolist() == alone
    in_turn[0].begin_episode(rng)
    again = [in_turn[0].choose(seen, every) for seen in lives[0]]
    forgetful = [agent.make_policy().choose(seen, every) for seen in lives[0]]
    assert again == alone[0] != forgetful, "an episode begins with an empty memory, and keeps it"


def test_a_policy_without_memory_has_an_empty_state_for_vectors_and_pictures():
    for shape in ((2, 5), (0, 5), (2, 3, 8, 6)):
        assert Memory().get_state(np.zeros(shape)).shape == (shape[0], 0)
