"""Seasons of a benchmark: the same rungs with other codes, so that what is learned in one is useless in another.

`cues-1@7` is season 7 of `cues-1`. The code of cues, of positional cues and of families of graphs follows from the
names of benchmark, season and rung. The sets of a season share it.
"""

from __future__ import annotations

import dataclasses
import re

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.errors import ConfigError
from hrl_escape.sets.manifest import ROLES, Manifest, RungRecord, SetRecord
from hrl_escape.sets.rung import derive_seed

_SEASON = re.compile(r"(?P<name>.+)@(?P<season>\d{1,4})")


def split_season(name: str) -> tuple[str, int | None]:
    """Split a name such as `cues-1@7` into benchmark and season; None without one."""
    found = _SEASON.fullmatch(name)
    return (found["name"], int(found["season"])) if found else (name, None)


def choose_season(manifest: Manifest, season: int | None) -> Manifest:
    """Return the manifest of one season, the first for None; a benchmark without seasons has one.

    Raises:
        ConfigError: the benchmark has no such season.
    """
    if not manifest.seasons:
        if season is not None:
            raise ConfigError("benchmark", f"{manifest.name}@{season}", f"{manifest.name}, which has no seasons")
        return manifest
    if season is not None and season >= manifest.seasons:
        raise ConfigError("benchmark", f"{manifest.name}@{season}", f"a season from {manifest.name}@0 to "
                          f"{manifest.name}@{manifest.seasons - 1}")
    name = f"{manifest.name}@{season or 0}"
    rungs = (dataclasses.replace(record, config=set_code(record.config, derive_seed(name, record.name, "code")))
             for record in manifest.rungs)
    return dataclasses.replace(manifest, name=name, seasons=0,
                               rungs=tuple(_choose_sets(record, season or 0) for record in rungs))


def _choose_sets(record: RungRecord, season: int) -> RungRecord:
    sets: dict[str, SetRecord | None] = {role: getattr(record, role) for role in ROLES}
    return dataclasses.replace(record, **{
        role: dataclasses.replace(own, root=own.roots[season], roots=())
        for role, own in sets.items() if own is not None and own.roots})


def set_code(config: RoomConfig, code: int) -> RoomConfig:
    """Return a room configuration with this code in every part that it uses."""
    puzzle = config.puzzle
    if not isinstance(puzzle, ButtonsConfig):
        return config
    changes = {name: dataclasses.replace(getattr(puzzle, name), code=code) for name, is_used in (
        ("cues", puzzle.cues.kind != "none"), ("positional_cues", puzzle.positional_cues.sections > 0),
        ("graph", puzzle.graph.family > 0)) if is_used}
    return dataclasses.replace(config, puzzle=dataclasses.replace(puzzle, **changes))
