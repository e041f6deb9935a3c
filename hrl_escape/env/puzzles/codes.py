"""Base of puzzles in which targets are pressed in the order of a code: the state is how much of it has been entered."""

from __future__ import annotations

from typing import Any

from hrl_escape.env.puzzles.base import Puzzle


class CodePuzzle(Puzzle):
    """Base of puzzles with a code; a subclass adds names, rules, and the field `code`."""

    code: tuple[int, ...]
    """Numbers of the targets in order."""

    def make_state(self) -> int:
        """State 0: nothing of the code has been entered."""
        return 0

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a number of presses of the code."""
        return type(state) is int and 0 <= state <= len(self.code)

    def is_solved(self, state: int) -> bool:
        """Return whether the whole code has been entered."""
        return state == len(self.code)

    def compute_progress(self, state: int) -> float:
        """Share in [0, 1] of the code that has been entered."""
        return state / len(self.code)
