"""Behaviour of keras-rl 0.4.2 that the papers of its algorithms do not have, as the published results contain it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents.agent import LearningSettings, SMDPTransition, compute_backup
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.state import Kept, Stateful


class LateTerminal(Stateful):
    """The early end flag of its SARSAAgent: delays each experience, and moves the episode's end one decision forward.

    The last decision but one is valued as if nothing followed, and the last bootstraps even from a terminal state.
    """

    STATE = (Kept("_waiting", pack=lambda one: {name: np.asarray(field) for name, field in one._asdict().items()},
                  unpack=lambda saved: Experience(**saved)),)

    def __init__(self) -> None:
        self._waiting: Experience | None = None

    def push(self, experience: Experience, transition: SMDPTransition, settings: LearningSettings
             ) -> list[tuple[Experience, int | None]]:
        """Take in a decision and its backup; returns what is to be learned now.

        That are pairs of an experience and the action to bootstrap from; None where no action was taken there.
        """
        is_over = transition.terminated or transition.truncated
        _, factor = compute_backup(transition._replace(terminated=False, truncated=False), settings)
        due: list[tuple[Experience, int | None]] = []
        if self._waiting is not None:
            ended = is_over and experience.bootstrap == 0
            due.append((self._waiting._replace(bootstrap=0.0) if ended else self._waiting, transition.action))
        without_end = experience._replace(bootstrap=factor)
        if is_over:
            due.append((without_end, None))
        self._waiting = None if is_over else without_end
        return due


class LinearRelaxation:
    """The linear relaxation of discrete actions by its DDPGAgent: the vector of an action is the actor's output.

    So the critic sees unbounded outputs, noise included, in place of the action that ran.
    """

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
