"""Behaviour of keras-rl 0.4.2 that differs from the papers of its algorithms, as the published results contain it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents.agent import compute_backup
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.decisions import Decisions
from hrl_escape.agents.state import Kept, Stateful


class LateTerminal(Stateful):
    """The early end flag of its SARSAAgent: delays each experience, and moves the episode's end one decision forward.

    The second to last decision is valued as if it were terminal, and the last bootstraps even from a terminal state.
    """

    STATE = (Kept("_waiting", pack=lambda one: {name: np.asarray(field) for name, field in one._asdict().items()},
                  unpack=lambda saved: Experience(**saved)),)

    def __init__(self) -> None:
        self._waiting: Experience | None = None

    def push(self, experience: Experience, batch: Decisions, settings: Any) -> list[tuple[Experience, int | None]]:
        """Store one decision and its backup, both as batches; return what to learn now.

        The result has pairs of an experience and the action to bootstrap from, or None if no action followed.
        """
        no, is_over = np.zeros(1, np.bool_), bool(batch.terminated[0] or batch.truncated[0])
        _, factor = compute_backup(batch._replace(terminated=no, truncated=no), settings)
        due: list[tuple[Experience, int | None]] = []
        if self._waiting is not None:
            ended = is_over and experience.bootstrap[0] == 0
            before = self._waiting._replace(bootstrap=np.zeros(1, np.float32)) if ended else self._waiting
            due.append((before, int(batch.action[0])))
        without_end = experience._replace(bootstrap=np.asarray(factor, np.float32))
        if is_over:
            due.append((without_end, None))
        self._waiting = None if is_over else without_end
        return due


class LinearRelaxation:
    """The linear relaxation of discrete actions by its DDPGAgent: the vector of an action is the actor's output.

    The input of the critic is therefore the unbounded output, with noise, instead of the executed action.
    """

    def encode(self, outputs: NDArray[np.float32], action: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the vectors for replay: the outputs (n, actions) that led to the actions (n,)."""
        del action
        return outputs

    def relax(self, outputs: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """Return the critic's input for an actor's outputs (batch, actions): the outputs, legal or not."""
        del mask
        return outputs

    def compute_actor_loss(self, critic: Callable[[torch.Tensor], torch.Tensor], observation: torch.Tensor,
                           outputs: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """Return minus the mean of Q(s, mu(s))."""
        del mask
        return -critic(torch.cat((observation, outputs), dim=1)).mean()
