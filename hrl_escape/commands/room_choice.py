"""The choice of a room: the options that every command on a room shares. Not a command.

A room comes from a preset, a room configuration file or an instance file. Any field of a room configuration can
be changed by its dotted path.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.robot import load_urdf
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, FileReadError, UnknownNameError, UnsupportedError
from hrl_escape.files import parse_json, read_json, read_toml
from hrl_escape.settings import Settings

DEFAULT_PRESET = "paper-two-button"


KIND_PATHS = ("puzzle.kind", "reward.kind")
"""Paths of kinds: another kind has other fields, at its own defaults."""


@dataclasses.dataclass(frozen=True)
class RoomChoice:
    """Options that choose a room; dataclasses of commands inherit them."""

    preset: str | None = None
    """Named room configuration, paper-two-button by default; `hrl-escape list presets` names them all."""
    arguments: tuple[str, ...] = ()
    """Arguments of the preset, as name=value: size=4 seed=3 for larg-2019."""
    config: Path | None = None
    """Room configuration in a TOML or JSON file, in place of a preset."""
    set: tuple[str, ...] = ()
    """Fields of the room configuration to change, as path=value: room.width=30 obstacles.count=40; robot.urdf takes a
    file. Without --preset or --config all others have the defaults of `RoomConfig`."""
    seed: int = 0
    """Instance seed: selects one room of the room configuration."""
    load: Path | None = None
    """Instance in a JSON file written by --save, in place of a room configuration."""

    def make_config(self) -> RoomConfig:
        """Build the room configuration; `EscapeError` for an unknown preset or field, or an impossible value."""
        if self.config is None:
            arguments = dict(split_assignment(text, "--arguments", "size=3") for text in self.arguments)
            is_bare = self.preset is None and self.set and not arguments
            config = RoomConfig() if is_bare else get_preset(self.preset or DEFAULT_PRESET, **arguments)
        else:
            refuse_options(self, ("preset", "arguments"), "is about presets, and --config is a room configuration of "
                           "its own: change its fields by --set")
            read = read_toml if self.config.suffix.lower() == ".toml" else read_json
            content = read(self.config, "room configuration")
            if not isinstance(content, dict):
                raise ConfigError("config", content, "a table of fields")
            table = {"name": self.config.stem} | content
            _read_urdf(table, self.config.parent)
            config = RoomConfig.from_dict(table)
        if not self.set:
            return config
        fields = config.to_dict()
        for text in self.set:
            path, value = split_assignment(text, "--set", "room.width=30")
            _check_path(config, path)
            change_field(fields, path, value)
            if path in ("puzzle", "reward", *KIND_PATHS):
                config = RoomConfig.from_dict(fields)  # whose other paths are those of the kind
        _read_urdf(fields, Path())
        return RoomConfig.from_dict(fields)

    def make_instance(self) -> RoomInstance:
        """Load the instance, or generate it."""
        if self.load is None:
            return generate(self.make_config(), self.seed)
        refuse_options(self, ("preset", "arguments", "config", "set", "seed"),
                       "chooses a room to make, and --load takes a finished one: give one of them")
        return RoomInstance.load(self.load)


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


def _read_urdf(fields: dict[str, Any], folder: Path) -> None:
    """Put the text of a URDF file, and the paths of its meshes, in place of the file's path."""
    robot = fields.get("robot")
    urdf = robot.get("urdf") if isinstance(robot, dict) else None
    if isinstance(robot, dict) and isinstance(urdf, str) and not urdf.lstrip().startswith("<"):
        robot["urdf"] = load_urdf(folder / urdf)


def refuse_options(args: Any, names: Collection[str], why: str) -> None:
    """Refuse the first of these options, fields of a dataclass, that was given: it would say nothing."""
    defaults = {field.name: field.default for field in dataclasses.fields(args)}
    for name in names:
        if getattr(args, name) != defaults[name]:
            raise UnsupportedError(f"--{name.replace('_', '-')} {why}")


def split_assignment(text: str, option: str, example: str) -> tuple[str, Any]:
    """Read `name=value` given to an option; a value that is not JSON is text, and one without bounds is refused."""
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise ConfigError(option, text, f"name=value is needed, such as {example}")
    try:
        return name, parse_json(value, f"{option} {name}", "value")
    except FileReadError as error:
        if isinstance(error.__cause__, json.JSONDecodeError):
            return name, value
        raise


def change_field(fields: dict[str, Any], path: str, value: Any) -> None:
    """Set one field of a nested table; the room configuration itself refuses unknown fields and sections.

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
