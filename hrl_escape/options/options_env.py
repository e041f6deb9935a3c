"""`OptionsEnv`: a Gymnasium wrapper under which one step is one decision of an SMDP.

A primitive, or an option run to its end, becomes one transition with its duration and discount
(Sutton, Precup and Singh 1999, section 3). This module only counts and records; the options come
from `sources.py`, the loop inside one decision from `execution.py`.
"""

from __future__ import annotations

import operator
from typing import Any, NamedTuple, SupportsFloat

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.primitives import BASE_ACTIONS, make_action_table
from hrl_escape.errors import (
    ActionError,
    ConfigError,
    OptionError,
    PlanningFailed,
    ResetNeededError,
    UnsupportedError,
)
from hrl_escape.options.execution import DecisionOutcome, OptionExecution, RoomEnv, RunningDecision
from hrl_escape.options.sources import OptionsSource, make_meta_source, make_options
from hrl_escape.spaces import PointingDiscrete

__all__ = ["OptionsEnv", "TraceStep", "make_options_env"]


class TraceStep(NamedTuple):
    """One primitive inside a decision.

    Attributes:
        observation: observation of the wrapped environment before it.
        action: the primitive.
        reward: its reward.
        next_observation: observation after it.
        state: the full state before.
        next_state: the full state after.
        next_action_mask: int8 (actions,), the actions legal after it.
        consistent: (action, beta) of the primitive itself and of every option that would have chosen it
            here, with beta the option's probability of ending after it. Only options whose policy is a
            function of the state are among them (see `Option.is_markov`).
    """

    observation: Any
    action: int
    reward: float
    next_observation: Any
    state: RoomState
    next_state: RoomState
    next_action_mask: NDArray[np.int8]
    consistent: tuple[tuple[int, float], ...]


class OptionsEnv(gymnasium.Wrapper, RecordConstructorArgs):
    """Lets an agent choose among options and primitives; one step is one SMDP transition.

    The action space is a `PointingDiscrete(n)`, whose `about` names the object of each action: first the primitives
    (unless `include_primitives` is false), then the options. Names and numbers stay for the life of the environment;
    illegal actions are masked. It wraps an `EscapeRoomEnv` with any wrappers between: every primitive passes through
    them.

    `step(a)` returns the sum of the primitive rewards (or their discounted sum, see `discounted_reward`) and
    adds to the last primitive's `info`:

    | key | meaning |
    |---|---|
    | `duration` | k >= 1, primitives that ran |
    | `discount` | gamma^k |
    | `rewards` | the k primitive rewards, in order |
    | `discounted_reward` | sum over i < k of gamma^i r_i, whatever `reward` is |
    | `pressed` | targets pressed by any of the k primitives, in order |
    | `action_mask` | int8 (n,), the legal actions at the state reached; for `action_space.sample(mask)` |
    | `option` | the option that ran and how it ended, see below |
    | `trace` | tuple of k `TraceStep`, with `trace=True` |

    `reset` gives `action_mask` too. The backup is `discounted_reward` + `discount` (1 - terminated) max over
    legal o' of Q(s', o').

    `info["option"]` has `name`, `index` and `ended`: `reached` (its termination fired; always so for a
    primitive), `interrupted` (see `interruptible`), `timeout` (`max_duration`), `episode-over` (by exit or
    truncation) or `planning-failed`; then `planner_seconds`, `planner_calls`, `cache_hits`, `replans`,
    `cache_hit_rate` (of all calls of this environment), `also_pressed` (names of other targets pressed on
    the way), `unavoidable` (those that the plan had to press) and `reason` (why planning failed, else empty).

    A decision for an option that is masked or whose planning fails costs one primitive: the robot turns left.

    Args:
        env: the flat environment, wrapped or not.
        options: the options, or a function that makes them for an instance (needed where instances are
            resampled); None synthesises `meta-01` to `meta-NN` and `meta-exit`.
        include_primitives: whether primitives are actions too.
        discount: gamma per primitive, in [0, 1]; readable as `gamma`.
        discounted_reward: return sum gamma^i r_i as the reward instead of sum r_i.
        flavour: with `options=None`: `press` presses one button only, `press-with-ancestors` first those
            that must be on before it (as the published 2019 code did).
        interruptible: return to the agent after every primitive of an option, `ended="interrupted"`.
            Choosing the same option again continues it; choosing another drops it. So the policy over
            options is asked at every primitive and every duration is 1.
        max_duration: primitives after which an option is ended (`timeout`); None for no limit.
        trace: put every primitive into `info["trace"]`, for intra-option learning.
        observation: `pass`, or `options` to append per option two numbers to a flat observation: 1 if it is
            legal, 1 if it is running (see `interruptible`).
        planner: with `options=None`: method of their plans by name, as in `RoomPlanner`: `auto`, `fields`, or a
            path planner such as `RRTConnect`.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        options: OptionsSource | None = None,
        include_primitives: bool = True,
        discount: float = 0.99,
        discounted_reward: bool = False,
        flavour: str = "press",
        interruptible: bool = False,
        max_duration: int | None = None,
        trace: bool = False,
        observation: str = "pass",
        planner: str = "auto",
    ) -> None:
        RecordConstructorArgs.__init__(
            self, options=options, include_primitives=include_primitives, discount=discount,
            discounted_reward=discounted_reward, flavour=flavour, interruptible=interruptible,
            max_duration=max_duration, trace=trace, observation=observation, planner=planner,
        )
        super().__init__(env)
        self._room = self._check(env, discount, max_duration, observation)
        self.gamma = float(discount)
        self.interruptible, self.max_duration = interruptible, max_duration
        self._discounted, self._tracing = discounted_reward, trace
        self._source = options if options is not None else make_meta_source(flavour, planner)
        self._calls = self._hits = 0
        self._run: OptionExecution | None = None
        self._observation: Any = None  # the wrapped environment's, at the present state
        self._shown: Any = None  # the same as the agent saw it
        self._can_step = False
        self._instance: RoomInstance = self._room.instance
        names = make_action_table(self._instance.robot.joints).names if include_primitives else ()
        self._primitives = len(names)
        self.options = make_options(self._source, self._instance)
        if not self.options and not include_primitives:
            raise OptionError("there is nothing to choose: no options, and include_primitives is false")
        self.action_names = (*names, *(option.name for option in self.options))
        about = [*(None for _ in names), *(option.about for option in self.options)]
        self.action_space = PointingDiscrete(len(about), about)
        self._features = observation == "options"
        if self._features:
            self.observation_space = self._extend_space(env.observation_space)

    @staticmethod
    def _check(env: gymnasium.Env, discount: float, max_duration: int | None, observation: str) -> RoomEnv:
        if not 0.0 <= discount <= 1.0:
            raise ConfigError("OptionsEnv.discount", discount, "a number from 0 to 1")
        if max_duration is not None and max_duration < 1:
            raise ConfigError("OptionsEnv.max_duration", max_duration, "at least 1, or None for no limit")
        if observation not in ("pass", "options"):
            raise ConfigError("OptionsEnv.observation", observation, "'pass' or 'options'")
        room = env.unwrapped
        if not isinstance(room, RoomEnv):
            raise UnsupportedError(f"options need a room: {room} has no get_state() and instance. "
                                   "Wrap an hrl_escape environment")
        if not isinstance(env.action_space, spaces.Discrete):
            raise UnsupportedError(f"options choose primitives by number, but a wrapper below changed the action "
                                   f"space to {env.action_space}. Apply that wrapper after OptionsEnv")
        return room

    def _extend_space(self, inner: spaces.Space) -> spaces.Box:
        if not isinstance(inner, spaces.Box) or len(inner.shape) != 1:
            raise UnsupportedError(f"observation='options' appends to a flat Box, not to {inner}: "
                                   "use observation='pass'")
        extra = 2 * len(self.options)
        return spaces.Box(np.concatenate([inner.low, np.zeros(extra, inner.dtype)]),
                          np.concatenate([inner.high, np.ones(extra, inner.dtype)]), dtype=inner.dtype.type)

    # --- Gymnasium ---------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; `info` has `action_mask` and an empty `pressed`. Its noise key seeds terminations."""
        observation, info = self.env.reset(seed=seed, options=options)
        mask = self._begin(observation)
        return self._show(observation, mask), {**info, "pressed": (), "action_mask": mask}

    def resume(self, observation: Any = None) -> NDArray[np.int8]:
        """Take over an episode that has already begun in the wrapped environment, instead of `reset`.

        Args:
            observation: last observation of the wrapped environment, for the first step's trace.

        Returns:
            The legal actions, int8 (actions,).
        """
        return self._begin(observation)

    def _begin(self, observation: Any) -> NDArray[np.int8]:
        instance = self._room.instance
        if instance is not self._instance and instance.id != self._instance.id:
            self._enter(instance)
        self._run, self._can_step = None, True
        self._observation = observation
        state: RoomState = self._room.get_state()
        self._rng = np.random.default_rng([state.noise_key, state.primitives, 0x0971])
        return self._compute_mask(state)

    def _enter(self, instance: RoomInstance) -> None:
        made = make_options(self._source, instance)
        if [option.name for option in made] != [option.name for option in self.options]:
            raise OptionError(f"the options of a new room must keep their names: {[o.name for o in self.options]} "
                              f"became {[o.name for o in made]}")
        self._instance, self.options = instance, made

    def step(self, action: int) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Run one primitive, or one option to its end; see the class for `info`."""
        if not self._can_step:
            raise ResetNeededError("call reset() first: no episode has begun, or it has ended")
        try:
            index = operator.index(action)
        except TypeError:
            index = -1
        if not 0 <= index < len(self.action_names):
            raise ActionError(action, len(self.action_names))
        decision = RunningDecision(self.env, self._room, self._observation)
        if index < self._primitives:
            self._run = None
            decision.do(index)
            outcome = DecisionOutcome("reached")
        else:
            outcome = self._run_option(index, decision)
        self._can_step, self._observation = not decision.is_over, decision.observation
        mask = self._compute_mask(decision.state)
        info = self._inform(index, decision, outcome, mask)
        reward = info["discounted_reward"] if self._discounted else float(sum(decision.rewards))
        return self._show(decision.observation, mask), reward, decision.terminated, decision.truncated, info

    def _run_option(self, index: int, decision: RunningDecision) -> DecisionOutcome:
        """Run an option until it ends, or, if interruptible, for one primitive."""
        option = self.options[index - self._primitives]
        run = self._run if self._run is not None and self._run.index == index else None
        self._run = None
        if run is None and not option.initiation(decision.state):
            decision.do(BASE_ACTIONS.wait)
            return DecisionOutcome("planning-failed", "the option was masked: it cannot start here")
        ended, reason = "", ""
        try:
            run = run or OptionExecution(index, option, decision.state)
            while not ended:
                decision.do(run.choose(decision.state))
                run.duration += 1
                if run.ends_at(decision.state, self._rng):
                    ended = "reached"
                elif decision.is_over:
                    ended = "episode-over"
                elif self.max_duration is not None and run.duration >= self.max_duration:
                    ended = "timeout"
                elif self.interruptible:
                    ended, self._run = "interrupted", run
        except PlanningFailed as failure:
            ended, reason = "planning-failed", str(failure)
            if not decision.rewards:
                decision.do(BASE_ACTIONS.wait)
        return DecisionOutcome(ended, reason, run.make_report() if run else option.report)

    def _inform(self, index: int, decision: RunningDecision, outcome: DecisionOutcome, mask: NDArray[np.int8]
                ) -> dict[str, Any]:
        discounted = 0.0
        for reward in reversed(decision.rewards):
            discounted = reward + self.gamma * discounted
        own = self.options[index - self._primitives].targets if index >= self._primitives else None
        targets = self._instance.targets
        others = () if own is None else tuple(targets[i].name for i in decision.pressed if i not in own)
        self._calls += outcome.report.planner_calls
        self._hits += outcome.report.cache_hits
        info = {
            **decision.info,
            "duration": len(decision.rewards),
            "discount": self.gamma ** len(decision.rewards),
            "rewards": tuple(decision.rewards),
            "discounted_reward": discounted,
            "pressed": tuple(decision.pressed),
            "action_mask": mask,
            "option": {"name": self.action_names[index], "index": index, "ended": outcome.ended,
                       **vars(outcome.report), "cache_hit_rate": self._hits / max(self._calls, 1),
                       "also_pressed": others, "reason": outcome.reason},
        }
        if self._tracing:
            info["trace"] = self._make_trace(decision, mask)
        return info

    def _make_trace(self, decision: RunningDecision, last_mask: NDArray[np.int8]) -> tuple[TraceStep, ...]:
        """Add to the decision's notes each state's observation and mask as the agent would have seen them."""
        steps = []
        seen = self._shown
        for number, (primitive, before, after, observation) in enumerate(decision.notes, 1):
            is_last = number == len(decision.notes)
            mask = last_mask if is_last else self._compute_mask(after)
            shown = self._show(observation, mask, is_last)
            steps.append(TraceStep(seen, primitive, decision.rewards[number - 1], shown, before, after, mask,
                                   self._find_consistent(before, primitive, after)))
            seen = shown
        return tuple(steps)

    # --- legal actions and observations ---------------------------------------------------

    def action_masks(self) -> NDArray[np.bool_]:
        """The legal actions at the present state, bool (n,), under the name that sb3-contrib's MaskablePPO asks for."""
        return self._compute_mask(self._room.get_state()).astype(np.bool_)

    def _compute_mask(self, state: RoomState) -> NDArray[np.int8]:
        mask = np.ones(len(self.action_names), dtype=np.int8)
        running = self._run.index if self._run else -1
        for index, option in enumerate(self.options, self._primitives):
            if index != running and not option.initiation(state):
                mask[index] = 0
        if not mask.any():  # nothing can start: any choice then costs one primitive
            mask[:] = 1
        return mask

    def _show(self, observation: Any, mask: NDArray[np.int8], is_now: bool = True) -> Any:
        """Observation for the agent: with option features, the legal options and the one that is running now."""
        if self._features:
            running = np.zeros(len(self.options), dtype=observation.dtype)
            if self._run and is_now:
                running[self._run.index - self._primitives] = 1
            observation = np.concatenate([observation, mask[self._primitives :].astype(observation.dtype), running])
        if is_now:
            self._shown = observation
        return observation

    def _find_consistent(self, state: RoomState, primitive: int, reached: RoomState) -> tuple[tuple[int, float], ...]:
        """Actions with a Markov policy that would have chosen this primitive, with their beta."""
        found = [(primitive, 1.0)] if self._primitives else []
        for index, option in enumerate(self.options, self._primitives):
            if option.is_markov and option.initiation(state) and option.policy(state) == primitive:
                found.append((index, option.termination(reached)))
        return tuple(found)


def make_options_env(
    config: str | RoomConfig | dict[str, Any] = "paper-two-button",
    *,
    options: OptionsSource | None = None,
    include_primitives: bool = True,
    discount: float = 0.99,
    discounted_reward: bool = False,
    flavour: str = "press",
    interruptible: bool = False,
    max_duration: int | None = None,
    trace: bool = False,
    option_features: bool = False,
    planner: str = "auto",
    **room: Any,
) -> OptionsEnv:
    """Make an `EscapeRoomEnv` wrapped in an `OptionsEnv`; the entry point of the ids `hrl_escape/<Preset>Options-v1`.

    Args:
        config: schematic of the room, see `EscapeRoomEnv`.
        options: as in `OptionsEnv`.
        include_primitives: as in `OptionsEnv`.
        discount: as in `OptionsEnv`.
        discounted_reward: as in `OptionsEnv`.
        flavour: as in `OptionsEnv`.
        interruptible: as in `OptionsEnv`.
        max_duration: as in `OptionsEnv`.
        trace: as in `OptionsEnv`.
        planner: as in `OptionsEnv`.
        option_features: append option features to the observation, as `OptionsEnv(observation="options")` does.
        room: all other arguments of `EscapeRoomEnv`, such as `observation="features"`.
    """
    return OptionsEnv(
        EscapeRoomEnv(config, **room), options, include_primitives, discount, discounted_reward, flavour, interruptible,
        max_duration, trace, "options" if option_features else "pass", planner,
    )
