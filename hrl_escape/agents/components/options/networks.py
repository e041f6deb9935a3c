"""Networks of options: what they say of one observation and of many, and the losses that learners share.

Networks of the policies of all options, their values Q(s, o), the policy over options and the terminations.

The option is drawn from pi(o | s, o-) = (1 - beta_o-(s)) [o = o-] + beta_o-(s) pi_Omega(o | s), where o- ran before,
and in an episode's first state from pi_Omega; `OptionChoices` keep what ran, and how likely it was.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.components.exploration import compute_softmax, make_rng, mask_values
from hrl_escape.agents.components.networks import (
    Learner,
    ObservationEncoder,
    make_forward,
    make_generator,
    make_network,
)
from hrl_escape.agents.components.options.agent import OptionLog
from hrl_escape.agents.components.policy_gradient import (
    Rollout,
    compute_advantages,
    compute_clipped_parts,
    compute_log_policy,
    find_next,
    sample_policy,
    take_column,
)
from hrl_escape.agents.state import Stateful

NONE = -1
"""In place of the option before an episode's first decision."""
SMALLEST = 1e-12
"""Probability below which the logarithm of a choice is cut off."""


class OptionChoices(NamedTuple):
    """Options of the decisions of a rollout."""

    option: Tensor  # int64 (n,), that ran
    former: Tensor  # int64 (n,), that ran before it; `NONE` at an episode's first decision
    is_chosen: Tensor  # bool (n,), the former had ended, or there was none
    log_probability: Tensor | None = None
    """Float32 (n,), of the option that ran, as it was drawn; None where the networks are still those that drew."""


def mix_with_former(beta: Tensor, choice: Tensor, former: Tensor) -> Tensor:
    """pi(o | s, the option before), from beta and pi_Omega, all (n, options); with one option it is 1 to the bit."""
    kept = torch.nn.functional.one_hot(former.clamp(min=0), choice.shape[1]).to(choice.dtype)
    ends = beta.gather(1, former.clamp(min=0)[:, None]).masked_fill((former == NONE)[:, None], 1.0)
    return torch.where(ends == 1.0, choice, kept + ends * (choice - kept))


def mix_values(choice: Tensor, values: Tensor, former: Tensor) -> Tensor:
    """Sum over options of choice x Q(s, o), (n,) from (n, options); exact where one option has all of the choice."""
    base = take_column(values, former.clamp(min=0))
    return base + (choice * (values - base[:, None])).sum(dim=1)


class OpenOptions(Stateful):
    """The option that each stream runs, how it came to run, and for how many decisions it has run."""

    STATE = ("_option", "_former", "_is_chosen", "_log_probability", "_decisions", "_generator")

    def __init__(self, count: int, device: torch.device, rng: np.random.Generator) -> None:
        self._generator = torch.Generator(device).manual_seed(int(rng.integers(2**63)))
        self._option, self._former = (torch.full((count,), NONE, device=device) for _ in range(2))
        self._is_chosen = torch.ones(count, dtype=torch.bool, device=device)
        self._log_probability = torch.zeros(count, device=device)
        self._decisions = torch.zeros(count, dtype=torch.int64, device=device)
        self._over: list[Tensor] = []  # runs that are over: option and decisions, (2, n) each

    def draw(self, stream: Tensor, betas: Tensor, choice: Tensor) -> Tensor:
        """Draw whether the options of streams end, and the next ones; of a new episode, the first. Returns int64 (n,).

        `betas` are the terminations of all options where the streams are, `choice` the policy over options there, (n,
        options).
        """
        former = self._option[stream]
        draws = torch.rand(len(stream), generator=self._generator, device=stream.device)
        ends = (former == NONE) | (draws < take_column(betas, former.clamp(min=0)))
        option = torch.where(ends, sample_policy(choice.clamp(min=SMALLEST).log(), self._generator), former)
        chance = take_column(mix_with_former(betas, choice, former), option)
        self._finish(stream[ends & (former != NONE)])
        self._option[stream], self._former[stream], self._is_chosen[stream] = option, former, ends
        self._log_probability[stream] = chance.clamp(min=SMALLEST).log()
        return option

    def get_running(self, stream: Tensor) -> Tensor:
        """Options that some streams run, int64 (n,)."""
        return self._option[stream]

    def end(self, stream: Tensor, over: Tensor) -> OptionChoices:
        """Options of decisions that ended, int64 (n,); where the episode is `over` too, bool (n,), none goes on."""
        choices = OptionChoices(self._option[stream], self._former[stream], self._is_chosen[stream],
                                self._log_probability[stream])
        self._decisions[stream] += 1
        self._finish(stream[over])
        self._option[stream[over]] = NONE
        return choices

    def _finish(self, stream: Tensor) -> None:
        """Keep the runs of these streams' options, which are over."""
        self._over.append(torch.stack((self._option[stream], self._decisions[stream])))
        self._decisions[stream] = 0

    def report(self, log: OptionLog) -> None:
        """Tell a log of the runs that are over since the last report, in order."""
        runs = torch.cat(self._over, dim=1).T.tolist() if self._over else []
        self._over = []
        for option, decisions in runs:
            log.add(option, decisions)

    def begin_episodes(self) -> None:
        """Drop the options that run: every stream begins an episode."""
        self._option.fill_(NONE)
        self._decisions.zero_()

    def after_load(self) -> None:
        """Forget the runs that are over: a log was told of them before the state was taken."""
        self._over = []


class OptionHeads(Stateful):
    """Networks of a fixed number of options over encoded observations, and their optimiser.

    Args:
        settings: of the agent: those of networks, `options`, and `initial_termination` where options end.
        trained: names of the networks that are learned with `learning_rate`; empty for all.

    Attributes:
        networks: by name. `policy`: logits of every option's policy, (options x actions). `critic`: Q(s, o) in scaled
            return, (options,). `ending`: terminations before the logistic function and the shift of
            `initial_termination`, (options,). `chooser`: logits of the policy over options, (options,).
    """

    STATE = ("learner",)
    names: ClassVar[tuple[str, ...]] = ("policy", "critic", "ending", "chooser")

    def __init__(self, name: str, encoder: ObservationEncoder, actions: int, seed: int, settings: Any,
                 trained: tuple[str, ...] = ()) -> None:
        self.settings, self.options, self.actions, self._encoder = settings, settings.options, actions, encoder
        generator = make_generator(make_rng(seed, "weights"))
        self.networks = {}
        for head in self.names:
            outputs = self.options * (actions if head == "policy" else 1)
            gain = 1.0 if head == "critic" else 0.01
            self.networks[head] = make_network(encoder, outputs, settings, generator, 0, gain)
        self.policy, self.critic = self.networks["policy"], self.networks["critic"]
        self.learner = Learner(name, self.networks, trained or self.names, settings)
        self._make_forwards()

    def _make_forwards(self) -> None:
        self._forward = {name: make_forward(network) for name, network in self.networks.items()}

    def move(self, device: torch.device) -> None:
        """Move networks and optimiser to a device."""
        self.learner.move(device)
        self._make_forwards()

    @property
    def _shift(self) -> float:
        """Number added to the outputs of the network of terminations, so that 0 there is `initial_termination`."""
        return math.log(self.settings.initial_termination / (1 - self.settings.initial_termination))

    # --- of one observation ---------------------------------------------------------------

    def compute(self, network: str, observation: Any) -> NDArray[np.float64]:
        """Outputs of a network for one observation."""
        return self._forward[network](self._encoder.encode(observation)).astype(np.float64)

    def compute_policies(self, observation: Any, action_mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """pi_o(a | s) over legal actions, float64 (options, actions)."""
        logits = self.compute("policy", observation).reshape(self.options, -1)
        return compute_softmax(mask_values(logits, action_mask))

    def compute_terminations(self, observation: Any) -> NDArray[np.float64]:
        """Probability that each option ends at the observation, beta_o(s), float64 (options,)."""
        return 1 / (1 + np.exp(-self.compute("ending", observation) - self._shift))

    def compute_option_policy(self, observation: Any) -> NDArray[np.float64]:
        """pi_Omega(o | s), float64 (options,)."""
        return compute_softmax(self.compute("chooser", observation))

    def compute_option_values(self, observation: Any) -> NDArray[np.float64]:
        """Q(s, .) of options, in units of return, float64 (options,)."""
        return self.compute("critic", observation) / self.settings.reward_scale

    # --- of many, on their device ---------------------------------------------------------

    def compute_log_policies(self, observation: Tensor, option: Tensor, mask: Tensor) -> Tensor:
        """Log probabilities of the actions of one option a row, (n, actions)."""
        logits = self.policy(observation).view(len(option), self.options, self.actions)
        return compute_log_policy(logits[torch.arange(len(option), device=option.device), option], mask)

    def compute_betas(self, observation: Tensor) -> Tensor:
        """beta_o(s) of all options, (n, options)."""
        return torch.sigmoid(self.networks["ending"](observation) + self._shift)

    def compute_option_choice(self, observation: Tensor, former: Tensor) -> Tensor:
        """pi(o | s, the option before), (n, options)."""
        return mix_with_former(self.compute_betas(observation), self.compute_fresh_choice(observation), former)

    def compute_fresh_choice(self, observation: Tensor) -> Tensor:
        """pi_Omega(o | s), (n, options)."""
        return torch.softmax(self.networks["chooser"](observation), dim=1)

    # --- learning ---------------------------------------------------------------------------

    def compute_next_values(self, rollout: Rollout, choices: OptionChoices) -> tuple[Tensor, Tensor]:
        """Values of the states reached, (n,) each: of the option that ran next, and before that one was drawn.

        Where none ran next in the rollout, because the episode was cut or the rollout ended, both are the latter.
        """
        values = self.critic(rollout.next_observation)
        mean = mix_values(self.compute_option_choice(rollout.next_observation, choices.option), values, choices.option)
        after, goes_on = find_next(rollout)
        return torch.where(goes_on, take_column(values, choices.option[after]), mean), mean

    def compute_advantages(self, rollout: Rollout, choices: OptionChoices, values: Tensor, cost: float) -> Tensor:
        """Advantages of actions within options, (n,); ending an option costs `cost`, in scaled return, upon arrival."""
        next_values, _ = self.compute_next_values(rollout, choices)
        betas = take_column(self.compute_betas(rollout.next_observation), choices.option)
        after, goes_on = find_next(rollout)
        ends = torch.where(goes_on, choices.is_chosen[after].float(), betas)
        return compute_advantages(rollout, values, next_values - cost * ends, self.settings)

    def compute_termination_loss(self, reached: Tensor, goes_on: Tensor, option: Tensor, margin: float) -> Tensor:
        """Mean of beta_o(s') (Q(s', o) - V(s') + margin) over decisions, 0 where the task ended, ().

        `reached` are the states s', encoded, (n, ...), at which the task goes on or not, bool (n,); the margin is in
        scaled return.

        V(s') is the mean of Q(s', .) over the policy over options, and only beta has a gradient.
        """
        with torch.no_grad():
            values = self.critic(reached)
            worse = take_column(values, option) - mix_values(self.compute_fresh_choice(reached), values, option)
        return (take_column(self.compute_betas(reached), option) * (worse + margin) * goes_on).mean()

    def compute_old_log_probability(self, rollout: Rollout, choices: OptionChoices) -> Tensor:
        """Log probability of each action when it was chosen, (n,); while the networks are those that chose."""
        if choices.log_probability is not None:
            return rollout.log_probability
        return take_column(self.compute_log_policies(rollout.observation, choices.option, rollout.mask),
                           rollout.action)

    def compute_option_loss(self, observation: Tensor, mask: Tensor, option: Tensor, action: Tensor,
                            old_log_probability: Tensor, advantage: Tensor, target: Tensor) -> dict[str, Tensor]:
        """PPO's loss of actions within options over a minibatch, and its parts.

        Observations are encoded, (n, ...), the mask is bool (n, actions), all others are (n,); the target is that of
        Q(s, o).
        """
        log_policy = self.compute_log_policies(observation, option, mask)
        values = take_column(self.critic(observation), option)
        return compute_clipped_parts(log_policy, mask, action, values, old_log_probability, advantage, target,
                                     self.settings)
