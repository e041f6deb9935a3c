"""What happens inside one decision: an option runs, primitives are stepped, and all of it is noted.

`OptionsEnv` makes an SMDP transition of these notes. Nothing here knows actions' numbers,
masks or discounts.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium
import numpy as np

from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import OptionError
from hrl_escape.options.option import Option, OptionReport

__all__ = ["Decision", "Outcome", "Run"]

DEEPEST_NESTING = 8


class Run:
    """One option from its start on: the stack of nested options and how long it has run."""

    def __init__(self, index: int, option: Option, state: RoomState) -> None:
        self.index = index
        self.option = option
        self.duration = 0
        self._stack = [option]
        self._finished = OptionReport()
        option.start(state)

    def choose(self, state: RoomState) -> int:
        """The next primitive, entering nested options as the policies say."""
        while True:
            decision = self._stack[-1].policy(state)
            if not isinstance(decision, Option):
                return int(decision)
            if len(self._stack) == DEEPEST_NESTING:
                raise OptionError(f"option {self.option.name!r} nests deeper than {DEEPEST_NESTING} options")
            self._stack.append(decision)
            decision.start(state)

    def ends_at(self, state: RoomState, rng: np.random.Generator) -> bool:
        """Ask the innermost option's termination at the state reached, then that of who called it."""
        while True:
            beta = self._stack[-1].termination(state)
            if beta <= 0.0 or (beta < 1.0 and rng.random() >= beta):
                return False
            if len(self._stack) == 1:
                return True
            self._finished.add(self._stack.pop().report)

    def make_report(self) -> OptionReport:
        """Sum of what the option and those nested in it tell."""
        total = OptionReport()
        total.add(self._finished)
        for option in self._stack:
            total.add(option.report)
        return total


class Decision:
    """One decision while it runs: steps the wrapped environment and notes what happens."""

    def __init__(self, env: gymnasium.Env, room: Any, observation: Any) -> None:
        self._env, self._room = env, room
        self.state: RoomState = room.get_state()
        self.observation = observation
        self.rewards: list[float] = []
        self.pressed: list[int] = []
        self.notes: list[tuple[int, RoomState, RoomState, Any]] = []
        self.terminated = self.truncated = False
        self.info: dict[str, Any] = {}

    @property
    def is_over(self) -> bool:
        """The episode has ended."""
        return self.terminated or self.truncated

    def do(self, primitive: int) -> None:
        """Step the wrapped environment once."""
        before = self.state
        self.observation, reward, self.terminated, self.truncated, self.info = self._env.step(primitive)
        self.rewards.append(float(reward))
        self.state = self._room.get_state()
        begun = self.state.touching & ~before.touching
        if begun:
            self.pressed.extend(i for i in range(begun.bit_length()) if begun >> i & 1)
        self.notes.append((primitive, before, self.state, self.observation))


@dataclasses.dataclass
class Outcome:
    """How a decision ended, and why planning failed if it did."""

    ended: str
    reason: str = ""
    report: OptionReport = dataclasses.field(default_factory=OptionReport)
