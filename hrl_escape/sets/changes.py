"""Changes to a configuration by dotted path: `--set room.width=30` and `changes={"room.width": 30}`."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.urdf import load_urdf
from hrl_escape.errors import FileReadError, UnknownNameError
from hrl_escape.files import parse_json
from hrl_escape.settings import Settings

KIND_PATHS = ("puzzle.kind", "reward.kind")
"""Paths of kinds: another kind has other fields, at its own defaults."""


def change_config(config: RoomConfig, changes: Mapping[str, Any]) -> RoomConfig:
    """Return a configuration with some fields changed.

    Args:
        config: what is changed.
        changes: values by dotted path, such as `{"room.width": 30}`; `robot.urdf` takes the path of a file.

    Raises:
        UnknownNameError: no such path; the message names the closest.
        ConfigError: an impossible value.
    """
    if not changes:
        return config
    fields = config.to_dict()
    for path, value in changes.items():
        _check_path(config, path)
        change_field(fields, path, value)
        if path in ("puzzle", "reward", *KIND_PATHS):
            config = RoomConfig.from_dict(fields)  # whose other paths are those of the kind
    read_urdf(fields, Path())
    return RoomConfig.from_dict(fields)


def parse_value(text: str, path: str) -> Any:
    """Read the value of `name=value`: JSON, or plain text where it is no JSON.

    Raises:
        FileReadError: JSON without bounds, such as NaN or very deep nesting.
    """
    try:
        return parse_json(text, path, "value")
    except FileReadError as error:
        if isinstance(error.__cause__, json.JSONDecodeError):
            return text
        raise


def change_field(fields: dict[str, Any], path: str, value: Any) -> None:
    """Set one field of a nested table; the configuration itself refuses unknown fields and sections.

    Another kind of puzzle or reward begins with that kind's defaults.
    """
    *sections, last = path.split(".")
    for depth, section in enumerate(sections):
        inner = fields.setdefault(section, {})  # a section at its defaults is not written
        if not isinstance(inner, dict):
            known = [name for name, part in fields.items() if isinstance(part, dict)]
            raise UnknownNameError(" ".join([*sections[:depth], "section"]), section, known)
        fields = inner
    if path in KIND_PATHS and fields.get("kind") != value:
        fields.clear()
    fields[last] = value


def list_paths(settings: Any, prefix: str = "") -> list[str]:
    """Dotted paths of the fields of settings, and of the sections in them."""
    paths: list[str] = []
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        paths.append(prefix + field.name)
        if isinstance(value, Settings):
            paths += list_paths(value, f"{prefix}{field.name}.")
    return paths


def _check_path(config: RoomConfig, path: str) -> None:
    """Refuse a path that cannot be set; the message gives those of its section and those with its last name."""
    known = [*list_paths(config), *KIND_PATHS]
    if path in known or not path:
        return
    section, _, name = path.rpartition(".")
    named = [each for each in known if each.rpartition(".")[2] == name]
    beside = [each for each in known if each.rpartition(".")[0] == section]
    note = f". {name!r} is in {', '.join(named)}" if named and beside else ""
    raise UnknownNameError("path of --set", path, beside or named or [each for each in known if "." not in each], note)


def read_urdf(fields: dict[str, Any], folder: Path) -> None:
    """Replace the path of a URDF file by its text and the paths of its meshes."""
    robot = fields.get("robot")
    urdf = robot.get("urdf") if isinstance(robot, dict) else None
    if isinstance(robot, dict) and isinstance(urdf, str) and not urdf.lstrip().startswith("<"):
        robot["urdf"] = load_urdf(folder / urdf)
