"""A benchmark of rooms that are generated in milliseconds."""

from __future__ import annotations

from functools import cache

from benchmarks.freezing import freeze_manifest
from hrl_escape.env.config import Between, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.sets.manifest import Manifest, RungRecord, SetRecord


def make_config(count: int, kind: str) -> RoomConfig:
    return RoomConfig(
        room=ShapeConfig(width=Between(8, 12), depth=Between(8, 12)), robot=RobotConfig(body_radius=0.4),
        puzzle=ButtonsConfig(count=count, graph=GraphConfig(kind=kind, max_parents=2), buttons=Panels(width=0.8)),
    )


@cache
def make_manifest() -> Manifest:
    """One rung of one task, and one that holds tasks out; frozen."""
    few, some = SetRecord(count=4), SetRecord(count=12)
    rungs = (
        RungRecord(name="one", isolates="a chain", config=make_config(2, "chain"), train=some, valid=few, test=few),
        RungRecord(name="five", isolates="a graph", config=make_config(Between(4, 6), "layered"), train=some, valid=few,
                   test=few, test_task=few),
    )
    return freeze_manifest(Manifest(name="small", rungs=rungs), "0")
