"""Macro-actions: policies that run to their end, offered to a learner beside the primitives.

McGovern, Sutton and Fagg (1997). "Run to the wall" is a macro; so is any course of primitives that
depends on what is seen. A macro is a task without a learner, so the stack runs it as any other call.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.task import BaseTask, Call, Frame, Hierarchy, Seen, Stack, allow_only

__all__ = ["Macro", "MacroChooser", "make_macro_hierarchy"]


class Macro(BaseTask):
    """One macro-action.

    Args:
        name: unique among the macros.
        primitives: of the environment.
        policy: moment -> primitive.
        until: moment reached -> whether the macro is over there; asked after each of its primitives, not before the
            first, so that every macro lasts at least one.
        start: moment -> whether it may begin there; anywhere by default.
    """

    def __init__(
        self,
        name: str,
        primitives: int,
        policy: Callable[[Seen], int],
        until: Callable[[Seen], bool],
        start: Callable[[Seen], bool] | None = None,
    ) -> None:
        super().__init__(name, primitives)
        self._policy, self._until, self._start = policy, until, start

    def is_callable(self, seen: Seen, context: Any) -> bool:
        """The macro may begin here, and its first primitive is legal."""
        return bool(seen.mask[self._policy(seen)]) and (self._start is None or self._start(seen))

    def view(self, seen: Seen, stack: Stack) -> Any:
        """Nothing: the policy reads the moment."""
        return None

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """The policy's primitive; none where that is illegal, which ends the macro."""
        return allow_only(self._policy(seen), seen.mask)

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Certain where `until` says so, after the first primitive."""
        return float(frame.primitives > 0 and self._until(seen))


class MacroChooser(BaseTask):
    """The root: chooses among the primitives, numbered first, and the macros."""

    def __init__(self, primitives: int, macros: Sequence[Macro]) -> None:
        super().__init__("root", primitives + len(macros))
        self._primitives, self.macros = primitives, tuple(macros)

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Legal primitives, and macros that may begin."""
        callable_now = [macro.is_callable(seen, context) for macro in self.macros]
        return np.concatenate([seen.mask, np.array(callable_now, np.bool_)])

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        """The primitive or the macro of this number."""
        return Call(choice if choice < self._primitives else self.macros[choice - self._primitives])


def make_macro_hierarchy(primitives: int, macros: Sequence[Macro]) -> Hierarchy:
    """A chooser over primitives and macros."""
    return Hierarchy(
        MacroChooser(primitives, macros), tuple(macros), privileges=("macro-actions",) if macros else ()
    )
