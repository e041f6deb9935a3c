"""Manifests: files of a few kB from which the sets of a benchmark are generated and verified.

A manifest holds room configurations, counts, skipped indices and a Merkle root for each set. Rooms are not stored: the
seed of room i of a set is a hash of the names of benchmark, rung and role and of i.
"""

from __future__ import annotations

import dataclasses
import functools
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

from hrl_escape.env.config import RoomConfig
from hrl_escape.errors import UnknownNameError
from hrl_escape.files import read_json, write_json
from hrl_escape.sets.keys import LATEST_LAYOUTS
from hrl_escape.settings import Range, Settings

ROLES = ("train", "valid", "test", "test_task")
"""Sets of a rung: training, validation, test with unseen layouts, test with unseen layouts and tasks."""

_DATA = Path(str(files("hrl_escape.sets") / "data"))


@dataclasses.dataclass(frozen=True)
class SetRecord(Settings):
    """Record of one set of rooms."""

    _section = "set"
    count: Annotated[int, Range(1, 1_000_000)] = 64
    """Rooms in the set."""
    root: str = ""
    """Merkle root over the rooms' content hashes, in order."""
    skipped: tuple[int, ...] = ()
    """Indices whose rooms are alike to a room of an earlier set, or cannot be generated."""
    roots: tuple[str, ...] = ()
    """Roots of the set in each season."""
    covered: Annotated[int, Range(0, 1_000_000)] = 0
    """Rooms that a root covers, from the first; 0 for all."""
    seeds: tuple[int, ...] = ()
    """Explicit instance seeds; empty for the seeds that follow from the names."""


@dataclasses.dataclass(frozen=True)
class RungRecord(Settings):
    """Record of one rung: its configuration and its sets."""

    _section = "rung"
    name: str = "rung"
    """Name of the rung."""
    isolates: str = ""
    """Ability that the rung requires beyond the previous one."""
    config: RoomConfig = RoomConfig()
    """Room configuration of its rooms."""
    train: SetRecord = SetRecord(count=256)
    """Rooms to learn in, disjoint from the other sets."""
    valid: SetRecord = SetRecord()
    """Rooms to choose settings by, disjoint from the other sets."""
    test: SetRecord = SetRecord()
    """Test rooms, with unseen layouts."""
    test_task: SetRecord | None = None
    """Test rooms with unseen layouts and tasks (None: the rung has too few tasks to hold out)."""
    task_overlap: Annotated[float, Range(0, 1)] = 0.0
    """Share of test rooms whose task occurs in training."""


@dataclasses.dataclass(frozen=True)
class AxisRecord(Settings):
    """Record of one axis of a profile: an ability and rungs of increasing difficulty."""

    _section = "axis"
    name: str = "axis"
    """Name of the ability."""
    rungs: tuple[str, ...] = ()
    """Names of the rungs, from easy to hard."""
    observation: str = ""
    """Default observation on this axis (empty: the protocol's)."""


@dataclasses.dataclass(frozen=True)
class Manifest(Settings):
    """Manifest of a benchmark: name, version and rungs in order."""

    _section = "manifest"
    name: str = "benchmark"
    """Name of the benchmark; a change of dynamics or generation requires a new name."""
    package: str = ""
    """Version of hrl_escape that computed the roots."""
    schema: Annotated[int, Range(1, 1000)] = 1
    """Schema version of the instances."""
    rungs: tuple[RungRecord, ...] = ()
    """Rungs from easy to hard."""
    axes: tuple[AxisRecord, ...] = ()
    """Axes of the benchmark's profile; empty for rungs in one order."""
    seasons: Annotated[int, Range(0, 1000)] = 0
    """Seasons, each with its own codes and rooms; 0 for a benchmark without seasons. See `sets.seasons`."""
    layouts: Annotated[int, Range(1, LATEST_LAYOUTS)] = 1
    """Version of layouts by which rooms are compared; see `sets.keys`."""

    def save(self, path: str | Path) -> None:
        """Write the manifest as JSON without fields at their defaults."""
        write_json(path, list_changes(self), indent=1)


def list_changes(settings: Settings) -> dict[str, Any]:
    """Return the fields of settings that differ from their defaults, as plain values."""
    found: dict[str, Any] = {}
    plain = settings.to_dict()
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if value == field.default:
            continue
        if isinstance(value, Settings):
            kind = {"kind": plain[field.name]["kind"]} if hasattr(type(value), "kind") else {}
            found[field.name] = kind | list_changes(value)
        elif isinstance(value, tuple) and value and isinstance(value[0], Settings):
            found[field.name] = [list_changes(item) for item in value]
        else:
            found[field.name] = plain[field.name]
    return found


def list_benchmarks() -> tuple[str, ...]:
    """Return the names of the benchmarks that come with the package."""
    return tuple(sorted(path.stem for path in _DATA.glob("*.json")))


def load_manifest(name: str | Path) -> Manifest:
    """Load a manifest by name, or from a JSON file."""
    if isinstance(name, Path) or name.endswith(".json"):
        return Manifest.from_dict(read_json(name, "manifest"))
    if name not in list_benchmarks():
        raise UnknownNameError("benchmark", name, list_benchmarks())
    return _load_own(name)


@functools.cache
def _load_own(name: str) -> Manifest:
    return Manifest.from_dict(read_json(_DATA / f"{name}.json", "manifest"))
