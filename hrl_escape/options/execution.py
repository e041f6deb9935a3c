"""Execution of one decision: an option runs, primitives are stepped, and rewards and calls are recorded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.errors import OptionError, PlanningFailed, StepContractError
from hrl_escape.options.domain import DomainStep, OptionDomain
from hrl_escape.options.option import Option
from hrl_escape.planning.route import PlanningReport
from hrl_escape.step_info import read_payment

DEEPEST_NESTING = 8


class OptionCall(NamedTuple):
    """One run of an option, nested or not: an SMDP transition of its level."""

    name: str  # of the option
    level: int  # options that were running above it; 0 is the one that was chosen
    state: Any  # state where it began
    next_state: Any  # state where it ended
    rewards: tuple[float, ...]  # one a primitive
    ended: str  # as in `info["option"]`; an option ended by its caller's end has the caller's ending

    @property
    def duration(self) -> int:
        """Number of primitives that the call ran."""
        return len(self.rewards)


class TraceStep(NamedTuple):
    """One step of the wrapped environment inside a decision: a primitive, or a decision of the level below.

    Attributes:
        observation: observation of the wrapped environment before it.
        action: the primitive, as the wrapped environment took it.
        reward: its reward; the sum, if the level below ran several primitives.
        next_observation: observation after it.
        state: what options saw before; the full state of a room.
        next_state: the same after.
        next_action_mask: int8 (actions,), the actions legal after it.
        consistent: (action, beta) of the primitive itself and of every option that would have chosen it
            here, with beta the option's probability of ending after it. Only options whose policy is a
            function of the state are among them (see `Option.is_markov`).
        name: of the primitive; empty where primitives have no numbers.
        rewards: one a primitive of the lowest level.
        trace: trace of the level below, if there is one and it traces.
    """

    observation: Any
    action: Any
    reward: float
    next_observation: Any
    state: Any
    next_state: Any
    next_action_mask: NDArray[np.int8]
    consistent: tuple[tuple[int, float], ...]
    name: str = ""
    rewards: tuple[float, ...] = ()
    trace: tuple[Any, ...] = ()


class _Frame(NamedTuple):
    """A running option with the state and primitive count at its start."""

    option: Option
    state: Any
    begin: int


def read_termination(option: Option, state: Any) -> float:
    """Probability of an option's end in a state. Raises `OptionError` where it gives no probability."""
    given = option.termination(state)
    try:
        beta = float(given)
    except (TypeError, ValueError):
        beta = math.nan
    if not 0.0 <= beta <= 1.0:
        raise OptionError(f"option {option.name!r} ends in state {state!r} with {given!r}: termination must return a "
                          "probability from 0 to 1")
    return beta


def check_choice(option: Option, action: Any, domain: OptionDomain) -> Any:
    """Bring an option's primitive into the form that the environment takes. Raises `OptionError`, with its name."""
    try:
        return domain.check_action(action)
    except OptionError as error:
        raise OptionError(f"option {option.name!r} chose {error}") from None


class OptionExecution:
    """One run of an option: the stack of nested options and the rewards so far, one a primitive.

    Each option on the stack is a run of its own (see `Option.make_run`), so that an option may run several times at
    once.
    """

    def __init__(self, index: int, option: Option, rng: np.random.Generator) -> None:
        self.index = index
        self.option = option
        self.rewards: list[float] = []
        self._ended: list[OptionCall] = []
        self._rng = rng
        self._stack: list[_Frame] = []
        self._finished, self._told = PlanningReport(), PlanningReport()

    def start(self, state: Any) -> None:
        """Begin the run here, unless it has begun. May raise `PlanningFailed`; nothing then runs."""
        if self._stack:
            return
        run = self.option.make_run()
        try:
            run.start(state)
        except PlanningFailed:
            self._finished.add(run.report)
            raise
        self._stack.append(_Frame(run, state, 0))

    def choose(self, state: Any, domain: OptionDomain | None = None) -> Any:
        """Next primitive, in the form of a domain if one is given; lower options are entered as the policies ask.

        Raises `OptionError` if they nest too deep, or the primitive is none of that environment.
        """
        while True:
            option = self._stack[-1].option
            action = option.sample_action(state, self._rng)
            if not isinstance(action, Option):
                return action if domain is None else check_choice(option, action, domain)
            if len(self._stack) == DEEPEST_NESTING:
                raise OptionError(f"option {self.option.name!r} nests deeper than {DEEPEST_NESTING} options")
            run = action.make_run()
            self._stack.append(_Frame(run, state, len(self.rewards)))
            run.start(state)

    def ends_at(self, state: Any) -> bool:
        """Draw the innermost option's termination at the state reached, then its caller's, up to the outermost."""
        while True:
            beta = read_termination(self._stack[-1].option, state)
            if beta <= 0.0 or (beta < 1.0 and self._rng.random() >= beta):
                return False
            if len(self._stack) == 1:
                return True
            self._close(state, "reached")

    def stop(self, state: Any, ended: str) -> None:
        """End every option that still runs."""
        while self._stack:
            self._close(state, ended)

    def collect(self) -> tuple[OptionCall, ...]:
        """Return the runs that ended since the last call, innermost first."""
        ended, self._ended = tuple(self._ended), []
        return ended

    def _close(self, state: Any, ended: str) -> None:
        option, first, begin = self._stack.pop()
        self._finished.add(option.report)
        self._ended.append(OptionCall(option.name, len(self._stack), first, state, tuple(self.rewards[begin:]), ended))

    def take_report(self) -> PlanningReport:
        """Return the planning report of the option and all options nested in it, since the last call."""
        total = PlanningReport()
        total.add(self._finished)
        for frame in self._stack:
            total.add(frame.option.report)
        earlier, self._told = self._told, total
        return total.count_since(earlier)


class RunningDecision:
    """One decision while it runs: steps the wrapped environment and records the result.

    Rewards are one a primitive. `ended` is as in `info["option"]`, with a `reason` where planning failed. `calls` are
    runs of options that ended in it, nested ones included, innermost first.
    """

    def __init__(self, env: gymnasium.Env, domain: OptionDomain, observation: Any) -> None:
        self._env, self._domain = env, domain
        self.state: Any = domain.get_state(observation)
        self.observation = observation
        self.rewards: list[float] = []
        self.steps: list[DomainStep] = []
        self.terminated = self.truncated = False
        self.info: Mapping[str, Any] = {}
        self.ended, self.reason = "reached", ""
        self.report = PlanningReport()
        self.calls: tuple[OptionCall, ...] = ()

    @property
    def is_over(self) -> bool:
        """True once the episode has ended."""
        return self.terminated or self.truncated

    def do(self, action: Any) -> tuple[float, ...]:
        """Step the wrapped environment once; returns the rewards of the primitives that ran."""
        before = self.state
        self.observation, reward, self.terminated, self.truncated, self.info = self._env.step(action)
        rewards = read_rewards(reward, self.info, self._env)
        self.rewards.extend(rewards)
        self.state = self._domain.get_state(self.observation)
        self.steps.append(DomainStep(action, before, self.state, self.observation, rewards, self.info,
                                     self._domain.get_events()))
        return rewards


def read_rewards(reward: Any, info: Mapping[str, Any], env: gymnasium.Env) -> tuple[float, ...]:
    """Rewards of a step of the environment below, one a primitive.

    They are in `info["rewards"]`, else in the attribute `last_rewards` of the environment or a wrapper around it.

    Raises:
        StepContractError: it gives none for its primitives, or `reward` is not their sum.
    """
    paid = read_payment(reward, info, "of a step below OptionsEnv")
    if paid.rewards is not None:
        return paid.rewards
    rewards: tuple[float, ...] = env.get_wrapper_attr("last_rewards") if env.has_wrapper_attr("last_rewards") else ()
    if len(rewards) != paid.duration:
        raise StepContractError(f"a step below OptionsEnv ran {paid.duration} primitives and gives the rewards of "
                                f"{len(rewards)}; a level above needs the reward of each primitive, in info['rewards'] "
                                "or the attribute last_rewards")
    return rewards
