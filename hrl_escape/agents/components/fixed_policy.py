"""Agents that follow a rule: nothing to learn, keep or restore."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition
from hrl_escape.agents.settings import DiscountSettings


class FixedPolicy(Agent):
    """Base of such agents: a subclass gives `act`, which is evaluated as it is."""

    Settings: ClassVar[type] = DiscountSettings
    STATE = ()
    settings: Any = DiscountSettings()

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Same choice as `act`."""
        del rng
        return self.act(observation, action_mask)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn nothing and log nothing."""
        del transition
        return {}
