"""Entry points of other packages, loaded in one way, and functions that training calls without knowing them.

What cannot be loaded is an error only for who asks for it by name; to everybody else it is a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hrl_escape.errors import PluginError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

RUN_OBSERVERS: list[str] = []
"""Functions, `module:name`, that `train` calls at its end as `observer(env, seeds, evaluations, source)`: the
evaluation environment, the seeds of an evaluation's episodes, the evaluations, agent and seed in words. They are
imported when a run has ended, so that layers above training can add one without being loaded."""


def load_entry_points(group: str, what: str, shape: str, take: Callable[[Any], object], wanted: object = None) -> None:
    """Load all entry points of a group.

    Args:
        group: name of the group, such as `hrl_escape.puzzles`.
        what: one of its things, for messages: `puzzle`.
        shape: in words, the value that an entry point must have: `an Observation`.
        take: registers the loaded value; may raise anything where it has another shape.
        wanted: name of the entry point that is asked for; a broken other one is warned of.

    Raises:
        PluginError: the entry point that is asked for cannot be loaded; the message names it and its package.
    """
    from importlib.metadata import entry_points  # takes a tenth of the package's import

    for point in entry_points(group=group):
        try:
            load_entry_point(point, what, shape, take)
        except PluginError as error:
            if point.name == wanted:
                raise
            warnings.warn(f"left out: {error}", stacklevel=2)


def load_entry_point(point: EntryPoint, what: str, shape: str, take: Callable[[Any], object]) -> None:
    """Load one entry point; arguments and errors as those of `load_entry_points`."""
    try:
        take(point.load())
    except Exception as error:  # whatever a stranger's module raises
        package = point.dist.name if point.dist else "an unknown package"
        raise PluginError(f"the {what} {point.name!r} of package {package!r} cannot be loaded from {point.value!r}, "
                          f"which must be {shape}: {error}") from error
