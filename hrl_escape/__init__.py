"""hrl_escape: escape rooms for hierarchical reinforcement learning.

Importing this package registers the environments with Gymnasium and loads only light modules. The names below are
imported from their modules at first use.
"""

from __future__ import annotations

import gymnasium
import lazy_loader

from hrl_escape.env.presets import PRESETS, make_env_name
from hrl_escape.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_DOORS: dict[str, tuple[str, str]] = {  # suffix of the id: (entry point for one room, entry point for many)
    "": ("hrl_escape.env.escape_room:EscapeRoomEnv", "hrl_escape.env.vector_env:EscapeRoomVectorEnv"),
    "Options": ("hrl_escape.options.options_env:make_options_env",
                "hrl_escape.options.batched.vector_env:OptionsVectorEnv"),
}

for _suffix, (_one, _many) in _DOORS.items():
    gymnasium.register(f"hrl_escape/EscapeRoom{_suffix}-v1", _one, vector_entry_point=_many)
    for _name in PRESETS:
        _id = f"hrl_escape/{make_env_name(_name)}{_suffix}-v1"
        gymnasium.register(_id, _one, vector_entry_point=_many, kwargs={"config": _name})

gymnasium.register("hrl_escape/EscapeRoomContinuous-v1", "hrl_escape.env.continuous:EscapeRoomContinuousEnv",
                   vector_entry_point="hrl_escape.env.continuous_vector_env:EscapeRoomContinuousVectorEnv")
gymnasium.register("hrl_escape/PointMaze-v1", "hrl_escape.env.mazes:PointMazeEnv",
                   vector_entry_point="hrl_escape.env.maze_vector_env:PointMazeVectorEnv")
gymnasium.register("hrl_escape/Ladder-v1", "hrl_escape.sets.environments:make_ladder_env",
                   vector_entry_point="hrl_escape.sets.environments:make_ladder_vec")
