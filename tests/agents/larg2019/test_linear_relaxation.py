"""The linear relaxation lets the critic see the actor's outputs as they are."""

import numpy as np
import torch

from hrl_escape.agents.larg2019.linear_relaxation import LinearRelaxation


def test_replay_and_critic_see_the_outputs_themselves_legal_or_not():
    relaxation = LinearRelaxation()
    outputs, mask = torch.tensor([[3.0, 1.0, -0.5]]), torch.tensor([[False, True, True]])
    assert relaxation.relax(outputs, mask) is outputs
    assert relaxation.encode(outputs.numpy()[0], 1).tolist() == [3.0, 1.0, -0.5]


def test_the_actor_loss_is_minus_the_mean_value_of_its_outputs():
    observation, outputs = torch.from_numpy(np.random.default_rng(0).standard_normal((2, 8, 3)).astype(np.float32))
    loss = LinearRelaxation().compute_actor_loss(lambda pairs: pairs.sum(dim=1, keepdim=True), observation, outputs,
                                                 torch.ones((8, 3), dtype=torch.bool))
    assert torch.isclose(loss, -(observation.sum(dim=1) + outputs.sum(dim=1)).mean())
