"""Named option sets, which make the options of a room.

| name | options |
|---|---|
| `press` | each reaches one goal of the room, such as the press of one button |
| `press-with-ancestors` | each first carries out what the puzzle requires before its goal |
| `press-reactive` | each reaches one goal by a policy that is a function of the state |

Your own option set is a function of a room's planner. Register it by `register_option_set`, or by an entry point in the
group `hrl_escape.option_sets`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeAlias

from hrl_escape.errors import UnknownNameError
from hrl_escape.options.option import Option
from hrl_escape.registry import Registry

if TYPE_CHECKING:
    from hrl_escape.env.instance import RoomInstance
    from hrl_escape.planning.planner import RoomPlanner

OptionSet: TypeAlias = "Callable[[RoomPlanner], Sequence[Option]]"
"""Function from a room's planner to its options. All rooms of one configuration get options with the same names, in the
same order."""

DEFAULT_SET = "press"
_SHIPPED = {name: f"hrl_escape.options.meta_actions:{function}" for name, function in (
    (DEFAULT_SET, "make_presses"), ("press-with-ancestors", "make_presses_with_ancestors"),
    ("press-reactive", "make_reactive_presses"))}  # they load the planners

option_sets: Registry[OptionSet] = Registry("option set", "a function of a RoomPlanner", callable, _SHIPPED)
"""Option sets by name."""


def register_option_set(name: str, make: OptionSet) -> None:
    """Register an option set. Every `option_set=` and `--option-set` then accepts its name.

    Args:
        name: the name.
        make: function from the planner of a room to its options.

    Raises:
        ConfigError: the value is not a function, or the name is taken.
    """
    option_sets.register(name, make)


def check_option_set(name: str) -> None:
    """Check that an option set has this name, without loading it.

    Raises:
        UnknownNameError: no option set has this name; the message names the closest.
    """
    if not isinstance(name, str) or name not in option_sets:
        raise UnknownNameError(option_sets.kind, name, option_sets.names(),
                               closest="press-reactive" if str(name) == "press-markov" else None)


@dataclasses.dataclass(frozen=True)
class OptionSetSource:
    """Makes the options of any room by the name of an option set.

    Raises:
        UnknownNameError: no option set has this name.
    """

    option_set: str
    planner: str = "auto"  # method of the options' plans, as in `RoomPlanner`

    def __post_init__(self) -> None:
        check_option_set(self.option_set)

    def __call__(self, instance: RoomInstance) -> Sequence[Option]:
        """Make the options of a room."""
        from hrl_escape.planning.planner import get_planner  # loads the planners

        return option_sets.get(self.option_set)(get_planner(instance, self.planner))
