"""Ranges in settings: a number to be drawn for each room, and the functions that list and fill them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar


class Between:
    """Number that is drawn from a range, both ends included, as in `ButtonsConfig(count=Between(3, 5))`.

    Its text is `3..5`, in JSON and on the command line alike. To a type checker it is `Any`, for it stands where a
    number is declared.

    Attributes:
        low: smallest number.
        high: largest number.
    """

    low: float
    high: float

    def __new__(cls, low: float, high: float) -> Any:  # noqa: D102  # the class says it
        made = super().__new__(cls)
        made.low, made.high = low, high
        return made

    @classmethod
    def parse(cls, text: str) -> Any:
        """Range from its text.

        Raises:
            ValueError: the text is no range.
        """
        low, _, high = text.partition("..")
        return cls(_read_number(low), _read_number(high))

    def __getnewargs__(self) -> tuple[float, float]:
        return self.low, self.high

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Between) and (self.low, self.high) == (other.low, other.high)

    def __hash__(self) -> int:
        return hash((self.low, self.high))

    def __str__(self) -> str:
        return f"{self.low!r}..{self.high!r}"

    def __format__(self, spec: str) -> str:
        return f"{self.low:{spec}}..{self.high:{spec}}" if spec else str(self)

    def __repr__(self) -> str:
        return f"Between({self.low!r}, {self.high!r})"


def _read_number(text: str) -> float:
    try:
        return int(text)
    except ValueError:
        return float(text)


Dataclass = TypeVar("Dataclass")


def list_ranges(settings: Any) -> dict[str, Between]:
    """Ranges in a dataclass and the dataclasses in its fields, by dotted path, in the order of the fields."""
    return dict(_find_ranges(settings, ""))


def _find_ranges(settings: Any, path: str) -> Iterator[tuple[str, Between]]:
    for name in _list_names(type(settings)):
        value = getattr(settings, name)
        if isinstance(value, Between):
            yield path + name, value
        elif dataclasses.is_dataclass(value):
            yield from _find_ranges(value, f"{path}{name}.")


@functools.cache
def _list_names(kind: type) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(kind))


def fill_ranges(settings: Dataclass, values: Mapping[str, Any]) -> Dataclass:
    """Copy of settings with numbers in place of ranges.

    Args:
        settings: a dataclass.
        values: a number for each path that `list_ranges` gives.

    Raises:
        ConfigError: these numbers do not go together.
    """
    changes: dict[str, Any] = {}
    inner: dict[str, dict[str, Any]] = {}
    for path, value in values.items():
        name, _, rest = path.partition(".")
        if rest:
            inner.setdefault(name, {})[rest] = value
        else:
            changes[name] = value
    changes |= {name: fill_ranges(getattr(settings, name), rest) for name, rest in inner.items()}
    return dataclasses.replace(settings, **changes)  # type: ignore[type-var]  # a dataclass
