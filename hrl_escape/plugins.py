"""Entry points of other packages, loaded in one way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from hrl_escape.errors import PluginError

__all__ = ["load_entry_points"]

T = TypeVar("T")


def load_entry_points(group: str, what: str, shape: str, make: Callable[[Any], T]) -> Iterator[T]:
    """Load all entry points of a group.

    Args:
        group: name of the group, such as `hrl_escape.puzzles`.
        what: one of its things, for messages: `puzzle`.
        shape: in words, the value that an entry point must have: `an Observation`.
        make: makes the thing of the loaded value; may raise anything where it has another shape.

    Raises:
        PluginError: an entry point cannot be loaded; the message names it and its package.
    """
    from importlib.metadata import entry_points  # takes a tenth of the package's import

    for point in entry_points(group=group):
        try:
            made = make(point.load())
        except Exception as error:  # whatever a stranger's module raises
            package = point.dist.name if point.dist else "an unknown package"
            raise PluginError(f"the {what} {point.name!r} of package {package!r} cannot be loaded from "
                              f"{point.value!r}, which must be {shape}: {error}") from error
        yield made
