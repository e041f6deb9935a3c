"""One decision from the inside: an option runs, primitives are stepped, and everything is recorded.

`OptionsEnv` turns these records into an SMDP transition. Nothing here knows action numbers,
masks or discounts.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import OptionError
from hrl_escape.options.option import Option
from hrl_escape.planning.report import PlanningReport

__all__ = ["RunningDecision", "OptionExecution", "DecisionOutcome", "RoomEnv"]

DEEPEST_NESTING = 8


@runtime_checkable
class RoomEnv(Protocol):
    """Environment that options can run in: it shows its room and its full state."""

    @property
    def instance(self) -> RoomInstance:
        """Present room."""
        ...

    def get_state(self) -> RoomState:
        """Full state at present."""
        ...


class OptionExecution:
    """One option from its start on: the stack of nested options and its duration so far."""

    def __init__(self, index: int, option: Option, state: RoomState) -> None:
        self.index = index
        self.option = option
        self.duration = 0
        self._stack = [option]
        self._finished = PlanningReport()
        option.start(state)

    def choose(self, state: RoomState) -> int:
        """Next primitive; lower options are entered as the policies ask."""
        while True:
            action = self._stack[-1].policy(state)
            if not isinstance(action, Option):
                return int(action)
            if len(self._stack) == DEEPEST_NESTING:
                raise OptionError(f"option {self.option.name!r} nests deeper than {DEEPEST_NESTING} options")
            self._stack.append(action)
            action.start(state)

    def ends_at(self, state: RoomState, rng: np.random.Generator) -> bool:
        """Draw the innermost option's termination at the state reached, then its caller's, up to the outermost."""
        while True:
            beta = self._stack[-1].termination(state)
            if beta <= 0.0 or (beta < 1.0 and rng.random() >= beta):
                return False
            if len(self._stack) == 1:
                return True
            self._finished.add(self._stack.pop().report)

    def make_report(self) -> PlanningReport:
        """Planning of the option and of all options nested in it."""
        total = PlanningReport()
        total.add(self._finished)
        for option in self._stack:
            total.add(option.report)
        return total


class RunningDecision:
    """One decision while it runs: steps the wrapped environment and records the result."""

    def __init__(self, env: gymnasium.Env, room: RoomEnv, observation: Any) -> None:
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
class DecisionOutcome:
    """Ending of a decision, and the reason if planning failed."""

    ended: str
    reason: str = ""
    report: PlanningReport = dataclasses.field(default_factory=PlanningReport)
