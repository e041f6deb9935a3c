"""Option-critic over networks: advantage actor-critic within options, learned terminations, a price of ending.

A2OC of Harb, Bacon, Klissarov and Precup (2018), which is option-critic (Bacon, Harb and Precup 2017) on returns of
several decisions; in one environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.components.exploration import compute_epsilon_greedy
from hrl_escape.agents.components.option_agent import OptionSettings
from hrl_escape.agents.components.option_networks import OptionChoices, OptionHeads, StreamOptionAgent
from hrl_escape.agents.components.policy_gradient import AdvantageSettings, Rollout, compute_entropy, take_column
from hrl_escape.settings import Range


@dataclass(frozen=True)
class A2OCSettings(AdvantageSettings, OptionSettings):
    """Options, their terminations and the actor-critic update of `a2oc`."""

    rollout: Annotated[int, Range(2)] = 20
    """Decisions collected before each update."""
    stream_rollout: Annotated[int, Range(1)] = 20
    """Decisions of each stream, on average, that a rollout of several streams has at least."""
    epsilon: Annotated[float, Range(0, 1)] = 0.1
    """Share of options that are chosen at random, and of the mean in the value of ending an option."""
    deliberation_cost: Annotated[float, Range(0)] = 0.01
    """Price of ending an option, in scaled return: paid upon arrival, and so a margin of terminations."""
    termination_margin: Annotated[float, Range(0)] = 0.0
    """Margin by which an option must be worse than the mean before it is ended more often, in scaled return; no value
    pays it."""


class GreedyHeads(OptionHeads):
    """Networks of options whose choice is epsilon-greedy in their values."""

    names: ClassVar[tuple[str, ...]] = ("policy", "critic", "ending")

    def compute_option_policy(self, observation: Any) -> NDArray[np.float64]:
        """Epsilon-greedy choice among the values of options, float64 (options,)."""
        return compute_epsilon_greedy(self.compute_option_values(observation), self.settings.epsilon)

    def compute_fresh_choice(self, observation: Tensor) -> Tensor:
        """The same for many observations, (n, options)."""
        best = functional.one_hot(self.critic(observation).argmax(dim=1), self.options)
        return (1 - self.settings.epsilon) * best + self.settings.epsilon / self.options


class A2OC(StreamOptionAgent):
    """Learn pi_o, Q(s, o) and beta_o from every few decisions (s, o, a) -> R, s', in one step down the sum of losses.

        policy       - log pi_o(a | s) (G - Q(s, o)) - weight x entropy of pi_o
        critic       weight x half of (G - Q(s, o))^2
        termination  beta_o(s') (Q(s', o) - V(s') + cost + margin), unless terminated

    G = R + b G' where the next decision is known, b its discount, less b x cost where the option ended before it; at
    the last one G' = U(s', o) = (1 - beta_o(s')) Q(s', o) + beta_o(s') (V(s') - cost). V is the value of the
    epsilon-greedy choice among options, by which they are chosen.
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
        """The loss over a rollout, and its parts."""
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
