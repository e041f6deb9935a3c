"""`check_agent` passes every agent there is, and finds each promise that an agent can break."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hrl_escape.agents import list_agents
from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.registry import get_agent_class, get_recipe
from hrl_escape.checks import check_agent
from hrl_escape.errors import ContractError
from tests.agents.training.test_resuming import SMALL
from tests.covering import thin


@pytest.mark.nightly_for("factored-r-max", "ppo", "rainbow", "torchrl-dqn", "a2oc", "diayn")
@pytest.mark.parametrize("name", thin(list_agents(), 3, 2))
def test_every_agent_keeps_its_contract(name):
    settings = get_recipe(name)
    check_agent(get_agent_class(name), type(settings)(**{**vars(settings), **SMALL.get(name, {})}), decisions=200)


class Illegal(QLearning):
    def act(self, observation, action_mask):
        super().act(observation, action_mask)
        return int(np.argmin(action_mask))


class CountsFromTheEnd(QLearning):
    """-1 in place of the last action."""

    def act(self, observation, action_mask):
        chosen = super().act(observation, action_mask)
        return chosen - len(action_mask) if chosen == len(action_mask) - 1 else chosen


class Wavers(QLearning):
    """The last legal action, and after a hundred answers the first."""

    asked = 0

    def act_greedy(self, observation, action_mask, rng):
        self.asked += 1
        return int(np.flatnonzero(action_mask)[0 if self.asked > 100 else -1])


class IllegalWhenForced(QLearning):
    def act_greedy(self, observation, action_mask, rng):
        return super().act_greedy(observation, action_mask if action_mask.sum() > 1 else ~action_mask, rng)


class LearnsWhileEvaluated(QLearning):
    def act_greedy(self, observation, action_mask, rng):
        self._rng.random()
        return super().act_greedy(observation, action_mask, rng)


class Reseeded(QLearning):
    """Its exploration begins anew after a resume."""

    def state_dict(self):
        return {**super().state_dict(), "rng": {}}

    def load_state_dict(self, state):
        super().load_state_dict({**state, "rng": self._rng.bit_generator.state})


class Forgetful(QLearning):
    """Its table is in no checkpoint."""

    def state_dict(self):
        return {"steps": self._steps, "rng": self._rng.bit_generator.state}

    def load_state_dict(self, state):
        self._steps, self._rng.bit_generator.state = state["steps"], state["rng"]


class Strict(QLearning):
    """It cannot read its own checkpoint."""

    def load_state_dict(self, state):
        raise KeyError("optimiser")


class Pickles(QLearning):
    def state_dict(self):
        return {**super().state_dict(), "self": object()}


class NotANumber(QLearning):
    def observe(self, transition):
        return {**super().observe(transition), "loss": float("nan")}


class DrawsFromNumpy(QLearning):
    def act(self, observation, action_mask):
        np.random.random()  # noqa: NPY002  # the fault that is planted
        return super().act(observation, action_mask)


class DrawsFromTorch(QLearning):
    def act(self, observation, action_mask):
        torch.rand(1)
        return super().act(observation, action_mask)


class Unrepeatable(QLearning):
    made = 0

    def __init__(self, observation_space, action_space, seed, settings=None):
        type(self).made += 1
        super().__init__(observation_space, action_space, seed + type(self).made, settings)


@pytest.mark.parametrize(("agent", "claim"), [
    (Illegal, "act returns the index of a legal action"),
    (CountsFromTheEnd, "act returns the index of a legal action"),
    (Wavers, "act_greedy repeats itself"),
    (IllegalWhenForced, "act_greedy, where one action is legal"),
    (LearnsWhileEvaluated, "act_greedy changes nothing"),
    (Reseeded, "resumed agent makes the decisions"),
    (Forgetful, "resumed agent makes the decisions"),
    (Strict, "load_state_dict takes what state_dict gave"),
    (Pickles, "numbers, text and arrays"),
    (NotANumber, "finite numbers by name"),
    (DrawsFromNumpy, "generators of its own"),
    (DrawsFromTorch, "generators of its own"),
    (Unrepeatable, "the same seed makes the same decisions"),
])
def test_a_broken_promise_is_found_and_named(agent, claim):
    with pytest.raises(ContractError, match=claim):
        check_agent(agent)
