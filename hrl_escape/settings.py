"""Frozen dataclass settings: ranges in the annotations, a sentence under each field, checks at construction.

Room configurations, puzzles, agents and grids have this form:

    @dataclasses.dataclass(frozen=True)
    class ShapeConfig(Settings):
        width: Annotated[float, Range(5, 200, "m")] = 20.0
        '''Inner size along x.'''

Fields hold numbers, text, `Literal` names, booleans, tuples, None and other settings. Construction raises for invalid
values. `to_dict` and `from_dict` convert settings to plain JSON values and back. Some classes also accept ranges for
numbers, such as `Between(3, 5)`, which each room draws from.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import itertools
import math
import numbers
import textwrap
import types
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from typing_extensions import Self

from hrl_escape.errors import ConfigError, UnknownNameError


class Between:
    """Range of a number that is drawn at random, both ends included, as in `ButtonsConfig(count=Between(3, 5))`.

    Its text is `3..5`, in JSON and on the command line. Its type for type checkers is `Any`, because it replaces a
    number.
    """

    low: float
    high: float

    def __new__(cls, low: float, high: float) -> Any:  # noqa: D102  # documented by the class
        made = super().__new__(cls)
        made.low, made.high = low, high
        return made

    @classmethod
    def parse(cls, text: str) -> Any:
        """Parse a range from its text. Raises `ValueError` for other text."""
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
    """Return the ranges in a dataclass and its nested dataclasses, by dotted path, in the order of the fields."""
    return dict(_find_ranges(settings, ""))


_PLAIN = frozenset({int, float, str, bool, tuple, type(None)})


def _find_ranges(settings: Any, path: str) -> Iterator[tuple[str, Between]]:
    for name in _list_names(type(settings)):
        value = getattr(settings, name)
        if type(value) in _PLAIN:  # a shortcut for most fields, because every construction runs this
            continue
        if isinstance(value, Between):
            yield path + name, value
        elif dataclasses.is_dataclass(value):
            yield from _find_ranges(value, f"{path}{name}.")


@functools.cache
def _list_names(kind: type) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(kind))


def fill_ranges(settings: Dataclass, values: Mapping[str, Any]) -> Dataclass:
    """Return a copy of a dataclass with numbers instead of ranges, given by the paths of `list_ranges`."""
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


MOST_RANGES = 8
"""Most ranges in settings and their sections, because every combination of their ends is checked."""


@dataclasses.dataclass(frozen=True)
class Range:
    """Valid numbers of a field, as in `Annotated[float, Range(0, 1)]`."""

    low: float = -math.inf  # smallest valid number
    high: float = math.inf  # largest valid number
    unit: str = ""  # unit of the number, empty for counts and fractions
    _: dataclasses.KW_ONLY
    open_low: bool = False  # exclude `low` itself
    open_high: bool = False  # exclude `high` itself

    def __contains__(self, value: float) -> bool:
        above = self.low < value if self.open_low else self.low <= value
        return above and (value < self.high if self.open_high else value <= self.high)

    def __str__(self) -> str:
        if self.low == -math.inf and self.high == math.inf:
            words = ""
        elif self.high == math.inf:
            words = f"above {self.low:g}" if self.open_low else f"of at least {self.low:g}"
        elif self.low == -math.inf:
            words = f"below {self.high:g}" if self.open_high else f"of at most {self.high:g}"
        else:
            low = f"above {self.low:g}" if self.open_low else f"from {self.low:g}"
            words = f"{low} to below {self.high:g}" if self.open_high else f"{low} to {self.high:g}"
        return f"{words} {self.unit}" if self.unit else words


ExactCount = Annotated[int, Range(0, 2**53)]
"""A number of things, which is exact as a float."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """Base class of all settings: construction checks every field against its annotation."""

    _section: ClassVar[str] = ""
    """Name of the section in messages and paths; the name of the class if empty."""
    _error: ClassVar[type[ConfigError]] = ConfigError
    """Exception for invalid values in this family of settings."""
    _takes_ranges: ClassVar[bool] = False
    """True if numbers may be ranges."""

    def __post_init__(self) -> None:
        section = self._section or type(self).__name__
        for name, reader in _make_readers(type(self)).items():
            given = getattr(self, name)
            try:
                value = reader.read(f"{section}.{name}", given)
            except _Refusal as refusal:
                raise self._error(*refusal.args) from None
            if value is not given:
                object.__setattr__(self, name, value)
        ranges = list_ranges(self)
        if not ranges:
            self.check()
        elif len(ranges) > MOST_RANGES:
            raise self._error(section, ", ".join(ranges), f"at most {MOST_RANGES} ranges")
        else:
            for ends in itertools.product(*((between.low, between.high) for between in ranges.values())):
                fill_ranges(self, dict(zip(ranges, ends, strict=True)))  # construction checks the ends

    def check(self) -> None:
        """Raise for invalid combinations of fields. Subclasses extend it."""

    def to_dict(self) -> dict[str, Any]:
        """Return nested plain dicts, lists, numbers and text, ready for JSON."""
        return {field.name: _make_plain(getattr(self, field.name)) for field in dataclasses.fields(self)}

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build settings from the output of `to_dict`. Missing fields get their defaults.

        Raises:
            UnknownNameError: no such field; the message names the closest.
            ConfigError: a value is not valid.
        """
        section = cls._section or cls.__name__
        if not isinstance(data, Mapping):
            raise cls._error(section, data, "a table of fields")
        fields = {field.name: field for field in dataclasses.fields(cls)}
        for name, value in data.items():
            if name not in fields:
                what = "section" if isinstance(value, Mapping) else "field"
                raise UnknownNameError(f"{section} {what}", name, fields)
        missing = [name for name, field in fields.items() if name not in data and _is_required(field)]
        if missing:
            raise cls._error(section, dict(data), f"a table with the field {missing[0]!r}")
        return cls(**data)


def replace_settings(settings: Dataclass, changes: Mapping[str, Any]) -> Dataclass:
    """Return a copy of settings with some fields changed.

    Raises:
        UnknownNameError: no such field; the message names the closest.
        ConfigError: a value is not valid.
    """
    known = [field.name for field in dataclasses.fields(settings)]  # type: ignore[arg-type]  # a frozen dataclass
    for name in changes:
        if name not in known:
            raise UnknownNameError(f"setting of {type(settings).__name__}", name, known)
    return dataclasses.replace(settings, **changes)  # type: ignore[type-var]  # a frozen dataclass


def read_record(kind: type[Dataclass], data: Any, path: str = "") -> Dataclass:
    """Build a dataclass from a JSON table, with a check of every field against its annotation.

    `path` is the dotted path of the table in messages; by default the name of the class.

    Raises:
        UnknownNameError: no such field; the message names the closest.
        ConfigError: a field is missing, or its value is not valid.
    """
    path = path or kind.__name__
    if not isinstance(data, Mapping):
        raise ConfigError(path, data, "a table of fields")
    readers = _make_readers(kind)
    for name in data:
        if name not in readers:
            raise UnknownNameError(f"field of {path}", name, readers)
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]  # a dataclass
        if field.name not in data and _is_required(field):
            raise ConfigError(path, list(data), f"a table with the field {field.name!r}")
    try:
        return kind(**{name: readers[name].read(f"{path}.{name}", value) for name, value in data.items()})
    except _Refusal as refusal:
        raise ConfigError(*refusal.args) from None


def read_argument(hint: Any, name: str, value: Any) -> Any:
    """Check an argument of a function as a field of settings is checked, and return it; numbers may be numpy's.

    Args:
        hint: its annotation, such as `Annotated[float, Range(0, 1)]`.
        name: its name in messages.
        value: the argument.

    Raises:
        ConfigError: the value is not valid.
    """
    if isinstance(value, numbers.Integral) and not isinstance(value, bool):
        value = int(value)
    elif isinstance(value, numbers.Real) and not isinstance(value, bool):
        value = float(value)
    try:
        return _make_reader(hint).read(name, value)
    except _Refusal as refusal:
        raise ConfigError(*refusal.args) from None


# --- descriptions ----------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class FieldDescription:
    """Description of one field for tables and `--help`."""

    name: str  # name of the field
    default: Any  # default value
    allowed: str  # valid values, in words
    document: str  # the sentence under the field
    is_section: bool  # whether the field holds nested settings


def describe_fields(settings: type[Settings]) -> tuple[FieldDescription, ...]:
    """Describe the fields of a settings class, in order."""
    documents, readers = read_field_documents(settings), _make_readers(settings)
    return tuple(
        FieldDescription(field.name, field.default if field.default_factory is dataclasses.MISSING
                         else field.default_factory(), readers[field.name].allowed, documents.get(field.name, ""),
                         readers[field.name].is_section)
        for field in dataclasses.fields(settings))


def read_field_documents(settings: Any) -> dict[str, str]:
    """Return the sentences under the fields of a settings dataclass and its bases, by field name.

    They are read from the source code; a class without source code has none.
    """
    documents: dict[str, str] = {}
    for owner in reversed(settings.__mro__):
        if "__dataclass_fields__" in owner.__dict__:
            documents |= _read_own_documents(owner)
    return {field.name: documents[field.name] for field in dataclasses.fields(settings) if field.name in documents}


@functools.cache
def _read_own_documents(owner: type) -> dict[str, str]:
    """Sentences under the fields that a class itself declares. Python parses the whole module once per class."""
    try:
        source = inspect.getsource(owner)
    except (OSError, TypeError):
        return {}
    (definition,) = ast.parse(textwrap.dedent(source)).body
    body = definition.body if isinstance(definition, ast.ClassDef) else []
    return {field.target.id: " ".join(str(ast.literal_eval(below.value)).split())
            for field, below in zip(body, body[1:], strict=False)
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(below, ast.Expr)}


# --- values ----------------------------------------------------------------------------


class _Refusal(Exception):  # noqa: N818  # converted to the error of the settings' family
    """An invalid value: its path, the value, and the valid ones in words."""


@dataclasses.dataclass(frozen=True)
class _Reader:
    """Valid values of a field in words, and the function that checks and converts a (path, value)."""

    allowed: str
    read: Callable[[str, Any], Any]
    is_section: bool = False
    is_number: bool = False


@functools.cache
def _make_readers(settings: type) -> dict[str, _Reader]:
    hints = get_type_hints(settings, include_extras=True)
    readers = {field.name: _make_reader(hints[field.name]) for field in dataclasses.fields(settings)}
    if getattr(settings, "_takes_ranges", False):
        return {name: _take_ranges(reader) if reader.is_number else reader for name, reader in readers.items()}
    return readers


def _make_reader(hint: Any, limits: Range | None = None) -> _Reader:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _make_reader(arguments[0], next((mark for mark in arguments[1:] if isinstance(mark, Range)), None))
    if origin is Union or origin is types.UnionType:
        return _make_union_reader(arguments)
    if origin is tuple:
        return _make_tuple_reader(arguments)
    if origin is dict:
        return _make_dict_reader(*arguments)
    if origin is Literal:
        return _make_test_reader("one of " + ", ".join(map(repr, arguments)),
                                 lambda value: isinstance(value, type(arguments[0])) and value in arguments)
    if hint is Any:
        return _make_test_reader("anything", lambda value: True)
    if hint is bool:
        return _make_test_reader("true or false", lambda value: isinstance(value, bool))
    if hint is int or hint is float:
        return _make_number_reader(hint, limits)
    kind = origin or hint
    if dataclasses.is_dataclass(kind):
        return _make_table_reader(kind)
    words = {str: "text", dict: "a table"}.get(kind, f"a {kind.__name__}")
    return _make_test_reader(words, lambda value: isinstance(value, kind))


def _make_test_reader(allowed: str, is_possible: Callable[[Any], bool]) -> _Reader:
    def read(path: str, value: Any) -> Any:
        if not is_possible(value):
            raise _Refusal(path, value, allowed)
        return value

    return _Reader(allowed, read)


def _make_number_reader(kind: type, limits: Range | None) -> _Reader:
    allowed = f"{'a whole number' if kind is int else 'a number'} {limits or ''}".rstrip()

    def read(path: str, given: Any) -> Any:
        value = float(given) if kind is float and type(given) is int and abs(given) < 2**53 else given
        if not isinstance(value, kind) or isinstance(value, bool) or (kind is float and not math.isfinite(value)):
            raise _Refusal(path, given, allowed)
        if limits is not None and value not in limits:
            raise _Refusal(path, given, allowed)
        return value or kind(0)  # -0.0 becomes 0.0, which gives equal settings equal text

    return _Reader(allowed, read, is_number=True)


def _take_ranges(reader: _Reader) -> _Reader:
    """Reader of the values of `reader`, and of ranges of such numbers."""

    def read(path: str, value: Any) -> Any:
        given = value
        if isinstance(value, str):
            try:
                given = Between.parse(value)
            except ValueError:
                pass
        if not isinstance(given, Between):
            return reader.read(path, value)
        low, high = reader.read(path, given.low), reader.read(path, given.high)
        if low is None or high is None or low > high:
            raise _Refusal(path, str(given), "a range from a number to one that is at least as large")
        return Between(low, high)

    return dataclasses.replace(reader, read=read)


def _make_table_reader(kind: Any) -> _Reader:
    """Reader of settings, whose errors name the section, or of another dataclass, whose errors name the path."""
    is_section, allowed = issubclass(kind, Settings), "a table of fields"

    def read(path: str, value: Any) -> Any:
        if isinstance(value, kind):
            return value
        if not is_section:
            return read_record(kind, value, path)
        if isinstance(value, Mapping):
            return kind.from_dict(value)
        raise _Refusal(path, value, allowed)

    return _Reader(allowed, read, is_section)


def _make_tuple_reader(hints: tuple[Any, ...]) -> _Reader:
    any_length = hints[-1] is Ellipsis
    items = [_make_reader(hint) for hint in hints if hint is not Ellipsis]
    of_any_length = "a list of tables" if items[0].is_section else f"a list, each {items[0].allowed}"
    allowed = of_any_length if any_length else f"a list of {len(items)} values"

    def read(path: str, value: Any) -> Any:
        if not isinstance(value, (tuple, list)) or not (any_length or len(value) == len(items)):
            raise _Refusal(path, value, allowed)
        readers = items * len(value) if any_length else items
        made = tuple(reader.read(f"{path}[{i}]", item)
                     for i, (reader, item) in enumerate(zip(readers, value, strict=True)))
        is_same = isinstance(value, tuple) and all(new is old for new, old in zip(made, value, strict=True))
        return value if is_same else made

    return _Reader(allowed, read)


def _make_dict_reader(key: Any, item: Any) -> _Reader:
    keys, items = _make_reader(key), _make_reader(item)
    allowed = "a table" if item is Any else f"a table, each {items.allowed}"

    def read(path: str, value: Any) -> Any:
        if not isinstance(value, dict):
            raise _Refusal(path, value, allowed)
        return {keys.read(f"{path}: a name", name): items.read(f"{path}.{name}", each) for name, each in value.items()}

    return _Reader(allowed, read)


def _make_union_reader(hints: tuple[Any, ...]) -> _Reader:
    readers = [_make_reader(hint) for hint in hints if hint is not types.NoneType]
    takes_none = types.NoneType in hints
    allowed = ", or ".join([reader.allowed for reader in readers] + ["nothing (None)"] * takes_none)

    def read(path: str, value: Any) -> Any:
        if value is None and takes_none:
            return None
        for reader in readers:
            try:
                return reader.read(path, value)
            except _Refusal:
                continue
        raise _Refusal(path, value, allowed)

    return _Reader(allowed, read, is_section=any(reader.is_section for reader in readers),
                   is_number=any(reader.is_number for reader in readers))


def _is_required(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _make_plain(value: Any) -> Any:
    if isinstance(value, Settings):
        return value.to_dict()
    if isinstance(value, (tuple, list)):
        return [_make_plain(item) for item in value]
    return str(value) if isinstance(value, Between) else value
