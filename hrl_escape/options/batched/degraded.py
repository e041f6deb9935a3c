"""`OptionDegradation` in tensors: the draws of `degraded.py` for every room at once.

A draw depends on the seed of the degradation, the option's name, and the episode and primitive of the room, so that an
option fails and stops here where it does in `OptionsEnv`.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from hrl_escape.env.batched.noise import philox
from hrl_escape.env.batched.poses import TensorState
from hrl_escape.options.degraded import OptionDegradation

__all__ = ["draw_uniform", "name_options"]

_MASK = 0xFFFFFFFF


def name_options(targets: int) -> tuple[str, ...]:
    """Names of the batched options of rooms with a number of targets, in the order of their actions."""
    return (*(f"meta-{n + 1:02d}" for n in range(targets)), "meta-exit")


def draw_uniform(degradation: OptionDegradation, names: Sequence[str], option: Tensor, purpose: int,
                 state: TensorState) -> Tensor:
    """Uniform numbers in (0, 1) for a purpose at the present primitives, float64 (rooms,).

    Args:
        degradation: its seed is that of the draws.
        names: names of the options.
        option: number of each room's option, int64 (rooms,).
        purpose: `FAILURE` or `STOP`.
        state: states of the rooms.
    """
    keys = torch.tensor([degradation.make_key(name) for name in names], device=option.device)[option]
    episode, primitive = state.noise_key, state.primitives.to(torch.int64)
    word, *_ = philox((primitive & _MASK, torch.full_like(episode, purpose), episode & _MASK, (episode >> 32) & _MASK),
                      (keys[:, 0], keys[:, 1]))
    return (word.to(torch.float64) + 0.5) / 2**32
