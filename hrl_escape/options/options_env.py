"""`OptionsEnv` turns a Gymnasium environment into a semi-MDP: one step runs one option, or one primitive.

A step returns the option's reward, duration and discount (Sutton, Precup and Singh 1999, section 3). This module counts
and records. The options come from `domain.py`, and the loop inside one decision is in `execution.py`.
"""

from __future__ import annotations

import inspect
import numbers
from collections.abc import Callable, Mapping
from pkgutil import resolve_name
from types import MappingProxyType
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import RenderCollection
from numpy.typing import NDArray

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.errors import ConfigError, OptionError, PlanningFailed, ResetNeededError, UnsupportedError
from hrl_escape.notebook import make_caption, make_html_table
from hrl_escape.options.domain import DomainStep, OptionDomain, OptionsSource, make_option_domain, make_options
from hrl_escape.options.execution import OptionExecution, RunningDecision, TraceStep, check_choice, read_termination
from hrl_escape.options.option import Option
from hrl_escape.planning.route import PlanningSummary
from hrl_escape.spaces import PointingDiscrete
from hrl_escape.step_info import read_action

_SPECS = "hrl_escape.agents.training.env_description:find_spec"
"""Describes environments, which options do not know; imported when a spec is asked for."""


class OptionsEnv(gymnasium.Wrapper, RecordConstructorArgs):
    """Wrapper whose actions are options and primitives; one step is one SMDP transition.

    It wraps any Gymnasium environment, with any wrappers between. The action space is a `PointingDiscrete(n)`: first
    the primitives (unless `include_primitives` is false), then the options. Its `about` names the object of each
    action. Names and numbers of actions are constant. Illegal actions are masked, also by the environment's own
    `info["action_mask"]`. Options read the full state of a room, and the observation of any other environment (see
    `domain`). If the action space is not Discrete, the options are the only actions.

    An `OptionsEnv` can wrap another: the actions of the lower level are the primitives of the upper. Durations,
    discounts and rewards count the primitives of the lowest level.

    `step(a)` returns the sum of the primitive rewards (or their discounted sum, see `discounted_reward`) and adds to
    the last primitive's `info`:

    | key | meaning |
    |---|---|
    | `duration` | k >= 1, primitives that ran, int64 |
    | `discount` | gamma^k, float64 |
    | `summed_reward` | sum over i < k of r_i, float64 |
    | `discounted_reward` | sum over i < k of gamma^i r_i, float64 |
    | `pressed` | in a room: 1 for each target pressed by any of the k primitives, int8 (targets,) |
    | `also_pressed` | in a room: 1 for each of these that was not the option's target, int8 (targets,) |
    | `unavoidable` | in a room: 1 for each target that the plan had to press on its way, int8 (targets,) |
    | `action_mask` | int8 (n,), the legal actions at the state reached; for `action_space.sample(mask)` |
    | `option` | the option that ran and how it ended, see below |
    | `instance` | in a room: its number among the rooms so far, from 0, int64 |

    These have the same shapes and dtypes at every step, and depend on no clock and no cache. `trace=True` adds three
    entries of varying length:

    | key | meaning |
    |---|---|
    | `rewards` | tuple of the k primitive rewards, in order; see also `last_rewards` |
    | `trace` | tuple of `TraceStep`, one per step of the wrapped environment |
    | `calls` | tuple of `OptionCall`, the runs of options that ended, nested ones first |

    The keys replace equal keys of the wrapped environment. `reset` returns the same keys for an empty decision:
    duration 0, discount 1, and an option without a name and with index -1.

    `info["option"]` has `name`, `index` (int64), `ended` and `reason`. `ended` is `reached` (the termination fired;
    always so for a primitive), `interrupted` (see `interruptible`), `timeout` (`max_duration`), `episode-over` or
    `planning-failed`. `reason` says why planning failed, and is empty otherwise.

    The backup is `discounted_reward` + `discount` (1 - terminated) max over legal o' of Q(s', o').

    Put reward wrappers below, `OptionsEnv(ClipReward(env))`, where they act on every primitive. Above, they change only
    `reward`. `train`, `evaluate` and a level above compare `reward` with `summed_reward` and `discounted_reward`, and
    raise `StepContractError` if it equals neither. `train` and `evaluate` set `gamma` to the agent's.

    `render` shows the state at the end of a decision. For a frame of every primitive, record below this wrapper,
    `OptionsEnv(RecordVideo(env, folder))`, or use `OptionsEnv(RenderCollection(env))`.

    A decision whose option is masked or fails to plan costs one primitive: in a room the robot turns left, elsewhere
    see `OptionDomain.get_idle_action`.

    Args:
        env: the environment, wrapped or not.
        options: the options, or a function that makes them from an instance (required where instances are resampled)
            or, without a room, from `env`. By default, the planned options of a room, such as `press-button-1` and
            `go-to-exit`.
        include_primitives: whether primitives are actions too, if the action space is Discrete.
        discount: gamma per primitive, in [0, 1]; readable as `gamma`.
        discounted_reward: return sum gamma^i r_i as the reward instead of sum r_i.
        option_set: name of the default option set. `press` presses one button, `press-with-ancestors` first the buttons
            that must be on before it (as the published code did), `press-reactive` one button by a function of the
            state; see `hrl_escape.options.option_sets`.
        interruptible: return to the agent after every primitive of an option, with `ended="interrupted"`. Choosing the
            same option again continues it, and choosing another drops it. Every duration is then 1.
        max_duration: maximum primitives of an option, which then ends with `timeout`, or None for no limit.
        trace: add `rewards`, `trace` and `calls` to `info`, for intra-option learning.
        observation: `pass`, or `options` to append two numbers per option to a flat observation: 1 if it is legal, 1 if
            it is running (see `interruptible`).
        planner: planning method of the default options, as in `RoomPlanner`: `auto`, `fields`, or a path planner such
            as `RRTConnect`. Over velocities `auto` is OMPL's Informed RRT*, see `MotionSampler`.
        domain: env -> its `OptionDomain`, such as a class derived from it. By default a room's domain, or the domain of
            any environment by its observation.

    Attributes:
        gamma: discount per primitive; see `set_option_discount`.
        options: the options, in the order of their actions.
        action_names: names of all actions.
        primitive_count: number of primitives among the actions; they come first.
        level: number of environments of options below this one.
        last_steps: steps of the wrapped environment in the latest decision.
        last_decision: `info["option"]` of the latest decision, with its `duration` and `summed_reward`; empty before
            the first episode.
        planning_report: planning of the latest decision. In a vector environment, `get_attr("planning_report")` returns
            one per sub-environment.
        planning_total: planning of all decisions since construction.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        options: OptionsSource | None = None,
        include_primitives: bool = True,
        discount: float = 0.99,
        discounted_reward: bool = False,
        option_set: str = "press",
        interruptible: bool = False,
        max_duration: int | None = None,
        trace: bool = False,
        observation: str = "pass",
        planner: str = "auto",
        domain: Callable[[gymnasium.Env], OptionDomain] | None = None,
    ) -> None:
        given: dict[str, Any] = {} if domain is None else {"domain": domain}
        RecordConstructorArgs.__init__(
            self, options=options, include_primitives=include_primitives, discount=discount,
            discounted_reward=discounted_reward, option_set=option_set, interruptible=interruptible,
            max_duration=max_duration, trace=trace, observation=observation, planner=planner,
            **given,
        )
        super().__init__(env)
        self._check(discount, max_duration, observation)
        self._domain = _make_domain(domain, env)
        self.gamma = float(discount)
        self.interruptible, self.max_duration = interruptible, max_duration
        self._discounted, self._tracing = discounted_reward, trace
        self._source: OptionsSource = (
            options if options is not None else self._domain.make_default_options(option_set, planner))
        self.planning_report = self.planning_total = PlanningSummary()
        self.last_steps: tuple[DomainStep, ...] = ()
        self.last_decision: Mapping[str, Any] = {}
        self._run: OptionExecution | None = None
        self._observation: Any = None  # of the wrapped environment, at the present state
        self._shown: Any = None  # the same, as the agent saw it
        self._can_step = False
        self._rng: np.random.Generator | None = None
        self._subject = self._domain.subject
        names = self._domain.action_names if include_primitives else ()
        self.primitive_count, self.level = len(names), self._domain.level
        self.options = make_options(self._source, self._subject)
        if not self.options and not names:
            raise OptionError("there is nothing to choose: no options, and no primitives (include_primitives is false, "
                              "or they are not Discrete)")
        self.action_names = (*names, *(option.name for option in self.options))
        if len(set(self.action_names)) < len(self.action_names):
            raise OptionError(f"an option has the name of a primitive: {', '.join(self.action_names)}")
        about = [*(None for _ in names), *(option.about for option in self.options)]
        self.action_space = PointingDiscrete(len(about), about)
        self._features = observation == "options"
        if self._features:
            self.observation_space = self._extend_space(env.observation_space)

    def _repr_html_(self) -> str:
        mask = self.action_masks() if self._can_step else None
        rows = [(number, name, "" if mask is None else "yes" if mask[number] else "no",
                 "option" if number >= self.primitive_count else "primitive")
                for number, name in enumerate(self.action_names)]
        last = self.last_decision
        words = "A new episode." if last else "No episode has begun."
        if last and last["duration"]:
            words = (f"Last decision: {last['name'] or 'idle'}, {last['duration']} primitives, {last['ended']}, "
                     f"reward {last['summed_reward']:g}.")
        return make_caption(make_html_table(("action", "name", "legal", "kind"), rows), f"{self}. {words}")

    @property
    def spec(self) -> EnvSpec | None:
        """Spec from which `gymnasium.make` makes an equal environment, also after JSON.

        Options of your own must come from a function of a module; otherwise the spec cannot be written as JSON.
        """
        return resolve_name(_SPECS)(self, super().spec)

    @staticmethod
    def _check(discount: float, max_duration: int | None, observation: str) -> None:
        if isinstance(discount, bool) or not isinstance(discount, numbers.Real) or not 0.0 <= discount <= 1.0:
            raise ConfigError("OptionsEnv.discount", discount, "a number from 0 to 1")
        is_whole = isinstance(max_duration, numbers.Integral) and not isinstance(max_duration, bool)
        if max_duration is not None and not (is_whole and max_duration >= 1):
            raise ConfigError("OptionsEnv.max_duration", max_duration, "at least 1, or None for no limit")
        if observation not in ("pass", "options"):
            raise ConfigError("OptionsEnv.observation", observation, "'pass' or 'options'")

    def set_option_discount(self, gamma: float) -> None:
        """Set the discount per primitive, in [0, 1], here and at all levels below."""
        self._check(gamma, None, "pass")
        self.gamma = float(gamma)
        if self.env.has_wrapper_attr("set_option_discount"):
            self.env.get_wrapper_attr("set_option_discount")(gamma)

    def _extend_space(self, inner: spaces.Space) -> spaces.Box:
        if not isinstance(inner, spaces.Box) or len(inner.shape) != 1:
            raise UnsupportedError(f"observation='options' appends to a flat Box, not to {inner}: "
                                   "use observation='pass'")
        extra = 2 * len(self.options)
        return spaces.Box(np.concatenate([inner.low, np.zeros(extra, inner.dtype)]),
                          np.concatenate([inner.high, np.ones(extra, inner.dtype)]), dtype=inner.dtype.type)

    # --- Gymnasium ---------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; `info` has the keys of a step, for an empty decision.

        The seed also fixes terminations and stochastic policies.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        mask = self._begin(observation, seed, info)
        nothing = RunningDecision(self.env, self._domain, observation)
        nothing.info, nothing.ended, self.last_steps = info, "", ()
        return self._show(observation, mask), self._inform(-1, nothing, mask)

    def resume(self, observation: Any = None, info: Mapping[str, Any] = MappingProxyType({})) -> NDArray[np.int8]:
        """Take over a running episode of the wrapped environment, instead of `reset`.

        Args:
            observation: last observation of the wrapped environment. In a room it can be omitted; it is only used for
                the trace.
            info: last `info` of the wrapped environment, for its `action_mask`.

        Returns:
            The legal actions, int8 (actions,).
        """
        self._shown = observation
        return self._begin(observation, None, info)

    def _begin(self, observation: Any, seed: int | None, info: Mapping[str, Any]) -> NDArray[np.int8]:
        if self._domain.has_left(self._subject):
            self._enter(self._domain.subject)
        self._run, self._can_step, self._observation = None, True, observation
        key = self._domain.make_key(seed)
        if key is not None or self._rng is None:
            self._rng = np.random.default_rng(key)
        self._lower_mask = self._domain.get_mask(info)
        state = self._domain.get_state(observation)
        for option in self.options if len(self._lower_mask) else ():
            option.check_actions(state, len(self._lower_mask))
        return self._compute_mask(state, self._lower_mask)

    def _enter(self, subject: Any) -> None:
        made = make_options(self._source, subject)
        if [option.name for option in made] != [option.name for option in self.options]:
            raise OptionError(f"the options of a new room must keep their names: {[o.name for o in self.options]} "
                              f"became {[o.name for o in made]}")
        self._subject, self.options = subject, made

    def step(self, action: int) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Run one primitive, or one option to its end; see the class for `info`."""
        if not self._can_step:
            raise ResetNeededError("call reset() first: no episode has begun, or it has ended")
        return self._decide(read_action(action, len(self.action_names)))

    def idle(self, reason: str) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Run one idle primitive, the cost of a masked option, for a choice that names no action.

        `info["option"]` then has the index -1, no name and this reason.
        """
        if not self._can_step:
            raise ResetNeededError("call reset() first: no episode has begun, or it has ended")
        return self._decide(-1, reason)

    def _stand(self, decision: RunningDecision, reason: str) -> None:
        decision.do(self._domain.get_idle_action(self._lower_mask))
        decision.ended, decision.reason = "planning-failed", reason

    def _decide(self, index: int, reason: str = "") -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Carry out an action. If the index is -1, spend one primitive for the given reason."""
        decision = RunningDecision(self.env, self._domain, self._observation)
        if index >= self.primitive_count:
            self._run_option(index, decision)
        else:
            self._run = None
            self._stand(decision, reason) if index < 0 else decision.do(self._domain.make_action(index))
        self.last_steps = tuple(decision.steps)
        self._can_step, self._observation = not decision.is_over, decision.observation
        self._lower_mask = self._domain.get_mask(decision.info)
        mask = self._compute_mask(decision.state, self._lower_mask)
        info = self._inform(index, decision, mask)
        reward = float(info["discounted_reward" if self._discounted else "summed_reward"])
        return self._show(decision.observation, mask), reward, decision.terminated, decision.truncated, info

    def _run_option(self, index: int, decision: RunningDecision) -> None:
        """Run an option until it ends, or, if interruptible, for one primitive."""
        option = self.options[index - self.primitive_count]
        run = self._run if self._run is not None and self._run.index == index else None
        self._run = None
        assert self._rng is not None
        if run is None:
            if not option.initiation(decision.state):
                self._stand(decision, "the option was masked: it cannot start here")
                return
            run = OptionExecution(index, option, self._rng)
        ended = ""
        try:
            run.start(decision.state)
            while not ended:
                run.rewards += decision.do(run.choose(decision.state, self._domain))
                if run.ends_at(decision.state):
                    ended = "reached"
                elif decision.is_over:
                    ended = "episode-over"
                elif self.max_duration is not None and len(run.rewards) >= self.max_duration:
                    ended = "timeout"
                elif self.interruptible:
                    ended, self._run = "interrupted", run
        except PlanningFailed as failure:
            ended, decision.reason = "planning-failed", str(failure)
            if not decision.rewards:
                run.rewards += decision.do(self._domain.get_idle_action(self._lower_mask))
        decision.ended = ended
        if self._run is None:
            run.stop(decision.state, ended)
        decision.report, decision.calls = run.take_report(), run.collect()

    def _inform(self, index: int, decision: RunningDecision, mask: NDArray[np.int8]) -> dict[str, Any]:
        discounted = 0.0
        for reward in reversed(decision.rewards):
            discounted = reward + self.gamma * discounted
        self.planning_report = decision.report.summarise()
        self.planning_total += self.planning_report
        info = {
            **{name: value for name, value in decision.info.items() if name not in ("trace", "calls")},
            "duration": np.int64(len(decision.rewards)),
            "discount": np.float64(self.gamma ** len(decision.rewards)),
            "summed_reward": np.float64(sum(decision.rewards)),
            "discounted_reward": np.float64(discounted),
            "action_mask": mask,
            "option": {"name": self.action_names[index] if index >= 0 else "", "index": np.int64(index),
                       "ended": decision.ended, "reason": decision.reason},
        }
        self.last_decision = info["option"] | {name: info[name] for name in ("duration", "summed_reward")}
        option = self.options[index - self.primitive_count] if index >= self.primitive_count else None
        self._domain.inform(info, decision.steps, option, decision.report.unavoidable)
        if self._tracing:
            info["rewards"] = tuple(decision.rewards)
            info["trace"], info["calls"] = self._make_trace(decision, mask), decision.calls
        return info

    def _make_trace(self, decision: RunningDecision, last_mask: NDArray[np.int8]) -> tuple[TraceStep, ...]:
        """Add the observations and masks, as the agent would have received them, to the steps of the decision."""
        made = []
        seen = self._shown
        names = self._domain.action_names
        for number, step in enumerate(decision.steps, 1):
            is_last = number == len(decision.steps)
            mask = last_mask if is_last else self._compute_mask(step.next_state, self._domain.get_mask(step.info))
            shown = self._show(step.observation, mask, is_last)
            choice = self._domain.find_choice(step.action)
            made.append(TraceStep(
                seen, step.action, float(sum(step.rewards)), shown, step.state, step.next_state, mask,
                self._find_consistent(step, choice), names[choice] if choice is not None else "", step.rewards,
                step.info.get("trace", ()) if self.level else ()))
            seen = shown
        return tuple(made)

    @property
    def last_rewards(self) -> tuple[float, ...]:
        """Return the rewards of the primitives of the latest decision, in order."""
        return tuple(reward for step in self.last_steps for reward in step.rewards)

    # --- legal actions and observations ---------------------------------------------------

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the legal actions at the present state, bool (n,), for sb3-contrib's MaskablePPO."""
        return self._compute_mask(self._domain.get_state(self._observation), self._lower_mask).astype(np.bool_)

    def _compute_mask(self, state: Any, lower: NDArray[np.int8]) -> NDArray[np.int8]:
        mask = np.ones(len(self.action_names), dtype=np.int8)
        mask[: self.primitive_count] = lower[: self.primitive_count]
        running = self._run.index if self._run else -1
        for index, option in enumerate(self.options, self.primitive_count):
            if index != running and not option.initiation(state):
                mask[index] = 0
        return mask if mask.any() else np.ones_like(mask)  # nothing can start: any choice then costs one primitive

    def _show(self, observation: Any, mask: NDArray[np.int8], is_now: bool = True) -> Any:
        """Return the observation for the agent, with the legal and the running options if option features are on."""
        if self._features:
            running = np.zeros(len(self.options), dtype=observation.dtype)
            if self._run and is_now:
                running[self._run.index - self.primitive_count] = 1
            observation = np.concatenate([observation, mask[self.primitive_count :].astype(observation.dtype), running])
        if is_now:
            self._shown = observation
        return observation

    def _find_consistent(self, step: DomainStep, choice: int | None) -> tuple[tuple[int, float], ...]:
        """Return the actions with a Markov policy that would have chosen this primitive, with their beta."""
        found = [(choice, 1.0)] if choice is not None and self.primitive_count else []
        for index, option in enumerate(self.options, self.primitive_count):
            if option.is_markov and option.initiation(step.state) and self._agrees(option, step):
                found.append((index, read_termination(option, step.next_state)))
        return tuple(found)

    def _agrees(self, option: Option, step: DomainStep) -> bool:
        chosen, domain = option.policy(step.state), self._domain
        return not isinstance(chosen, Option) and np.array_equal(check_choice(option, chosen, domain), step.action)


def _make_domain(domain: Callable[[gymnasium.Env], OptionDomain] | None, env: gymnasium.Env) -> OptionDomain:
    made = make_option_domain(env) if domain is None else domain(env) if callable(domain) else domain
    if not isinstance(made, OptionDomain):
        raise ConfigError("OptionsEnv.domain", domain, "a function of the environment that returns its OptionDomain")
    return made


def make_options_env(config: str | RoomConfig | dict[str, Any] = "paper-two-button", *, option_features: bool = False,
                     **arguments: Any) -> OptionsEnv:
    """Make an `EscapeRoomEnv` wrapped in an `OptionsEnv`; entry point of the ids `hrl_escape/<Preset>Options-v1`.

    Args:
        config: configuration of the room, see `EscapeRoomEnv`.
        option_features: append option features to the observation, as `OptionsEnv(observation="options")` does.
        arguments: arguments of `OptionsEnv` (except `observation` and `domain`) and of `EscapeRoomEnv`, such as
            `observation="features"`. With `render_mode="rgb_array_list"`, `render()` returns the frames of all
            primitives since the last call or reset.
    """
    names = inspect.signature(OptionsEnv).parameters.keys() - {"env", "observation", "domain"}
    own = {name: arguments.pop(name) for name in names & arguments.keys()}
    films_primitives = arguments.get("render_mode") == "rgb_array_list"
    if films_primitives:
        arguments["render_mode"] = "rgb_array"
    env: gymnasium.Env = EscapeRoomEnv(config, **arguments)
    if films_primitives:
        env = RenderCollection(env)
    return OptionsEnv(env, observation="options" if option_features else "pass", **own)
