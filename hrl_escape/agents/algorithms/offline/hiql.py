"""HIQL: one value function, a policy over subgoals and a policy that goes there (Park et al. 2023), over options.

Published with subgoals a fixed number of steps ahead. Here the subgoal is the state in which the data's option ended,
so that the high level learns from decisions and the low level from the primitives inside them.
"""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import cross_entropy

from hrl_escape.agents.algorithms.offline.iql import MOST_WEIGHT, IQLSettings, expectile_loss
from hrl_escape.agents.components.networks import Network, ObservationEncoder, make_network
from hrl_escape.agents.components.offline import (
    Batch,
    Decisions,
    OfflineAgent,
    Primitives,
    encode_all,
)
from hrl_escape.errors import AgentSettingsError


class HIQL(OfflineAgent):
    """V is the expectile of R + gamma^k (1 - terminated) V(s') over decisions.

    The high policy predicts s', weighted by exp(inverse temperature x (R + gamma^k V(s') - V(s))); the low policy
    clones the primitives of options given the state in which each ended. It acts by primitives, under the name `hiql`.
    """

    heads = {"value": "state", "target_value": "state"}
    acting: ClassVar[str] = "low"
    has_table: ClassVar[bool] = False
    reads_both: ClassVar[bool] = True
    Settings: ClassVar[type] = IQLSettings
    settings: IQLSettings

    def begin(self, data: Decisions, primitives: Primitives | None = None) -> None:
        """Take decisions and the primitives inside them; `AgentSettingsError` without primitives."""
        if primitives is None:
            raise AgentSettingsError("data", "decisions alone", "a data set with the primitives inside its decisions")
        super().begin(data)
        self._low = (encode_all(self._encoder, primitives.observation), torch.from_numpy(primitives.action),
                     torch.from_numpy(np.cumsum(primitives.begins) - 1))
        self._goals = encode_all(self._encoder, data.next_observation)

    def make_networks(self, encoder: ObservationEncoder, action_space: gymnasium.Space, settings: Any,
                      generator: torch.Generator) -> dict[str, Network]:
        """V and its target, the subgoal predicted from a state, and the logits of primitives given both."""
        size = int(np.prod(encoder.shape))
        return super().make_networks(encoder, action_space, settings, generator) | {
            "high": make_network(encoder, size, settings, generator),
            "low": make_network(encoder, self._actions, settings, generator, size)}

    def compute_loss(self, batch: Batch) -> tuple[Tensor, dict[str, float]]:
        """Sum of the losses of the value, of the subgoals, and of the primitives towards them."""
        settings, networks = self.settings, self.networks
        values = networks["value"](batch.observation).squeeze(1)
        with torch.no_grad():
            targets = batch.reward + batch.bootstrap * networks["target_value"](batch.next_observation).squeeze(1)
            advantage = (targets - values) * settings.inverse_temperature / settings.reward_scale
            weights = advantage.exp().clamp(max=MOST_WEIGHT)
        misses = ((networks["high"](batch.observation) - batch.next_observation) ** 2).mean(dim=1)
        observation, action, decision = self._low
        rows = torch.from_numpy(self._rng.integers(len(action), size=settings.batch_size))
        given = torch.cat([observation[rows], self._goals[decision[rows]]], dim=1)
        cloned = cross_entropy(networks["low"](given), action[rows])
        loss = expectile_loss(targets - values, settings.expectile) + (weights * misses).mean() + cloned
        return loss, {"value": values.mean().item() / settings.reward_scale}

    def compute_preferences(self, observation: Any) -> NDArray:
        """Logits of the primitives towards the predicted subgoal, (actions,)."""
        encoded = self._encoder.encode(observation)
        return self.networks["low"].compute(np.concatenate([encoded, self.networks["high"].compute(encoded.copy())]))
