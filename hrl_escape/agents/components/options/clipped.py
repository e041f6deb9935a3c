"""Options over networks whose policies learn by the clipped objective of PPO."""

from __future__ import annotations

from collections.abc import Iterator

from torch import Tensor

from hrl_escape.agents.components.options.choices import OptionChoices
from hrl_escape.agents.components.options.networks import NetworkOptionAgent
from hrl_escape.agents.components.policy_gradient import Rollout, compute_clipped_parts, draw_minibatches, take_column

__all__ = ["ClippedOptionAgent"]


class ClippedOptionAgent(NetworkOptionAgent):
    """Base of agents whose settings are `ClippedSettings`."""

    def _draw_batches(self, units: int, collected: int) -> Iterator[Tensor]:
        """Rows of the minibatches of all epochs; one row is left out, since one advantage cannot be normalised.

        Args:
            units: rows.
            collected: decisions of the rollout, which is cut into as many minibatches as one of `rollout` decisions.
        """
        size = self.settings.batch_size
        size = max(size, collected * size // self.settings.rollout)
        batches = draw_minibatches(self._batch_rng, units, size, self.settings.epochs)
        return (rows.to(self.policy.weights.device) for rows in batches if len(rows) > 1)

    def compute_old_log_probability(self, rollout: Rollout, choices: OptionChoices) -> Tensor:
        """Log probability of each action when it was chosen, (n,); while the networks are those that chose."""
        if choices.log_probability is not None:
            return rollout.log_probability
        return take_column(self.compute_log_policies(rollout.observation, choices.option, rollout.mask),
                           rollout.action)

    def compute_option_loss(self, observation: Tensor, mask: Tensor, option: Tensor, action: Tensor,
                            old_log_probability: Tensor, advantage: Tensor, target: Tensor) -> dict[str, Tensor]:
        """PPO's loss of actions within options over a minibatch, and its parts.

        Args:
            observation: encoded, (n, ...).
            mask: bool (n, actions).
            option: int64 (n,), that ran.
            action: int64 (n,).
            old_log_probability: of the action, under the policy that chose it, (n,).
            advantage: (n,).
            target: of Q(s, o), (n,).
        """
        log_policy = self.compute_log_policies(observation, option, mask)
        values = take_column(self.critic(observation), option)
        return compute_clipped_parts(log_policy, mask, action, values, old_log_probability, advantage, target,
                                     self.settings)
