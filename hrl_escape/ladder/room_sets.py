"""Sets of rooms by a short text: those of a ladder, a range of a preset's instances, or a file.

| text | rooms |
|---|---|
| `ladder-1/lattice/train` | the set of a rung |
| `ladder-1/lattice/train[:64]` | its first 64 rooms |
| `ladder-1/lattice/test[3]` | one of them |
| `clutter#0..15` | instances 0 to 15 of a preset |
| `rooms.json` | a file with `name`, `config` and `seeds`, as `InstanceSet.save` writes it |
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import gymnasium

from hrl_escape.env.presets import get_preset
from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.ladder.benchmark import load_benchmark
from hrl_escape.ladder.instance_set import InstanceSet
from hrl_escape.names import parse_whole

_FORM = re.compile(r"(?P<name>[^\[\]]+)(?:\[(?P<start>\d*)(?P<colon>:?)(?P<stop>\d*)\])?")


def parse_room_set(text: str) -> InstanceSet:
    """Rooms of a short text; none is generated yet.

    Raises:
        ConfigError: the text names no rooms.
        UnknownNameError: no such benchmark, rung, set or preset.
        FileReadError: the file is missing or damaged.
    """
    form = _FORM.fullmatch(text)
    if form is None or text.endswith("[]"):
        raise ConfigError("rooms", text, "such as ladder-1/lattice/train[:64], clutter#0..15 or rooms.json")
    rooms = _find(form["name"])
    if form["start"] is not None:
        start = int(form["start"] or 0)
        stop = int(form["stop"] or len(rooms)) if form["colon"] else start + 1
        if not start < min(stop, len(rooms)):
            raise ConfigError("rooms", text, f"at least one of the {len(rooms)} rooms of {form['name']}")
        name, rooms = rooms.name, rooms[start:stop]
        rooms.name = name + text[len(form["name"]):]
    return rooms


def make_ladder_env(benchmark: str = "ladder-1", rung: str = "pair", set: str = "train", slice: str = "",
                    options: bool | Mapping[str, Any] = False, **arguments: Any) -> gymnasium.Env:
    """Make an environment over a rung's set of rooms; the entry point of `hrl_escape/Ladder-v1`.

    Args:
        benchmark: one that comes with the package, or a manifest file.
        rung: name of the rung.
        set: `train`, `valid`, `test` or `test_task`.
        slice: part of the set, such as `:64`, `64:128` or `3`; empty for all rooms.
        options: wrap it in an `OptionsEnv`; a table gives its arguments.
        arguments: all other arguments of `EscapeRoomEnv`, such as `observation="objects"`.

    Raises:
        UnknownNameError: no such benchmark, rung, set or argument.
        ConfigError: the slice holds no room.
    """
    return _find_ladder(benchmark, rung, set, slice).make_env(options, **arguments)


def make_ladder_vec(num_envs: int = 1, benchmark: str = "ladder-1", rung: str = "pair", set: str = "train",
                    slice: str = "", **arguments: Any) -> Any:
    """Make a vector environment over a rung's set; every episode draws a room. See `make_ladder_env`."""
    return _find_ladder(benchmark, rung, set, slice).make_vec(num_envs, **arguments)


def _find_ladder(benchmark: str, rung: str, role: str, part: str) -> InstanceSet:
    return parse_room_set(f"{benchmark}/{rung}/{role}" + (f"[{part}]" if part else ""))


def _find(name: str) -> InstanceSet:
    if name.count("/") >= 2 and not name.endswith(".json"):
        bench, rung, role = name.rsplit("/", 2)
        sets = load_benchmark(bench)[rung].sets
        if role not in sets:
            raise UnknownNameError(f"set of {bench}/{rung}", role, sets)
        return sets[role]
    if name.endswith(".json"):
        return InstanceSet.load(name)
    preset, _, seeds = name.partition("#")
    low, _, high = (seeds or "0").partition("..")
    first, last = parse_whole(low), parse_whole(high or low)
    if first is None or last is None or first > last:
        raise ConfigError("rooms", name, f"a range of instances such as {preset}#0..15")
    return InstanceSet(name, get_preset(preset), range(first, last + 1))
