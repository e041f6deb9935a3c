"""hrl_escape: escape rooms for hierarchical reinforcement learning.

Importing this package registers the environments with Gymnasium and loads nothing heavy;
the names below are fetched from their modules when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import gymnasium

from hrl_escape.env.presets import PRESETS, make_env_name

__version__ = "0.1.0"

_PUBLIC = {
    "EscapeRoomEnv": "hrl_escape.env.escape_room",
    "RoomConfig": "hrl_escape.env.config",
    "RoomInstance": "hrl_escape.env.instance",
    "generate": "hrl_escape.env.generation",
    "get_preset": "hrl_escape.env.presets",
    "OptionsEnv": "hrl_escape.options.options_env",
    "RoomPlanner": "hrl_escape.options.planner",
    "make_agent": "hrl_escape.agents.registry",
    "train": "hrl_escape.agents.training",
}
__all__ = ["__version__", *_PUBLIC]

_ENTRY_POINT = "hrl_escape.env.escape_room:EscapeRoomEnv"

gymnasium.register("hrl_escape/EscapeRoom-v0", _ENTRY_POINT)
for _name in PRESETS:
    gymnasium.register(f"hrl_escape/{make_env_name(_name)}-v0", _ENTRY_POINT, kwargs={"config": _name})


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'hrl_escape' has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
