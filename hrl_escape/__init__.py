"""hrl_escape: escape rooms for hierarchical reinforcement learning.

Importing this package registers the environments with Gymnasium and loads nothing heavy;
the names below are fetched from their modules when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium

from hrl_escape.env.presets import PRESETS, make_env_name

if TYPE_CHECKING:
    from hrl_escape.agents.registry import make_agent
    from hrl_escape.agents.training import train
    from hrl_escape.env.config import RoomConfig
    from hrl_escape.env.escape_room import EscapeRoomEnv
    from hrl_escape.env.generation import generate
    from hrl_escape.env.instance import RoomInstance
    from hrl_escape.env.presets import get_preset
    from hrl_escape.options.options_env import OptionsEnv
    from hrl_escape.options.planner import RoomPlanner

__all__ = [
    "EscapeRoomEnv",
    "OptionsEnv",
    "RoomConfig",
    "RoomInstance",
    "RoomPlanner",
    "__version__",
    "generate",
    "get_preset",
    "make_agent",
    "train",
]
__version__ = "0.1.0"

_HOMES = {
    "EscapeRoomEnv": "hrl_escape.env.escape_room",
    "OptionsEnv": "hrl_escape.options.options_env",
    "RoomConfig": "hrl_escape.env.config",
    "RoomInstance": "hrl_escape.env.instance",
    "RoomPlanner": "hrl_escape.options.planner",
    "generate": "hrl_escape.env.generation",
    "get_preset": "hrl_escape.env.presets",
    "make_agent": "hrl_escape.agents.registry",
    "train": "hrl_escape.agents.training",
}
_DOORS: dict[str, tuple[str, str | None]] = {  # suffix of the id: (one room, many rooms at once)
    "": ("hrl_escape.env.escape_room:EscapeRoomEnv", "hrl_escape.env.vector_env:EscapeRoomVectorEnv"),
    "Options": ("hrl_escape.options.making:make_options_env", None),
}

for _suffix, (_one, _many) in _DOORS.items():
    gymnasium.register(f"hrl_escape/EscapeRoom{_suffix}-v0", _one, vector_entry_point=_many)
    for _name in PRESETS:
        _id = f"hrl_escape/{make_env_name(_name)}{_suffix}-v0"
        gymnasium.register(_id, _one, vector_entry_point=_many, kwargs={"config": _name})


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'hrl_escape' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
