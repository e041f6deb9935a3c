"""Frozen dataclass settings with a unit and a range on every field, checked at construction.

This is the small machinery under `config.py`: `knob` declares a field, `Settings` checks
values, turns trees into plain dicts and back. It knows nothing of rooms.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from typing import Any, ClassVar

from typing_extensions import Self

from hrl_escape.errors import ConfigError

__all__ = ["Knob", "Settings", "knob"]


@dataclasses.dataclass(frozen=True)
class Knob:
    """What may stand in a field.

    Attributes:
        doc: one sentence for the docs and `--help`.
        unit: unit of the number, empty for counts and names.
        low: smallest value allowed (included unless `open_low`).
        high: largest value allowed (included unless `open_high`).
        open_low: exclude `low` itself.
        open_high: exclude `high` itself.
        choices: the allowed names, for text fields.
        optional: None is allowed too.
    """

    doc: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    open_low: bool = False
    open_high: bool = False
    choices: tuple[str, ...] | None = None
    optional: bool = False

    def describe(self, kind: type) -> str:
        """Say in words what is allowed for a value of type `kind`."""
        if self.choices is not None:
            words = "one of " + ", ".join(repr(choice) for choice in self.choices)
        elif kind in (int, float) and self.low is not None and self.high is not None:
            name = "a whole number" if kind is int else "a number"
            low, high = format(self.low, "g"), format(self.high, "g")
            edges = [f"above {low}" if self.open_low else f"from {low}",
                     f"to below {high}" if self.open_high else f"to {high}"]
            words = f"{name} {' '.join(edges)}{' ' + self.unit if self.unit else ''}"
        else:
            names = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}
            words = names.get(kind, f"a {getattr(kind, '__name__', kind)}")
        return words + (", or nothing (None)" if self.optional else "")


def knob(
    default: Any = dataclasses.MISSING,
    doc: str = "",
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    *,
    factory: Any = dataclasses.MISSING,
    **more: Any,
) -> Any:
    """Declare a settings field; see `Knob` for the words."""
    optional = more.pop("optional", default is None)
    metadata = {"knob": Knob(doc, unit, low, high, optional=optional, **more)}
    if factory is not dataclasses.MISSING:
        return dataclasses.field(default_factory=factory, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


class Settings:
    """Base of every settings dataclass: checked when made, plain dicts both ways."""

    _section: ClassVar[str] = "config"

    def __post_init__(self) -> None:
        hints = _hints(type(self))
        for field in dataclasses.fields(self):  # type: ignore[arg-type]  # every subclass is a dataclass
            value = getattr(self, field.name)
            checked = _check(f"{self._section}.{field.name}", value, hints[field.name], _knob_of(field))
            if checked is not value:
                object.__setattr__(self, field.name, checked)
        self.check()

    def check(self) -> None:
        """Check what spans several fields; raises `ConfigError`. Subclasses extend it."""

    def to_dict(self) -> dict[str, Any]:
        """Return nested plain dicts, lists, numbers and text, ready for JSON."""
        return {f.name: _plain(getattr(self, f.name)) for f in dataclasses.fields(self)}  # type: ignore[arg-type]

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build from what `to_dict` gave (missing fields take their defaults).

        Raises:
            ConfigError: an unknown field, or a value that is not possible.
        """
        if not isinstance(data, dict):
            raise ConfigError(cls._section, data, "a table of fields")
        fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
        hints = _hints(cls)
        values = {}
        for name, value in data.items():
            if name not in fields:
                raise ConfigError(f"{cls._section}.{name}", value, "no such field; fields are " + ", ".join(fields))
            values[name] = _revive(f"{cls._section}.{name}", value, hints[name])
        try:
            return cls(**values)
        except TypeError as error:
            raise ConfigError(cls._section, data, str(error).split("__init__() ")[-1]) from None


_HINTS: dict[type, dict[str, Any]] = {}


def _hints(cls: type) -> dict[str, Any]:
    if cls not in _HINTS:
        _HINTS[cls] = typing.get_type_hints(cls)
    return _HINTS[cls]


def _knob_of(field: dataclasses.Field) -> Knob:
    return field.metadata.get("knob") or Knob(field.name, optional=field.default is None)


def _parts(hint: Any) -> tuple[Any, ...]:
    """The alternatives of a union, without None."""
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        return tuple(part for part in typing.get_args(hint) if part is not type(None))
    return (hint,)


def _check(path: str, value: Any, hint: Any, rule: Knob) -> Any:
    parts = _parts(hint)
    if value is None and rule.optional:
        return None
    if typing.get_origin(parts[-1]) is tuple and isinstance(value, (tuple, list)):
        inner = typing.get_args(parts[-1])
        kinds = [inner[0]] * len(value) if inner[-1] is Ellipsis else inner
        if len(kinds) != len(value):
            raise ConfigError(path, value, f"a list of {len(kinds)} values")
        items = dataclasses.replace(rule, optional=False)
        return tuple(_check(f"{path}[{i}]", v, k, items) for i, (v, k) in enumerate(zip(value, kinds, strict=True)))
    kind = typing.get_origin(parts[0]) or parts[0]
    allowed = rule.describe(kind) if kind is not tuple else "a list"
    if kind is float and type(value) is int and abs(value) < 2**53:
        value = float(value)
    if not (isinstance(value, kind) and (kind is bool or not isinstance(value, bool))):
        raise ConfigError(path, value, allowed)
    if kind in (int, float):
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(path, value, allowed)
        if rule.low is not None and (value < rule.low or (rule.open_low and value == rule.low)):  # type: ignore[operator]
            raise ConfigError(path, value, allowed)
        if rule.high is not None and (value > rule.high or (rule.open_high and value == rule.high)):  # type: ignore[operator]
            raise ConfigError(path, value, allowed)
    if kind is str and rule.choices is not None and value not in rule.choices:
        raise ConfigError(path, value, allowed)
    return value


def _plain(value: Any) -> Any:
    if isinstance(value, Settings):
        return value.to_dict()
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    return value


def _revive(path: str, value: Any, hint: Any) -> Any:
    for part in _parts(hint):
        if isinstance(part, type) and issubclass(part, Settings) and isinstance(value, dict):
            return part.from_dict(value)
        if typing.get_origin(part) is tuple and isinstance(value, list):
            inner = typing.get_args(part)
            kinds = [inner[0]] * len(value) if inner[-1] is Ellipsis else list(inner)
            if len(kinds) != len(value):
                raise ConfigError(path, value, f"a list of {len(kinds)} values")
            return tuple(_revive(f"{path}[{i}]", v, k) for i, (v, k) in enumerate(zip(value, kinds, strict=True)))
    return value
