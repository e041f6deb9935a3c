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

from hrl_escape.env.presets import get_preset
from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.ladder.benchmark import load_benchmark
from hrl_escape.ladder.instance_set import InstanceSet
from hrl_escape.names import parse_whole

__all__ = ["parse_room_set"]

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
        rooms = InstanceSet(rooms.name + text[len(form["name"]):], rooms.config, rooms.seeds[start:stop])
    return rooms


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
