"""Schedule of rooms: evaluation episodes cycle through a set in order."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
from gymnasium.utils import RecordConstructorArgs


class RoomSchedule(gymnasium.Wrapper, RecordConstructorArgs):
    """Wrapper that chooses the room of an episode by its seed, for evaluations that cycle through a set.

    Args:
        env: an `InstanceSetEnv`.
        rooms: episode seed -> number of the room in the set. Episodes with other seeds draw a room.
    """

    def __init__(self, env: gymnasium.Env, rooms: Mapping[str, int]) -> None:
        RecordConstructorArgs.__init__(self, rooms=dict(rooms))
        super().__init__(env)
        self._rooms = {int(seed): number for seed, number in rooms.items()}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in the room of its seed."""
        if seed in self._rooms:
            options = {"instance_index": self._rooms[seed], **(options or {})}
        return self.env.reset(seed=seed, options=options)
