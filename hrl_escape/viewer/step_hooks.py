"""Callbacks on every primitive of a flat room, those inside options included.

The wrapper changes nothing that passes through it. A callback may take its time, and may stop
the episode by raising.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from hrl_escape.env.episode_end import EpisodeEnd
from hrl_escape.env.kinematics import RoomState


class PrimitiveStep(NamedTuple):
    """One primitive and its transition."""

    before: RoomState
    primitive: int
    after: RoomState
    reward: float
    pressed: tuple[int, ...]
    end: EpisodeEnd


class StepHooks(gymnasium.Wrapper):
    """Wrapper between a flat room and its `OptionsEnv` that calls back.

    Attributes:
        on_step: called after every primitive.
        before_step: called before every primitive.
        on_reset: called with the first state of an episode.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.on_step: Callable[[PrimitiveStep], None] | None = None
        self.before_step: Callable[[], None] | None = None
        self.on_reset: Callable[[RoomState], None] | None = None

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, then call `on_reset`."""
        result = self.env.reset(**arguments)
        if self.on_reset is not None:
            self.on_reset(self._get_state())
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Run one primitive between `before_step` and `on_step`."""
        if self.before_step is not None:
            self.before_step()
        before = self._get_state()
        result = self.env.step(action)
        if self.on_step is not None:
            _, reward, terminated, truncated, info = result
            pressed = tuple(np.flatnonzero(info["pressed"]).tolist())
            self.on_step(PrimitiveStep(before, int(action), self._get_state(), float(reward), pressed,
                                       EpisodeEnd.of_step(bool(info["success"]), terminated, truncated)))
        return result

    def _get_state(self) -> RoomState:
        room: Any = self.env.unwrapped
        return room.get_state()
