"""Environments over rooms by name: `make_env`, `make_vec`, and the entry points of `hrl_escape/Ladder-v1`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import gymnasium
from gymnasium.vector import VectorEnv

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ConfigError
from hrl_escape.sets.changes import change_config
from hrl_escape.sets.grammar import FreshRooms, NamedRooms, find_rooms, find_set, make_room
from hrl_escape.sets.instance_set import CHOOSING_ROOMS, InstanceSet, add_options, check_names
from hrl_escape.sets.room_sequence import RoomSequence, RoomSets
from hrl_escape.sets.sequence import SequenceEnv

RoomForm: TypeAlias = "str | RoomConfig | RoomInstance | RoomSets"
"""A text of the grammar in `sets.grammar`, a configuration, a room, or sets of rooms."""
LARGEST_BATCH = 10_000
"""Largest number of rooms of a vector environment, which generates them in advance."""


def make_env(room: RoomForm = "paper-two-button", options: bool | Mapping[str, Any] = False,
             changes: Mapping[str, Any] | None = None, **arguments: Any) -> gymnasium.Env:
    """Make an environment over rooms by name.

        env = make_env("clutter#3")                                   # one room
        env = make_env("clutter#*", observation="features")           # a fresh room each episode
        env = make_env("ladder-1/chain/train#0..64", options=True)    # each episode draws one of 64 rooms

    Args:
        room: text such as `clutter#3`, see `sets.grammar`; or a `RoomConfig`, `RoomInstance` or `InstanceSet`.
        options: wrap it in an `OptionsEnv`; a table gives its arguments.
        changes: changes to the configuration by dotted path, such as `{"room.width": 30}`.
        arguments: all other arguments of `EscapeRoomEnv`, such as `observation="features"`.

    Raises:
        ConfigError: the text is malformed, or names no rooms.
        UnknownNameError: no such preset, benchmark, rung, set, field or argument; the message names the closest.
    """
    rooms = _find(room, changes)
    if isinstance(rooms, RoomSequence):
        first, *others = (each.make_env(options, **arguments) for each in rooms.sets)
        return SequenceEnv(first, then=others, paired=rooms.paired)
    if isinstance(rooms, InstanceSet):
        return rooms.make_env(options, **arguments)
    check_names("EscapeRoomEnv (OptionsEnv's go into options={...})", arguments, EscapeRoomEnv, CHOOSING_ROOMS)
    if isinstance(rooms, FreshRooms):
        return add_options(EscapeRoomEnv(rooms.config, resample_instance=True, **arguments), options)
    return add_options(EscapeRoomEnv(instance=rooms, **arguments), options)


def make_vec(room: RoomForm = "paper-two-button", num_envs: int = 1, options: bool | Mapping[str, Any] = False,
             changes: Mapping[str, Any] | None = None, **arguments: Any) -> VectorEnv:
    """Make a Gymnasium vector environment over rooms by name; every episode of a set draws a room.

    Args:
        room: as in `make_env`, without sequences and `#*`.
        num_envs: number of environments.
        options: make an `OptionsVectorEnv`; a table gives its arguments.
        changes: as in `make_env`.
        arguments: all other arguments of the batch, such as `device="cuda"`.

    Raises:
        ConfigError: as `make_env` does; a fresh room each episode, a sequence, or more than `LARGEST_BATCH` rooms.
    """
    return _make_batch(num_envs, list_batch_arguments(_find(room, changes)), options, arguments)


def list_batch_arguments(rooms: NamedRooms) -> dict[str, Any]:
    """Return the arguments of a batch over rooms: one room, or a set from which every episode draws.

    Raises:
        ConfigError: a fresh room each episode, a sequence, or more than `LARGEST_BATCH` rooms.
    """
    if isinstance(rooms, FreshRooms):
        raise ConfigError("room", rooms.name, "a batch generates its rooms beforehand: write "
                          f"{rooms.name.rpartition('#')[0]}#0..256")
    if isinstance(rooms, RoomSequence):
        raise ConfigError("room", rooms.name, "sequences of rooms have no vector environment: take make_env")
    if isinstance(rooms, InstanceSet) and len(rooms) > LARGEST_BATCH:
        raise ConfigError("room", rooms.name, f"at most {LARGEST_BATCH:,} rooms in a batch, which generates them "
                          "beforehand")
    return {"instance": rooms} if isinstance(rooms, RoomInstance) else {
        "instance": list(rooms), "resample_instance": True}


def _make_batch(num_envs: int, rooms: Mapping[str, Any], options: bool | Mapping[str, Any],
                arguments: Mapping[str, Any]) -> VectorEnv:
    if isinstance(options, Mapping) or options:
        from hrl_escape.options.batched.vector_env import OptionsVectorEnv  # loads torch

        chosen = dict(options) if isinstance(options, Mapping) else {}
        return OptionsVectorEnv(num_envs, **{**rooms, **arguments, **chosen})
    from hrl_escape.env.vector_env import EscapeRoomVectorEnv  # loads torch

    return EscapeRoomVectorEnv(num_envs, **{**rooms, **arguments})


def _find(room: RoomForm, changes: Mapping[str, Any] | None) -> NamedRooms:
    if isinstance(room, str):
        return find_rooms(room, changes)
    if isinstance(room, InstanceSet):
        return InstanceSet(room.name, change_config(room.config, changes), room.seeds) if changes else room
    if isinstance(room, RoomSequence) and not changes:
        return room
    if isinstance(room, (RoomConfig, RoomInstance)):
        return make_room(room, changes)
    raise ConfigError("room", room, "a text such as clutter#3, a RoomConfig, a RoomInstance or an InstanceSet")


# --- hrl_escape/Ladder-v1 ------------------------------------------------------------------


def make_ladder_env(benchmark: str = "ladder-1", rung: str = "pair", set: str = "train", slice: str = "",
                    options: bool | Mapping[str, Any] = False, **arguments: Any) -> gymnasium.Env:
    """Make an environment over a rung's set of rooms; the entry point of `hrl_escape/Ladder-v1`.

    Args:
        benchmark: one that comes with the package, or a manifest file.
        rung: name of the rung.
        set: `train`, `valid`, `test` or `test_task`.
        slice: part of the set, as after `#` in a room's text: `0..64` or `3`; empty for all rooms.
        options: wrap it in an `OptionsEnv`; a table gives its arguments.
        arguments: all other arguments of `EscapeRoomEnv`, such as `observation="objects"`.

    Raises:
        UnknownNameError: no such benchmark, rung, set or argument.
        ConfigError: the slice holds no room.
    """
    return _find_ladder(benchmark, rung, set, slice).make_env(options, **arguments)


def make_ladder_vec(num_envs: int = 1, benchmark: str = "ladder-1", rung: str = "pair", set: str = "train",
                    slice: str = "", options: bool | Mapping[str, Any] = False, **arguments: Any) -> VectorEnv:
    """Make a vector environment over a rung's set; every episode draws a room. See `make_ladder_env`."""
    rooms = list(_find_ladder(benchmark, rung, set, slice))
    return _make_batch(num_envs, {"instance": rooms, "resample_instance": True}, options, arguments)


def _find_ladder(benchmark: str, rung: str, role: str, part: str) -> InstanceSet:
    start, colon, stop = part.partition(":")
    if colon:
        raise ConfigError("slice", part, f"write {start or 0}..{stop or 'STOP'}")
    return find_set(f"{benchmark}/{rung}/{role}" + (f"#{part}" if part else ""))
