"""Puzzles whose targets must be touched in the order of a code: a combination lock, Pin Pad and Key-Chest.

The state is the number of entered elements of the code.

**Combination lock**: press the panels in the order of a hidden code. With `memory="reset"` a wrong press loses all
progress. With `"slide"` only the latest presses count: the state is the longest prefix of the code that the
presses end with.

**Pin Pad** (Director, Hafner et al. 2022): walk over the pads on the floor in the order of a hidden code. The exit
opens once the latest distinct pads, one after another, are the code; stepping on the same pad again counts once.

**Key-Chest** (Zhang et al. 2020, HRAC): walk over the key, which has reward 1, then to the chest, which opens the exit.
Without the key the chest has no effect.
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
    """Base class of puzzles with a code. A subclass adds names, rules, and the field `code`."""

    code: tuple[int, ...]
    """Indices of the targets in the order of the code."""

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a possible number of entered elements."""
        return type(state) is int and 0 <= state <= len(self.code)

    def is_solved(self, state: int) -> bool:
        """Return whether the whole code was entered."""
        return state == len(self.code)

    def compute_progress(self, state: int) -> float:
        """Return the fraction, in [0, 1], of the code that was entered."""
        return state / len(self.code)

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each target is lit: the entered part of the code."""
        entered = self.code[:state]
        return tuple(target in entered for target in range(len(self.target_names)))


@dataclasses.dataclass(frozen=True)
class CodeLockConfig(PuzzleConfig):
    """Configuration of the lock; the instance seed draws the code."""

    kind = "code-lock"
    _takes_ranges = True
    digits: Annotated[int, Range(2, 16)] = 4
    """Number of panels, one per digit. More digits make the code harder to find."""
    length: Annotated[int, Range(1, 32)] = 4
    """Number of presses in the code. No digit occurs twice in a row."""
    memory: LockMemory = "reset"
    """`reset`: a wrong press loses all progress. `slide`: only the latest presses count."""
    shown: bool = True
    """If true, observations show how much of the code was entered."""
    buttons: Panels = Panels(width=1.5)
    """Sizes and places of the digits' panels."""

    def make_puzzle(self, rng: np.random.Generator) -> CodeLockPuzzle:
        """Sample the code uniformly."""
        code = [int(rng.integers(self.digits))]
        while len(code) < self.length:
            code.append((code[-1] + 1 + int(rng.integers(self.digits - 1))) % self.digits)
        return CodeLockPuzzle(self.digits, tuple(code), self.memory, self.shown)


@dataclasses.dataclass(frozen=True)
class CodeLockPuzzle(Modelled, CodePuzzle):
    """A concrete lock. The name of digit i is `digit-<i+1>`."""

    kind = "code-lock"
    about = "A hidden code, pressed digit by digit, opens the exit."
    digits: Annotated[int, Range(2, 16)] = 2
    """Number of panels, one per digit."""
    code: tuple[Annotated[int, Range(0, 15)], ...] = (0,)
    """Indices of the panels to press, in order."""
    memory: LockMemory = "reset"
    """`reset`: a wrong press loses all progress. `slide`: only the latest presses count."""
    shown: bool = True
    """If true, observations show how much of the code was entered."""

    def check(self) -> None:
        """Check that the code is possible."""
        if not 1 <= len(self.code) <= 32 or max(self.code) >= self.digits:
            raise ConfigError("puzzle.code", self.code, f"1 to 32 digits below puzzle.digits = {self.digits}")
        if any(one == other for one, other in zip(self.code, self.code[1:], strict=False)):
            raise ConfigError("puzzle.code", self.code, "no digit twice in a row")

    def _advance(self, progress: int, digit: int) -> int:
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
        """Enter presses in index order; an open lock stays open."""
        for digit in contacts.pressed:
            if state < len(self.code):
                state = self._advance(state, digit)
        return state

    def observe(self, state: int) -> tuple[float, ...]:
        """Return one number per digit of the code: 1 once it is entered, or all 0 if progress is hidden."""
        seen = state if self.shown or self.is_solved(state) else 0
        return tuple(float(i < seen) for i in range(len(self.code)))

    def describe(self, state: int) -> tuple[str, ...]:
        """Return a sentence with the number of entered digits that observations show."""
        return (f"{int(sum(self.observe(state)))} of {len(self.code)} digits of the code are entered.",)

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each panel is lit: the latest one entered, if progress is shown; all once the lock is open."""
        if self.is_solved(state):
            return (True,) * self.digits
        last = self.code[state - 1] if self.shown and state else None
        return tuple(digit == last for digit in range(self.digits))

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `entered(i)` for the first i digits of the code."""
        return frozenset(f"entered({i + 1})" for i in range(state))

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: one operator per digit of the code."""
        facts = [f"entered({i + 1})" for i in range(len(self.code))]
        operators = (Operator(f"enter-{i + 1}", self.target_names[digit], "press", frozenset(facts[:i]),
                              frozenset(facts[i:]), frozenset({facts[i]}))
                     for i, digit in enumerate(self.code))
        return SymbolicModel(tuple(facts), tuple(operators), frozenset(facts))


@dataclasses.dataclass(frozen=True)
class PinPadConfig(PuzzleConfig):
    """Configuration of Pin Pad; the instance seed draws the order of the pads."""

    kind = "pin-pad"
    count: Annotated[int, Range(1, 8)] = 4
    """Number of pads, all of them in the code."""
    floor: Pads = Pads()
    """Size and places of the pads."""

    def make_puzzle(self, rng: np.random.Generator) -> PinPadPuzzle:
        """Sample the order of the pads."""
        return PinPadPuzzle(tuple(rng.permutation(self.count).tolist()))


@dataclasses.dataclass(frozen=True)
class PinPadPuzzle(CodePuzzle):
    """A concrete order of pads. The name of pad i is `pad-<i+1>`."""

    kind = "pin-pad"
    are_pads = True
    code: tuple[Annotated[int, Range(0, 7)], ...] = (0, 1)
    """Indices of the pads in order, each once."""

    def check(self) -> None:
        """Check that every pad occurs once."""
        if not self.code or sorted(self.code) != list(range(len(self.code))):
            raise ConfigError("puzzle.code", self.code, "an order of 1 to 8 pads")

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the pads, `pad-1` to `pad-<count>`."""
        return tuple(f"pad-{i + 1}" for i in range(len(self.code)))

    def update(self, state: int, contacts: Contacts) -> int:
        """Enter the pads stepped on, in index order; an open exit stays open."""
        for pad in contacts.pressed:
            if state < len(self.code) and not (state and pad == self.code[state - 1]):
                state = state + 1 if pad == self.code[state] else int(pad == self.code[0])
        return state


@dataclasses.dataclass(frozen=True)
class KeyChestConfig(PuzzleConfig):
    """Configuration of Key-Chest, whose key and chest are pads."""

    kind = "key-chest"
    floor: Pads = Pads()
    """Size and places of key and chest."""


@dataclasses.dataclass(frozen=True)
class KeyChestPuzzle(CodePuzzle):
    """Concrete rules. The pads are named `key` and `chest`."""

    kind = "key-chest"
    fixed_names = ("key", "chest")
    are_pads = True
    code = (0, 1)

    def update(self, state: int, contacts: Contacts) -> int:
        """Take the key on its pad, or open the chest with it."""
        for pad in contacts.pressed:
            state += pad == state
        return state

    def compute_reward(self, before: int, after: int, contacts: Contacts) -> float:
        """Return 1 for taking the key, otherwise 0."""
        return float(before == 0 < after)


register_puzzle(CodeLockConfig, CodeLockPuzzle)
register_puzzle(PinPadConfig, PinPadPuzzle)
register_puzzle(KeyChestConfig, KeyChestPuzzle)
