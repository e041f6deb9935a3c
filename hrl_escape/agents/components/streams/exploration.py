"""Exploration from action values of many streams: the draws of `exploration.py`, a row a stream."""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_escape.agents.components.exploration import ExplorationSettings, compute_epsilon

__all__ = ["sample_actions"]


def sample_actions(values: Tensor, mask: Tensor, settings: ExplorationSettings, steps: int,
                   generator: torch.Generator) -> Tensor:
    """Draw an action for each row of values (n, actions) as `sample_action` does, int64 (n,).

    Args:
        values: in units of return.
        mask: bool (n, actions), legal.
        settings: of exploration.
        steps: on the clock.
        generator: on the device of the values.
    """
    waits = torch.empty_like(values).exponential_(generator=generator).clamp_(min=1e-30).log()
    if settings.exploration == "boltzmann":
        ratio = values / settings.temperature
        if settings.boltzmann_clip:
            ratio = ratio.clamp(-settings.boltzmann_clip, settings.boltzmann_clip)
        return (ratio - waits).masked_fill(~mask, -torch.inf).argmax(dim=1)
    best, any_legal = (scores.masked_fill(~mask, -torch.inf).argmax(dim=1) for scores in (values, -waits))
    draws = torch.rand(len(values), generator=generator, device=values.device)
    return torch.where(draws < compute_epsilon(settings, steps), any_legal, best)
