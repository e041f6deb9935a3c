"""What every agent's settings share: ranges checked at construction, and the SMDP choices.

A settings class is a frozen dataclass with a sentence under each field; the command line is
made from it. Ranges stand in the annotation, `Annotated[float, Range(0, 1)]`.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import math
import textwrap
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from hrl_escape.errors import AgentSettingsError, UnknownNameError

__all__ = ["AgentSettings", "LearningSettings", "Range", "read_field_documents", "replace_settings"]


@dataclasses.dataclass(frozen=True)
class Range:
    """The numbers a setting may take.

    Attributes:
        low: smallest value allowed.
        high: largest value allowed.
        open_low: exclude `low` itself.
    """

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False

    def __contains__(self, value: float) -> bool:
        return (self.low < value if self.open_low else self.low <= value) and value <= self.high

    def __str__(self) -> str:
        if self.high == math.inf:
            return f"above {self.low:g}" if self.open_low else f"{self.low:g} or more"
        return f"{'above' if self.open_low else 'from'} {self.low:g} to {self.high:g}"


@dataclasses.dataclass(frozen=True)
class AgentSettings:
    """Base of all settings: construction checks each field against its annotation."""

    def __post_init__(self) -> None:
        """Refuse impossible values.

        Raises:
            AgentSettingsError: a value has the wrong type or lies outside its range.
        """
        hints = get_type_hints(type(self), include_extras=True)
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            problem = _find_problem(hints[field.name], value)
            if problem:
                raise AgentSettingsError(f"{type(self).__name__}.{field.name}", value, problem)
            if isinstance(value, list):
                object.__setattr__(self, field.name, tuple(value))


@dataclasses.dataclass(frozen=True)
class LearningSettings(AgentSettings):
    """How an algorithm treats actions of different duration and episodes that are cut off."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive`: an action of k primitives is worth sum gamma^i r_i and discounts by gamma^k. `decision`: it is
    worth the plain sum and discounts by gamma, as if it were one step, which is what the paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Value the state in which an episode was cut off; otherwise a cut counts as termination, as it did then."""
    clock: Literal["primitive", "decision"] = "primitive"
    """What warm-up, update and exploration schedules count. With primitives, flat and option-level agents do the
    same work on the same experience."""


Settings = TypeVar("Settings", bound=AgentSettings)


def replace_settings(settings: Settings, changes: Mapping[str, Any]) -> Settings:
    """Return settings with some fields changed.

    Raises:
        UnknownNameError: there is no such field; the message names the closest.
        AgentSettingsError: a value is not possible.
    """
    known = [field.name for field in dataclasses.fields(settings)]
    for name in changes:
        if name not in known:
            raise UnknownNameError(f"setting of {type(settings).__name__}", name, known)
    return dataclasses.replace(settings, **changes)


def read_field_documents(settings: type) -> dict[str, str]:
    """The sentence under each field of a settings dataclass and its bases, by the field's name."""
    documents: dict[str, str] = {}
    for owner in reversed(settings.__mro__[:-1]):
        (definition,) = ast.parse(textwrap.dedent(inspect.getsource(owner))).body
        body = definition.body if isinstance(definition, ast.ClassDef) else []
        for field, below in zip(body, body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(below, ast.Expr):
                documents[field.target.id] = " ".join(str(ast.literal_eval(below.value)).split())
    return documents


def _find_problem(hint: Any, value: Any) -> str | None:
    """Say what is wrong with a value, or None; knows the kinds of field that settings use."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        problem = _find_problem(arguments[0], value)
        values = value if isinstance(value, (tuple, list)) else (value,)
        if problem is None and not all(item in arguments[1] for item in values):
            problem = f"it must be {arguments[1]}"
        return problem
    if origin is Literal:
        return None if value in arguments else "it must be one of " + ", ".join(map(repr, arguments))
    if origin is tuple:
        problems = [_find_problem(arguments[0], item) for item in value] if isinstance(value, (tuple, list)) else [""]
        return None if not any(p is not None for p in problems) else "it must be a list of whole numbers"
    if hint is bool:
        return None if isinstance(value, bool) else "it must be true or false"
    if hint is int:
        return None if isinstance(value, int) and not isinstance(value, bool) else "it must be a whole number"
    if hint is float:
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return None if is_number and math.isfinite(value) else "it must be a finite number"
    return None if isinstance(value, hint) else f"it must be a {hint.__name__}"
