"""State declared once, by the names of attributes: from the declaration follow `state_dict` and `load_state_dict`.

    class Learner(Stateful):
        STATE = ("table", "_steps", "_rng")

saves {"table": ..., "steps": ..., "rng": ...}: a subclass's declaration adds to those of its bases, whose keys come
first. What an attribute is decides how it is kept:

| attribute | in the tree | loading |
|---|---|---|
| a part with `state_dict` and `load_state_dict` | its own tree | into the part that is there |
| a dict whose values are all parts | a tree a name | into the parts that are there, name by name |
| numpy or torch generator | its state | set on the generator that is there |
| torch tensor | array | copied into the tensor that is there, on its device; the shape must be the same |
| numpy array | array | a copy, of the dtype that is there |
| NamedTuple | dict of its fields | read as above, field by field |
| number, truth value, text, tuple, None | as it is | of the type that is there |
| list, dict of what a tree holds | as it is | a copy |
| anything else | as `Kept.pack` makes it | as `Kept.unpack` makes it |

Where the attribute is None and the tree holds a part's state, or the other way round, nothing is loaded: whoever made
the tree had a part that is not here. `Kept` gives an attribute another key, a form of its own, or leaves its key out
while it is None. A class whose form follows from more than one attribute gives a property with a setter, or writes the
two methods itself. What follows from the state (an index, a plan) is computed in `after_load`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, ClassVar, TypeGuard

import numpy as np

from hrl_escape.errors import CheckpointError

__all__ = ["Kept", "StateTree", "Stateful", "read_value", "restore_value"]

StateTree = dict[str, Any]
"""Content of a checkpoint: a tree of dicts and lists over numbers, strings, None and numpy arrays."""


@dataclass(frozen=True)
class Kept:
    """An attribute of the state whose key or form is not the one that follows from its name and type.

    Attributes:
        attribute: its name, or a path through parts such as `noise.state`.
        key: in the tree; by default the attribute's name without underscores before it.
        pack: from a value that is not None to its form in the tree.
        unpack: from that form to the value; None takes it as `restore_value` does.
        is_left_out: the tree has no such key while the attribute is None.
    """

    attribute: str
    key: str = ""
    pack: Callable[[Any], Any] | None = None
    unpack: Callable[[Any], Any] | None = None
    is_left_out: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "key", self.key or self.attribute.lstrip("_"))


class Stateful:
    """Base of whatever a checkpoint holds. See the module's text for how attributes are kept."""

    STATE: ClassVar[tuple[str | Kept, ...]]
    """Attributes that the class adds to the state of its bases, in the order of the tree."""

    def state_dict(self) -> StateTree:
        """Everything that `STATE` names.

        Arrays may share memory with their owner: write or copy them before it goes on learning.

        Raises:
            TypeError: neither the class nor a base declares a state, or a value has no form in a tree.
        """
        tree = {}
        for kept in list_kept(type(self)):
            value = attrgetter(kept.attribute)(self) if _find_owner(self, kept) is not None else None
            if value is not None or not kept.is_left_out:
                tree[kept.key] = kept.pack(value) if kept.pack and value is not None else read_value(
                    value, f"{type(self).__name__}.{kept.attribute}")
        return tree

    def load_state_dict(self, state: StateTree) -> None:
        """Go on exactly where `state_dict` was taken, to the last bit.

        Raises:
            CheckpointError: the tree lacks something, or does not fit.
        """
        for kept in list_kept(type(self)):
            if kept.key not in state:
                if kept.is_left_out:
                    continue
                raise CheckpointError(f"the checkpoint has no {kept.key!r} of {type(self).__name__}")
            owner, name = _find_owner(self, kept), kept.attribute.rpartition(".")[2]
            if owner is None:
                continue
            saved, before = state[kept.key], getattr(owner, name)
            if kept.unpack is not None:
                value = None if saved is None else kept.unpack(saved)
            else:
                value = restore_value(before, saved, f"{kept.key} of {type(self).__name__}")
            if value is not before:
                setattr(owner, name, value)
        self.after_load()

    def after_load(self) -> None:
        """Compute what follows from the state and is not kept."""


def list_kept(kind: type[Stateful]) -> Iterator[Kept]:
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


def _find_owner(holder: Any, kept: Kept) -> Any:
    """Object that has the attribute itself, at the end of its path; None where the path ends early."""
    for name in kept.attribute.split(".")[:-1]:
        holder = None if holder is None else getattr(holder, name)
    return holder


def read_value(value: Any, where: str) -> Any:
    """Form of a value in a tree.

    Args:
        value: of an attribute.
        where: in words, for the message.

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
    if isinstance(value, dict) and all(map(_is_part, value.values())):
        return {name: part.state_dict() for name, part in value.items()}
    if isinstance(value, (list, dict)):
        return value.copy()
    if value is None or isinstance(value, (bool, int, float, str, np.generic, np.ndarray, tuple)):
        return value
    raise TypeError(f"{where} is a {type(value).__name__}, which has no form in a checkpoint: keep it with "
                    "Kept(..., pack=..., unpack=...)")


def restore_value(value: Any, saved: Any, where: str) -> Any:
    """The value that a form in a tree stands for; parts, generators and tensors are changed in place.

    Args:
        value: that is there.
        saved: the form.
        where: in words, for messages.

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
    if isinstance(value, dict) and value and all(map(_is_part, value.values())):
        for name, part in value.items():
            part.load_state_dict(saved[name])
        return value
    if isinstance(value, np.ndarray):
        return np.array(saved, value.dtype)
    return type(value)(saved) if isinstance(value, (bool, int, float, tuple)) else deepcopy(saved)


def _is_part(value: Any) -> bool:
    return hasattr(value, "state_dict") and hasattr(value, "load_state_dict")


def _is_named_tuple(value: Any) -> TypeGuard[Any]:
    return isinstance(value, tuple) and hasattr(value, "_fields")


def _is_torch(value: Any, kind: str) -> bool:
    """True for a tensor or a generator of torch, which is not imported for the question."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, getattr(torch, kind))
