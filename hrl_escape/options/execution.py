"""Execution of one decision: runs an option, steps primitives, and records rewards and calls."""

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
        """Return the number of primitives that the call ran."""
        return len(self.rewards)


class TraceStep(NamedTuple):
    """One step of the wrapped environment inside a decision: a primitive, or a decision of the level below.

    Attributes:
        observation: observation of the wrapped environment before the step.
        action: the primitive, as the wrapped environment took it.
        reward: its reward, or the sum if the level below ran several primitives.
        next_observation: observation after the step.
        state: state for options before the step; the full state of a room.
        next_state: state for options after the step.
        next_action_mask: legal actions after the step, int8 (actions,).
        consistent: (action, beta) of the primitive itself and of every option that would have chosen it here, with the
            option's probability beta of ending after it. Only options with a policy that is a function of the state are
            included (see `Option.is_markov`).
        name: name of the primitive; empty if primitives have no numbers.
        rewards: rewards, one per primitive of the lowest level.
        trace: trace of the level below, if it traces.
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
    """Return an option's probability of ending in a state. Raises `OptionError` outside 0 to 1."""
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
    """Convert an option's primitive to the form that the environment takes. Raises `OptionError` with its name."""
    try:
        return domain.check_action(action)
    except OptionError as error:
        raise OptionError(f"option {option.name!r} chose {error}") from None


class OptionExecution:
    """One run of an option: the stack of nested options and the rewards so far, one per primitive.

    Each option on the stack is a run of its own (see `Option.make_run`), so an option can run several times at once.
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
        """Start the run at this state, unless it has started. If it raises `PlanningFailed`, nothing runs."""
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
        """Return the next primitive, in the form of a domain if one is given; enters lower-level options.

        Raises:
            OptionError: options nest too deep, or the environment does not accept the primitive.
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
        """Draw whether the innermost option ends at the state reached, then its callers."""
        while True:
            beta = read_termination(self._stack[-1].option, state)
            if beta <= 0.0 or (beta < 1.0 and self._rng.random() >= beta):
                return False
            if len(self._stack) == 1:
                return True
            self._close(state, "reached")

    def stop(self, state: Any, ended: str) -> None:
        """End every running option."""
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
        """Return the planning report of the option and all nested options since the last call."""
        total = PlanningReport()
        total.add(self._finished)
        for frame in self._stack:
            total.add(frame.option.report)
        earlier, self._told = self._told, total
        return total.count_since(earlier)


class RunningDecision:
    """A running decision: steps the wrapped environment and records the result.

    There is one reward per primitive. `ended` and `reason` are as in `info["option"]`. `calls` are the runs of options
    that ended in the decision, innermost first.
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
        """Return whether the episode has ended."""
        return self.terminated or self.truncated

    def do(self, action: Any) -> tuple[float, ...]:
        """Step the wrapped environment once and return the rewards of the primitives that ran."""
        before = self.state
        self.observation, reward, self.terminated, self.truncated, self.info = self._env.step(action)
        rewards = read_rewards(reward, self.info, self._env)
        self.rewards.extend(rewards)
        self.state = self._domain.get_state(self.observation)
        self.steps.append(DomainStep(action, before, self.state, self.observation, rewards, self.info,
                                     self._domain.get_events()))
        return rewards


def read_rewards(reward: Any, info: Mapping[str, Any], env: gymnasium.Env) -> tuple[float, ...]:
    """Return the rewards of a step of the environment below, one per primitive.

    They are in `info["rewards"]`, or in the attribute `last_rewards` of the environment or a wrapper around it.

    Raises:
        StepContractError: there are none for its primitives, or `reward` is not their sum.
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
