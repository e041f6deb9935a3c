"""The early end flag of keras-rl 0.4.2's SARSAAgent, a mistake that the published results contain.

The flag that the episode ended reaches the learner one decision early: the last decision but one is valued as if
nothing followed, and the last bootstraps even from a terminal state.
"""

from __future__ import annotations

import numpy as np

from hrl_escape.agents.agent import SMDPTransition, compute_backup
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.settings import LearningSettings
from hrl_escape.agents.state import Kept, Stateful, StateTree


def _pack(experience: Experience) -> StateTree:
    return {name: np.asarray(field) for name, field in experience._asdict().items()}


class LateTerminal(Stateful):
    """Delays each experience by one decision and moves the end of the episode to the one before."""

    STATE = (Kept("_waiting", pack=_pack, unpack=lambda saved: Experience(**saved)),)

    def __init__(self) -> None:
        self._waiting: Experience | None = None

    def push(self, experience: Experience, transition: SMDPTransition, settings: LearningSettings
             ) -> list[tuple[Experience, int | None]]:
        """Take in one decision; returns what is to be learned now.

        Args:
            experience: its backup.
            transition: the same decision.
            settings: discounting and treatment of truncation.

        Returns:
            Pairs of an experience and the action to bootstrap from; None where no action was taken there.
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
