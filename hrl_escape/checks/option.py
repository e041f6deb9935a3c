"""The contract of options: initiation, policy and termination in a room, nested options included."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from hrl_escape.checks.claims import Claims
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import PlanningFailed
from hrl_escape.options.option import Option

__all__ = ["check_option"]


def check_option(option: Option, env: gymnasium.Env, runs: int = 10, seed: int = 0,
                 states: Sequence[RoomState] = ()) -> None:
    """Check an option by running it in a room from where random play has led.

    Args:
        option: any option.
        env: a flat environment of a room that it suits.
        runs: how many places random play leads to.
        seed: of the random play.
        states: more places to start from, for an option that starts where random play hardly leads.

    Raises:
        ContractError: the first claim that does not hold.
    """
    _OptionCheck(option, env, np.random.default_rng(seed)).run(runs, seed, states)


class _OptionCheck(Claims):
    """The claims about one option, and the runs they are tried in."""

    DEEPEST = 8

    def __init__(self, option: Option, env: gymnasium.Env, rng: np.random.Generator) -> None:
        super().__init__(f"option {option.name!r}")
        self.option, self.env, self.rng = option, env, rng
        self.room: Any = env.unwrapped
        self.primitives = len(self.room.rules.actions)

    def run(self, runs: int, seed: int, states: Sequence[RoomState]) -> None:
        option = self.option
        self.require(isinstance(option.name, str) and bool(option.name), "the name is text", option.name)
        self.require(option.instance is None or option.instance.id == self.room.instance.id,
                     "it was made for this room, or for any", option.instance and option.instance.id)
        started = sum(self.try_from(state) for state in states)
        for number in range(runs):
            self.env.reset(seed=seed + number)
            if self.wander(10 * number):
                started += self.try_from(self.room.get_state())
        self.require(started > 0, f"it starts somewhere in {runs} places that random play led to, or in given states",
                     started)

    def wander(self, steps: int) -> bool:
        """Play at random; false if the episode ended."""
        for _ in range(steps):
            *_, terminated, truncated, _ = self.env.step(int(self.rng.integers(self.primitives)))
            if terminated or truncated:
                return False
        return True

    def try_from(self, state: RoomState) -> bool:
        """Run it twice from one state; false if it may not start there, or could not be planned."""
        allowed = self.option.initiation(state)
        self.require(isinstance(allowed, bool), "initiation gives a bool", allowed)
        self.require(self.option.initiation(state) == allowed, "initiation gives the same answer each time", state)
        if not allowed:
            return False
        try:
            first, again = self.roll_out(state), self.roll_out(state)
        except PlanningFailed as failure:
            self.require(bool(str(failure)), "a failed plan says why", failure)
            return False
        self.require(first == again, "the same state and the same draws give the same run", (first, again))
        if self.option.is_markov:
            for at, primitive in first:
                self.require(self.option.policy(at) == primitive, "is_markov: the policy is a function of the state",
                             at)
        return True

    def roll_out(self, state: RoomState) -> list[tuple[RoomState, int]]:
        """One run to its end: (state, primitive) of each step."""
        option, rng = self.option, np.random.default_rng(0)
        self.env.reset(seed=0)
        self.room.set_state(state)
        option.start(state)
        stack, steps = [option], []
        touched, ended = 0, False
        while not ended:
            self.require(len(steps) <= self.room.instance.horizon, "it ends with the episode at the latest", len(steps))
            primitive = self.ask(stack, state)
            *_, terminated, truncated, _ = self.env.step(primitive)
            steps.append((state, primitive))
            before, state = state, self.room.get_state()
            touched |= state.touching & ~before.touching
            ended = self.ends(stack, state, rng) or terminated or truncated
        report = option.report
        self.require(0 <= report.cache_hits <= report.planner_calls and report.planner_seconds >= 0.0,
                     "the report's counts make sense", report)
        dynamics = self.room.instance.dynamics
        if option.targets is not None and dynamics.kind == "kinematic" and not dynamics.noise:
            told = {*report.unavoidable, *(self.room.instance.targets[i].name for i in option.targets)}
            names = [target.name for i, target in enumerate(self.room.instance.targets) if touched >> i & 1]
            others = [name for name in names if name not in told]
            self.require(not others, "it presses no target but its own and those it reports as unavoidable", others)
        return steps

    def ask(self, stack: list[Option], state: RoomState) -> int:
        """The next primitive, through nested options."""
        while True:
            decision = stack[-1].policy(state)
            if not isinstance(decision, Option):
                self.require(not isinstance(decision, bool) and decision in range(self.primitives),
                             f"the policy gives a primitive from 0 to {self.primitives - 1}, or an option", decision)
                return int(decision)
            self.require(len(stack) < self.DEEPEST, f"options nest at most {self.DEEPEST} deep", stack)
            self.require(bool(decision.initiation(state)), "a nested option is entered where it may start", decision)
            decision.start(state)
            stack.append(decision)

    def ends(self, stack: list[Option], state: RoomState, rng: np.random.Generator) -> bool:
        """Ask terminations at the state reached, from the innermost out."""
        while stack:
            beta = stack[-1].termination(state)
            self.require(isinstance(beta, float) and 0.0 <= beta <= 1.0, "termination gives a probability", beta)
            self.require(stack[-1].termination(state) == beta, "termination gives the same answer each time", state)
            if rng.random() >= beta:
                return False
            stack.pop()
        return True
