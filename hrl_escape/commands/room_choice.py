"""Options that choose a room, shared by commands; not a command.

A room is named by one text, see `sets.grammar`. Any field of its configuration can be changed by its dotted path.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from typing import Any

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.names import join_words
from hrl_escape.sets.changes import parse_value
from hrl_escape.sets.grammar import NamedRooms, find_config, find_rooms, make_room, quote_room
from hrl_escape.sets.room_spec import renew_room

DEFAULT_ROOM = "paper-two-button"
OLD_OPTIONS = ("--preset", "--arguments", "--config", "--load", "--rung")
"""Options of 0.3 that named a room, besides `--seed` without `--room`."""


@dataclasses.dataclass(frozen=True)
class RoomChoice:
    """Options that choose a room, inherited by dataclasses of commands."""

    room: str | None = None
    """Room, paper-two-button by default: a preset (clutter), an instance of it (clutter#3), a preset with arguments
    ('larg-2019(size=4)'), a room of a set (ladder-1/chain/test#5), or a file (my-room.json, my-config.toml).
    `hrl-escape list presets` and `hrl-escape ladder list` name them."""
    set: tuple[str, ...] = ()
    """Fields of the configuration to change, as path=value: room.width=30 obstacles.count=40; robot.urdf takes a file.
    Without --room all others have the defaults of `RoomConfig`."""

    @classmethod
    def check_words(cls, command: Sequence[str], words: Sequence[str]) -> None:
        """Raise for the options of 0.3 that chose a room.

        Args:
            command: words before the options, such as `hrl-escape solve`.
            words: the options as given.

        Raises:
            UnsupportedError: the message shows the new form with the given values.
        """
        refuse_old_options(command, words, "seed" in {field.name for field in dataclasses.fields(cls)})

    @property
    def changes(self) -> dict[str, Any]:
        """Changes by dotted path."""
        return dict(split_assignment(text, "--set", "room.width=30") for text in self.set)

    @property
    def is_given(self) -> bool:
        """True if a room or a change is given."""
        return self.room is not None or bool(self.set)

    @property
    def _source(self) -> str | RoomConfig:
        return RoomConfig() if self.room is None and self.set else self.room or DEFAULT_ROOM

    def find_config(self) -> RoomConfig | None:
        """Find the configuration that the room is sampled from, or None for the file of a finished room."""
        return find_config(self._source, self.changes)

    def find_rooms(self) -> NamedRooms:
        """Find the rooms of the text."""
        source = self._source
        return make_room(source, self.changes) if isinstance(source, RoomConfig) else find_rooms(source, self.changes)

    def make_instance(self) -> RoomInstance:
        """Load the room, or generate it."""
        return make_room(self._source, self.changes)


def refuse_old_options(command: Sequence[str], words: Sequence[str], trains: bool = False) -> None:
    """Raise for options of 0.3 that chose a room or the number of its copies.

    Args:
        command: words before the options.
        words: the options as given.
        trains: the command takes `--seed` as its training seed, which needs `--room`, `--env` or `--data`.

    Raises:
        UnsupportedError: the message shows the new form with the given values.
    """
    given = _read_words(words)
    if "--batch" in given:
        raise UnsupportedError(f"--batch is --num-envs now: write --num-envs {' '.join(given['--batch']) or 'N'}")
    old = [name for name in OLD_OPTIONS if name in given]
    if "--seed" in given and (not trains or old or not {"--room", "--env", "--data"} & given.keys()):
        old.append("--seed")
    if "--training-seed" in given:
        old.append("--training-seed")
    if not old:
        return
    room = quote_room(_name_old(given, "--seed" in old))
    advice = f"write --room {room}"
    if "--training-seed" in given:
        advice += f" --seed {' '.join(given['--training-seed'])}"
    elif trains and old == ["--seed"]:
        base, seed = quote_room(_name_old(given, False)), " ".join(given["--seed"])
        advice += f" for this room, or --room {base} --seed {seed} for the training seed {seed}"
    raise UnsupportedError(f"{join_words(old)} of version 0.3: --room names the room of {' '.join(command)} now"
                           + (", and --seed is the training seed" if trains else "") + f": {advice}")


def refuse_rooms(words: Sequence[str]) -> None:
    """Raise for `--rooms`, the name of `--room` for several rooms in 0.3; the message shows the new form."""
    given = _read_words(words)
    if "--rooms" in given:
        rooms = (quote_room(str(renew_room(room))) for room in given["--rooms"])
        raise UnsupportedError(f"--rooms is --room now: write --room {' '.join(rooms)}")


def _read_words(words: Sequence[str]) -> dict[str, list[str]]:
    """Return the values of each option; words before the first option have an empty name."""
    given: dict[str, list[str]] = {"": []}
    name = ""
    for word in words:
        if word.startswith("--"):
            name, equals, value = word.partition("=")
            given.setdefault(name, [])
            if equals:
                given[name].append(value)
        else:
            given[name].append(word)
    return given


def _name_old(given: dict[str, list[str]], has_seed: bool) -> str:
    """Return the text of the room that options of 0.3 chose."""
    def first(name: str, default: str = "") -> str:
        return (given.get(name) or [default])[0]

    if file := first("--load"):
        return file
    if rung := first("--rung"):
        return f"{first('--benchmark', 'ladder-1')}/{rung}/{first('--room', 'test#0')}"
    default = RoomConfig().name if "--set" in given else DEFAULT_ROOM
    base = first("--config") or first("--room") or first("--preset", default)
    if given.get("--arguments"):
        base += f"({', '.join(given['--arguments'])})"
    seed = first("--seed") if has_seed else ""
    return f"{base.partition('#')[0]}#{seed}" if seed not in ("", "0") else base


def refuse_options(args: Any, names: Collection[str], why: str) -> None:
    """Raise for the first of these options that is given, because it has no effect."""
    defaults = {field.name: field.default for field in dataclasses.fields(args)}
    for name in names:
        if getattr(args, name) != defaults[name]:
            raise UnsupportedError(f"--{name.replace('_', '-')} {why}")


def split_assignment(text: str, option: str, example: str) -> tuple[str, Any]:
    """Parse `name=value`; a value that is not JSON is text."""
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise ConfigError(option, text, f"name=value is needed, such as {example}")
    return name, parse_value(value, f"{option} {name}")
