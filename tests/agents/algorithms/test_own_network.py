"""A torch module of the user's own learns in place of an agent's network, and is left as it was."""

import gymnasium
import numpy as np
import pytest
import torch
from torch import nn

from hrl_escape.agents import make_agent
from hrl_escape.agents.algorithms.dqn import DQN, DQNSettings
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.errors import AgentSettingsError
from tests.agents.running import learn
from tests.agents.small_envs import ButtonGrid

SETTINGS = {"warmup": 20, "batch_size": 8, "learning_rate": 1e-3}


class Residual(nn.Module):
    """A layer that the package does not have, with a buffer beside its weights."""

    def __init__(self, inputs, actions):
        super().__init__()
        self.inner, self.head = nn.Linear(inputs, inputs), nn.Linear(inputs, actions)
        self.register_buffer("shift", torch.ones(inputs))

    def forward(self, seen):
        return self.head(seen + nn.functional.silu(self.inner(seen)) * self.shift)


def make_module(env, kind):
    torch.manual_seed(0)
    (inputs,), actions = DQN(env.observation_space, env.action_space, 0)._encoder.shape, int(env.action_space.n)
    return Residual(inputs, actions) if kind == "residual" else nn.Sequential(
        nn.Linear(inputs, 8), nn.ReLU(), nn.Linear(8, actions))


@pytest.mark.nightly_for("sequential")
@pytest.mark.parametrize("kind", ["residual", "sequential"])
def test_dqn_learns_with_a_module_of_ones_own_and_resumes_to_the_same_bits(tmp_path, kind):
    env = ButtonGrid(trace=True, horizon=40)
    module = make_module(env, kind)
    first = [weights.detach().clone() for weights in module.parameters()]
    agent = DQN(env.observation_space, env.action_space, 0, DQNSettings(**SETTINGS), network=module)
    observation, info = env.reset(seed=0)
    with torch.no_grad():
        own = module(torch.from_numpy(agent._encoder.encode(observation))[None])[0].numpy()
    assert agent.compute_values(observation) * agent.settings.reward_scale == pytest.approx(own, abs=1e-6)
    learn(agent, env, 80)
    assert agent.values.learner.updates > 10
    assert all(torch.equal(now, before) for now, before in zip(module.parameters(), first, strict=True))
    save_checkpoint(tmp_path / "agent.npz", agent.state_dict())
    made = {"structure": {"network": module}, **SETTINGS}
    again = make_agent("dqn", env.observation_space, env.action_space, 1, **made)
    again.load_state_dict(load_checkpoint(tmp_path / "agent.npz"))
    for each in agent, again:
        learn(each, ButtonGrid(trace=True, horizon=40), 30, seed=3)
    assert torch.equal(agent.values.online.weights, again.values.online.weights)
    assert agent.compute_values(observation).tolist() == again.compute_values(observation).tolist()


@pytest.mark.parametrize(("module", "message"), [
    (nn.Linear(3, 5), r"outputs of shape \(2, 5\).*\(2, 4\) from two encoded observations of shape \(3,\)"),
    (nn.Identity(), "a module with float32 weights"),
    (nn.Linear(3, 4).double(), "a module with float32 weights")])
def test_a_module_that_does_not_fit_is_refused_with_the_shape_that_would(module, message):
    spaces = gymnasium.spaces.Box(-1, 1, (3,), np.float32), gymnasium.spaces.Discrete(4)
    with pytest.raises(AgentSettingsError, match=message):
        DQN(*spaces, 0, network=module)
