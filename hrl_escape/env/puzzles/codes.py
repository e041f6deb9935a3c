"""Puzzles in which targets are touched in the order of a code: a combination lock, Pin Pad and Key-Chest.

The state is how much of the code has been entered.

**A combination lock**: press the panels in the order of a hidden code. With `memory="reset"` a wrong press loses all
progress. With `"slide"` the last presses count whatever came before them: the state is the longest beginning of the
code with which the presses end.

**Pin Pad** (Director, Hafner et al. 2022): walk over the pads on the floor in the order of a hidden code. The exit
opens once the last pads stepped on, one after another, are the code; stepping on the same pad again counts once. One
pad is a place to go to.

**Key-Chest** (Zhang et al. 2020, HRAC): walk over the key, which earns 1, then to the chest, which opens the exit.
Without the key the chest is inert.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Literal

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Pads, Panels, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

LockMemory = Literal["reset", "slide"]


class CodePuzzle(Puzzle):
    """Base of puzzles with a code; a subclass adds names, rules, and the field `code`."""

    code: tuple[int, ...]
    """Numbers of the targets in order."""

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a number of presses of the code."""
        return type(state) is int and 0 <= state <= len(self.code)

    def is_solved(self, state: int) -> bool:
        """Return whether the whole code has been entered."""
        return state == len(self.code)

    def compute_progress(self, state: int) -> float:
        """Share in [0, 1] of the code that has been entered."""
        return state / len(self.code)

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Lit targets: those in the part of the code entered so far."""
        entered = self.code[:state]
        return tuple(target in entered for target in range(len(self.target_names)))


@dataclasses.dataclass(frozen=True)
class CodeLockConfig(PuzzleConfig):
    """Room configuration of the lock; the instance seed draws the code."""

    kind = "code-lock"
    _takes_ranges = True
    digits: Annotated[int, Range(2, 16)] = 4
    """Number of panels, one for each digit that can be entered."""
    length: Annotated[int, Range(1, 32)] = 4
    """Number of presses in the code; no digit comes twice in a row."""
    memory: LockMemory = "reset"
    """A wrong press loses all progress, or only the last presses count."""
    shown: bool = True
    """Observations show how much of the code has been entered."""
    buttons: Panels = Panels(width=1.5)
    """Sizes and places of the digits' panels."""

    def make_puzzle(self, rng: np.random.Generator) -> CodeLockPuzzle:
        """Draw the code, uniformly among all codes."""
        code = [int(rng.integers(self.digits))]
        while len(code) < self.length:
            code.append((code[-1] + 1 + int(rng.integers(self.digits - 1))) % self.digits)
        return CodeLockPuzzle(self.digits, tuple(code), self.memory, self.shown)


@dataclasses.dataclass(frozen=True)
class CodeLockPuzzle(Modelled, CodePuzzle):
    """A concrete lock. Digit i is called `digit-<i+1>`."""

    kind = "code-lock"
    about = "A hidden code, pressed digit by digit, opens the exit."
    digits: Annotated[int, Range(2, 16)] = 2
    """Number of panels, one for each digit that can be entered."""
    code: tuple[Annotated[int, Range(0, 15)], ...] = (0,)
    """Numbers of the panels to press, in order."""
    memory: LockMemory = "reset"
    """A wrong press loses all progress, or only the last presses count."""
    shown: bool = True
    """Observations show how much of the code has been entered."""

    def check(self) -> None:
        """Check that the code can be entered."""
        if not 1 <= len(self.code) <= 32 or max(self.code) >= self.digits:
            raise ConfigError("puzzle.code", self.code, f"1 to 32 digits below puzzle.digits = {self.digits}")
        if any(one == other for one, other in zip(self.code, self.code[1:], strict=False)):
            raise ConfigError("puzzle.code", self.code, "no digit twice in a row")

    def _advance(self, progress: int, digit: int) -> int:
        """Progress after the press of a digit."""
        if self.code[progress] == digit:
            return progress + 1
        if self.memory == "reset":
            return 0
        ending = (*self.code[:progress], digit)
        return max(n for n in range(progress + 1) if self.code[:n] == ending[len(ending) - n:])

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the panels, `digit-1` to `digit-<digits>`."""
        return tuple(f"digit-{i + 1}" for i in range(self.digits))

    def update(self, state: int, contacts: Contacts) -> int:
        """Enter each press in index order; an open lock stays open."""
        for digit in contacts.pressed:
            if state < len(self.code):
                state = self._advance(state, digit)
        return state

    def observe(self, state: int) -> tuple[float, ...]:
        """One number a digit of the code: 1 once it is entered; all 0 while that is hidden."""
        seen = state if self.shown or self.is_solved(state) else 0
        return tuple(float(i < seen) for i in range(len(self.code)))

    def describe(self, state: int) -> tuple[str, ...]:
        """Number of the code's digits that are entered, as observations show it."""
        return (f"{int(sum(self.observe(state)))} of {len(self.code)} digits of the code are entered.",)

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Lit panels: the last one entered, if progress is shown; all once the lock is open."""
        if self.is_solved(state):
            return (True,) * self.digits
        last = self.code[state - 1] if self.shown and state else None
        return tuple(digit == last for digit in range(self.digits))

    def get_facts(self, state: int) -> frozenset[str]:
        """`entered(i)` for the first i digits of the code."""
        return frozenset(f"entered({i + 1})" for i in range(state))

    def make_symbolic_model(self) -> SymbolicModel:
        """One operator a digit of the code: enter it next."""
        facts = [f"entered({i + 1})" for i in range(len(self.code))]
        operators = (Operator(f"enter-{i + 1}", self.target_names[digit], "press", frozenset(facts[:i]),
                              frozenset(facts[i:]), frozenset({facts[i]}))
                     for i, digit in enumerate(self.code))
        return SymbolicModel(tuple(facts), tuple(operators), frozenset(facts))


@dataclasses.dataclass(frozen=True)
class PinPadConfig(PuzzleConfig):
    """Room configuration of Pin Pad; the instance seed draws the order of the pads."""

    kind = "pin-pad"
    count: Annotated[int, Range(1, 8)] = 4
    """Number of pads, all of them in the code."""
    floor: Pads = Pads()
    """Size and places of the pads."""

    def make_puzzle(self, rng: np.random.Generator) -> PinPadPuzzle:
        """Draw the order of the pads."""
        return PinPadPuzzle(tuple(rng.permutation(self.count).tolist()))


@dataclasses.dataclass(frozen=True)
class PinPadPuzzle(CodePuzzle):
    """A concrete walk. Pad i is called `pad-<i+1>`."""

    kind = "pin-pad"
    are_pads = True
    code: tuple[Annotated[int, Range(0, 7)], ...] = (0, 1)
    """Numbers of the pads in order, each of them once."""

    def check(self) -> None:
        """Check that every pad comes once."""
        if not self.code or sorted(self.code) != list(range(len(self.code))):
            raise ConfigError("puzzle.code", self.code, "an order of 1 to 8 pads")

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the pads, `pad-1` to `pad-<count>`."""
        return tuple(f"pad-{i + 1}" for i in range(len(self.code)))

    def update(self, state: int, contacts: Contacts) -> int:
        """Enter each pad stepped on, in index order; an open exit stays open."""
        for pad in contacts.pressed:
            if state < len(self.code) and not (state and pad == self.code[state - 1]):
                state = state + 1 if pad == self.code[state] else int(pad == self.code[0])
        return state


@dataclasses.dataclass(frozen=True)
class KeyChestConfig(PuzzleConfig):
    """Room configuration of Key-Chest, whose key and chest are pads."""

    kind = "key-chest"
    floor: Pads = Pads()
    """Size and places of key and chest."""


@dataclasses.dataclass(frozen=True)
class KeyChestPuzzle(CodePuzzle):
    """Concrete rules; the pads are called `key` and `chest`."""

    kind = "key-chest"
    fixed_names = ("key", "chest")
    are_pads = True
    code = (0, 1)

    def update(self, state: int, contacts: Contacts) -> int:
        """Take the key on its pad; open the chest with it."""
        for pad in contacts.pressed:
            state += pad == state
        return state

    def compute_reward(self, before: int, after: int, contacts: Contacts) -> float:
        """Reward of 1 for taking the key."""
        return float(before == 0 < after)


register_puzzle(CodeLockConfig, CodeLockPuzzle)
register_puzzle(PinPadConfig, PinPadPuzzle)
register_puzzle(KeyChestConfig, KeyChestPuzzle)
