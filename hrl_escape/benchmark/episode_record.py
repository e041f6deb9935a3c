"""Form of the recorded episodes that a finished run keeps in `episodes.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range, read_argument, read_record

Count = Annotated[int, Range(0)]


@dataclass(frozen=True)
class Frames:
    """States of an episode in numbers, see `make_frames`."""

    x: tuple[float, ...]
    y: tuple[float, ...]
    heading: tuple[float, ...]
    arm: tuple[tuple[tuple[float, float], ...], ...]
    lit: tuple[tuple[Count, tuple[Count, ...]], ...]
    shut: tuple[tuple[Count, tuple[Count, ...]], ...]
    open: tuple[tuple[Count, bool], ...]
    props: tuple[tuple[tuple[float, float, float], ...], ...]


@dataclass(frozen=True)
class ReplayRecord:
    """Form of `RecordedEpisode.to_json`, without `return`, which is no name of a field in Python."""

    primitives: Count
    success: bool
    decisions: tuple[tuple[str, Count, str], ...]
    frames: Frames


def check_episodes(value: Any) -> list[dict[str, Any]]:
    """Return recorded episodes unchanged if they have the form of `RecordedEpisode.to_json`.

    Args:
        value: content of an `episodes.json`.

    Raises:
        ConfigError: a value is missing or not valid, or the numbers of states differ.
        UnknownNameError: no such field.
    """
    if not isinstance(value, list):
        raise ConfigError("episodes", value, "a list of tables")
    for number, episode in enumerate(value):
        _check(f"episodes[{number}]", episode)
    return value


def _check(path: str, episode: Any) -> None:
    if not isinstance(episode, Mapping) or "return" not in episode:
        raise ConfigError(path, episode, "a table with the field 'return'")
    read_argument(float, f"{path}.return", episode["return"])
    rest = {name: each for name, each in episode.items() if name != "return"}
    record = read_record(ReplayRecord, rest, path)
    frames, states = record.frames, record.primitives + 1
    for name in ("x", "y", "heading", "arm", "props"):
        count = len(getattr(frames, name))
        if count != states and (count or name not in ("arm", "props")):
            raise ConfigError(f"{path}.frames.{name}", f"{count} values", f"{states}, one for each state")
    for name in ("lit", "shut", "open"):
        changes = [frame for frame, _ in getattr(frames, name)]
        if changes[:1] != [0] or changes != sorted(set(changes)) or changes[-1] >= states:
            raise ConfigError(f"{path}.frames.{name}", changes, f"rising frames from 0 to below {states}")
