"""Proximal policy option-critic: PPO within options, policy gradient among them, and the termination gradient.

Klissarov, Bacon, Harb and Precup (2017). The constants of the published program (mklissa/PPOC) are settings here,
except for the step size of terminations, 5e-7. The program makes two steps per minibatch, of 5e-7 for terminations and
of 3e-4 for everything else. These share the moments of one Adam, and the second step therefore also moves terminations,
by 2e-4 in total. Here two optimisers make two steps, of 2e-4 and of `learning_rate`. Unlike in that program,
terminations are learned at the next state for the option that ran, and the policy over options where an option was
chosen.
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
    """Settings of `ppoc`: options, their terminations and the clipped updates."""

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
    options: Annotated[int, Range(1)] = 2
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
    least_samples: Annotated[int, Range(2)] = 160
    """Smallest number of decisions of an option before it is updated, collected over several rollouts if necessary."""
    termination_rate: Annotated[float, Range(0)] = 2e-4
    """Step size of Adam for terminations, one step per minibatch. The default is the total effect of the published
    program's 5e-7 and 3e-4. 0 keeps terminations fixed."""
    option_entropy_weight: Annotated[float, Range(0)] = 0.1
    """Weight of the entropy of the policy over options in the loss. More keeps more options in use."""
    deliberation_cost: Annotated[float, Range(0)] = 0.0
    """Cost of ending an option, in scaled return, paid on arrival, which makes it a margin of terminations. More makes
    options last longer."""


class OptionSamples(NamedTuple):
    """Decisions of one option that wait for its update, tensors with leading dimension n."""

    observation: Tensor  # encoded
    mask: Tensor  # bool (n, actions)
    action: Tensor  # int64
    log_probability: Tensor  # of the action, under the behaviour policy
    advantage: Tensor  # of the action within the option
    target: Tensor  # of Q(s, o)
    choice_advantage: Tensor  # target - V(s) if the option was chosen at this decision, otherwise 0
    is_chosen: Tensor  # bool, whether the option was chosen at this decision
    reached: Tensor  # encoded next observation
    goes_on: Tensor  # bool, whether the task continues


class PPOC(OptionRolloutAgent):
    """Learn pi_o, Q(s, o), pi_Omega and beta_o from decisions (s, o, a) -> R, s'.

        arrival      U = Q(s', o) if o continues, Q(s', o') - cost if it ended and o' was chosen; the mean of both if
                     neither is known
        policy       PPO on log pi_o(a | s) with the advantages of Q and U; Q(s, o) towards advantage + Q(s, o)
        choice       grad log pi_Omega(o | s) (target - V(s)) if o was chosen, V(s) = sum pi_Omega(o | s) Q(s, o)
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
            batches = (OptionSamples(*(field.index_select(0, rows) for field in own))
                       for rows in self._draw_batches(len(own.action), len(choices.option)))
            metrics |= self.heads.learner.minimise_each(
                self.compute_loss(option, batch) | self.step_termination(option, batch) for batch in batches)
            metrics["gradient_norm"] = self.heads.learner.gradient_norm
        betas = take_column(self.heads.compute_betas(rollout.next_observation), choices.option)
        return metrics | {"termination": betas.mean().item(),
                          "value": (samples.target - samples.advantage).mean().item() / settings.reward_scale}

    def compute_samples(self, rollout: Rollout, choices: OptionChoices) -> OptionSamples:
        """Return the samples of every decision for its option, computed before the networks change."""
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
        """Make one step of an option's terminations over some decisions; none with one option or without a rate."""
        if self.options == 1 or not self.settings.termination_rate:
            return {}
        loss = self.heads.compute_termination_loss(batch.reached, batch.goes_on, torch.full_like(batch.action, option),
                                                   self.settings.deliberation_cost)
        self._ending_learner.minimise(loss)
        return {"termination_loss": loss.detach()}

    def compute_loss(self, option: int, batch: OptionSamples) -> dict[str, Tensor]:
        """Return the loss of an option over some of its decisions, and its parts."""
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
        """Move networks, optimisers and waiting samples to a device."""
        self._ending_learner.move(device)
        super().move(device)
        self._waiting = {option: OptionSamples(*(field.to(device) for field in samples))
                         for option, samples in self._waiting.items()}

    def after_load(self) -> None:
        """Move waiting samples to the networks' device."""
        device = self.heads.policy.weights.device
        self._waiting = {option: OptionSamples(*(field.to(device) for field in samples))
                         for option, samples in self._waiting.items()}
