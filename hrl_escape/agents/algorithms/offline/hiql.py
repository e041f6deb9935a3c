"""HIQL: one value function, a policy over subgoals and a policy towards them (Park et al. 2023), over options.

The published subgoals are a fixed number of steps ahead. Here the subgoal is the state where the data's option ended.
All three parts learn at every primitive from the rest of the option, because the subgoal is predicted again at each.
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
from hrl_escape.agents.components.offline import OfflineAgent, Primitives, RecordedDecisions
from hrl_escape.agents.components.replay import Experience
from hrl_escape.errors import AgentSettingsError


def cut_everywhere(data: RecordedDecisions, primitives: Primitives, gamma: float, actions: int) -> RecordedDecisions:
    """Make one decision per primitive of an option: from that primitive to the option's end.

    `action` is the primitive, one of `actions`; reward, duration and discount belong to the rest of the option.
    """
    decision = np.cumsum(primitives.begins) - 1
    left = np.cumsum(data.duration)[decision] - np.arange(len(decision))
    whole = primitives.as_decisions(gamma, actions)
    reward = primitives.reward.astype(np.float64)
    plain = reward.copy()
    for row in np.flatnonzero(left > 1)[::-1]:
        reward[row] += gamma * reward[row + 1]
        plain[row] += plain[row + 1]
    return whole._replace(reward=reward, summed_reward=plain, duration=left, discount=gamma**left,
                          next_observation=data.next_observation[decision], terminated=data.terminated[decision],
                          last=data.last[decision], ended=data.ended[decision])


class HIQL(OfflineAgent):
    """V is the expectile of R + gamma^k (1 - terminated) V(s') over the rest of options, of k primitives and reward R.

    The high policy predicts s', weighted by exp(inverse temperature x (R + gamma^k V(s') - V(s))); the low policy
    clones the primitive given s and s'. The agent `hiql` acts by primitives. Each row of a minibatch trains one
    primitive, and `decisions` in its log therefore counts primitives too.
    """

    heads = {"value": "state", "target_value": "state"}
    acting: ClassVar[str] = "low"
    has_table: ClassVar[bool] = False
    reads_both: ClassVar[bool] = True
    settings: IQLSettings

    def begin(self, data: RecordedDecisions, primitives: Primitives | None = None) -> None:
        """Load decisions and the primitives inside them. Raises `AgentSettingsError` without primitives."""
        if primitives is None:
            raise AgentSettingsError("data", "decisions alone", "a data set with the primitives inside its decisions")
        rest = cut_everywhere(data, primitives, self.settings.gamma, self._actions)
        super().begin(rest._replace(duration=np.ones_like(rest.duration)))  # a row trains one primitive

    def make_networks(self, encoder: ObservationEncoder, action_space: gymnasium.Space, settings: Any,
                      generator: torch.Generator) -> dict[str, Network]:
        """Make V and its target, the subgoal predicted from a state, and the logits of primitives given both."""
        size = int(np.prod(encoder.shape))
        return super().make_networks(encoder, action_space, settings, generator) | {
            "high": make_network(encoder, size, settings, generator),
            "low": make_network(encoder, self._actions, settings, generator, size)}

    def compute_loss(self, batch: Experience, rows: NDArray[np.int64]) -> tuple[Tensor, dict[str, float]]:
        """Return the sum of the losses of the value, of the subgoals, and of the primitives towards them."""
        settings, networks = self.settings, self.networks
        values = networks["value"](batch.observation).squeeze(1)
        with torch.no_grad():
            targets = batch.reward + batch.bootstrap * networks["target_value"](batch.next_observation).squeeze(1)
            advantage = (targets - values) * settings.inverse_temperature / settings.reward_scale
            weights = advantage.exp().clamp(max=MOST_WEIGHT)
        misses = ((networks["high"](batch.observation) - batch.next_observation) ** 2).mean(dim=1)
        given = torch.cat([batch.observation, batch.next_observation], dim=1)
        cloned = cross_entropy(networks["low"](given), batch.action)
        loss = expectile_loss(targets - values, settings.expectile) + (weights * misses).mean() + cloned
        return loss, {"value": values.mean().item() / settings.reward_scale}

    def compute_preferences(self, observation: Any) -> NDArray:
        """Return the logits of the primitives towards the predicted subgoal, (actions,)."""
        encoded = self._encoder.encode(observation)
        return self.networks["low"].compute(np.concatenate([encoded, self.networks["high"].compute(encoded.copy())]))
