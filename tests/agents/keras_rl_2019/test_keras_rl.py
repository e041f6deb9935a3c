"""The early end flag of keras-rl 0.4.2, decision by decision, and its linear relaxation."""

import numpy as np
import pytest
import torch

from hrl_escape.agents.agent import LearningSettings, SMDPTransition, compute_backup
from hrl_escape.agents.components.replay import Experience, make_batch
from hrl_escape.agents.decisions import make_decision
from hrl_escape.agents.keras_rl_2019.keras_rl import LateTerminal, LinearRelaxation

MASK = np.ones(3, np.bool_)
SETTINGS = LearningSettings(gamma=0.9, discounting="decision", bootstrap_on_truncation=False)


def push(late, number, action, end=""):
    place = np.float32([number])
    transition = SMDPTransition(place, action, MASK, float(number), float(number), 1, 0.9, place + 1, MASK,
                                end == "terminated", end == "truncated")
    reward, bootstrap = compute_backup(transition, SETTINGS)
    experience = make_batch(Experience(place, MASK, action, reward, bootstrap, place + 1, MASK))
    return [(float(each.reward[0]), pytest.approx(float(each.bootstrap[0])), taken)
            for each, taken in late.push(experience, make_decision(transition), SETTINGS)]


@pytest.mark.parametrize("end", ["terminated", "truncated"])
def test_the_last_decision_but_one_ends_the_return_and_the_last_goes_on(end):
    late = LateTerminal()
    assert push(late, 1, 0) == []
    assert push(late, 2, 1) == [(1.0, 0.9, 1)]
    assert push(late, 3, 2, end) == [(2.0, 0.0, 2), (3.0, 0.9, None)]
    assert push(late, 4, 0) == [], "nothing is left over from the episode before"


def test_the_decision_that_waits_survives_a_checkpoint():
    late, again = LateTerminal(), LateTerminal()
    push(late, 1, 0)
    again.load_state_dict(late.state_dict())
    assert push(again, 2, 1) == push(late, 2, 1) == [(1.0, 0.9, 1)]


def test_replay_and_critic_see_the_outputs_themselves_legal_or_not():
    relaxation = LinearRelaxation()
    outputs, mask = torch.tensor([[3.0, 1.0, -0.5]]), torch.tensor([[False, True, True]])
    assert relaxation.relax(outputs, mask) is outputs
    assert relaxation.encode(outputs.numpy(), np.array([1])).tolist() == [[3.0, 1.0, -0.5]]


def test_the_actor_loss_is_minus_the_mean_value_of_its_outputs():
    observation, outputs = torch.from_numpy(np.random.default_rng(0).standard_normal((2, 8, 3)).astype(np.float32))
    loss = LinearRelaxation().compute_actor_loss(lambda pairs: pairs.sum(dim=1, keepdim=True), observation, outputs,
                                                 torch.ones((8, 3), dtype=torch.bool))
    assert torch.isclose(loss, -(observation.sum(dim=1) + outputs.sum(dim=1)).mean())
