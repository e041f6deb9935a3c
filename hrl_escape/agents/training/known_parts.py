"""Code that a run's folder may name, so that a folder from a stranger runs none of his own.

A description names classes and functions as `module:name`. Whoever reads it looks the name up here, in tables, and
imports nothing to find out: this package's environments, wrappers and settings; the wrappers of Gymnasium that only
compute, and the environments registered with it; and what installed packages list as entry points of the group
`hrl_escape.parts`. An entry point's name is free; its value is the `module:name` that descriptions give, such as
`doubled = "my_package.wrappers:Doubled"`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from typing import Any

import gymnasium
from gymnasium import wrappers

__all__ = ["PARTS_GROUP", "OWN", "find_part", "import_part", "name_part"]

PARTS_GROUP = "hrl_escape.parts"
"""Entry points of other packages: environments, wrappers, settings and functions that run folders may name."""

OWN = frozenset({
    "hrl_escape.comparison.places:RoomSchedule",
    "hrl_escape.env.config:DynamicsConfig",
    "hrl_escape.env.config:ExitConfig",
    "hrl_escape.env.config:ObstaclesConfig",
    "hrl_escape.env.config:RewardConfig",
    "hrl_escape.env.config:RobotConfig",
    "hrl_escape.env.config:RoomConfig",
    "hrl_escape.env.config:ShapeConfig",
    "hrl_escape.env.config:StartConfig",
    "hrl_escape.env.escape_room:EscapeRoomEnv",
    "hrl_escape.env.instance:RoomInstance",
    "hrl_escape.ladder.common_spaces:CommonSpacesEnv",
    "hrl_escape.ladder.goals:GoalsEnv",
    "hrl_escape.ladder.instance_set:InstanceSetEnv",
    "hrl_escape.ladder.sequence:SequenceEnv",
    "hrl_escape.options.domain:OptionDomain",
    "hrl_escape.options.domain:RoomDomain",
    "hrl_escape.options.memory:DecisionMemory",
    "hrl_escape.options.options_env:OptionsEnv",
    "hrl_escape.synthesis.hierarchy_env:HierarchyEnv",
})
"""Parts of this package, each imported when it is asked for."""

_COMPUTING = (
    wrappers.AddRenderObservation, wrappers.AddWhiteNoise, wrappers.AtariPreprocessing, wrappers.Autoreset,
    wrappers.ClipAction, wrappers.ClipReward, wrappers.DelayObservation, wrappers.DiscretizeAction,
    wrappers.DiscretizeObservation, wrappers.DtypeObservation, wrappers.FilterObservation, wrappers.FlattenObservation,
    wrappers.FrameStackObservation, wrappers.GrayscaleObservation, wrappers.MaxAndSkipObservation,
    wrappers.NormalizeObservation, wrappers.NormalizeReward, wrappers.ObstructView, wrappers.RenderCollection,
    wrappers.RepeatAction, wrappers.RescaleAction, wrappers.RescaleObservation, wrappers.ReshapeObservation,
    wrappers.ResizeObservation, wrappers.StickyAction, wrappers.TimeAwareObservation, wrappers.TimeLimit,
    wrappers.TransformAction, wrappers.TransformObservation, wrappers.TransformReward,
)
"""Wrappers of Gymnasium that write no file and open no window."""


def name_part(part: Any) -> str:
    """Name of a class or function in descriptions, `module:name`."""
    return f"{part.__module__}:{part.__qualname__}"


def find_part(name: Any) -> Callable[[], Any] | None:
    """Loader of the part of a name; None where the name is not known. Nothing is imported to answer."""
    return next((load for known, load in _list_parts() if known == name), None)


def _list_parts() -> Iterator[tuple[str, Callable[[], Any]]]:
    yield from ((name, lambda name=name: import_part(name)) for name in OWN)
    yield from ((name_part(wrapper), lambda wrapper=wrapper: wrapper) for wrapper in _COMPUTING)
    for spec in gymnasium.registry.values():
        made_by = spec.entry_point
        if isinstance(made_by, str):
            yield made_by, lambda made_by=made_by: import_part(made_by)
        elif isinstance(made_by, type):
            yield name_part(made_by), lambda made_by=made_by: made_by
    yield from ((point.value, point.load) for point in entry_points(group=PARTS_GROUP))


def import_part(name: str) -> Any:
    """Import a part by its name, which runs its module's code."""
    module, _, path = name.partition(":")
    found: Any = importlib.import_module(module)
    for part in path.split("."):
        found = getattr(found, part)
    return found
