"""Double actor-critic: options learned as two ordinary decision processes on one trajectory, each by PPO.

Zhang and Whiteson (2019), on the clipped objective of Schulman et al. (2017). With one option it is `ppo`, to the bit.
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
    """Options, their terminations and the clipped updates of `dac`."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive; per decision if `discounting` is `decision`."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive`: an action of k primitives is worth sum gamma^i r_i and discounts by gamma^k. `decision`: it is
    worth the plain sum and discounts by gamma, as if it were one step, as the paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the state in which an episode was truncated; otherwise truncation counts as termination, as in
    the paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit in which warm-up, update and exploration schedules count. With primitives, flat and option-level agents do
    the same work on the same experience."""
    options: Annotated[int, Range(1)] = 4
    """Options that are learned."""
    initial_termination: Annotated[float, Range(0, 1, open_low=True, open_high=True)] = 0.5
    """Probability of ending an option before anything is learned."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "orthogonal"
    """Initial weights; `orthogonal` goes with tanh units and a small last layer of the policy."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam."""
    max_grad_norm: Annotated[float, Range(0)] = 0.5
    """Gradients are scaled down to this Euclidean norm; 0 leaves them."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; Keras has 1e-7."""
    scale_observations: bool = True
    """Map components with finite bounds in the observation space to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Networks learn rewards times this; temperatures and logged values stay in units of return."""
    entropy_weight: Annotated[float, Range(0)] = 0.01
    """Weight of the policy's entropy in the loss."""
    value_weight: Annotated[float, Range(0)] = 0.5
    """Weight of half the squared value error in the loss."""
    gae_lambda: Annotated[float, Range(0, 1)] = 0.95
    """Lambda of generalised advantage estimation; 1 has returns of as many decisions as the rollout has left."""
    lambda_per: Literal["decision", "primitive"] = "decision"
    """Unit of lambda: a decision of k primitives weighs later errors by lambda, or by lambda^k."""
    rollout: Annotated[int, Range(2)] = 256
    """Decisions collected before each round of updates, of all streams together."""
    stream_rollout: Annotated[int, Range(1)] = 32
    """Decisions of each stream, on average, that a rollout of several streams has at least. A rollout larger than
    `rollout` is cut into as many minibatches, so into larger ones."""
    epochs: Annotated[int, Range(1)] = 10
    """Passes over a rollout."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in a minibatch of a rollout of `rollout` decisions."""
    clip: Annotated[float, Range(0, open_low=True)] = 0.2
    """Bound on how far the probability ratio may move to any advantage."""
    normalise_advantages: bool = True
    """Shift and scale the advantages of each minibatch to mean 0 and deviation 1. Where no episode has escaped yet,
    that blows noise up to full-sized steps; without it such steps are as small as the rewards."""
    option_entropy_weight: Annotated[float, Range(0)] = 0.01
    """Weight of the entropy of the choice of options in the loss."""
    deliberation_cost: Annotated[float, Range(0)] = 0.0
    """Weight of the mean termination in the loss; above 0 options last longer."""


class DAC(OptionRolloutAgent):
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
