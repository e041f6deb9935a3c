"""The `Agent` protocol, its settings and the SMDP transition: the interface between agents and environments.

Agents learn from SMDP transitions (Sutton, Precup and Singh 1999, section 3): one decision runs k >= 1 primitives. A
flat environment is the case k = 1, so each algorithm is written once. This module depends on Gymnasium and `info`,
not on rooms or options.
"""

from __future__ import annotations

import inspect
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from hrl_escape.agents.decisions import AgentPolicy, Policy, SMDPTransition, to_plain_action
from hrl_escape.agents.state import Stateful, StateTree
from hrl_escape.errors import AgentSettingsError, StepContractError, UnsupportedSpaceError
from hrl_escape.settings import Range, Settings
from hrl_escape.step_info import read_option, read_payment, read_trace

# --- settings ---------------------------------------------------------------------------


@dataclass(frozen=True)
class AgentSettings(Settings):
    """Base class of agent settings; invalid values raise `AgentSettingsError`."""

    _error = AgentSettingsError


@dataclass(frozen=True)
class DiscountSettings(AgentSettings):
    """Discount of agents that count time in primitives alone."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""


@dataclass(frozen=True)
class LearningSettings(AgentSettings):
    """Discounting of actions of different duration, treatment of truncated episodes, and the clock of schedules."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive, or per decision if `discounting` is `decision`. Higher values look further ahead and
    learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma, as the
    paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination, as in the
    paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""


# --- the protocol -----------------------------------------------------------------------

CATALOGUE = "hrl_escape.agents.algorithms"
"""Package of the algorithms, one file each, named like the file."""
SUCCESS_KEYS = ("is_success", "success")
"""Keys of `info` for an episode's success; the first with a value counts."""


class RunningCall(NamedTuple):
    """One running call of a hierarchical agent, for display."""

    task: str  # its name
    context: Any  # argument from its caller, or None without one
    primitives: int  # run since the call
    ends: float  # probability that it is over at the moment of the choice
    place: tuple[float, float] | None = None  # x and y of its goal on the floor, m, or None if it has no place


class Agent(Stateful, ABC):
    """Base class of agents. A subclass defines the abstract members and declares its `STATE`; `train` can then run it.

    `STATE` names the attributes that learning depends on: weights, optimiser, replay, counters, generators; see
    `hrl_escape.agents.state`.

    For `make_agent` by name, a class also has `Settings`, a frozen dataclass such as an `AgentSettings`. It is
    constructed as `Class(observation_space, action_space, seed, settings)`, with Discrete or Box actions as the class
    supports; the seed determines all of its randomness. It is published under the entry-point group
    `hrl_escape.agents`:

        [project.entry-points."hrl_escape.agents"]
        my-agent = "my_package.my_module:MyAgent"

    All other members are optional and declare further abilities of an agent.
    """

    name: ClassVar[str] = ""
    """Name in messages: by default the class's name, and for the algorithms of this package the name of their file,
    which `make_agent` accepts."""
    Settings: ClassVar[type]
    """Dataclass of its settings; by default the annotation of `settings` in the class, found in its module."""
    recipes: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """Name -> settings, in addition to `default`, which is `Settings()`; prefixed with `smdp-` for agents over
    options."""
    acts_in: ClassVar[tuple[str, ...]] = ("discrete",)
    """Action spaces that it supports: `discrete`, `box` or both."""
    needs_trace: ClassVar[bool] = False
    """True if the agent learns from `SMDPTransition.trace`; `train` then turns traces on in environments of options."""
    is_frozen: ClassVar[bool] = False
    """True if the agent is evaluated without training, as a `FrozenAgent` is."""
    is_resumable: ClassVar[bool] = True
    """False if the state between episodes cannot be saved; a stopped run then starts again."""
    is_markov: bool = False
    """True if `act_greedy` is a function of the observation and the legal actions, without randomness and memory."""
    settings: Any
    """The settings that the agent was made with."""
    origin: Mapping[str, Any] = MappingProxyType({})
    """Training of the agent, filled in by `train` and `load_agent`: `agent`, `run` (key of the run's folder, empty
    without one), `seed` and `primitives`; empty for an untrained agent."""
    privileges: tuple[str, ...] = ()
    """Information that it is given and a flat agent is not."""
    _evaluation: tuple[Any, ...] | None = None
    """Generator of the running evaluation, which identifies it, and the agent's memory of its episode."""
    made_for: int | tuple[int, ...] | None = None
    """Number of actions of the Discrete space, or shape of the Box, that it was made with; None if its class is
    constructed in another way."""

    def __init_subclass__(cls, **named: Any) -> None:
        """Set the default name, of the file for an algorithm and of the class otherwise, and find `Settings`."""
        super().__init_subclass__(**named)
        if (said := inspect.get_annotations(cls).get("settings")) and "Settings" not in cls.__dict__:
            declared = getattr(sys.modules[cls.__module__], said, None) if isinstance(said, str) else said
            if declared is None:
                raise TypeError(f"{cls.__name__}: its module has no {said}; name the class by `Settings = ...`, too")
            if isinstance(declared, type) and is_dataclass(declared):
                cls.Settings = declared
        package, _, file = cls.__module__.rpartition(".")
        if package.startswith(CATALOGUE):
            cls.name = file.replace("_", "-")
        else:
            giver = next(base for base in cls.__mro__ if "name" in vars(base))
            if giver.name in ("", giver.__name__) or giver.__module__.startswith(CATALOGUE):
                cls.name = cls.__name__

    def __new__(cls, *arguments: Any, **named: Any) -> Self:
        """Record the number of actions."""
        made = super().__new__(cls)
        space = named.get("action_space", arguments[1] if len(arguments) > 1 else None)
        if isinstance(space, (gymnasium.spaces.Discrete, gymnasium.spaces.Box)):
            made.made_for = _find_form(space)
        return made

    @property
    def gamma(self) -> float:
        """Discount per primitive of `SMDPTransition.reward` and `.discount`."""
        return self.settings.gamma

    @abstractmethod
    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> Any:
        """Choose an action for learning: explore, from the agent's own generator.

        An int in a Discrete space; in a Box a float32 array, and the mask is empty.
        """

    @abstractmethod
    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> Any:
        """Choose an action for evaluation, without any change of the agent.

        A stochastic policy draws from `rng`, never from the agent's own generator. Evaluating twice then gives the same
        numbers, and evaluation does not change learning.
        """

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the exact state of `state_dict`; a running evaluation loses the memory of its episode."""
        super().load_state_dict(state)
        self._evaluation = None

    def recall(self, rng: np.random.Generator) -> tuple[Any, ...] | None:
        """Return the memory of an evaluation's episode, identified by its generator, or None in a new one."""
        return self._evaluation[1:] if self._evaluation is not None and self._evaluation[0] is rng else None

    def note_budget(self, primitives: int) -> None:  # noqa: B027
        """Receive the budget of a run before its first episode; by default do nothing.

        For agents whose schedules follow the length of training.
        """

    def note_outcome(self, transition: SMDPTransition, rng: np.random.Generator) -> None:  # noqa: B027
        """Receive the outcome of the latest `act_greedy` with this generator in evaluation; by default do nothing.

        For agents that count primitives within an episode: a decision can last several.
        """

    def make_policy(self) -> Policy:
        """Make a policy that chooses as evaluation does: `act_greedy`, with the memory of an episode of its own."""
        return AgentPolicy(self)

    @abstractmethod
    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn from one decision and return numbers to log, such as the loss.

        Transitions come in order, each from the state reached by the one before, until one is terminated or
        truncated.
        """

    def compute_values(self, observation: Any) -> NDArray | None:
        """Return Q(s, .) at an observation in units of return, (actions,), or None without action values."""
        return None

    def compute_preferences(self, observation: Any) -> NDArray | None:
        """Return the unmasked numbers whose argmax is the greedy action, (actions,), or None without them.

        For agents with preferences other than values, such as the logits of a policy.
        """
        return None

    def compute_state_value(self, observation: Any) -> float | None:
        """Return V(s) of a critic, in units of return, or None without one."""
        return None

    def list_calls(self) -> tuple[RunningCall, ...]:
        """Return the nested calls behind the latest choice, in learning or evaluation, the outermost first."""
        return ()

    def get_options(self) -> tuple[OptionPolicy, ...]:
        """Return the learned policies of the agent, each with its own initiation and termination.

        `hrl_escape.options.make_learned_options` makes options of them. The default is the greedy policy, which never
        ends by itself.
        """
        return (OptionPolicy("policy", self, lambda: _WholeRun(self), is_markov=self.is_markov),)

    def get_graph(self) -> frozenset[tuple[int, int]] | None:
        """Return the edges (parent, child) of a learned graph of observation components, or None without a graph."""
        return None


class FixedPolicy(Agent):
    """Base of agents that follow a fixed rule: a subclass defines `act`, which evaluation uses unchanged."""

    Settings: ClassVar[type] = DiscountSettings
    STATE = ()
    settings: Any = DiscountSettings()

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> Any:
        """Return the choice of `act`."""
        return self.act(observation, action_mask)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Ignore the decision and return no numbers."""
        return {}


# --- learned policies ------------------------------------------------------------------


class OptionRun(Protocol):
    """One run of a learned policy, from its start."""

    def act(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator, /) -> int:
        """Choose an action, as evaluation does; random choices are drawn from `rng`."""
        ...

    def compute_termination(self, observation: Any, action_mask: NDArray[np.bool_], /) -> float:
        """Return the probability beta(s') of ending at the state after the latest action."""
        ...


@dataclass(frozen=True)
class OptionPolicy:
    """A learned policy of an agent, with its own initiation and termination.

    It acts by the present parameters of the agent, which further learning changes.
    """

    name: str  #: unique among the policies of an agent
    agent: Agent  #: its agent
    begin: Callable[[], OptionRun]  #: makes a run
    can_start: Callable[[Any, NDArray[np.bool_]], bool] = lambda observation, action_mask: True
    """(observation, action mask) -> whether it may start there."""
    is_markov: bool = False  #: choice and end are functions of the observation and the legal actions alone

    @property
    def origin(self) -> Mapping[str, Any]:
        """Run that trained the agent, see `Agent.origin`."""
        return self.agent.origin


@dataclass(frozen=True)
class MarkovRun:
    """A run without memory, defined by two functions."""

    act: Callable[[Any, NDArray[np.bool_], np.random.Generator], int]
    compute_termination: Callable[[Any, NDArray[np.bool_]], float]  # a truth value will do


class _WholeRun:
    """The greedy policy of an agent, which never ends by itself."""

    def __init__(self, agent: Agent) -> None:
        self._policy, self._has_begun = agent.make_policy(), False

    def act(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        if not self._has_begun:
            # The caller's generator may serve several runs; what one draws must not depend on the others.
            self._policy.begin_episode(rng if self._policy.is_markov else np.random.default_rng(
                int(rng.integers(2**63))))
            self._has_begun = True
        return self._policy.choose(observation, action_mask)

    def compute_termination(self, observation: Any, action_mask: NDArray[np.bool_]) -> float:
        return 0.0


# --- what an environment reports --------------------------------------------------------


class GoalRule(NamedTuple):
    """Reward and termination of an environment with goals, by the convention of Gymnasium-Robotics' `GoalEnv`.

    Its observations are a Dict of `observation`, `achieved_goal` and `desired_goal` (Plappert et al. 2018). Agents give
    an empty `info`: both must be functions of the two goals alone.
    """

    compute_reward: Callable[[Any, Any, Mapping[str, Any]], Any]
    """(achieved, desired, info) -> reward of a step that led to these goals."""
    compute_terminated: Callable[[Any, Any, Mapping[str, Any]], Any]
    """The same -> whether the goals end the episode."""


def read_goal_rule(env: gymnasium.Env) -> GoalRule | None:
    """Return the rule of an environment, through any wrappers, or None if it lacks one of the two methods."""
    if not all(env.has_wrapper_attr(name) for name in GoalRule._fields):
        return None
    return GoalRule(*map(env.get_wrapper_attr, GoalRule._fields))


def read_action_mask(info: Mapping[str, Any], actions: int) -> NDArray[np.bool_]:
    """Read `info["action_mask"]` as bool (actions,) of its own memory; without one, all actions are legal.

    A Box has no mask: with `actions` 0 the result is empty.

    Raises:
        StepContractError: the mask has another length, or no action is legal.
    """
    mask = info.get("action_mask")
    if mask is None or not actions:
        return np.ones(actions, dtype=np.bool_)
    legal = np.asarray(mask) != 0
    if legal.shape != (actions,):
        raise StepContractError(f"info['action_mask'] has shape {legal.shape}; the action space needs ({actions},)")
    if not np.count_nonzero(legal):  # a fourth of the time of any(), at every decision
        raise StepContractError("info['action_mask'] is all zero: at least one action must always be legal")
    return legal


def read_success(info: Mapping[str, Any]) -> bool | None:
    """Read whether an episode succeeded from the `info` of its last step.

    Args:
        info: of the last step. `is_success` counts, else `success`; None counts as missing. Gymnasium's own
            environments define neither, and a termination alone is not a success.

    Returns:
        Success, or None if the environment reports neither.

    Raises:
        StepContractError: the value is not True, False, 1 or 0.
    """
    for name in SUCCESS_KEYS:
        value = info.get(name)
        if value is not None:
            return read_success_value(name, value)
    return None


def read_success_value(name: str, value: Any) -> bool:
    """Read a success of `info` under this name: True, False, 1 or 0, else `StepContractError`."""
    try:
        array = np.asarray(value)
    except ValueError:  # lists of unequal lengths
        array = np.asarray(None)
    if array.size != 1 or array.dtype.kind not in "biuf" or array.item() not in (0, 1):
        raise StepContractError(f"info[{name!r}] is {value!r} at the last step of an episode; success must be True, "
                                "False, 1 or 0. Leave the key out, or set it to None, if success is undefined")
    return bool(array.item())


def check_observation(observation: Any, when: str) -> None:
    """Check that all numbers of an observation are finite, in tables and tuples too; `when` names its moment.

    Raises:
        StepContractError: it has NaN or an infinity; the message names the first.
    """
    if isinstance(observation, np.ndarray):
        if observation.dtype.kind == "f" and not np.isfinite(observation).all():
            place = tuple(int(index) for index in np.argwhere(~np.isfinite(observation))[0])
            raise StepContractError(f"the observation {when} has {observation[place]} at index "
                                    f"{place[0] if len(place) == 1 else place}; observations must be finite numbers")
    elif isinstance(observation, Mapping):
        for name, part in observation.items():
            check_observation(part, f"{when}, {name!r},")
    elif isinstance(observation, (tuple, list)):
        for part in observation:
            check_observation(part, when)
    elif isinstance(observation, (float, np.floating)) and not math.isfinite(observation):
        raise StepContractError(f"the observation {when} is {observation}; observations must be finite numbers")


def make_transition(observation: Any, action: Any, action_mask: NDArray[np.bool_],
                    step: tuple[Any, Any, bool, bool, Mapping[str, Any]], gamma: float) -> SMDPTransition:
    """Turn the result of `env.step` into an SMDP transition at this gamma.

    The contract of `info`, all keys optional:

    - `duration`: int k >= 1, primitives that ran; absent means 1.
    - `discounted_reward` and `discount`: R = sum gamma^i r_i and gamma^k, read where the gamma is the agent's (see
      `set_option_discount`).
    - `rewards`: the k primitive rewards in order, to compute R at any gamma. One of the two ways is needed
      where k > 1.
    - `summed_reward`: the undiscounted sum, where `rewards` are left out.
    - `action_mask`: see `read_action_mask`; at the state reached.
    - `option`: a mapping whose `ended` is one of `hrl_escape.step_info.ENDINGS`, `episode-over` where the episode's end
      stopped the option, so that a truncation cut it; without it, every truncated action of several primitives is
      taken for cut.
    - `trace`: one tuple per primitive. It begins with (observation, action, reward,
      next_observation) and can have the attributes `next_action_mask` and `consistent`: pairs (action, beta)
      of the actions whose policy, a function of the state alone, does this same primitive here, with
      their termination probability at the next state. A primitive is consistent with itself, beta = 1. An item
      can represent several primitives, a decision of a level below; it then has their `rewards`.

    `reward` must be the sum of the primitive rewards or their discounted sum. Where it is neither, a wrapper changed it
    after the primitives were summed, and the step is refused: below the options such a wrapper acts on every primitive.
    A step without `duration` is one primitive, and its `reward` counts. So is a step whose `duration` is not a whole
    number and comes without the other keys: the environment then uses the name for something else.

    Args:
        observation: at the decision.
        action: the action taken.
        action_mask: bool (actions,), the actions legal there; (0,) for a Box.
        step: the result of `env.step(action)`.
        gamma: discount per primitive.

    Raises:
        StepContractError: a reward or observation is not finite, the observation's shape is another one, the duration
            is below 1, the rewards do not match it, or a wrapper changed the reward of a decision.
        DiscountMismatchError: only `discounted_reward` is given and for another gamma.
    """
    next_observation, reward, terminated, truncated, info = step
    check_observation(next_observation, f"after action {action}")
    if isinstance(observation, np.ndarray) and np.shape(next_observation) != observation.shape:
        raise StepContractError(f"the observation after action {action} has shape {np.shape(next_observation)}; "
                                f"the one before it has {observation.shape}")
    paid = read_payment(reward, info, f"of action {action}")
    duration = paid.duration
    option = read_option(info)
    cut = truncated and not terminated and (duration > 1 if option is None else option["ended"] == "episode-over")
    return SMDPTransition(
        observation, to_plain_action(action), action_mask, paid.compute_discounted(gamma), paid.summed, duration,
        gamma**duration, next_observation, read_action_mask(info, len(action_mask)), bool(terminated), bool(truncated),
        read_trace(info, duration), bool(cut))


def set_option_discount(env: Any, gamma: float) -> None:
    """Set the discount of every `OptionsEnv` in an environment, so that its `discounted_reward` is at this gamma.

    Environments without options remain unchanged. `train` and `evaluate` call it with the agent's gamma.

    Args:
        env: an environment, a vector environment, or streams.
        gamma: discount per primitive, in [0, 1].
    """
    name = "set_option_discount"
    inner = getattr(env, "unwrapped", env)
    if isinstance(env, gymnasium.Env):
        if env.has_wrapper_attr(name):
            env.get_wrapper_attr(name)(gamma)
    elif hasattr(inner, name):
        getattr(inner, name)(gamma)
    elif isinstance(inner, gymnasium.vector.SyncVectorEnv):
        for each in inner.envs:
            set_option_discount(each, gamma)
    elif isinstance(inner, gymnasium.vector.AsyncVectorEnv) and all(inner.call("has_wrapper_attr", name)):
        inner.call(name, gamma)


def compute_backup(decided: Any, settings: Any) -> tuple[Any, Any]:
    """R and b of the backup R + b V(s'), which hold all that a learner needs to know of durations and ends.

    With `discounting="primitive"`: R = sum gamma^i r_i and b = gamma^k (1 - terminated). Truncation keeps b
    unless `bootstrap_on_truncation` is off. Backups compose: (R1, b1) then (R2, b2) is (R1 + b1 R2, b1 b2).

    Args:
        decided: an `SMDPTransition`, or `Decisions` of n rows.
        settings: `LearningSettings`, or others with these fields.

    Returns:
        Numbers, or arrays (n,).
    """
    if settings.discounting == "primitive":
        reward, factor = decided.reward, decided.discount
    else:
        reward, factor = decided.summed_reward, settings.gamma
    ended = decided.terminated | (decided.truncated & (not settings.bootstrap_on_truncation))
    return reward, factor * (ended == 0)


def count_actions(action_space: gymnasium.Space, agent: str) -> int:
    """Number of actions of a discrete space that starts at 0.

    Raises:
        UnsupportedSpaceError: the space is of another kind.
    """
    if not isinstance(action_space, gymnasium.spaces.Discrete) or action_space.start != 0:
        advice = "; `hrl-escape list agents` shows which agents act in a Box" if isinstance(
            action_space, gymnasium.spaces.Box) else ""
        raise UnsupportedSpaceError(f"{agent} chooses among Discrete(n) actions from 0, not {action_space}{advice}")
    return int(action_space.n)


def count_choices(action_space: gymnasium.Space, agent: str) -> int:
    """Length of action masks: the number of actions of a Discrete space that starts at 0, and 0 for a Box.

    Raises:
        UnsupportedSpaceError: the space is of another kind.
    """
    return 0 if isinstance(action_space, gymnasium.spaces.Box) else count_actions(action_space, agent)


def _find_form(action_space: Any) -> int | tuple[int, ...]:
    """Number of actions of a Discrete space, or shape of a Box."""
    return action_space.shape if isinstance(action_space, gymnasium.spaces.Box) else int(action_space.n)


def check_actions(agent: Agent, action_space: gymnasium.Space) -> int:
    """Length of action masks of an environment that is to run an agent; see `count_choices`.

    Raises:
        UnsupportedSpaceError: the space is neither a Box nor Discrete(n) from 0, or the agent was made for another.
    """
    name = type(agent).__name__
    actions = count_choices(action_space, name)
    if agent.made_for not in (None, _find_form(action_space)):
        made, has = (f"a Box of shape {form}" if isinstance(form, tuple) else f"{form} actions"
                     for form in (agent.made_for, _find_form(action_space)))
        raise UnsupportedSpaceError(f"this {name} was made for {made}, and the environment has {has}: give the "
                                    "environment of its training, with options where it had them")
    return actions


def check_same_observations(trained: gymnasium.Space, evaluated: gymnasium.Space) -> None:
    """Check that observations of the evaluation environment have the form of those in training; bounds may differ.

    Raises:
        UnsupportedSpaceError: they have not.
    """
    if describe_form(trained) != describe_form(evaluated):
        raise UnsupportedSpaceError(
            f"`eval_env` has observations {show_form(evaluated)}, but the agent is trained on observations "
            f"{show_form(trained)}. Make both with the same `observation=`; `gymnasium.make` and `make_vec` both use "
            "`state` by default")


def describe_form(space: gymnasium.Space) -> Any:
    """Kind, shape and kind of numbers of a space, and of all its parts, as a value to compare."""
    if isinstance(space, gymnasium.spaces.Dict):
        return {name: describe_form(part) for name, part in space.spaces.items()}
    if isinstance(space, gymnasium.spaces.Tuple):
        return tuple(describe_form(part) for part in space.spaces)
    if isinstance(space, gymnasium.spaces.Discrete):
        return "Discrete", int(space.n), int(space.start)
    if isinstance(space, gymnasium.spaces.Box):
        return "Box", space.shape, np.dtype(space.dtype).kind
    return repr(space)


def show_form(space: gymnasium.Space) -> str:
    """A space in words: its shape if it is a Box, else its text."""
    return f"of shape {space.shape}, {space.dtype}," if isinstance(space, gymnasium.spaces.Box) else f"in {space}"


def count_steps(transition: SMDPTransition, settings: LearningSettings) -> int:
    """Steps of the agent's clock in a decision: k with the clock in primitives, else 1."""
    return transition.duration if settings.clock == "primitive" else 1
