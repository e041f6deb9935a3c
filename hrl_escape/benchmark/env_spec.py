"""Environments of a grid from elsewhere: a Gymnasium id or a function that makes one, with options.

| text | meaning |
|---|---|
| `CartPole-v1`, `minigrid:MiniGrid-DoorKey-8x8-v0` | an id of `gymnasium.make` |
| `my_envs.py:make_env` | a function of a file |
| `my_package.envs:make_env` | a function or class of a module |

Options have the last two forms: a function from the environment to its options, or the options.

A function that is given in Python and cannot be imported, such as a lambda or a function of a notebook, gets a name
with a hash of its code. `cloudpickle` takes it to other processes, as Gymnasium does for `AsyncVectorEnv`.
"""

from __future__ import annotations

import dataclasses
import importlib
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Literal

import gymnasium
from gymnasium.vector import VectorEnv

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.env_description import compute_code_digest, compute_digest, describe_env, load_file
from hrl_escape.errors import EscapeError, GridError
from hrl_escape.files import write_json
from hrl_escape.names import join_words
from hrl_escape.settings import Settings

VALID_ENVS = ("a Gymnasium id such as CartPole-v1, a function that makes an environment, file.py:function or "
              "module:function")
_VERSION = re.compile(r".*-v\d+")
_given: dict[str, Any] = {}
"""Functions and options that were given in this process and cannot be imported, by their text."""


@dataclasses.dataclass(frozen=True)
class EnvSpec(Settings):
    """Environment of a grid, in place of rooms."""

    _section = "env"
    env: str = ""
    """Gymnasium id, file.py:function or module:function."""
    options: str = ""
    """Options for agents that choose among them, as file.py:function or module:function; empty for none, or where the
    environment has its own."""
    arguments: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Arguments of `gymnasium.make`, or of the function."""
    score: Literal["auto", "return", "success"] = "auto"
    """Number that agents are compared by: the mean return, or the success rate of `info["is_success"]`; `auto` takes
    the success rate where every episode reports it."""
    reference: float | None = None
    """Return to draw and to name for comparison, such as that of a solved task."""

    @classmethod
    def make(cls, env: str | Callable[..., gymnasium.Env], options: Any = None, **fields: Any) -> EnvSpec:
        """Describe an environment.

        Args:
            env: Gymnasium id, function that makes an environment, or text of either.
            options: options, function from the environment to them, or text; None for none.
            **fields: further fields.

        Raises:
            GridError: `env` is neither.
        """
        if isinstance(env, gymnasium.Env):
            raise GridError(f"env is an environment, {env}: give a function that makes it, so that every run has its "
                            "own, such as lambda: gymnasium.make('CartPole-v1')")
        if not isinstance(env, str) and not callable(env):
            raise GridError(f"env = {env!r} is not possible: give {VALID_ENVS}")
        return cls(_name_part(env), "" if options is None else _name_part(options), **fields)

    def check(self) -> None:
        """Require an environment."""
        if not self.env:
            raise GridError(f"an environment is missing: give {VALID_ENVS}")

    def __reduce__(self) -> tuple[Any, ...]:
        given = {text: _given[text] for text in (self.env, self.options) if text in _given}
        return _restore, (type(self), dict(vars(self)), given)

    @property
    def name(self) -> str:
        """Name in tables: the id, or the name of the function."""
        return re.sub(r".*<locals>\.", "", self.env.partition("#")[0].rpartition(":")[2])

    def make_flat(self) -> gymnasium.Env:
        """Make the environment without the options.

        Raises:
            GridError: there is no such environment, or its function fails.
        """
        made_by = None if self._is_id else _find_part(self.env, "env")
        try:
            made = gymnasium.make(self.env, **self.arguments) if made_by is None else made_by(**self.arguments)
        except EscapeError:
            raise
        except Exception as error:  # another package's code can raise anything
            raise GridError(f"the environment {self.env} cannot be made: {type(error).__name__}: {error}") from error
        if not isinstance(made, gymnasium.Env):
            raise GridError(f"{self.env} made {made!r}, which is not a gymnasium.Env")
        return made

    @property
    def _is_id(self) -> bool:
        return self.env not in _given and ".py:" not in self.env and (
            ":" not in self.env or bool(_VERSION.fullmatch(self.env)))

    def make_agent_env(self, agent: AgentSpec) -> gymnasium.Env:
        """Make the environment of an agent, with the options if it chooses among them.

        Raises:
            GridError: the agent needs a room, options that are missing, or the environment without its own options; or
            the function that makes the options fails.
        """
        if agent.low_level is not None or (agent.is_reference and not agent.is_frozen):
            what = "its hierarchy is made from a room" if agent.low_level else "it reads a room"
            raise GridError(f"{agent.label} needs a room, because {what}: leave it out, or give rooms in place of env")
        if agent.options.option_set != "press" or agent.options.memory:
            raise GridError(f"{agent.label} needs a room for its options: take {agent.name} and give the options of "
                            f"{self.name}")
        env, view = self.make_flat(), agent.options
        if agent.chooses_options and self.options:
            from hrl_escape.options.options_env import OptionsEnv  # loads the planners

            options = _find_part(self.options, "options")
            try:
                return OptionsEnv(env, options, include_primitives=view.include_primitives, trace=agent.needs_trace,
                                  interruptible=view.interruptible, max_duration=view.max_duration)
            except EscapeError:
                raise
            except Exception as error:  # the user's function can raise anything
                raise GridError(f"options = {self.options}: they cannot be made: {type(error).__name__}: {error}"
                                ) from error
        if agent.chooses_options == env.has_wrapper_attr("primitive_count"):
            return env
        env.close()
        if agent.chooses_options:
            raise GridError(f"{agent.label} chooses among options, and {self.name} has none: give options=")
        raise GridError(f"{agent.label} acts with primitives, and {self.name} has options: give env= without them, "
                        "and options=")

    def make_many(self, agent: AgentSpec, num_envs: int) -> VectorEnv:
        """Make copies of the environment that step together, without options.

        Raises:
            GridError: the environment has no Gymnasium id, or the agent chooses among options.
        """
        if not self._is_id:
            raise GridError(f"many copies need a Gymnasium id: gymnasium.make_vec makes none of {self.env}")
        if agent.chooses_options:
            raise GridError(f"{agent.label} chooses among options, which copies of {self.name} do not have: take "
                            f"{agent.algorithm}")
        return gymnasium.make_vec(self.env, num_envs=num_envs, **self.arguments)

    def make_place(self, agents: Sequence[AgentSpec]) -> EnvPlace:
        """Make the environment once for every kind of agent, and return it as a place of runs.

        Raises:
            GridError: see `make_agent_env`.
            EscapeError: options that are not valid.
        """
        for agent in agents:
            self.make_agent_env(agent).close()
        env = self.make_flat()
        described = describe_env(env)
        env.close()
        functions = [_find_part(text, role) for role, text in (("env", self.env), ("options", self.options))
                     if text and not (role == "env" and self._is_id)]
        identity = [described, self.arguments, *map(compute_code_digest, functions)]
        name = env.spec.id if "<lambda>" in self.name and env.spec is not None else self.name
        return EnvPlace(name, compute_digest(identity), self)


@dataclasses.dataclass(frozen=True)
class EnvPlace:
    """Environment where runs train and are evaluated."""

    name: str  # in tables
    id: str  # hash of its description, and of the code of the functions that make it and its options
    spec: EnvSpec  # how it is made
    split: None = None  # training and evaluation are in the same environment

    def save(self, folder: Path) -> None:
        """Write the settings to a file named by the id."""
        write_json(folder / f"{self.id}.json", {"env": self.spec.to_dict()})


def _restore(kind: type[EnvSpec], fields: Mapping[str, Any], given: Mapping[str, Any]) -> EnvSpec:
    _given.update(given)
    made = object.__new__(kind)
    vars(made).update(fields)
    return made


def _name_part(part: Any) -> str:
    """Return the text of a function or of options; what cannot be imported is kept in this process."""
    if isinstance(part, str):
        return part
    name = f"{getattr(part, '__module__', '')}:{getattr(part, '__qualname__', type(part).__name__)}"
    if not name.startswith(("__main__:", ":")) and "<" not in name:
        try:
            if resolve_name(name) is part:
                return name
        except (ImportError, AttributeError, ValueError):
            pass
    text = f"{name}#{compute_code_digest(part)}"
    _given[text] = part
    return text


def _find_part(text: str, role: str) -> Any:
    """Return the function or the options of a text.

    Raises:
        GridError: it cannot be found or loaded.
    """
    if text in _given:
        return _given[text]
    place, colon, name = text.rpartition(":")
    if "#" in text:
        raise GridError(f"{role} = {text} was given in another process: give the function again, or file.py:function")
    if not colon:
        raise GridError(f"{role} = {text} is not possible: give file.py:function or module:function")
    try:
        module = load_file(place) if place.endswith(".py") else importlib.import_module(place)
    except EscapeError:
        raise
    except (Exception, SystemExit) as error:  # the user's code can raise anything, and a script can end itself
        raise GridError(f"{role} = {text}: {place} cannot be loaded: {type(error).__name__}: {error}") from error
    try:
        return getattr(module, name)
    except AttributeError:
        known = [each for each, value in vars(module).items() if callable(value) and not each.startswith("_")]
        raise GridError(f"{role} = {text}: {place} has no {name}; it has {join_words(known)}") from None
