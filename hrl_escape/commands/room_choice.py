"""Which room a command is about: the options that every command on a room shares. Not a command.

A room is a preset, a schematic from a file, or an instance from a file; any field of a
schematic can be changed by its dotted path.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.generation import generate
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.files import read_json, read_toml

__all__ = ["RoomChoice", "split_assignment"]


@dataclasses.dataclass(frozen=True)
class RoomChoice:
    """Options that say which room is meant; dataclasses of commands inherit them."""

    preset: str = "paper-two-button"
    """Named schematic; `hrl-escape list presets` shows them."""
    arguments: tuple[str, ...] = ()
    """Arguments of the preset, as name=value: size=4 seed=3 for larg-2019."""
    config: Path | None = None
    """Schematic from a TOML or JSON file, instead of a preset."""
    set: tuple[str, ...] = ()
    """Fields of the schematic to change, as path=value: room.width=30 obstacles.count=40."""
    seed: int = 0
    """Instance seed: which room of the schematic."""
    load: Path | None = None
    """Instance from a JSON file that --save wrote, instead of a schematic."""

    def make_config(self) -> RoomConfig:
        """Build the schematic.

        Raises:
            EscapeError: an unknown preset or field, an impossible value, or an unreadable file.
        """
        if self.config is None:
            arguments = dict(split_assignment(text, "--arguments", "size=3") for text in self.arguments)
            config = get_preset(self.preset, **arguments)
        elif self.arguments:
            raise UnsupportedError("--arguments are a preset's; with --config use --set")
        else:
            read = read_toml if self.config.suffix.lower() == ".toml" else read_json
            config = RoomConfig.from_dict({"name": self.config.stem} | _require_table(read(self.config, "schematic")))
        if not self.set:
            return config
        fields = config.to_dict()
        for text in self.set:
            path, value = split_assignment(text, "--set", "room.width=30")
            _change(fields, path, value)
        return RoomConfig.from_dict(fields)

    def make_instance(self) -> RoomInstance:
        """Load the instance, or generate it.

        Raises:
            EscapeError: as `make_config`; no solvable room; a damaged file.
        """
        if self.load is None:
            return generate(self.make_config(), self.seed)
        if self.config or self.set or self.arguments:
            raise UnsupportedError("--load takes a finished room: leave out --config, --set and --arguments")
        return RoomInstance.load(self.load)


def _require_table(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ConfigError("config", value, "a table of fields")
    return value


def split_assignment(text: str, option: str, example: str) -> tuple[str, Any]:
    """Read `name=value` given to an option; values are JSON where they can be read so, else text."""
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise ConfigError(option, text, f"name=value is needed, such as {example}")
    try:
        return name, json.loads(value)
    except json.JSONDecodeError:
        return name, value


def _change(fields: dict[str, Any], path: str, value: Any) -> None:
    """Set one field of a nested table; the schematic itself refuses what it does not know."""
    *sections, last = path.split(".")
    for depth, section in enumerate(sections):
        inner = fields.get(section)
        if not isinstance(inner, dict):
            known = [name for name, part in fields.items() if isinstance(part, dict)] or ["none here"]
            raise ConfigError(".".join(sections[: depth + 1]), path, f"a section: one of {', '.join(known)}")
        fields = inner
    fields[last] = value
