"""Double actor-critic: options learned as two ordinary decision processes on one trajectory, each by PPO.

Zhang and Whiteson (2019), on the clipped objective of Schulman et al. (2017). With one option it equals `ppo` exactly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.components.option_networks import SMALLEST, OptionChoices, OptionRolloutAgent, mix_values
from hrl_escape.agents.components.policy_gradient import (
    Rollout,
    compute_advantages,
    compute_clipped_loss,
    take_column,
)
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class DACSettings(AgentSettings):
    """Settings of `dac`: options, their terminations and the clipped updates."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive, or per decision if `discounting` is `decision`. Higher values look further ahead and
    learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma, as the
    paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination, as in the
    paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""
    options: Annotated[int, Range(1)] = 4
    """Number of options to learn."""
    initial_termination: Annotated[float, Range(0, 1, open_low=True, open_high=True)] = 0.5
    """Initial probability of ending an option. Smaller values make the first options longer."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "orthogonal"
    """Initial weights; `orthogonal` goes with tanh units and a small last layer of the policy."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam. Too large a step diverges."""
    max_grad_norm: Annotated[float, Range(0)] = 0.5
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns. Temperatures and logged values
    keep units of return."""
    entropy_weight: Annotated[float, Range(0)] = 0.01
    """Weight of the policy's entropy in the loss. More explores for longer."""
    value_weight: Annotated[float, Range(0)] = 0.5
    """Weight of half the squared value error in the loss."""
    gae_lambda: Annotated[float, Range(0, 1)] = 0.95
    """Lambda of generalised advantage estimation. 1 has the most variance, and no bias from the critic."""
    lambda_per: Literal["decision", "primitive"] = "decision"
    """Unit of lambda: a decision of k primitives weighs later errors by lambda, or by lambda^k."""
    rollout: Annotated[int, Range(2)] = 256
    """Decisions collected before each round of updates, of all environments together. More make steadier updates, and
    fewer of them."""
    rollout_per_env: Annotated[int, Range(1)] = 32
    """Least decisions of each of many environments, on average, in a rollout. A rollout above `rollout` is cut into as
    many minibatches, so into larger ones."""
    epochs: Annotated[int, Range(1)] = 10
    """Passes over a rollout. More learn more from it and move further from the policy that collected it."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in a minibatch of a rollout of `rollout` decisions."""
    clip: Annotated[float, Range(0, open_low=True)] = 0.2
    """Bound on how far the probability ratio may move to any advantage. Smaller is slower and steadier."""
    normalise_advantages: bool = True
    """Shift and scale the advantages of each minibatch to mean 0 and deviation 1. Before the first success that blows
    noise up to full-sized steps."""
    option_entropy_weight: Annotated[float, Range(0)] = 0.01
    """Weight of the entropy of the policy over options in the loss. More keeps more options in use."""
    deliberation_cost: Annotated[float, Range(0)] = 0.0
    """Weight of the mean termination in the loss. More makes options last longer."""


class DAC(OptionRolloutAgent):
    """PPO in two decision processes with the same rewards and one critic q(s, o).

        high: state (s, o-), action o    pi(o | s, o-) = (1 - beta_o-(s)) [o = o-] + beta_o-(s) pi_Omega(o | s)
              value v(s, o-) = sum over o of pi(o | s, o-) q(s, o)
        low:  state (s, o), action a     pi_o(a | s), value q(s, o)

    o- is the previous option; in an episode's first state pi is pi_Omega. Advantages and old probabilities of both are
    computed with the networks that chose. One process then runs through all of its epochs, then the other, in random
    order. A truncated episode bootstraps both by v(s', o). Terminations learn through pi alone.
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
            if self.options > 1:  # a single option leaves no choice
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
                compute_loss(rollout, choices, rows, *(each.index_select(0, rows) for each in numbers))
                for rows in self._draw_batches(len(option), len(option)))
        return metrics | {"gradient_norm": self.heads.learner.gradient_norm,
                          "value": low_values.mean().item() / settings.reward_scale}

    def compute_low_loss(self, rollout: Rollout, choices: OptionChoices, rows: Tensor, old_log_probability: Tensor,
                         advantage: Tensor, target: Tensor) -> dict[str, Tensor]:
        """Return the loss of actions within options over some rows, and its parts."""
        observation, mask, option, action = (field.index_select(0, rows) for field in (
            rollout.observation, rollout.mask, choices.option, rollout.action))
        return self.heads.compute_option_loss(observation, mask, option, action, old_log_probability, advantage, target)

    def compute_high_loss(self, rollout: Rollout, choices: OptionChoices, rows: Tensor, old_log_probability: Tensor,
                          advantage: Tensor, target: Tensor) -> dict[str, Tensor]:
        """Return the loss of the policy over options over some rows, and its parts; values only train the critic."""
        settings, (observation, option, former) = self.settings, (field.index_select(0, rows) for field in (
            rollout.observation, choices.option, choices.former))
        choice = self.heads.compute_option_choice(observation, former)
        log_probability = take_column(choice, option).clamp(min=SMALLEST).log()
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
