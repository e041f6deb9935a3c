"""Options of an environment, made from a list, a function, or a flavour of meta-actions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ConfigError, OptionError
from hrl_escape.options.option import FLAVOURS, Option

OptionsSource: TypeAlias = Sequence[Option] | Callable[[Any], Sequence[Option]]
"""Options, or a function that makes them for a room's instance, or for any other environment."""


def make_options(source: OptionsSource, subject: Any) -> tuple[Option, ...]:
    """Make the options of an environment and check that they belong to it.

    Args:
        source: the options, or a function of the subject.
        subject: a room's instance, or any other environment.

    Raises:
        OptionError: two options share a name, one is no option, or one was made for another room.
    """
    made = tuple(source(subject) if callable(source) else source)
    for option in made:
        if not isinstance(option, Option):
            raise OptionError(f"{option!r} is no option: derive its class from Option, or make a FunctionOption of it")
    names = [option.name for option in made]
    if len(set(names)) < len(names):
        raise OptionError(f"option names must differ: {', '.join(names)}")
    here = subject.id if isinstance(subject, RoomInstance) else None
    for option in made:
        if option.instance is not None and option.instance.id != here:
            raise OptionError(f"option {option.name!r} was made for room {option.instance.id}, this one is "
                              f"{here or 'no room'}: give OptionsEnv a function that makes options for an instance")
    return made


@dataclasses.dataclass(frozen=True)
class MetaSource:
    """Makes the meta-actions of any room.

    Raises:
        ConfigError: no such flavour.
        UnknownNameError: no such method; only when the options are made, as path planners load OMPL.
    """

    flavour: str  # of `FLAVOURS`
    planner: str = "auto"  # method of their plans, as in `RoomPlanner`

    def __post_init__(self) -> None:
        if self.flavour not in FLAVOURS:
            raise ConfigError("OptionsEnv.flavour", self.flavour, " or ".join(map(repr, FLAVOURS)))

    def __call__(self, instance: RoomInstance) -> Sequence[Option]:
        """The meta-actions of a room."""
        from hrl_escape.options.meta_actions import make_meta_options  # loads the planners
        from hrl_escape.planning.planner import get_planner

        return make_meta_options(instance, self.flavour, get_planner(instance, self.planner))
