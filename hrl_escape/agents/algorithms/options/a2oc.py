"""Option-critic over networks: advantage actor-critic within options, learned terminations, a cost of ending.

A2OC of Harb, Bacon, Klissarov and Precup (2018): option-critic (Bacon, Harb and Precup 2017) on returns of several
decisions, in one environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.components.exploration import compute_epsilon_greedy
from hrl_escape.agents.components.option_networks import OptionChoices, OptionHeads, OptionRolloutAgent
from hrl_escape.agents.components.policy_gradient import Rollout, compute_entropy, take_column
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class A2OCSettings(AgentSettings):
    """Settings of `a2oc`: options, their terminations and the actor-critic update."""

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
    gae_lambda: Annotated[float, Range(0, 1)] = 1.0
    """Lambda of generalised advantage estimation. 1 has the most variance, and no bias from the critic."""
    lambda_per: Literal["decision", "primitive"] = "decision"
    """Unit of lambda: a decision of k primitives weighs later errors by lambda, or by lambda^k."""
    rollout: Annotated[int, Range(2)] = 20
    """Decisions collected before each update."""
    rollout_per_env: Annotated[int, Range(1)] = 20
    """Least decisions of each of many environments, on average, in a rollout."""
    epsilon: Annotated[float, Range(0, 1)] = 0.1
    """Probability of a random option, and weight of the mean in the value of ending an option. More explores more."""
    deliberation_cost: Annotated[float, Range(0)] = 0.01
    """Cost of ending an option, in scaled return, paid on arrival, which makes it a margin of terminations. More makes
    options last longer."""
    termination_margin: Annotated[float, Range(0)] = 0.0
    """Margin in the comparison of an option with the mean: its termination only grows if it is worse by more, in scaled
    return. Not part of values."""


class GreedyHeads(OptionHeads):
    """Networks of options with an epsilon-greedy choice among their values."""

    names: ClassVar[tuple[str, ...]] = ("policy", "critic", "ending")

    def compute_option_policy(self, observation: Any) -> NDArray[np.float64]:
        """Return the epsilon-greedy policy over options, float64 (options,)."""
        return compute_epsilon_greedy(self.compute_option_values(observation), self.settings.epsilon)

    def compute_fresh_choice(self, observation: Tensor) -> Tensor:
        """Return the same for many observations, (n, options)."""
        best = functional.one_hot(self.critic(observation).argmax(dim=1), self.options)
        return (1 - self.settings.epsilon) * best + self.settings.epsilon / self.options


class A2OC(OptionRolloutAgent):
    """Learn pi_o, Q(s, o) and beta_o from a few decisions (s, o, a) -> R, s' at a time, by one step on all losses.

        policy       - log pi_o(a | s) (G - Q(s, o)) - weight x entropy of pi_o
        critic       weight x half of (G - Q(s, o))^2
        termination  beta_o(s') (Q(s', o) - V(s') + cost + margin), unless terminated

    G = R + b G' if the next decision is known, b its discount, minus b x cost if the option ended before it; at the
    last decision G' = U(s', o) = (1 - beta_o(s')) Q(s', o) + beta_o(s') (V(s') - cost). V is the value of the
    epsilon-greedy policy over options, which chooses them.
    """

    settings: A2OCSettings
    Heads = GreedyHeads

    def _learn(self, rollout: Rollout, choices: OptionChoices) -> Mapping[str, float]:
        with torch.no_grad():
            values = take_column(self.heads.critic(rollout.observation), choices.option)
            advantage = self.heads.compute_advantages(rollout, choices, values, self.settings.deliberation_cost)
        parts = self.compute_loss(rollout, choices, advantage, advantage + values)
        self.heads.learner.minimise(parts["loss"])
        return {name: part.item() for name, part in parts.items()} | {
            "gradient_norm": self.heads.learner.gradient_norm,
            "value": values.mean().item() / self.settings.reward_scale}

    def compute_loss(self, rollout: Rollout, choices: OptionChoices, advantage: Tensor, target: Tensor
                     ) -> dict[str, Tensor]:
        """Return the loss over a rollout, and its parts."""
        settings, option = self.settings, choices.option
        log_policy = self.heads.compute_log_policies(rollout.observation, option, rollout.mask)
        policy_loss = -(take_column(log_policy, rollout.action) * advantage).mean()
        value_loss = 0.5 * functional.mse_loss(take_column(self.heads.critic(rollout.observation), option), target)
        entropy = compute_entropy(log_policy, rollout.mask)
        loss = policy_loss + settings.value_weight * value_loss - settings.entropy_weight * entropy
        margin = settings.deliberation_cost + settings.termination_margin
        termination_loss = self.heads.compute_termination_loss(
            rollout.next_observation, rollout.bootstrap > 0, option, margin)
        termination = take_column(self.heads.compute_betas(rollout.next_observation), option).mean().detach()
        return {"loss": loss + termination_loss, "policy_loss": policy_loss, "value_loss": value_loss,
                "entropy": entropy, "termination_loss": termination_loss, "termination": termination}
