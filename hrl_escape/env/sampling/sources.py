"""Reading of schematics and rooms: presets, dicts and files become `RoomConfig` and `RoomInstance`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance, check_room
from hrl_escape.env.presets import get_preset
from hrl_escape.errors import ConfigError

SchematicForm: TypeAlias = str | RoomConfig | dict[str, Any]
"""Name of a preset, a schematic, or the dict form of one."""
InstanceForm: TypeAlias = RoomInstance | dict[str, Any] | str | Path
"""A room, its dict form, or the path of one saved as JSON."""


def read_schematic(form: SchematicForm) -> RoomConfig:
    """Read a schematic in any of its forms.

    Raises:
        UnknownNameError: no preset of that name, or no such field.
        ConfigError: an impossible value.
    """
    if isinstance(form, RoomConfig):
        return form
    if isinstance(form, str):
        return get_preset(form)
    if isinstance(form, Mapping):
        return RoomConfig.from_dict(form)
    raise ConfigError("config", form, "the name of a preset, a RoomConfig, or the dict form of one")


def read_instance(form: InstanceForm) -> RoomInstance:
    """Read a room in any of its forms, with the checks for untrusted rooms.

    Raises:
        ConfigError: a room with gaps in its walls, or starts that are not free.
        FileReadError: no such file.
        InstanceFileError: the file or the table is no room.
    """
    if isinstance(form, RoomInstance):
        check_room(form)
        return form
    if isinstance(form, (str, Path)):
        return RoomInstance.load(form)
    if isinstance(form, Mapping):
        return RoomInstance.from_dict(form)
    raise ConfigError("instance", form, "a RoomInstance, its dict form, or the path of one saved as JSON")
