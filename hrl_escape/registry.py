"""One registry for every kind of named part: agents, puzzles, observations, rewards, bases and more.

A part comes from this package, from a program that calls `register`, or from an installed package with an entry point
under `hrl_escape.<kind>s`. Parts of other packages are imported at first use.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hrl_escape.errors import ConfigError, PluginError, UnknownNameError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

PartType = TypeVar("PartType")


class Registry(Generic[PartType]):
    """Parts of one kind by name.

    Args:
        kind: singular noun for messages, such as `path planner`; the entry-point group is `hrl_escape.path_planners`.
        shape: required type of a part, in words, such as `a subclass of Observer`.
        accepts: returns true for valid parts.
        shipped: parts of this package that are imported at first use: name to `module:attribute`, or to a function that
            imports and returns the part.

    Attributes:
        kind: singular noun for messages.
        group: name of the entry-point group.
    """

    def __init__(self, kind: str, shape: str, accepts: Callable[[Any], bool],
                 shipped: Mapping[str, str | Callable[[], PartType]] | None = None) -> None:
        self.kind, self.group = kind, f"hrl_escape.{kind.replace(' ', '_')}s"
        self._shape, self._accepts = shape, accepts
        self._shipped = dict(shipped or {})
        self._parts: dict[str, PartType] = {}
        self._given: set[str] = set()

    def register(self, name: str, part: PartType) -> None:
        """Register a part under a name. Registering the same part again has no effect.

        Raises:
            ConfigError: the part is not valid, or the name is taken.
        """
        if not self._accepts(part):
            raise ConfigError(self.kind, part, self._shape)
        if name in self._shipped or self._parts.get(name, part) != part:
            raise ConfigError(f"{self.kind}.name", name, f"a name that no other {self.kind} has")
        self._parts[name] = part
        self._given.add(name)

    def unregister(self, name: str) -> None:
        """Remove a part added by `register`; unknown names are ignored."""
        self._parts.pop(name, None)
        self._given.discard(name)

    def get(self, name: Any) -> PartType:
        """Return a part by name.

        Raises:
            UnknownNameError: no part of that name; the message names the closest.
            PluginError: the part belongs to another package and cannot be imported.
        """
        if not isinstance(name, str):
            raise UnknownNameError(self.kind, name, self.names())
        if name in self._parts:
            return self._parts[name]
        if name in self._shipped:
            where = self._shipped[name]
            part: PartType = resolve_name(where) if isinstance(where, str) else where()
        else:
            point = self._find_entry_points().get(name)
            if point is None:
                raise UnknownNameError(self.kind, name, self.names())
            part = self._load(point)
        self._parts[name] = part
        return part

    def find_given(self, name: str) -> PartType | None:
        """Return the part that `register` added under a name, or None for parts from elsewhere and unknown names."""
        return self._parts.get(name) if name in self._given else None

    def names(self) -> tuple[str, ...]:
        """Return all names: shipped and registered ones, then entry points, without loading them."""
        own = dict.fromkeys((*self._shipped, *self._parts))
        return (*own, *sorted(self._find_entry_points().keys() - own))

    def load_all(self) -> dict[str, PartType]:
        """Return all parts by name. Parts of other packages that fail to load are omitted with a warning."""
        loaded: dict[str, PartType] = {}
        for name in self.names():
            try:
                loaded[name] = self.get(name)
            except PluginError as error:
                warnings.warn(f"left out: {error}", stacklevel=2)
        return loaded

    def __contains__(self, name: object) -> bool:
        return name in self._parts or name in self._shipped or name in self._find_entry_points()

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def _find_entry_points(self) -> dict[str, EntryPoint]:
        from importlib.metadata import entry_points  # imported here: it takes a tenth of the package's import

        return {point.name: point for point in entry_points(group=self.group)}

    def _load(self, point: EntryPoint) -> PartType:
        package = point.dist.name if point.dist else "an unknown package"
        where = f"the {self.kind} {point.name!r} of package {package!r} cannot be loaded from {point.value!r}"
        try:
            part = point.load()
            is_accepted = self._accepts(part)
        except Exception as error:  # importing another package can raise anything
            raise PluginError(f"{where}: {type(error).__name__}: {error}") from error
        if not is_accepted:
            raise PluginError(f"{where}: it must be {self._shape}, got {part!r}")
        return part
