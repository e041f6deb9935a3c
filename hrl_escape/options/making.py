"""The entry point of the `...Options-v0` ids: a flat room and its options in one call."""

from __future__ import annotations

from typing import Any, Literal

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.options.options_env import OptionsEnv, OptionsSource

__all__ = ["make_options_env"]


def make_options_env(
    config: Any = "paper-two-button",
    *,
    options: OptionsSource = None,
    include_primitives: bool = True,
    discount: float = 0.99,
    discounted_reward: bool = False,
    flavour: Literal["press", "press-with-ancestors"] = "press",
    interruptible: bool = False,
    max_duration: int | None = None,
    trace: bool = False,
    option_features: bool = False,
    **room: Any,
) -> OptionsEnv:
    """Make a room and wrap it by `OptionsEnv`.

    Args:
        config: as for `EscapeRoomEnv`.
        options: as for `OptionsEnv`, like all that follow.
        include_primitives: whether primitives are actions too.
        discount: gamma per primitive.
        discounted_reward: return the discounted sum as the reward.
        flavour: `press` or `press-with-ancestors`.
        interruptible: return to the agent after every primitive of an option.
        max_duration: primitives after which an option is ended.
        trace: put every primitive into `info["trace"]`.
        option_features: append which options are legal and running to a flat observation.
        **room: every other argument of `EscapeRoomEnv`, such as `observation` or `instance_seed`.
    """
    return OptionsEnv(
        EscapeRoomEnv(config, **room), options, include_primitives, discount, discounted_reward, flavour,
        interruptible, max_duration, trace, "options" if option_features else "pass",
    )
