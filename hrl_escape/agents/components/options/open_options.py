"""Options that many streams run, drawn as in one environment, a row a stream."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from hrl_escape.agents.components.options.choices import NONE, SMALLEST, OptionChoices, mix_with_former
from hrl_escape.agents.components.options.log import OptionLog
from hrl_escape.agents.components.policy_gradient import sample_policy, take_column
from hrl_escape.agents.state import StateTree
from hrl_escape.errors import CheckpointError

__all__ = ["OpenOptions"]


class OpenOptions:
    """The option that each stream runs, how it came to run, and for how many decisions it has run.

    Args:
        count: number of streams.
        device: device of all tensors.
        rng: seeds the generator of the draws.
    """

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

    def state_dict(self) -> StateTree:
        """Options, how they came to run, the generator's state; what is over must have been reported."""
        return {name: field.cpu().numpy() for name, field in self._list_fields()} | {
            "generator": self._generator.get_state().numpy()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`.

        Raises:
            CheckpointError: it is of other streams.
        """
        self._over = []
        for name, field in self._list_fields():
            if state[name].shape != tuple(field.shape):
                raise CheckpointError(f"the checkpoint's streams have {name} of shape {state[name].shape}; here are "
                                      f"{tuple(field.shape)}")
            field.copy_(torch.from_numpy(state[name]))
        self._generator.set_state(torch.from_numpy(state["generator"]))

    def _list_fields(self) -> tuple[tuple[str, Tensor], ...]:
        return (("option", self._option), ("former", self._former), ("is_chosen", self._is_chosen),
                ("log_probability", self._log_probability), ("decisions", self._decisions))
