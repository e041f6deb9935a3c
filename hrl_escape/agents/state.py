"""State declared once, by the names of attributes: from the declaration follow `state_dict` and `load_state_dict`.

    class Learner(Stateful):
        STATE = ("table", "_steps", "_rng")

saves {"table": ..., "steps": ..., "rng": ...}: a subclass's declaration adds to its bases' declarations, whose keys
come first. What an attribute is decides how it is kept:

| attribute | in the tree | loading |
|---|---|---|
| a part with `state_dict` and `load_state_dict` | its own tree | into the part that is there |
| a dict or list of parts, a dict of tensors | a tree or array each | into those that are there, one by one |
| numpy or torch generator | its state | set on the generator that is there |
| torch tensor | array | copied into the tensor that is there, on its device; the shape must be the same |
| numpy array | array | a copy, of the dtype that is there |
| NamedTuple | dict of its fields | read as above, field by field |
| number, truth value, text, tuple, None | as it is | of the type that is there |
| list, dict of what a tree holds | as it is | a copy |
| anything else | as `Kept.pack` makes it | as `Kept.unpack` makes it |

If the attribute is None and the tree holds a part's state, or the other way round, nothing is loaded: the tree is from
an object with a part that this one lacks. `Kept` gives an attribute another key, a form of its own, or leaves its key
out while it is None. `Columns` keeps tables, dicts with the same keys. A class whose form follows from more than one
attribute gives a property with a setter, or writes the two methods itself. What follows from the state (an index, a
plan) is computed in `after_load`.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, ClassVar, TypeGuard

import numpy as np

from hrl_escape.errors import CheckpointError

StateTree = dict[str, Any]
"""Content of a checkpoint: a tree of dicts and lists over numbers, strings, None and numpy arrays."""


@dataclass(frozen=True)
class Kept:
    """An attribute of the state whose key or form is not the one that follows from its name and type."""

    attribute: str  #: its name, or a path through parts such as `noise.state`
    key: str = ""  #: in the tree; by default the attribute's name without underscores before it
    pack: Callable[[Any], Any] | None = None  #: from a value that is not None to its form in the tree
    unpack: Callable[[Any], Any] | None = None  #: from that form to the value; by default as `restore_value`
    is_left_out: bool = False  #: the tree has no such key while the attribute is None

    def __post_init__(self) -> None:
        object.__setattr__(self, "key", self.key or self.attribute.lstrip("_"))

    def write(self, holder: Any, tree: StateTree) -> None:
        """Put the attribute of a holder into its tree."""
        value = attrgetter(self.attribute)(holder) if self._find_owner(holder) is not None else None
        if value is not None or not self.is_left_out:
            tree[self.key] = self.pack(value) if self.pack and value is not None else read_value(
                value, f"{type(holder).__name__}.{self.attribute}")

    def read(self, holder: Any, tree: StateTree) -> None:
        """Set the attribute of a holder from a tree."""
        if self.key not in tree and self.is_left_out:
            return
        saved, owner, name = _get(tree, self.key, holder), self._find_owner(holder), self.attribute.rpartition(".")[2]
        if owner is None:
            return
        before = getattr(owner, name)
        if self.unpack is not None:
            value = None if saved is None else self.unpack(saved)
        else:
            value = restore_value(before, saved, f"{self.key} of {type(holder).__name__}")
        if value is not before:
            setattr(owner, name, value)

    def _find_owner(self, holder: Any) -> Any:
        """Object that has the attribute itself, at the end of its path, or None if the path ends early."""
        for name in self.attribute.split(".")[:-1]:
            holder = None if holder is None else getattr(holder, name)
        return holder


@dataclass(frozen=True)
class Columns:
    """Dicts with the same keys in the same order: the keys as one list, and the values of each dict as one array."""

    attributes: Mapping[str, str]
    """Key in the tree -> attribute; values are numbers, or arrays of one shape. The dicts' own keys are under
    `keys`."""
    are_literal: bool = False
    """Keys are literals (numbers, text, bytes, None and tuples of these), kept as text; else they are bytes of one
    length, kept as an array."""

    def write(self, holder: Any, tree: StateTree) -> None:
        """Put the dicts of a holder into its tree."""
        dicts = {key: getattr(holder, attribute) for key, attribute in self.attributes.items()}
        keys = next(iter(dicts.values()))
        tree["keys"] = list(map(repr, keys)) if self.are_literal else pack_keys(keys)
        tree |= {key: np.array(list(each.values())) for key, each in dicts.items()}

    def read(self, holder: Any, tree: StateTree) -> None:
        """Set the dicts of a holder from a tree."""
        saved = _get(tree, "keys", holder)
        keys = list(map(ast.literal_eval, saved)) if self.are_literal else unpack_keys(saved)
        for key, attribute in self.attributes.items():
            values = np.array(_get(tree, key, holder))
            rows = values.tolist() if values.ndim == 1 else values
            setattr(holder, attribute, dict(zip(keys, rows, strict=True)))


def pack_keys(keys: Iterable[bytes]) -> Any:
    """Keys of one length as uint8 (keys, length)."""
    return np.array([np.frombuffer(key, np.uint8) for key in keys], np.uint8)


def unpack_keys(saved: Any) -> list[bytes]:
    """Keys from what `pack_keys` gave."""
    return [key.tobytes() for key in np.asarray(saved, np.uint8)]


def pack_columns(rows: Iterable[Any], names: Iterable[str]) -> StateTree:
    """Some attributes of objects of the same form, a column each."""
    rows = list(rows)
    return {name: np.array([getattr(row, name) for row in rows]) for name in names}


def unpack_columns(saved: StateTree, names: Iterable[str]) -> Iterator[tuple[Any, ...]]:
    """Rows of the columns of these names, with numbers of Python."""
    columns = (np.asarray(saved[name]) for name in names)
    return zip(*(column.tolist() if column.ndim == 1 else list(column) for column in columns), strict=True)


def _get(tree: StateTree, key: str, holder: Any) -> Any:
    if key not in tree:
        raise CheckpointError(f"the checkpoint has no {key!r} of {type(holder).__name__}")
    return tree[key]


class Stateful:
    """Base of classes with a state in checkpoints. See the module's text for how attributes are kept."""

    STATE: ClassVar[tuple[str | Kept | Columns, ...]]
    """Attributes that the class adds to the state of its bases, in the order of the tree."""

    def state_dict(self) -> StateTree:
        """Everything that `STATE` names.

        Arrays may share memory with their owner: write or copy them before it continues to learn.

        Raises:
            TypeError: neither the class nor a base declares a state, or a value has no form in a tree.
        """
        tree: StateTree = {}
        for kept in list_kept(type(self)):
            kept.write(self, tree)
        return tree

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the state of `state_dict`, to the last bit.

        Raises:
            CheckpointError: the tree lacks something, or does not fit.
        """
        for kept in list_kept(type(self)):
            kept.read(self, state)
        self.after_load()

    def after_load(self) -> None:
        """Compute what follows from the state and is not kept."""


def list_kept(kind: type[Stateful]) -> Iterator[Kept | Columns]:
    """State that a class declares: the declarations of its bases in the order of construction, then its own.

    Raises:
        TypeError: none of them declares a state.
    """
    declared = [owner.__dict__["STATE"] for owner in reversed(kind.__mro__) if "STATE" in owner.__dict__]
    if not declared:
        raise TypeError(f"{kind.__name__} declares no state: give it STATE = ('name of an attribute', ...), or () "
                        "where nothing is to be kept; or write state_dict and load_state_dict")
    for kept in (kept for names in declared for kept in names):
        yield Kept(kept) if isinstance(kept, str) else kept


def read_value(value: Any, where: str) -> Any:
    """Form of an attribute's value in a tree; `where` names it in messages.

    Raises:
        TypeError: it has none.
    """
    if _is_part(value):
        return value.state_dict()
    if isinstance(value, np.random.Generator):
        return value.bit_generator.state
    if _is_torch(value, "Generator"):
        return value.get_state().numpy()
    if _is_torch(value, "Tensor"):
        return value.detach().cpu().numpy()
    if _is_named_tuple(value):
        return {name: read_value(each, f"{where}.{name}") for name, each in value._asdict().items()}
    if isinstance(value, dict) and all(map(_is_kept_in_place, value.values())):
        return {name: read_value(part, f"{where}[{name!r}]") for name, part in value.items()}
    if isinstance(value, list) and all(map(_is_part, value)):
        return [part.state_dict() for part in value]
    if isinstance(value, (list, dict)):
        return value.copy()
    if value is None or isinstance(value, (bool, int, float, str, np.generic, np.ndarray, tuple)):
        return value
    raise TypeError(f"{where} is a {type(value).__name__}, which has no form in a checkpoint: keep it with "
                    "Kept(..., pack=..., unpack=...)")


def restore_value(value: Any, saved: Any, where: str) -> Any:
    """Return the value of a form in a tree; parts, generators and tensors are changed in place.

    Raises:
        CheckpointError: the form does not fit.
    """
    if value is None:
        return None if isinstance(saved, Mapping) else saved
    if _is_part(value):
        if saved is not None:
            value.load_state_dict(saved)
        return value
    if isinstance(value, np.random.Generator):
        value.bit_generator.state = saved
        return value
    if _is_torch(value, "Generator"):
        value.set_state(sys.modules["torch"].from_numpy(np.asarray(saved)))
        return value
    if _is_torch(value, "Tensor"):
        if np.shape(saved) != tuple(value.shape):
            raise CheckpointError(f"the checkpoint has {where} of shape {np.shape(saved)}; here it is "
                                  f"{tuple(value.shape)}")
        return value.copy_(sys.modules["torch"].from_numpy(np.asarray(saved)))
    if saved is None:
        return None
    if _is_named_tuple(value):
        return type(value)(**{name: restore_value(each, saved[name], f"{name} in {where}")
                              for name, each in value._asdict().items()})
    if isinstance(value, dict) and value and all(map(_is_kept_in_place, value.values())):
        for name, part in value.items():
            restore_value(part, saved[name], f"{name} in {where}")
        return value
    if isinstance(value, list) and value and all(map(_is_part, value)):
        for part, each in zip(value, saved, strict=True):
            part.load_state_dict(each)
        return value
    if isinstance(value, np.ndarray):
        return np.array(saved, value.dtype)
    return type(value)(saved) if isinstance(value, (bool, int, float, tuple)) else deepcopy(saved)


def _is_part(value: Any) -> bool:
    return hasattr(value, "state_dict") and hasattr(value, "load_state_dict")


def _is_kept_in_place(value: Any) -> bool:
    return _is_part(value) or _is_torch(value, "Tensor")


def _is_named_tuple(value: Any) -> TypeGuard[Any]:
    return isinstance(value, tuple) and hasattr(value, "_fields")


def _is_torch(value: Any, kind: str) -> bool:
    """True for a tensor or a generator of torch, which is not imported for the question."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, getattr(torch, kind))
