"""Domains: what options read of an environment. There is one for any Gymnasium environment, and one for rooms.

A domain provides the state for options, the names of the primitives, and additional entries of `info`. Derive from
`OptionDomain` to give options more than the observation.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar, runtime_checkable

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import QUIET, RoomState
from hrl_escape.env.poses import list_touched
from hrl_escape.env.rewards import Events
from hrl_escape.errors import OptionError, StepContractError, UnsupportedError, show_value
from hrl_escape.options.option import Option
from hrl_escape.options.option_sets import DEFAULT_SET, OptionSetSource, check_option_set

TERMINATIONS = 0x0971
"""Key of the stream of terminations, distinct from other streams with the same seed."""


class DomainStep(NamedTuple):
    """One step of the wrapped environment inside a decision."""

    action: Any  # action that the wrapped environment took
    state: Any  # state that options saw before it
    next_state: Any  # state that they see after it
    observation: Any  # of the wrapped environment, after
    rewards: tuple[float, ...]  # one a primitive; one, unless the wrapped environment has options itself
    info: Mapping[str, Any]  # of the wrapped environment, after
    events: Events = QUIET  # of a room; empty elsewhere, and above other options


@runtime_checkable
class RoomEnv(Protocol):
    """Environment with a room and its full state."""

    @property
    def instance(self) -> RoomInstance:
        """Return the present instance of the room."""
        ...

    @property
    def events(self) -> Events:
        """Return the events of the latest primitive."""
        ...

    def get_state(self) -> RoomState:
        """Return the present full state."""
        ...


Layer = TypeVar("Layer")
"""Kind of a wrapper."""


@runtime_checkable
class OptionLevel(Protocol):
    """An environment of options, as a higher level uses it."""

    action_names: tuple[str, ...]  # of its actions, in their order
    primitive_count: int  # actions that are primitives; they come first
    level: int  # environments of options below it


class OptionDomain:
    """Domain of any Gymnasium environment, whose options read the observation.

    Derive from it to give options another state, and pass the class to `OptionsEnv(env, options, domain=...)`:

        class Cells(OptionDomain):
            def get_state(self, observation):
                return self.env.unwrapped.agent_pos

    Args:
        env: the environment that options act in, wrapped or not.

    Attributes:
        env: the same.
        lower: the nearest environment of options below, if there is one. Its actions are the primitives here.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        self.env = env
        self.lower = find_layer(env, OptionLevel)
        self._discrete = env.action_space if isinstance(env.action_space, spaces.Discrete) else None

    @property
    def level(self) -> int:
        """Return the number of environments of options below."""
        return 0 if self.lower is None else self.lower.level + 1

    @property
    def subject(self) -> Any:
        """Return the argument of a function that makes options: here the environment."""
        return self.env

    def has_left(self, subject: Any) -> bool:
        """Return whether the subject has changed, so its options must be made again."""
        return False

    @property
    def action_names(self) -> tuple[str, ...]:
        """Return the names of the primitives: the numbers of a Discrete action space, otherwise none."""
        space = self._discrete
        if space is None:
            return ()
        if self.lower is not None and len(self.lower.action_names) == space.n:
            return self.lower.action_names
        return tuple(str(self.make_action(index)) for index in range(int(space.n)))

    def make_default_options(self, option_set: str, planner: str) -> Any:
        """Return the default options of an environment, or a function that makes them.

        Args:
            option_set: name of an option set.
            planner: planning method, as in `RoomPlanner`.

        Raises:
            UnsupportedError: the environment is not a room.
        """
        raise UnsupportedError(f"{self.env} is not a room, so there are no planned options: give "
                               "OptionsEnv(env, options) a list of them")

    def get_state(self, observation: Any) -> Any:
        """Return the present state for options.

        Args:
            observation: last observation of the environment.
        """
        return observation

    def get_events(self) -> Events:
        """Return the events of the latest step; here none."""
        return QUIET

    def get_idle_action(self, mask: NDArray[np.int8]) -> Any:
        """Return the primitive of a decision that cannot run: the first legal one, or the action nearest to zero.

        Args:
            mask: legal primitives, int8 (primitives,); empty unless the action space is Discrete.
        """
        space = self.env.action_space
        if self._discrete is not None:
            return self.make_action(int(np.argmax(mask)))
        if isinstance(space, spaces.Box):
            return np.clip(np.zeros(space.shape, space.dtype), space.low, space.high)
        if isinstance(space, (spaces.MultiDiscrete, spaces.MultiBinary)):
            return np.zeros(space.shape, space.dtype) + getattr(space, "start", 0)
        raise UnsupportedError(f"a decision that cannot run costs one primitive, and {space} has no default one: "
                               "give OptionsEnv a domain with get_idle_action")

    def make_action(self, index: int) -> Any:
        """Return the primitive of a choice. The numbers of a Discrete space can begin above 0."""
        return index if self._discrete is None else index + int(self._discrete.start)

    def find_choice(self, action: Any) -> int | None:
        """Return the choice of a primitive, or None unless the action space is Discrete."""
        return None if self._discrete is None else int(action) - int(self._discrete.start)

    def check_action(self, action: Any) -> Any:
        """Convert an option's primitive to the form that the environment takes.

        Raises:
            OptionError: the environment does not accept it.
        """
        space = self.env.action_space
        if self._discrete is not None:
            try:
                number = operator.index(np.asarray(action).item())
            except (TypeError, ValueError):
                number = None
            if number is None or not 0 <= number - int(self._discrete.start) < self._discrete.n:
                raise OptionError(f"no action of {space}: {action!r}")
            return number
        if isinstance(space, (spaces.Box, spaces.MultiDiscrete, spaces.MultiBinary)):
            array = np.asarray(action, space.dtype)
            if array.shape != space.shape:
                raise OptionError(f"no action of {space}, whose shape is {space.shape}: {action!r} of {array.shape}")
            return array
        return action

    def get_mask(self, info: Mapping[str, Any]) -> NDArray[np.int8]:
        """Return the legal primitives, int8 (primitives,), from `info["action_mask"]`; all without such a key.

        Raises:
            StepContractError: the mask has another length.
        """
        count = 0 if self._discrete is None else int(self._discrete.n)
        mask = info.get("action_mask")
        if mask is None or not count:
            return np.ones(count, np.int8)
        legal = (np.asarray(mask) != 0).astype(np.int8)
        if legal.shape != (count,):
            raise StepContractError(f"info['action_mask'] has shape {legal.shape}; the action space needs ({count},)")
        return legal

    def make_key(self, seed: int | None) -> list[int] | None:
        """Return the key of the random stream for terminations and policies, or None to continue the last one.

        Args:
            seed: seed of `reset`.
        """
        return None if seed is None else [seed, TERMINATIONS, *([self.level] if self.level else [])]

    def inform(self, info: dict[str, Any], steps: Sequence[DomainStep], option: Option | None,
               unavoidable: Sequence[str] = ()) -> None:
        """Add the entries of this kind of environment to a decision's `info`; here none.

        Args:
            info: of the decision, changed in place.
            steps: steps of the decision; none at a reset.
            option: the option that ran, if any.
            unavoidable: names of the targets that its plan had to press on the way.
        """


class RoomDomain(OptionDomain):
    """Domain of a room. Options read its full state and are made for its instance, and `info` marks pressed targets.

    Raises:
        UnsupportedError: a wrapper below changed the action space.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        room = env.unwrapped
        assert isinstance(room, RoomEnv)
        self.room = room
        if self._discrete is None and not isinstance(room, EscapeRoomContinuousEnv):
            raise UnsupportedError(f"options choose primitives by number, but a wrapper below changed the action "
                                   f"space to {env.action_space}. Apply that wrapper after OptionsEnv")
        self._count = 0 if self._discrete is None else int(self._discrete.n)
        self._numbers: dict[Any, int] = {}  # of rooms, in order of first appearance

    @property
    def subject(self) -> RoomInstance:
        """Return the present instance of the room."""
        return self.room.instance

    def has_left(self, subject: RoomInstance) -> bool:
        """Return whether the room has another instance now."""
        return self.room.instance is not subject and self.room.instance.id != subject.id

    @property
    def action_names(self) -> tuple[str, ...]:
        """Return the names of the room's primitives, or of the actions of the environment of options below."""
        if self.lower is not None or self._discrete is None:
            return super().action_names
        return self.room.instance.robot.actions.names

    def make_default_options(self, option_set: str, planner: str) -> Any:
        """Return the function that makes the options of any room.

        Raises:
            UnknownNameError: no option set has this name.
            OptionError: the actions below are options themselves.
            UnsupportedError: over velocities, for an option set other than `press`.
        """
        check_option_set(option_set)
        if self.lower is not None:
            raise OptionError("planned options choose primitives, and the actions below are options themselves: give "
                              "OptionsEnv(env, options) options that choose among them")
        if isinstance(self.room, EscapeRoomContinuousEnv):
            if option_set != DEFAULT_SET:
                raise UnsupportedError(f"option_set = {option_set!r}: options over velocities are those of "
                                       f"{DEFAULT_SET!r}; use an environment of primitives")
            from hrl_escape.options.tracked import TrackedSource  # loads the planners

            return TrackedSource.of(self.room, planner)
        return OptionSetSource(option_set, planner)

    def get_state(self, observation: Any) -> RoomState:
        """Return the full state of the room."""
        return self.room.get_state()

    def get_events(self) -> Events:
        """Return the events of the latest primitive; none above other options, whose steps are several primitives."""
        return QUIET if self.lower is not None else self.room.events

    def get_idle_action(self, mask: NDArray[np.int8]) -> Any:
        """Return the primitive of a decision that cannot run: turn left, the first legal option, or zero velocity."""
        turns = self._discrete is not None and (self.lower is None or self.lower.primitive_count > 0)
        return self.room.instance.robot.actions.wait if turns else super().get_idle_action(mask)

    def check_action(self, action: Any) -> Any:
        """Convert an option's primitive to the form that the room takes."""
        return action if type(action) is int and 0 <= action < self._count else super().check_action(action)

    def make_key(self, seed: int | None) -> list[int]:
        """Return the key: the episode's noise key and its primitives. A restored episode has its own key."""
        state = self.room.get_state()
        return [state.noise_key, state.primitives, TERMINATIONS, *([self.level] if self.level else [])]

    def inform(self, info: dict[str, Any], steps: Sequence[DomainStep], option: Option | None,
               unavoidable: Sequence[str] = ()) -> None:
        """Add the targets `pressed`, `also_pressed` and `unavoidable`, each int8 (targets,).

        `instance` becomes a number, which does not identify the graph of the room.
        """
        names = self.room.instance.frame.target_names
        if "instance" in info:
            info["instance"] = np.int64(self._numbers.setdefault(info["instance"], len(self._numbers)))
        pressed = np.zeros(len(names), dtype=np.int8)
        for step in steps:
            if self.lower is not None:
                pressed |= step.info["pressed"]
            elif step.events.pressed:
                pressed[list(list_touched(step.events.pressed))] = 1
        also_pressed, forced = pressed.copy(), np.zeros_like(pressed)
        also_pressed[list(range(len(names)) if option is None or option.targets is None else option.targets)] = 0
        forced[[names.index(name) for name in unavoidable]] = 1
        info |= {"pressed": pressed, "also_pressed": also_pressed, "unavoidable": forced}


def make_option_domain(env: gymnasium.Env) -> OptionDomain:
    """Make the domain of an environment: a `RoomDomain` for rooms, otherwise an `OptionDomain`."""
    return RoomDomain(env) if isinstance(env.unwrapped, RoomEnv) else OptionDomain(env)


def find_layer(env: Any, kind: type[Layer]) -> Layer | None:
    """Return the outermost wrapper of an environment that is of a kind, or None."""
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, kind):
            return env
        env = env.env
    return None


# --- sources of options ---------------------------------------------------------------------

OptionsSource: TypeAlias = Sequence[Option] | Callable[[Any], Sequence[Option]]
"""Options, or a function that makes them from a room's instance or from any other environment."""


def make_options(source: OptionsSource, subject: Any) -> tuple[Option, ...]:
    """Make the options of a room's instance or of any other environment, and check them.

    Raises:
        OptionError: two options share a name, one is not an option, or one was made for another room.
    """
    given: Any = source(subject) if callable(source) else source
    if not isinstance(given, Iterable):
        raise OptionError(f"options = {show_value(given)}: give a list of options, or a function that makes them")
    made = tuple(given)
    for option in made:
        if not isinstance(option, Option):
            raise OptionError(f"{option!r} is not an Option: derive its class from Option, or make a FunctionOption")
    names = [option.name for option in made]
    if len(set(names)) < len(names):
        raise OptionError(f"option names must differ: {', '.join(names)}")
    here = subject.id if isinstance(subject, RoomInstance) else None
    for option in made:
        if option.instance is not None and option.instance.id != here:
            raise OptionError(f"option {option.name!r} was made for room {option.instance.id}, this one is "
                              f"{here or 'no room'}: give OptionsEnv a function that makes options for an instance")
    return made
