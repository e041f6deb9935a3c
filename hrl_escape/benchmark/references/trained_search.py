"""Base of search baselines that comparisons train: they remember earlier episodes, in rooms with button puzzles."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.search import SearchBacktrack
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.errors import UnsupportedError


class TrainedSearch(SearchBacktrack):
    """Search with backtracking that learns: `act` learns, `act_greedy` does not.

    The first decision raises `UnsupportedError` for puzzles other than buttons.
    """

    SPEC: ClassVar[str]
    """Name of the reference, for messages."""

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        self._is_learning = False

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Choose an action of a training episode."""
        self._is_learning = True
        return super().act_greedy(observation, action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Choose an action of an evaluation."""
        self._is_learning = False
        return super().act_greedy(observation, action_mask, rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Read the last presses of an episode, and learn from it."""
        if transition.terminated or transition.truncated:
            states = self._recorder.states
            self._read_on(states)
            self._chosen = None
            self._learn(transition, transition.terminated and self._puzzle.is_solved(states[-1].puzzle))
        return {}

    @abstractmethod
    def _learn(self, transition: SMDPTransition, has_escaped: bool) -> None:
        """Learn from an episode that ended with this transition."""

    def _begin(self, is_new: bool) -> None:
        room = self._room.instance
        if not isinstance(room.puzzle, ButtonsPuzzle):
            raise UnsupportedError(f"{self.SPEC} supports button puzzles; {room.name} has a puzzle of kind "
                                   f"{room.puzzle.kind!r}. Take search-backtrack, which forgets after each episode")
        super()._begin(is_new)
