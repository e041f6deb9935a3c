"""Rooms by a short text: the grammar of `--room`, `room=` and grids, and its parser.

| text | rooms |
|---|---|
| `clutter`, `clutter#3` | instance 0, instance 3 of a preset |
| `clutter#0..16` | instances 0 to 15 of a preset |
| `clutter#*` | a fresh instance each episode |
| `larg-2019(size=4)#7` | instance 7 of a preset with arguments |
| `ladder-1/chain/train` | a set of a frozen benchmark, `BENCHMARK/RUNG/SET` |
| `ladder-1/chain/test#5`, `ladder-1/chain/test#0..16` | one room of the set, its first 16 rooms |
| `ladder-1/chain/test x 3` | sequences of three rooms |
| `A + B` | sequences of a room of A and a room of B |
| `my-room.json`, `my-set.json`, `my-config.toml` | a file: one room, a set, or a configuration as TOML or JSON |
| `custom`, `custom#3` | the defaults of `RoomConfig`, to be changed by `--set` |

A range `START..STOP` holds STOP - START rooms; as in Python, STOP is excluded. Ranges are lazy and hold at most
`LARGEST_RANGE` rooms. A configuration in a file takes `#` as a preset does.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, InstanceFileError, UnknownNameError, UnsupportedError
from hrl_escape.files import read_json, read_toml
from hrl_escape.names import count_nouns, parse_whole
from hrl_escape.sets.benchmark import list_benchmarks, load_benchmark
from hrl_escape.sets.changes import change_config, parse_value, read_urdf
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.room_sequence import RoomSequence, RoomSets, repeat_set

LARGEST_RANGE = 1_000_000
"""Largest number of rooms in a range `START..STOP`."""
LONGEST_SEQUENCE = 1_000
"""Largest number of rooms in a sequence `SET x COUNT`."""
LONGEST_TEXT = 10_000
"""Largest number of characters in a room's text."""
THEN = " + "
"""Separator between the sets of a sequence."""
FRESH: Literal["*"] = "*"
"""Text after `#` for a fresh instance each episode."""
VALID = ("clutter, clutter#3, clutter#0..16, 'clutter#*', 'larg-2019(size=4)', ladder-1/chain/test#5, "
         "ladder-1/chain/train, my-room.json or my-config.toml")
"""Examples of valid texts, for messages."""

_REPEATED = re.compile(r"(?P<rooms>.+) x (?P<count>\d+)", re.DOTALL)
_CALL = re.compile(r"(?P<name>[^()\[\]]+)\((?P<arguments>.*)\)", re.DOTALL)
BRACKETS = re.compile(r"(?P<name>.+)\[(?P<start>\d*)(?P<colon>:?)(?P<stop>\d*)\]", re.DOTALL)
"""Index or slice of a set in version 0.3."""
_FILES = (".json", ".toml")


class FreshRooms(NamedTuple):
    """Rooms of a configuration, a fresh instance each episode."""

    name: str  # text that names them
    config: RoomConfig  # configuration that is sampled


NamedRooms: TypeAlias = "RoomInstance | RoomSets | FreshRooms"
"""Rooms of a text: one room, a set, sequences, or a fresh room each episode."""


@dataclasses.dataclass(frozen=True)
class RoomName:
    """Parts of a text that names one room or one set.

    Attributes:
        base: preset, `BENCHMARK/RUNG/SET` or path of a file.
        arguments: of the preset.
        chosen: numbers of the rooms after `#`; `FRESH`, or None without `#`.
        is_one: the text chooses one room by its number.
    """

    base: str
    arguments: Mapping[str, Any]
    chosen: range | Literal["*"] | None
    is_one: bool

    @property
    def is_file(self) -> bool:
        """The text names a file."""
        return Path(self.base).suffix.lower() in _FILES

    @property
    def is_in_set(self) -> bool:
        """The text names rooms of a frozen benchmark."""
        return not self.is_file and "/" in self.base

    @classmethod
    def parse(cls, text: str) -> RoomName:
        """Parse a text without looking anything up.

        Raises:
            ConfigError: the text is malformed; the message shows the form that is meant.
        """
        if not isinstance(text, str) or not 0 < len(text) <= LONGEST_TEXT:
            raise ConfigError("room", text, f"a text of 1 to {LONGEST_TEXT:,} characters, such as {VALID}")
        text = text.strip()
        base, mark, which = ("", "", "") if text.lower().endswith(_FILES) else text.rpartition("#")
        if not mark:
            base, which = text, ""
        if brackets := BRACKETS.fullmatch(text):
            raise ConfigError("room", text, f"write {renew_brackets(brackets)}")
        chosen, is_one = _parse_choice(text, base, which) if mark else (None, False)
        arguments: dict[str, Any] = {}
        if Path(base).suffix.lower() not in _FILES and (call := _CALL.fullmatch(base)):
            base, arguments = call["name"].strip(), _parse_arguments(text, call["arguments"])
        if not base or (any(sign in base for sign in "()[]") and "/" not in base and not base.lower().endswith(_FILES)):
            raise ConfigError("room", text, f"write a room such as {VALID}")
        return cls(base, arguments, chosen, is_one)


def renew_brackets(found: re.Match[str]) -> str:
    """Present form of an index or slice in brackets."""
    start = found["start"] or "0"
    return f"{found['name']}#{start}..{found['stop'] or 'STOP'}" if found["colon"] else f"{found['name']}#{start}"


def _parse_choice(text: str, base: str, which: str) -> tuple[range | Literal["*"], bool]:
    """Return the numbers after `#`, and whether they choose one room."""
    if which == FRESH:
        return FRESH, False
    low, dots, high = which.partition("..")
    first, stop = parse_whole(low), parse_whole(high) if dots else None
    if first is None or (dots and stop is None):
        raise ConfigError("room", text, f"after # write the number of a room, START..STOP or *, such as {base}#3, "
                          f"{base}#0..16 or '{base}#*'; a number has at most 18 digits")
    if stop is None:
        return range(first, first + 1), True
    if first >= stop:
        raise ConfigError("room", text, f"START..STOP leaves STOP out, so that START is below STOP: {base}#{first} is "
                          f"one room, {base}#{first}..{first + 16} are 16")
    if stop - first > LARGEST_RANGE:
        raise ConfigError("room", text, f"a range holds at most {LARGEST_RANGE:,} rooms; '{base}#*' samples a fresh "
                          "room each episode")
    return range(first, stop), False


def _parse_arguments(text: str, inside: str) -> dict[str, Any]:
    """Arguments of a preset, `size=4, seed=3`."""
    arguments: dict[str, Any] = {}
    for part in re.split(r",\s*(?=[^\W\d]\w*\s*=)", inside) if inside.strip() else ():
        name, equals, value = part.partition("=")
        if not equals or not name.strip().isidentifier():
            raise ConfigError("room", text, "write arguments as name=value, such as larg-2019(size=4)")
        arguments[name.strip()] = parse_value(value.strip(), f"argument {name.strip()}")
    return arguments


def quote_room(text: str) -> str:
    """Quote a room's text for a shell if needed; `#` within a word does not begin a comment."""
    return text if re.fullmatch(r"[\w./#:@%+=,-]+", text) else "'" + text.replace("'", "'\"'\"'") + "'"


# --- rooms of a text ---------------------------------------------------------------------


def find_rooms(text: str, changes: Mapping[str, Any] | None = None) -> NamedRooms:
    """Find the rooms of a text, in any form of the grammar; rooms of sets and ranges are generated on demand.

    Args:
        text: such as `clutter#3`, `ladder-1/chain/train` or `my-room.json`.
        changes: fields of the configuration that are changed, by dotted path, as `--set` does.

    Raises:
        ConfigError: the text is malformed, or names no rooms.
        UnknownNameError: no such preset, benchmark, rung, set or field; the message names the closest.
        FileReadError: the file is missing or damaged.
    """
    rooms = _split(text)
    if not isinstance(rooms, RoomName):
        return _find_sequence(*rooms, changes or {})
    found = _find(rooms, changes or {})
    if not isinstance(found, InstanceSet):
        return found
    is_one = rooms.is_one or found.seeds == range(1) and rooms.chosen is None  # instance 0 of a configuration
    return found[0] if is_one else found


def find_sets(text: str, changes: Mapping[str, Any] | None = None) -> RoomSets:
    """Find a set, or the sets of a sequence; one room of a configuration is a set of one.

    Raises:
        ConfigError: the text names a fresh room each episode, or a file of one room.
        EscapeError: as `find_rooms` does.
    """
    rooms = _split(text)
    if not isinstance(rooms, RoomName):
        return _find_sequence(*rooms, changes or {})
    return _require_set(text, _find(rooms, changes or {}))


def find_set(text: str, changes: Mapping[str, Any] | None = None) -> InstanceSet:
    """Find one set; as `find_sets`, without sequences."""
    found = find_sets(text, changes)
    if not isinstance(found, InstanceSet):
        raise ConfigError("room", text, "one set is needed here, without + and x")
    return found


def find_config(room: str | RoomConfig, changes: Mapping[str, Any] | None = None) -> RoomConfig | None:
    """Find the configuration that rooms of a text are sampled from, or None for the file of a finished room.

    Raises:
        EscapeError: as `find_rooms` does.
    """
    if isinstance(room, RoomConfig):
        return change_config(room, changes or {})
    rooms = _split(room)
    found = _find(rooms if isinstance(rooms, RoomName) else rooms[0][0], changes or {})
    return None if isinstance(found, RoomInstance) else found.config


def make_room(room: str | RoomConfig | RoomInstance, changes: Mapping[str, Any] | None = None) -> RoomInstance:
    """Make one room: the room of a text, or instance 0 of a configuration.

        room = make_room("clutter#3")
        plan = RoomPlanner(room).solve()

    Args:
        room: text such as `clutter#3`, configuration or room; a room is returned unchanged.
        changes: fields of the configuration that are changed, by dotted path.

    Raises:
        ConfigError: the text names several rooms.
        EscapeError: as `find_rooms` does.
    """
    if isinstance(room, RoomInstance):
        if changes:
            raise UnsupportedError("a finished room takes no changes: change its configuration")
        return room
    if isinstance(room, RoomConfig):
        return generate(change_config(room, changes or {}), 0)
    found = find_rooms(room, changes)
    if isinstance(found, RoomInstance):
        return found
    if isinstance(found, FreshRooms):
        raise ConfigError("room", room, f"one room is needed here, and this names a fresh one each episode: write "
                          f"{room.rpartition('#')[0]}#0")
    first = found.sets[0].name if isinstance(found, RoomSequence) else found.name
    words = "sequences of rooms" if isinstance(found, RoomSequence) else count_nouns(len(found), "room")
    raise ConfigError("room", room, f"one room is needed here, and this names {words}: write "
                      f"{re.sub(r'#[0-9.]+$', '', first)}#{_get_first(room)}")


def _get_first(text: str) -> int:
    """Number of the first room that a text chooses."""
    rooms = _split(text)
    return rooms.chosen.start if isinstance(rooms, RoomName) and isinstance(rooms.chosen, range) else 0


def _split(text: str) -> RoomName | tuple[list[RoomName], int]:
    """Split a text into the names of a sequence and the number of repeats."""
    if isinstance(text, str) and len(text) <= LONGEST_TEXT:
        if repeated := _REPEATED.fullmatch(text):
            count = parse_whole(repeated["count"])
            if count is None or not 2 <= count <= LONGEST_SEQUENCE:
                raise ConfigError("room", text, f"a sequence has 2 to {LONGEST_SEQUENCE:,} rooms")
            if THEN in repeated["rooms"]:
                raise ConfigError("room", text, "a sequence repeats one set, SET x 3, or joins several, A + B")
            return [RoomName.parse(repeated["rooms"])], count
        if THEN in text:
            return [RoomName.parse(part) for part in text.split(THEN)], 1
    return RoomName.parse(text)


def _find_sequence(names: Sequence[RoomName], count: int, changes: Mapping[str, Any]) -> RoomSequence:
    sets = [_require_set(name.base, _find(name, changes)) for name in names]
    return repeat_set(sets[0], count) if count > 1 else RoomSequence(sets)


def _require_set(text: str, found: InstanceSet | RoomInstance | FreshRooms) -> InstanceSet:
    if isinstance(found, InstanceSet):
        return found
    if isinstance(found, FreshRooms):
        raise ConfigError("room", text, f"a set of rooms that stay the same is needed here: write "
                          f"{found.name.rpartition('#')[0]}#0..16")
    raise ConfigError("room", text, "a set of rooms is needed here, and this file holds one room: use "
                      "ladder-1/chain/train, clutter#0..16 or the file of a set")


def _find(name: RoomName, changes: Mapping[str, Any]) -> InstanceSet | RoomInstance | FreshRooms:
    """Rooms of a name; one room of a configuration is a set of one."""
    found = _open_file(name) if name.is_file else _find_in_set(name) if name.is_in_set else _find_preset(name)
    if isinstance(found, RoomInstance):
        if changes or name.chosen is not None:
            raise UnsupportedError(f"{name.base} holds one finished room, so # and --set do not apply: use its "
                                   "configuration, or leave them out")
        return found
    if isinstance(found, InstanceSet):
        if changes:
            found = InstanceSet(found.name, change_config(found.config, changes), found.seeds)
        return _choose(name, found)
    config = change_config(found, changes)
    text = _format(name)
    if name.chosen == FRESH:
        return FreshRooms(text, config)
    return InstanceSet(text, config, range(1) if name.chosen is None else name.chosen)


def _choose(name: RoomName, rooms: InstanceSet) -> InstanceSet:
    """Return the rooms of a set that a name chooses."""
    if name.chosen is None:
        return rooms
    if name.chosen == FRESH:
        raise ConfigError("room", f"{name.base}#*", f"{name.base} has {count_nouns(len(rooms), 'room')}, of which an "
                          f"environment draws one each episode: write {name.base}")
    if name.chosen.stop > len(rooms):
        raise ConfigError("room", _format(name), f"{name.base} has {count_nouns(len(rooms), 'room')}, numbered from 0 "
                          f"to {len(rooms) - 1}: write {name.base}#0, or {name.base} for all of them")
    chosen = rooms[name.chosen.start : name.chosen.stop]
    if name.is_one:
        chosen.name = f"{rooms.name}#{name.chosen.start}"
    return chosen


def _format(name: RoomName) -> str:
    """Format a name with its arguments and numbers."""
    arguments = ", ".join(f"{key}={value}" for key, value in name.arguments.items())
    text = f"{name.base}({arguments})" if arguments else name.base
    if name.chosen is None:
        return text
    if name.chosen == FRESH:
        return f"{text}#*"
    return f"{text}#{name.chosen.start}" + ("" if name.is_one else f"..{name.chosen.stop}")


def _refuse_arguments(name: RoomName) -> None:
    if name.arguments:
        raise ConfigError("room", _format(name), "only presets take arguments in parentheses; change fields by --set "
                          "field=value")


def _find_preset(name: RoomName) -> RoomConfig:
    if name.base == RoomConfig().name and not name.arguments:
        return RoomConfig()
    try:
        return get_preset(name.base, **name.arguments)
    except UnknownNameError as error:
        rungs = [bench for bench in list_benchmarks() if name.base in [rung.name for rung in load_benchmark(bench)]]
        if rungs and error.name == name.base:
            raise UnknownNameError("preset", name.base, error.known, f". {name.base} is a rung of {rungs[0]}: write "
                                   f"{rungs[0]}/{name.base}/test#0") from None
        raise


def _find_in_set(name: RoomName) -> InstanceSet:
    _refuse_arguments(name)
    if name.base.count("/") < 2:
        raise ConfigError("room", name.base, "rooms of a benchmark are BENCHMARK/RUNG/SET, such as "
                          f"{name.base.strip('/')}/test#0 or ladder-1/chain/train; files end in .json or .toml")
    bench, rung, role = name.base.rsplit("/", 2)
    sets = load_benchmark(bench)[rung].sets
    if role not in sets:
        raise UnknownNameError(f"set of {bench}/{rung}", role, sets)
    return sets[role]


def _open_file(name: RoomName) -> RoomConfig | InstanceSet | RoomInstance:
    _refuse_arguments(name)
    path = Path(name.base)
    if path.suffix.lower() == ".toml":
        content = read_toml(path, "configuration")
    else:
        content = read_json(path, "room")
        if isinstance(content, dict) and "seeds" in content:
            return InstanceSet.load(path)
        if isinstance(content, dict) and ("schema" in content or "id" in content):
            return RoomInstance.load(path)
    if not isinstance(content, dict):
        raise InstanceFileError(f"{path}: this is neither a room, a set of rooms nor a configuration")
    table = {"name": path.stem} | content
    read_urdf(table, path.parent)
    return RoomConfig.from_dict(table)
