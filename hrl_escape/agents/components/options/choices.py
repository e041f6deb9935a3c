"""Choices of options in a rollout: what ran, what ran before it, and how likely each option was.

The option is drawn from pi(o | s, o-) = (1 - beta_o-(s)) [o = o-] + beta_o-(s) pi_Omega(o | s), where o- ran before,
and in an episode's first state from pi_Omega.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from hrl_escape.agents.components.policy_gradient import Rollout, take_column

__all__ = ["NONE", "SMALLEST", "OptionChoices", "find_next", "mix_values", "mix_with_former"]

NONE = -1
"""In place of the option before an episode's first decision."""
SMALLEST = 1e-12
"""Probability below which the logarithm of a choice is cut off."""


class OptionChoices(NamedTuple):
    """Options of the decisions of a rollout.

    Attributes:
        option: int64 (n,), that ran.
        former: int64 (n,), that ran before it; `NONE` at an episode's first decision.
        is_chosen: bool (n,), the former had ended, or there was none.
        log_probability: float32 (n,), of the option that ran, as it was drawn; None where the networks are still those
            that drew.
    """

    option: Tensor
    former: Tensor
    is_chosen: Tensor
    log_probability: Tensor | None = None


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


def find_next(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Next decision of the same stream.

    Returns:
        Its row, int64 (n,), and bool (n,): it is in the rollout, in the same episode. Where it is not, the row is 0.
    """
    place, stream = rollout.place, rollout.stream
    shape = int(place.max()) + 2, int(stream.max()) + 1
    rows = torch.full(shape, -1, dtype=torch.int64, device=place.device)
    rows[place, stream] = torch.arange(len(place), device=place.device)
    after = rows[place + 1, stream]
    return after.clamp(min=0), (after >= 0) & ~rollout.over


def mix_values(choice: Tensor, values: Tensor, former: Tensor) -> Tensor:
    """Sum over options of choice x value, (n,); exact where one option has all of the choice.

    Args:
        choice: (n, options).
        values: Q(s, o), (n, options).
        former: int64 (n,).
    """
    base = take_column(values, former.clamp(min=0))
    return base + (choice * (values - base[:, None])).sum(dim=1)
