"""Check of options: initiation, policy and termination in any environment, including nested options."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from hrl_escape.checks.claims import Claims
from hrl_escape.errors import OptionError, PlanningFailed, UnsupportedError
from hrl_escape.options.domain import OptionDomain, RoomDomain, make_option_domain
from hrl_escape.options.option import Option
from hrl_escape.planning.route import PlanningReport

StartPlace = Callable[[], Any]
"""Sets the environment to a place and returns its state."""


def check_option(option: Option, env: gymnasium.Env, runs: int = 10, seed: int = 0, states: Sequence[Any] = (),
                 domain: Callable[[gymnasium.Env], OptionDomain] = make_option_domain, horizon: int = 1000) -> None:
    """Check an option by running it from states that random play reaches.

    Args:
        option: any option.
        env: a flat room or another environment. Only rooms can be set to a state. Other environments replay the actions
            to it, so their episodes must depend only on seed and actions.
        runs: number of states from random play.
        seed: of the random play.
        states: further initial states of a room, for options that random play rarely can start.
        domain: as in `OptionsEnv`.
        horizon: primitives within which an option has to end; a room has its own.

    Raises:
        ContractError: a requirement is violated.
        UnsupportedError: `states` are given and the environment is not a room.
    """
    made = domain(env)
    check = _RoomOptionCheck(option, made) if isinstance(made, RoomDomain) else _OptionCheck(option, made, horizon)
    check.run(runs, seed, states)


class _OptionCheck(Claims):
    """Requirements of an option, checked in runs."""

    DEEPEST = 8

    def __init__(self, option: Option, domain: OptionDomain, horizon: int) -> None:
        super().__init__(f"option {option.name!r}")
        self.option, self.domain, self.env, self.horizon = option, domain, domain.env, horizon

    def run(self, runs: int, seed: int, states: Sequence[Any]) -> None:
        option = self.option
        self.require(isinstance(option.name, str) and bool(option.name), "the name is text", option.name)
        self.require(self.suits(option), "it was made for this room, or for any", option.instance)
        started = sum(self.try_from(self.make_place(state)) for state in states)
        rng = np.random.default_rng(seed)
        for number in range(runs):
            place = self.wander(seed + number, 10 * number, rng)
            started += place is not None and self.try_from(place)
        self.require(started > 0, f"it starts somewhere in {runs} places that random play led to, or in given states",
                     started)

    def suits(self, option: Option) -> bool:
        """Return whether the option is made for any environment."""
        return option.instance is None

    def make_place(self, state: Any) -> StartPlace:
        """Return the place of a given state."""
        raise UnsupportedError(f"{self.env} cannot be set to a state, as rooms can: leave states out, or give a seed "
                               "whose random play leads where the option starts")

    def wander(self, seed: int, steps: int, rng: np.random.Generator) -> StartPlace | None:
        """Play at random; returns the actions, or None if the episode ended."""
        self.env.reset(seed=seed)
        actions = [self.draw(rng) for _ in range(steps)]
        for action in actions:
            *_, terminated, truncated, _ = self.env.step(action)
            if terminated or truncated:
                return None
        return self.remember(seed, actions)

    def remember(self, seed: int, actions: Sequence[Any]) -> StartPlace:
        """Return the place at the end of a list of actions."""
        def go() -> Any:
            observation, _ = self.env.reset(seed=seed)
            for action in actions:
                observation, *_ = self.env.step(action)
            return self.domain.get_state(observation)

        return go

    def draw(self, rng: np.random.Generator) -> Any:
        """Sample a primitive uniformly."""
        space = self.env.action_space
        if isinstance(space, spaces.Discrete):
            return self.domain.make_action(int(rng.integers(space.n)))
        space.seed(int(rng.integers(2**31)))
        return space.sample()

    def try_from(self, place: StartPlace) -> bool:
        """Run the option twice from one place; returns false if it cannot start or be planned there."""
        state = place()
        allowed = self.option.initiation(state)
        self.require(isinstance(allowed, bool), "initiation gives a bool", allowed)
        self.require(self.option.initiation(state) == allowed, "initiation gives the same answer each time", state)
        if not allowed:
            return False
        try:
            first, again = self.roll_out(place), self.roll_out(place)
        except PlanningFailed as failure:
            self.require(bool(str(failure)), "a failed plan says why", failure)
            return False
        self.require(_is_same(first, again), "the same state and the same draws give the same run", (first, again))
        shared = self.roll_out(place, self.option.make_run(), is_shared=True)
        self.require(_is_same(first, shared), "a run does not change another one of the same option: start sets what a "
                     "run keeps, and make_run copies the objects that it changes", (first, shared))
        if self.option.is_markov:
            for at, primitive in first:
                self.require(_is_same(self.domain.check_action(self.option.policy(at)), primitive),
                             "is_markov: the policy is a function of the state", at)
        return True

    def roll_out(self, place: StartPlace, option: Option | None = None, is_shared: bool = False
                 ) -> list[tuple[Any, Any]]:
        """Run to the end; returns (state, primitive) of each step. `shared` begins another run after two steps."""
        option, rng = option or self.option, np.random.default_rng(0)
        state = place()
        option.start(state)
        stack, steps = [option], []
        ended = False
        while not ended:
            self.require(len(steps) <= self.horizon, "it ends with the episode at the latest", len(steps))
            primitive = self.ask(stack, state, rng)
            observation, _, terminated, truncated, _ = self.env.step(primitive)
            steps.append((state, primitive))
            state = self.domain.get_state(observation)
            ended = self.ends(stack, state, rng) or terminated or truncated
            if is_shared and len(steps) == 2 and not ended:
                self.begin_another(state)
        report = option.report
        self.require(0 <= report.cache_hits <= report.planner_calls and report.planner_seconds >= 0.0,
                     "the report's counts make sense", report)
        self.look_back([*(at for at, _ in steps), state], report)
        return steps

    def begin_another(self, state: Any) -> None:
        """Begin another run of the same option and query its policy once."""
        other = self.option.make_run()
        try:
            other.start(state)
            other.sample_action(state, np.random.default_rng(1))
        except PlanningFailed:
            pass

    def look_back(self, states: Sequence[Any], report: PlanningReport) -> None:
        """Check the states of a run."""

    def ask(self, stack: list[Option], state: Any, rng: np.random.Generator) -> Any:
        """Return the next primitive, through nested options."""
        while True:
            decision = stack[-1].sample_action(state, rng)
            if not isinstance(decision, Option):
                return self.check_primitive(decision)
            self.require(len(stack) < self.DEEPEST, f"options nest at most {self.DEEPEST} deep", stack)
            self.require(bool(decision.initiation(state)), "a nested option is entered where it may start", decision)
            decision.start(state)
            stack.append(decision)

    def check_primitive(self, decision: Any) -> Any:
        """Convert a policy's choice to an action of the environment."""
        claim = f"the policy gives an action of {self.env.action_space}, or an option"
        self.require(not isinstance(decision, bool), claim, decision)
        try:
            return self.domain.check_action(decision)
        except OptionError:
            self.require(False, claim, decision)

    def ends(self, stack: list[Option], state: Any, rng: np.random.Generator) -> bool:
        """Query the terminations at the new state, from the innermost option outwards."""
        while stack:
            beta = stack[-1].termination(state)
            self.require(isinstance(beta, float) and 0.0 <= beta <= 1.0, "termination gives a probability", beta)
            self.require(stack[-1].termination(state) == beta, "termination gives the same answer each time", state)
            if rng.random() >= beta:
                return False
            stack.pop()
        return True


class _RoomOptionCheck(_OptionCheck):
    """Requirements of an option in a room, which can be set to a state and reports presses."""

    def __init__(self, option: Option, domain: RoomDomain) -> None:
        super().__init__(option, domain, domain.room.instance.horizon)
        self.room: Any = domain.room

    def suits(self, option: Option) -> bool:
        """Return whether the option is made for this room or any."""
        return option.instance is None or option.instance.id == self.room.instance.id

    def make_place(self, state: Any) -> StartPlace:
        """Set the room to the state."""
        def go() -> Any:
            self.env.reset(seed=0)
            self.room.set_state(state)
            return state

        return go

    def remember(self, seed: int, actions: Sequence[Any]) -> StartPlace:
        """Return the current state as a place."""
        return self.make_place(self.room.get_state())

    def check_primitive(self, decision: Any) -> int:
        """Check a number of the action table."""
        count = len(self.room.rules.actions)
        self.require(not isinstance(decision, bool) and decision in range(count),
                     f"the policy gives a primitive from 0 to {count - 1}, or an option", decision)
        return int(decision)

    def look_back(self, states: Sequence[Any], report: PlanningReport) -> None:
        """Check that all presses are of the target or reported as unavoidable."""
        option, instance = self.option, self.room.instance
        if option.targets is None or instance.dynamics.kind != "kinematic" or instance.dynamics.noise:
            return
        touched = 0
        for before, after in zip(states, states[1:], strict=False):
            touched |= after.touching & ~before.touching
        told = {*report.unavoidable, *(instance.targets[i].name for i in option.targets)}
        names = [target.name for i, target in enumerate(instance.targets) if touched >> i & 1]
        others = [name for name in names if name not in told]
        self.require(not others, "it presses no target but its own and those it reports as unavoidable", others)


def _is_same(one: Any, other: Any) -> bool:
    """Return whether two values, arrays inside included, are equal."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_is_same(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)):
        return len(one) == len(other) and all(map(_is_same, one, other))
    return bool(one == other)
