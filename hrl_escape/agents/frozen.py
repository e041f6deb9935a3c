"""Trained policies of any library as agents that are evaluated without training.

`FrozenAgent(PPO.load("model.zip"), name="my-ppo")` is a model of Stable-Baselines3, and
`FrozenAgent(lambda observation: int(observation[2] > 0))` a function.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, DiscountSettings, FixedPolicy
from hrl_escape.agents.decisions import convert_action
from hrl_escape.errors import AgentSettingsError

ChooseAction = Callable[[Any, NDArray[np.bool_]], Any]
"""(observation, action mask) -> action."""


class _FrozenPolicy(FixedPolicy):
    """Base class: acts by `_choose`."""

    is_frozen = True
    acts_in = ("discrete", "box")
    _choose: ChooseAction
    _action_space: gymnasium.Space | None = None

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> Any:
        """Return the policy's action, an int or float32 in the shape of a Box."""
        return convert_action(self._choose(observation, action_mask), self._action_space)


class FrozenAgent(_FrozenPolicy):
    """A trained model, or a function that acts, as an agent without training.

    It is accepted wherever an agent is. A comparison evaluates it once, in the episodes of all other agents.

    Args:
        policy: a model with `predict(observation, deterministic=True)`, as in Stable-Baselines3, or a function from
            an observation, or an observation and a mask bool (actions,), to an action. A batch of one action is
            accepted, for a Box in comparisons only. Policies that remember earlier observations are not supported.
        name: name in tables; `smdp-NAME` chooses among options.

    Raises:
        AgentSettingsError: the policy is neither.
    """

    player: type[Agent]
    """Class that makes this agent for an environment."""

    def __init__(self, policy: Any, name: str = "frozen") -> None:
        self._choose = _read_policy(policy)
        network = getattr(policy, "policy", None)
        content = network if hasattr(network, "state_dict") else policy
        self.player = type(name, (_FrozenPlayer,), {"name": name, "policy": policy, "content": content})


class _FrozenPlayer(_FrozenPolicy):
    """A frozen agent, made as all agents are."""

    policy: ClassVar[Any]
    content: ClassVar[Any]
    """Part of the policy that decides its actions, for the identity of runs."""

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: DiscountSettings | None = None) -> None:
        self.settings, self._action_space = settings or DiscountSettings(), action_space
        self._choose = _read_policy(vars(type(self))["policy"])  # read from the class, where a function is no method


def _read_policy(policy: Any) -> ChooseAction:
    if hasattr(policy, "predict"):
        return lambda observation, action_mask: policy.predict(observation, deterministic=True)[0]
    if not callable(policy):
        raise AgentSettingsError("policy", policy, "a model with `predict`, or a function of an observation")
    try:
        takes_mask = len(inspect.signature(policy).parameters) > 1
    except (TypeError, ValueError):  # written in C
        takes_mask = False
    return policy if takes_mask else lambda observation, action_mask: policy(observation)
