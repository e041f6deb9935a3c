"""Registry of agents: names, classes, named settings, and agents of third parties.

A file in `agents/algorithms` or in one of its families is an agent, named like the file; its class is the one `Agent`
that the file defines, abstract ones aside. Agents of the family `task_hierarchies` act by a given hierarchy, and agents
of `offline` learn from a data set, so spaces and settings alone are not enough to make them. Agents of `continuous` act
in a Box alone. Agents of `across_rooms` need options over the observation `objects`.

`smdp-dqn` and `dqn` are one implementation. The prefix makes the agent choose among options, and can change named
settings as the published program did. The random policy over options is `random-options`. Third-party
agents are registered by the entry-point group `hrl_escape.agents`. Algorithms are imported on first use.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterable
from functools import cache, partial
from pkgutil import walk_packages
from typing import Any

from hrl_escape.agents.agent import CATALOGUE, Agent
from hrl_escape.agents.keras_rl_2019.recipes import CHANGES
from hrl_escape.errors import AgentSettingsError, UnknownNameError
from hrl_escape.registry import Registry
from hrl_escape.settings import replace_settings

SMDP_PREFIX = "smdp-"
"""Prefix of the names of agents that choose among options."""
RANDOM_OPTIONS = "random-options"
"""Name of the random policy over options."""
DEFAULT_RECIPE, KERAS_RL = "default", "keras-rl-2019"
"""Named settings of every agent, and the settings of keras-rl 0.4.2 with the published 2019 program."""
SHARED_RECIPES: dict[str, dict[str, Any]] = {
    "patient": {"learning_rate": 1e-3, "epsilon_end": 0.1, "epsilon_steps": 30_000, "replay_capacity": 100_000},
    "three-parents": {"max_parents": 3},
}
"""Named settings of every agent that has such settings: longer exploration and a larger replay memory; and up to three
parents a button, for agents that learn structure."""
_NO_NAME = re.compile(r"[\s(@+]|^smdp-|^$")
"""Matches names that the text of a spec cannot hold."""
HIERARCHY_PARTS = ("hierarchy", "program", "goals", "goal_space", "landmarks", "tree")
"""Arguments of agents that take a structure, each a kind of its own."""


def list_agents() -> list[str]:
    """Names of all agents made from spaces and settings, for Discrete actions; each also exists over options.

    Shipped ones come first. `list_continuous_agents` lists those that act in a Box alone.
    """
    return [*_list_made(), *sorted(set(agents) - _find_shipped().keys() - ADAPTERS.keys())]


def list_many_env_agents() -> list[str]:
    """Names of the shipped agents that learn from many environments at once, in alphabetical order."""
    from hrl_escape.agents.single_env import MANY

    return [name for name in sorted([*_list_made(), *list_hierarchy_agents(), *list_continuous_agents()])
            if issubclass(get_agent_class(name), MANY)]


def split_name(name: str) -> tuple[str, bool]:
    """Name of an agent's algorithm, and whether the agent chooses among options."""
    if name == RANDOM_OPTIONS:
        return "random", True
    base = name.removeprefix(SMDP_PREFIX)
    return base, base != name


def join_name(algorithm: str, over_options: bool) -> str:
    """Name of the agent that runs an algorithm over options, or over primitives."""
    if not over_options:
        return algorithm
    return RANDOM_OPTIONS if algorithm == "random" else SMDP_PREFIX + algorithm


def get_agent_class(name: str) -> type[Agent]:
    """Return the class of a name, over options or not.

    Raises:
        UnknownNameError: no agent has this name; the message names the closest.
        AgentSettingsError: a third party's class is not an `Agent`.
        PluginError: a third party's class cannot be loaded.
    """
    check_agent_name(name)
    return agents.get(split_name(name)[0])


def find_agent_name(agent_class: type[Agent]) -> str:
    """Return the registered name of a class. A class without one is registered in this process, under its `name`.

    A class that is defined again, as in a cell of a notebook that runs twice, takes the place of the earlier one.

    Raises:
        AgentSettingsError: it has abstract methods, or another agent has its name.
    """
    for name in agents:
        module = _find_shipped().get(name, agent_class.__module__)
        if module == agent_class.__module__ and agents.get(name) is agent_class:
            return name
    name, missing = agent_class.name, sorted(agent_class.__abstractmethods__)
    if missing:
        raise AgentSettingsError("agent", agent_class.__name__, f"a class that defines {', '.join(missing)} too")
    try:
        inspect.signature(agent_class).bind(None, None, 0, None)
    except TypeError:
        raise AgentSettingsError("agent", agent_class.__name__, f"a class made as {agent_class.__name__}("
                                 "observation_space, action_space, seed, settings), so that each run can make its own"
                                 ) from None
    if not hasattr(agent_class, "Settings"):
        raise AgentSettingsError("agent", agent_class.__name__, "a class with `Settings`, the dataclass of its settings"
                                 )
    if (earlier := find_given_agent(name)) is not None and (earlier.__module__, earlier.__qualname__) == (
            agent_class.__module__, agent_class.__qualname__):
        agents.unregister(name)
    if name in agents or _NO_NAME.search(name):
        raise AgentSettingsError("agent", name, "a class whose `name` no other agent has, without blanks and any of "
                                 f"(@+: register_agent('my-agent', {agent_class.__name__}) gives it another")
    agents.register(name, agent_class)
    return name


def find_given_agent(name: str) -> type[Agent] | None:
    """Return the class of a name, over options or not, that this process registered, or None for any other agent."""
    return agents.find_given(split_name(name)[0])


def register_agent(name: str, agent_class: type[Agent]) -> None:
    """Register an agent under a name for this process; packages publish an entry point instead.

    Args:
        name: with `smdp-` in front of it the agent chooses among options.
        agent_class: constructed as `Class(observation_space, action_space, seed, settings)`.

    Raises:
        ConfigError: the class is not an `Agent`, or another agent has that name.
    """
    agents.register(name, agent_class)


def check_agent_name(name: str, others: Iterable[str] = ()) -> None:
    """Check that a name is an agent's, over options or not, without importing the agent.

    Args:
        name: to be checked.
        others: further names that the caller takes.

    Raises:
        UnknownNameError: no agent has this name; the message names the closest.
    """
    others = tuple(others)
    if name in others or (split_name(name)[0] in agents and join_name(*split_name(name)) == name):
        return
    over_options = name.startswith(SMDP_PREFIX)
    note = "" if over_options else f"; each also with {SMDP_PREFIX} in front, which chooses among options"
    known = [join_name(each, over_options) for each in list_all_agents()]
    raise UnknownNameError("agent", name, dict.fromkeys([*known, RANDOM_OPTIONS, *others]), note)


def _is_agent(thing: Any) -> bool:
    return issubclass(type(thing), type) and issubclass(thing, Agent)  # 3.10: isinstance(dict[str, int], type)


def _load_shipped(module: str) -> type[Agent]:
    """The one concrete agent that a module defines."""
    (found,) = (thing for thing in vars(importlib.import_module(module)).values()
                if _is_agent(thing) and thing.__module__ == module and not inspect.isabstract(thing))
    return found


@cache
def _find_shipped() -> dict[str, str]:
    """Name -> module of every shipped algorithm: first without a family, then family by family; imports none."""
    found = walk_packages(importlib.import_module(CATALOGUE).__path__, f"{CATALOGUE}.")
    modules = sorted((module.name for module in found if not module.ispkg), key=lambda name: name.count("."))
    return {module.rpartition(".")[2].replace("_", "-"): module for module in modules}


def _list_made() -> list[str]:
    """Names of the algorithms that spaces and settings make."""
    return [name for name, module in _find_shipped().items()
            if module.split(".")[-2] not in ("task_hierarchies", "offline", "continuous", "across_rooms")]


def find_agent_module(name: str) -> str | None:
    """Module of a shipped agent, without importing it, or None for an agent of a third party."""
    return _find_shipped().get(split_name(name)[0])


def list_recipes(name: str) -> dict[str, Any]:
    """Named settings of an agent, `default` first.

    `keras-rl-2019` reproduces keras-rl 0.4.2 and the published program, for the agents they contain. For agents over
    options, settings that are for options come before the general ones of the same name.

    Raises:
        UnknownNameError: no such agent.
    """
    agent_class, (base, over_options) = get_agent_class(name), split_name(name)
    settings = agent_class.Settings()
    recipes = {DEFAULT_RECIPE: settings, **agent_class.recipes}
    known = getattr(settings, "__dataclass_fields__", {})
    recipes |= {recipe: replace_settings(settings, changes) for recipe, changes in SHARED_RECIPES.items()
                if changes.keys() <= known.keys()}
    if base in _find_shipped() and base in CHANGES:
        recipes[KERAS_RL] = replace_settings(settings, CHANGES.get(name, CHANGES[base]))
    for_options = {recipe.removeprefix(SMDP_PREFIX): recipes.pop(recipe) for recipe in list(recipes)
                   if recipe.startswith(SMDP_PREFIX)}
    return recipes | for_options if over_options else recipes


def get_recipe(name: str, recipe: str = DEFAULT_RECIPE) -> Any:
    """Named settings of an agent; see `list_recipes`.

    Raises:
        UnknownNameError: no such agent, or it has no settings of that name.
    """
    recipes = list_recipes(name)
    if recipe not in recipes:
        raise UnknownNameError(f"named settings of {name}", recipe, list(recipes))
    return recipes[recipe]


def list_hierarchy_agents() -> list[str]:
    """Names of the shipped agents that act by a hierarchy that they are given."""
    return [name for name, module in _find_shipped().items() if module.startswith(f"{CATALOGUE}.task_hierarchies.")]


def list_offline_agents() -> list[str]:
    """Names of the shipped agents that learn from a data set."""
    return [name for name, module in _find_shipped().items() if module.startswith(f"{CATALOGUE}.offline.")]


def list_continuous_agents() -> list[str]:
    """Names of the shipped agents that act in a Box alone, such as velocities."""
    return [name for name, module in _find_shipped().items() if module.startswith(f"{CATALOGUE}.continuous.")]


def list_across_rooms_agents() -> list[str]:
    """Names of the shipped agents that learn in training rooms for unseen ones, from options over `objects`."""
    return [name for name, module in _find_shipped().items() if module.startswith(f"{CATALOGUE}.across_rooms.")]


def list_all_agents() -> list[str]:
    """Names of the agents of all these kinds."""
    return [*list_agents(), *list_hierarchy_agents(), *list_offline_agents(), *list_continuous_agents(),
            *list_across_rooms_agents()]


def find_hierarchy_part(agent: str | type[Agent]) -> str | None:
    """Name of the structure that an agent can be given, such as `hierarchy`, or None if it takes none.

    Raises:
        UnknownNameError: no such agent.
    """
    taken = inspect.signature(get_agent_class(agent) if isinstance(agent, str) else agent).parameters
    return next((part for part in HIERARCHY_PARTS if part in taken), None)


ADAPTERS = {"sb3": "hrl_escape.agents.sb3:SB3Learner"}
"""Name -> class of agents that train an algorithm of another library."""

agents: Registry[type[Agent]] = Registry(
    "agent", "a class derived from hrl_escape.agents.Agent", _is_agent,
    {**{name: partial(_load_shipped, module) for name, module in _find_shipped().items()}, **ADAPTERS})
"""Classes of all algorithms by name."""
