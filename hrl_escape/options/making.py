"""`make_options_env`: a room and its options in one call, behind the ids `hrl_escape/<Preset>Options-v0`."""

from __future__ import annotations

from typing import Any

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.options.options_env import OptionsEnv, OptionsSource

__all__ = ["make_options_env"]


def make_options_env(
    config: str | RoomConfig | dict[str, Any] = "paper-two-button",
    *,
    options: OptionsSource = None,
    include_primitives: bool = True,
    discount: float = 0.99,
    discounted_reward: bool = False,
    flavour: str = "press",
    interruptible: bool = False,
    max_duration: int | None = None,
    trace: bool = False,
    option_features: bool = False,
    **room: Any,
) -> OptionsEnv:
    """Make an `EscapeRoomEnv` and wrap it in an `OptionsEnv`.

    Args:
        config: the schematic, see `EscapeRoomEnv`.
        options: see `OptionsEnv`.
        include_primitives: see `OptionsEnv`.
        discount: see `OptionsEnv`.
        discounted_reward: see `OptionsEnv`.
        flavour: see `OptionsEnv`.
        interruptible: see `OptionsEnv`.
        max_duration: see `OptionsEnv`.
        trace: see `OptionsEnv`.
        option_features: append option features to the observation (`OptionsEnv(observation="options")`).
        room: everything else that `EscapeRoomEnv` takes, such as `observation="features"`.
    """
    env = EscapeRoomEnv(config, **room)
    return OptionsEnv(
        env, options, include_primitives, discount, discounted_reward, flavour, interruptible, max_duration, trace,
        "options" if option_features else "pass",
    )
