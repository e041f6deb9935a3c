"""A tap on a flat room: tells a listener about every primitive, also those inside options.

It changes nothing in what passes through; the listener may take its time, and may stop the
episode by raising.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium

from hrl_escape.env.kinematics import RoomState

__all__ = ["Step", "Tap"]


class Step(NamedTuple):
    """One primitive and what came of it."""

    before: RoomState
    primitive: int
    after: RoomState
    reward: float
    pressed: tuple[int, ...]
    terminated: bool
    truncated: bool


class Tap(gymnasium.Wrapper):
    """Goes between a room and its `OptionsEnv`.

    Attributes:
        on_step: called after every primitive.
        before_step: called before every primitive.
        on_reset: called with the first state of an episode.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.on_step: Callable[[Step], None] | None = None
        self.before_step: Callable[[], None] | None = None
        self.on_reset: Callable[[RoomState], None] | None = None

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, and tell."""
        shown = self.env.reset(**arguments)
        if self.on_reset is not None:
            self.on_reset(self._get_state())
        return shown

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and tell."""
        if self.before_step is not None:
            self.before_step()
        before = self._get_state()
        shown = self.env.step(action)
        if self.on_step is not None:
            _, reward, terminated, truncated, info = shown
            self.on_step(Step(before, int(action), self._get_state(), float(reward), tuple(info["pressed"]),
                              terminated, truncated))
        return shown

    def _get_state(self) -> RoomState:
        room: Any = self.env.unwrapped
        return room.get_state()
