"""Double actor-critic: options learned as two ordinary decision processes on one trajectory, each by PPO.

Zhang and Whiteson (2019), on the clipped objective of Schulman et al. (2017). With one option it is `ppo`, to the bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.components.option_agent import OptionSettings
from hrl_escape.agents.components.option_networks import SMALLEST, OptionChoices, StreamOptionAgent, mix_values
from hrl_escape.agents.components.policy_gradient import (
    ClippedSettings,
    Rollout,
    compute_advantages,
    compute_clipped_loss,
    take_column,
)
from hrl_escape.settings import Range


@dataclass(frozen=True)
class DACSettings(ClippedSettings, OptionSettings):
    """Options, their terminations and the clipped updates of `dac`."""

    option_entropy_weight: Annotated[float, Range(0)] = 0.01
    """Weight of the entropy of the choice of options in the loss."""
    deliberation_cost: Annotated[float, Range(0)] = 0.0
    """Weight of the mean termination in the loss; above 0 options last longer."""


class DAC(StreamOptionAgent):
    """PPO in two decision processes with the same rewards and one critic q(s, o).

        high: state (s, o-), action o    pi(o | s, o-) = (1 - beta_o-(s)) [o = o-] + beta_o-(s) pi_Omega(o | s)
              value v(s, o-) = sum over o of pi(o | s, o-) q(s, o)
        low:  state (s, o), action a     pi_o(a | s), value q(s, o)

    o- is the option before; in an episode's first state pi is pi_Omega. Advantages and old probabilities of both are
    computed with the networks that chose; then one process goes through all of its epochs, then the other, in random
    order. An episode that was cut bootstraps both by v(s', o). Terminations learn through pi alone.
    """

    settings: DACSettings

    def _learn(self, rollout: Rollout, choices: OptionChoices) -> Mapping[str, float]:
        settings, option, former = self.settings, choices.option, choices.former
        with torch.no_grad():
            critic = self.heads.critic(rollout.observation)
            low_values = take_column(critic, option)
            choice = self.heads.compute_option_choice(rollout.observation, former)
            high_values = mix_values(choice, critic, former)
            low_next, high_next = self.heads.compute_next_values(rollout, choices)
            low = compute_advantages(rollout, low_values, low_next, settings)
            log_probability = self.heads.compute_old_log_probability(rollout, choices)
            updates = [(self.compute_low_loss, log_probability, low, low + low_values)]
            if self.options > 1:  # a choice among one is none
                high = compute_advantages(rollout, high_values, high_next, settings)
                log_choice = choices.log_probability
                if log_choice is None:
                    log_choice = take_column(choice, option).clamp(min=SMALLEST).log()
                updates.append((self.compute_high_loss, log_choice, high, high + high_values))
                if self._batch_rng.random() < 0.5:
                    updates.reverse()
        metrics: dict[str, float] = {}
        for compute_loss, *numbers in updates:
            metrics |= self.heads.learner.minimise_each(
                compute_loss(rollout, choices, rows, *(each[rows] for each in numbers))
                for rows in self._draw_batches(len(option), len(option)))
        return metrics | {"gradient_norm": self.heads.learner.gradient_norm,
                          "value": low_values.mean().item() / settings.reward_scale}

    def compute_low_loss(self, rollout: Rollout, choices: OptionChoices, rows: Tensor, old_log_probability: Tensor,
                         advantage: Tensor, target: Tensor) -> dict[str, Tensor]:
        """Loss of actions within options over some rows, and its parts."""
        return self.heads.compute_option_loss(rollout.observation[rows], rollout.mask[rows], choices.option[rows],
                                        rollout.action[rows], old_log_probability, advantage, target)

    def compute_high_loss(self, rollout: Rollout, choices: OptionChoices, rows: Tensor, old_log_probability: Tensor,
                          advantage: Tensor, target: Tensor) -> dict[str, Tensor]:
        """Loss of the choice of options over some rows, and its parts; the value's goes through the critic alone."""
        settings, observation = self.settings, rollout.observation[rows]
        former = choices.former[rows]
        choice = self.heads.compute_option_choice(observation, former)
        log_probability = take_column(choice, choices.option[rows]).clamp(min=SMALLEST).log()
        policy_loss = compute_clipped_loss(log_probability, old_log_probability, advantage, settings.clip,
                                           settings.normalise_advantages)
        values = mix_values(choice.detach(), self.heads.critic(observation), former)
        value_loss = 0.5 * functional.mse_loss(values, target)
        entropy = -(choice * choice.clamp(min=SMALLEST).log()).sum(dim=1).mean()
        has_former = former >= 0
        betas = take_column(self.heads.compute_betas(observation), former.clamp(min=0))
        ending = (betas * has_former).sum() / len(rows)
        loss = (policy_loss + settings.value_weight * value_loss - settings.option_entropy_weight * entropy
                + settings.deliberation_cost * ending)
        return {"high_loss": loss, "high_policy_loss": policy_loss, "high_value_loss": value_loss,
                "choice_entropy": entropy, "termination": ending}
