"""Rooms of a grid: a text of the grammar, or a configuration given inline."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from typing_extensions import Self

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import GridError
from hrl_escape.sets.changes import change_config
from hrl_escape.sets.grammar import BRACKETS, RoomName, make_room, renew_brackets
from hrl_escape.sets.places import RunPlace
from hrl_escape.settings import Range, Settings

_OLD_FIELDS = {"preset", "file", "seed", "arguments"}


def renew_room(room: str | Mapping[str, Any]) -> str | dict[str, Any]:
    """Convert a room or set of a grid of version 0.3, where ranges included their end."""
    if isinstance(room, str):
        return " + ".join(_renew_text(part) for part in room.split(" + "))
    if room.get("config") is not None:
        return {"config": room["config"], **({"instance": room["seed"]} if room.get("seed") else {})}
    for source in ("set", "file"):
        if room.get(source) is not None:
            return renew_room(str(room[source]))
    arguments = room.get("arguments")
    inside = ", ".join(f"{name}={value}" for name, value in arguments.items()) if isinstance(arguments, Mapping) else ""
    text = f"{room.get('preset') or 'clutter'}" + (f"({inside})" if inside else "")
    return f"{text}#{room['seed']}" if room.get("seed") else text


def _renew_text(text: str) -> str:
    repeated, cross, count = text.rpartition(" x ")
    text = repeated if cross else text
    if found := BRACKETS.fullmatch(text):
        text = renew_brackets(found)
    elif found := re.fullmatch(r"(.+#\d+\.\.)(\d{1,18})", text):
        text = found[1] + str(int(found[2]) + 1)
    return f"{text} x {count}" if cross else text


@dataclasses.dataclass(frozen=True)
class RoomSpec(Settings):
    """One room of a grid."""

    _section = "room"
    room: str = ""
    """Text of the grammar that names one room, such as clutter#3; see `sets.grammar`."""
    config: dict[str, Any] | None = None
    """Configuration in place of a text, in the form of `RoomConfig.to_dict`."""
    instance: Annotated[int, Range(0, 2**63 - 1)] = 0
    """Instance of `config`."""
    set: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Changes by dotted path, as with --set."""

    def check(self) -> None:
        """Require exactly one source, and a text that can be parsed."""
        if bool(self.room) == (self.config is not None) or (self.room and self.instance):
            raise GridError("a room is a text such as 'clutter#3', or a table with room, or with config and instance; "
                            f"got {self.to_dict()}")
        if self.room:
            RoomName.parse(self.room)

    @property
    def label(self) -> str:
        """Short name: the text, or the name of the configuration with `#` and the instance."""
        if self.config is None:
            return self.room
        name = self.config.get("name") or ""
        return f"{name}#{self.instance}" if self.instance else name

    def make_instance(self) -> RoomInstance:
        """Make the room.

        Raises:
            EscapeError: no such preset or set, an impossible configuration, or a damaged file.
        """
        if self.config is None:
            return make_room(self.room, self.set)
        return generate(change_config(RoomConfig.from_dict(self.config), self.set), self.instance)

    def make_place(self) -> RunPlace:
        """Make the room as a place of runs."""
        name = RoomName.parse(self.room) if self.room else None
        is_named = name is not None and (name.is_in_set or bool(name.arguments))
        return RunPlace.of_room(self.make_instance(), self.room if is_named else "")

    def move_to(self, folder: Path) -> Self:
        """Return the room with its file path resolved against a folder."""
        if not self.room or not RoomName.parse(self.room).is_file:
            return self
        return dataclasses.replace(self, room=str(folder / self.room))

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build from a table; raises for a table of version 0.3, with its new form in the message."""
        if isinstance(data, Mapping) and (_OLD_FIELDS & data.keys() or isinstance(data.get("set"), str)):
            raise GridError(f"a room of a grid is one text since version 0.4: write {renew_room(data)!r}")
        return super().from_dict(data)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a text of the grammar.

        Raises:
            ConfigError: it is malformed; the message shows the form that is meant.
        """
        return cls(room=text)
