"""Choices of options: what runs in each stream, and in a rollout what ran, what ran before it, and how likely it was.

The option is drawn from pi(o | s, o-) = (1 - beta_o-(s)) [o = o-] + beta_o-(s) pi_Omega(o | s), where o- ran before,
and in an episode's first state from pi_Omega.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from hrl_escape.agents.components.options.agent import OptionLog
from hrl_escape.agents.components.policy_gradient import sample_policy, take_column
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
    """pi(o | s, the option before), (n, options); with one option it is 1 to the bit.

    Args:
        beta: terminations of all options, (n, options).
        choice: pi_Omega, (n, options).
        former: int64 (n,).
    """
    kept = torch.nn.functional.one_hot(former.clamp(min=0), choice.shape[1]).to(choice.dtype)
    ends = beta.gather(1, former.clamp(min=0)[:, None]).masked_fill((former == NONE)[:, None], 1.0)
    return torch.where(ends == 1.0, choice, kept + ends * (choice - kept))


def mix_values(choice: Tensor, values: Tensor, former: Tensor) -> Tensor:
    """Sum over options of choice x value, (n,); exact where one option has all of the choice.

    Args:
        choice: (n, options).
        values: Q(s, o), (n, options).
        former: int64 (n,).
    """
    base = take_column(values, former.clamp(min=0))
    return base + (choice * (values - base[:, None])).sum(dim=1)


class OpenOptions(Stateful):
    """The option that each stream runs, how it came to run, and for how many decisions it has run.

    Args:
        count: number of streams.
        device: device of all tensors.
        rng: seeds the generator of the draws.
    """

    STATE = ("_option", "_former", "_is_chosen", "_log_probability", "_decisions", "_generator")

    def __init__(self, count: int, device: torch.device, rng: np.random.Generator) -> None:
        self._generator = torch.Generator(device).manual_seed(int(rng.integers(2**63)))
        self._option, self._former = (torch.full((count,), NONE, device=device) for _ in range(2))
        self._is_chosen = torch.ones(count, dtype=torch.bool, device=device)
        self._log_probability = torch.zeros(count, device=device)
        self._decisions = torch.zeros(count, dtype=torch.int64, device=device)
        self._over: list[Tensor] = []  # runs that are over: option and decisions, (2, n) each

    def draw(self, stream: Tensor, betas: Tensor, choice: Tensor) -> Tensor:
        """Draw whether the options of some streams end, and the next ones; of a new episode, the first.

        Args:
            stream: int64 (n,), each once.
            betas: terminations of all options where the streams are, (n, options).
            choice: policy over options there, (n, options).

        Returns:
            The options that run now, int64 (n,).
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
