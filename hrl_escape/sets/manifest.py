"""Manifests: a few kB from which a benchmark's sets of rooms are generated and by which they are verified.

A manifest holds room configurations, counts, the indices skipped, and one Merkle root a set. Rooms are not stored: the
seed of room i of a set follows from the names of benchmark, rung and role and from i.
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
"""Sets of a rung: to learn on, to choose by, unseen layouts, and unseen layouts with unseen tasks."""

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
    """Indices whose rooms look like one of an earlier set, or cannot be generated."""
    seeds: tuple[int, ...] = ()
    """Explicit instance seeds, in place of the seeds that follow from the names."""


@dataclasses.dataclass(frozen=True)
class RungRecord(Settings):
    """Record of one rung: its configuration and its sets."""

    _section = "rung"
    name: str = "rung"
    """Name of the rung."""
    isolates: str = ""
    """Ability that the rung asks for beyond the one before."""
    config: RoomConfig = RoomConfig()
    """Room configuration of its rooms."""
    train: SetRecord = SetRecord(count=256)
    """Rooms to learn on."""
    valid: SetRecord = SetRecord()
    """Rooms to choose settings by."""
    test: SetRecord = SetRecord()
    """Rooms with unseen layouts."""
    test_task: SetRecord | None = None
    """Rooms with unseen layouts and tasks (None: the rung has too few tasks to hold some out)."""
    task_overlap: Annotated[float, Range(0, 1)] = 0.0
    """Share of the test's rooms whose task some training room has."""


@dataclasses.dataclass(frozen=True)
class AxisRecord(Settings):
    """Record of one axis of a profile: an ability, and the rungs that ask more and more of it."""

    _section = "axis"
    name: str = "axis"
    """Name of the ability."""
    rungs: tuple[str, ...] = ()
    """Names of the rungs, from easy to hard."""
    observation: str = ""
    """Observation of agents that are asked for none (empty: the protocol's)."""


@dataclasses.dataclass(frozen=True)
class Manifest(Settings):
    """A benchmark: its name, the version that its roots belong to, and its rungs in order."""

    _section = "manifest"
    name: str = "benchmark"
    """Name of the benchmark; a season of its own wherever dynamics or generation change."""
    package: str = ""
    """Version of hrl_escape that the roots were computed with."""
    schema: Annotated[int, Range(1, 1000)] = 1
    """Schema version of the instances."""
    rungs: tuple[RungRecord, ...] = ()
    """Rungs from easy to hard."""
    axes: tuple[AxisRecord, ...] = ()
    """Axes of the profile that the benchmark gives, in place of one order; none by default."""
    layouts: Annotated[int, Range(1, LATEST_LAYOUTS)] = 1
    """Version by which rooms look alike: 1 by rounded places, 2 turned or mirrored and within a margin."""

    def save(self, path: str | Path) -> None:
        """Write the manifest as JSON; fields at their defaults are left out."""
        write_json(path, list_changes(self), indent=1)


def list_changes(settings: Settings) -> dict[str, Any]:
    """Fields of settings that are not at their defaults, as plain values."""
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
    """Names of the benchmarks that come with the package."""
    return tuple(sorted(path.stem for path in _DATA.glob("*.json")))


def load_manifest(name: str | Path) -> Manifest:
    """Load a manifest that comes with the package, or one from a JSON file."""
    if isinstance(name, Path) or name.endswith(".json"):
        return Manifest.from_dict(read_json(name, "manifest"))
    if name not in list_benchmarks():
        raise UnknownNameError("benchmark", name, list_benchmarks())
    return _load_own(name)


@functools.cache
def _load_own(name: str) -> Manifest:
    return Manifest.from_dict(read_json(_DATA / f"{name}.json", "manifest"))
