"""A variant of an algorithm: deep Q-network with mellowmax in place of the maximum (Asadi and Littman 2017)."""

from dataclasses import dataclass
from typing import Annotated

import torch

from hrl_escape.agents.algorithms.dqn import DQN, DQNSettings
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class MellowDQNSettings(DQNSettings):
    """Settings of `mellow-dqn`."""

    omega: Annotated[float, Range(0, open_low=True)] = 5.0
    """Sharpness of the mean over next actions, in scaled return."""


class MellowDQN(DQN):
    """R + b log(mean over legal o of exp(omega Q_target(s', o))) / omega."""

    name, Settings = "mellow-dqn", MellowDQNSettings

    def compute_targets(self, batch):
        """Compute the targets of a minibatch, shape (batch_size,)."""
        scores = self.settings.omega * self.values.target(batch.next_observation)
        total = scores.masked_fill(~batch.next_mask, -torch.inf).logsumexp(dim=1)
        mean = total - batch.next_mask.sum(dim=1).log()
        return batch.reward + batch.bootstrap * mean / self.settings.omega
