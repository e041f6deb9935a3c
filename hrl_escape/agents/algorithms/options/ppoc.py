"""Proximal policy option-critic: PPO within options, policy gradient among them, and the termination gradient.

Klissarov, Bacon, Harb and Precup (2017). The constants of its published program (mklissa/PPOC) are settings here, but
for the 5e-7 that it gives as the step size of terminations. Its two steps a minibatch, of 5e-7 for terminations and of
3e-4 for all else, share the moments of one Adam, and so the second moves terminations too: by 2e-4 in all. Two
optimisers here make two steps, of 2e-4 and of `learning_rate`. Unlike in that program, terminations are learned at the
state reached, for the option that ran, and the policy over options where an option was chosen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

import gymnasium
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.components.networks import Learner
from hrl_escape.agents.components.option_networks import OptionChoices, OptionRolloutAgent, mix_values
from hrl_escape.agents.components.policy_gradient import Rollout, take_column
from hrl_escape.agents.state import Kept, read_value
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class PPOCSettings(AgentSettings):
    """Options, their terminations and the clipped updates of `ppoc`."""

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
    options: Annotated[int, Range(1)] = 2
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
    least_samples: Annotated[int, Range(2)] = 160
    """Decisions of an option that are collected, over several rollouts if need be, before it is updated."""
    termination_rate: Annotated[float, Range(0)] = 2e-4
    """Step size of Adam for terminations, one step a minibatch. It is what the published program's 5e-7 and 3e-4 come
    to together; 0 leaves terminations as they begin."""
    option_entropy_weight: Annotated[float, Range(0)] = 0.1
    """Weight of the entropy of the policy over options in the loss."""
    deliberation_cost: Annotated[float, Range(0)] = 0.0
    """Price of ending an option, in scaled return: paid upon arrival, and so a margin of terminations."""


class OptionSamples(NamedTuple):
    """Decisions of one option that wait for its update, tensors with leading dimension n."""

    observation: Tensor  # encoded
    mask: Tensor  # bool (n, actions)
    action: Tensor  # int64
    log_probability: Tensor  # of the action, under the policy that chose it
    advantage: Tensor  # of the action within the option
    target: Tensor  # of Q(s, o)
    choice_advantage: Tensor  # target - V(s) where the option was chosen at this decision, else 0
    is_chosen: Tensor  # bool, it was chosen at this decision
    reached: Tensor  # encoded observation of the state reached
    goes_on: Tensor  # bool, the task did not end there


class PPOC(OptionRolloutAgent):
    """Learn pi_o, Q(s, o), pi_Omega and beta_o from decisions (s, o, a) -> R, s'.

        arrival      U = Q(s', o) if o goes on, Q(s', o') - cost if it ended and o' was chosen; where neither is known
                     the mean of both
        policy       PPO on log pi_o(a | s) with the advantages of Q and U; Q(s, o) towards advantage + Q(s, o)
        choice       grad log pi_Omega(o | s) (target - V(s)) where o was chosen, V(s) = sum pi_Omega(o | s) Q(s, o)
        termination  - grad beta_o(s') (Q(s', o) - V(s') + cost), unless terminated, with a step size of its own

    Each option is updated from its own decisions, once there are `least_samples`.
    """

    settings: PPOCSettings
    trained: ClassVar[tuple[str, ...]] = ("policy", "critic", "chooser")
    STATE = ("_ending_learner", Kept(
        "_waiting", pack=lambda waiting: [[option, read_value(own, "samples")] for option, own in waiting.items()],
        unpack=lambda saved: {
            int(option): OptionSamples(**{name: torch.from_numpy(np.asarray(field)) for name, field in own.items()})
            for option, own in saved}))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: PPOCSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._ending_learner = Learner(self.name, {"ending": self.heads.networks["ending"]}, ["ending"], self.settings,
                                       self.settings.termination_rate or 1.0)
        self._waiting: dict[int, OptionSamples] = {}

    def _learn(self, rollout: Rollout, choices: OptionChoices) -> Mapping[str, float]:
        settings = self.settings
        with torch.no_grad():
            samples = self.compute_samples(rollout, choices)
        for option in range(self.options):
            rows = choices.option == option
            if rows.any():
                own = OptionSamples(*(field[rows] for field in samples))
                former = self._waiting.get(option)
                self._waiting[option] = own if former is None else OptionSamples(
                    *map(torch.cat, zip(former, own, strict=True)))
        metrics: dict[str, float] = {}
        due = [option for option, own in self._waiting.items() if len(own.action) >= settings.least_samples]
        for option in sorted(due):
            own = self._waiting.pop(option)
            batches = (OptionSamples(*(field[rows] for field in own))
                       for rows in self._draw_batches(len(own.action), len(choices.option)))
            metrics |= self.heads.learner.minimise_each(
                self.compute_loss(option, batch) | self.step_termination(option, batch) for batch in batches)
            metrics["gradient_norm"] = self.heads.learner.gradient_norm
        betas = take_column(self.heads.compute_betas(rollout.next_observation), choices.option)
        return metrics | {"termination": betas.mean().item(),
                          "value": (samples.target - samples.advantage).mean().item() / settings.reward_scale}

    def compute_samples(self, rollout: Rollout, choices: OptionChoices) -> OptionSamples:
        """Lessons of every decision of a rollout for its option, while the networks are still those that chose."""
        option, critic = choices.option, self.heads.critic(rollout.observation)
        values = take_column(critic, option)
        advantage = self.heads.compute_advantages(rollout, choices, values, self.settings.deliberation_cost)
        target = advantage + values
        mean = mix_values(self.heads.compute_fresh_choice(rollout.observation), critic, option)
        return OptionSamples(rollout.observation, rollout.mask, rollout.action,
                             self.heads.compute_old_log_probability(rollout, choices), advantage, target,
                             (target - mean) * choices.is_chosen, choices.is_chosen, rollout.next_observation,
                             rollout.bootstrap > 0)

    def step_termination(self, option: int, batch: OptionSamples) -> dict[str, Tensor]:
        """One step of an option's terminations over some of its decisions; none with one option or without a rate."""
        if self.options == 1 or not self.settings.termination_rate:
            return {}
        loss = self.heads.compute_termination_loss(batch.reached, batch.goes_on, torch.full_like(batch.action, option),
                                                   self.settings.deliberation_cost)
        self._ending_learner.minimise(loss)
        return {"termination_loss": loss.detach()}

    def compute_loss(self, option: int, batch: OptionSamples) -> dict[str, Tensor]:
        """Loss of an option over some of its decisions, and its parts."""
        own = torch.full_like(batch.action, option)
        parts = self.heads.compute_option_loss(batch.observation, batch.mask, own, batch.action, batch.log_probability,
                                         batch.advantage, batch.target)
        log_choice = functional.log_softmax(self.heads.networks["chooser"](batch.observation), dim=1)
        choice_loss = -(log_choice[:, option] * batch.choice_advantage).mean()
        choice_entropy = -(log_choice.exp() * log_choice).sum(dim=1)
        choice_entropy = (choice_entropy * batch.is_chosen).mean()
        loss = parts.pop("loss") + choice_loss - self.settings.option_entropy_weight * choice_entropy
        return {"loss": loss, **parts, "choice_loss": choice_loss, "choice_entropy": choice_entropy}

    def move(self, device: torch.device) -> None:
        """Move networks, optimisers and what waits for updates to a device."""
        self._ending_learner.move(device)
        super().move(device)
        self._waiting = {option: OptionSamples(*(field.to(device) for field in samples))
                         for option, samples in self._waiting.items()}

    def after_load(self) -> None:
        """Move samples that wait for updates to the networks' device."""
        device = self.heads.policy.weights.device
        self._waiting = {option: OptionSamples(*(field.to(device) for field in samples))
                         for option, samples in self._waiting.items()}
