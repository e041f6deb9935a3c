"""DDPG's linear relaxation of discrete actions, as the published program used keras-rl 0.4.2's DDPGAgent.

The critic sees the actor's unbounded outputs, noise included, in place of the action that ran.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray


class LinearRelaxation:
    """The action vector is the actor's output itself."""

    def encode(self, outputs: NDArray[np.float32], action: int) -> NDArray[np.float32]:
        """The vector that replay keeps: the outputs (actions,) that led to `action`."""
        del action
        return outputs

    def relax(self, outputs: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """The vectors that the critic sees for an actor's outputs (batch, actions): the outputs, legal or not."""
        del mask
        return outputs

    def compute_actor_loss(self, critic: Callable[[torch.Tensor], torch.Tensor], observation: torch.Tensor,
                           outputs: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """Minus the mean of Q(s, mu(s))."""
        del mask
        return -critic(torch.cat((observation, outputs), dim=1)).mean()
