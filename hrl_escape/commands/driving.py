"""Open-loop driving by primitives written as text, and its record. Not a command."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from hrl_escape.env.episode_end import EpisodeEnd
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.names import parse_whole

RANDOM = "random"
MOST_REPEATS = 1_000_000


@dataclasses.dataclass(frozen=True)
class Drive:
    """Record of one episode.

    Attributes:
        primitives: names of the primitives that ran, in order.
        states: one more than primitives.
        rewards: one a primitive.
        pressed: number of a primitive, from 1, and the names of the targets that it pressed.
        end: how the episode ended.
    """

    primitives: tuple[str, ...]
    states: tuple[RoomState, ...]
    rewards: tuple[float, ...]
    pressed: tuple[tuple[int, tuple[str, ...]], ...]
    end: EpisodeEnd

    @property
    def total(self) -> float:
        """Return of the episode, without discount."""
        return float(sum(self.rewards))

    @property
    def path(self) -> list[tuple[float, float]]:
        """Positions of the body's axis, m."""
        return [(state.x, state.y) for state in self.states]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"primitives": list(self.primitives), "return": self.total, "end": self.end.value,
                "path": self.path,
                "pressed": [{"primitive": at, "targets": list(names)} for at, names in self.pressed]}


def parse_primitives(text: str, instance: RoomInstance, seed: int = 0) -> list[int]:
    """Read primitives such as "forward*3, turn-left random*20".

    Args:
        text: names or action numbers, separated by spaces or commas; `*n` repeats, `random` draws.
        instance: the room whose robot they are for.
        seed: seed of the random primitives.

    Returns:
        Action numbers.

    Raises:
        UnknownNameError: no such primitive.
        ConfigError: an impossible number of repetitions.
    """
    names, rng = get_names(instance), np.random.default_rng(seed)
    actions: list[int] = []
    for word in filter(None, re.split(r"[\s,]+", text)):
        name, star, times = word.partition("*")
        count = parse_whole(times) if star else 1
        if count is None or not 0 < count <= MOST_REPEATS:
            raise ConfigError("primitives", word, f"name*n with n from 1 to {MOST_REPEATS}")
        number = parse_whole(name)
        if number is not None and number < len(names):
            name = names[number]
        if name not in (*names, RANDOM):
            raise UnknownNameError("primitive", name, (*names, RANDOM))
        actions += rng.integers(len(names), size=count).tolist() if name == RANDOM else [names.index(name)] * count
    return actions


def get_names(instance: RoomInstance) -> tuple[str, ...]:
    """Names of the room's primitives, in action order."""
    return instance.robot.actions.names


def drive_room(instance: RoomInstance, actions: Sequence[int], seed: int = 0) -> Drive:
    """Run primitives from the start until they or the episode end.

    Args:
        instance: the room.
        actions: action numbers.
        seed: episode seed; fixes the start and the noise.
    """
    env = EscapeRoomEnv(instance=instance)
    env.reset(seed=seed)
    states, rewards, pressed = [env.get_state()], [], []
    end = EpisodeEnd.STOPPED
    for number, action in enumerate(actions, start=1):
        _, reward, terminated, truncated, info = env.step(action)
        states.append(env.get_state())
        rewards.append(float(reward))
        if info["pressed"].any():
            pressed.append((number, tuple(instance.targets[target].name for target in np.flatnonzero(info["pressed"]))))
        end = EpisodeEnd.of_step(bool(info["success"]), terminated, truncated)
        if end.is_over:
            break
    env.close()
    names = get_names(instance)
    done = tuple(names[action] for action in actions[: len(rewards)])
    return Drive(done, tuple(states), tuple(rewards), tuple(pressed), end)
