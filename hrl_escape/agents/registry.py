"""Names of agents: the list of them, agents made by name, and the door for agents of third parties.

A file in `agents/algorithms` or in one of its families is an agent, named like the file; its class is the one `Agent`
that the file defines, abstract ones aside. Those of the family `given` act by a hierarchy that they are given, and
those of `offline` learn from a data set, so spaces and settings alone do not make them.

`smdp-dqn` and `dqn` are one implementation; the prefix only says which view of an environment
is meant, and lets a recipe differ where the published program's did. Third-party agents arrive
through the entry-point group `hrl_escape.agents`. No algorithm is imported before it is asked for.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterable, Mapping
from functools import cache, partial
from pkgutil import walk_packages
from typing import Any

import gymnasium

from hrl_escape.agents.agent import CATALOGUE, Agent, read_goal_rule
from hrl_escape.agents.label import DEFAULT_RECIPE, SMDP_PREFIX, AgentLabel
from hrl_escape.agents.larg2019.recipes import PAPER
from hrl_escape.errors import AgentSettingsError, UnknownNameError
from hrl_escape.registry import Registry
from hrl_escape.settings import replace_settings

GIVEN_PARTS = ("hierarchy", "program", "goals", "goal_space", "landmarks", "tree")
"""Names under which agents take a structure, each a kind of its own."""
GOAL_RULE = "goal_rule"
"""Name under which agents take what an environment says of its goals; those that do not take it do without."""


def list_agents() -> list[str]:
    """Names of all agents made from spaces and settings, shipped ones first; each also exists with `smdp-`."""
    return [*_list_made(), *sorted(set(agents) - _find_shipped().keys())]


def list_stream_agents() -> list[str]:
    """Names of the shipped agents that learn from many environments at once, in alphabetical order."""
    from hrl_escape.agents.seam import MANY

    return [name for name in sorted([*_list_made(), *list_given_agents()])
            if issubclass(get_agent_class(name), MANY)]


def get_agent_class(name: str) -> type[Agent]:
    """The class behind a name, with or without the prefix `smdp-`.

    Raises:
        UnknownNameError: no agent has this name; the message names the closest.
        AgentSettingsError: a third party's class is no `Agent`.
        PluginError: a third party's class cannot be loaded.
    """
    base = name.removeprefix(SMDP_PREFIX)
    check_agent_name(name)
    return agents.get(base)


def register_agent(name: str, agent_class: type[Agent]) -> None:
    """Register an agent under a name for this process; packages publish an entry point instead.

    Args:
        name: the agent also exists with `smdp-` in front of it.
        agent_class: constructed as `Class(observation_space, action_space, seed, settings)`.

    Raises:
        ConfigError: the class is no `Agent`, or another agent has that name.
    """
    agents.register(name, agent_class)


def check_agent_name(name: str, others: Iterable[str] = ()) -> None:
    """Refuse a name that no agent has, with or without the prefix `smdp-`, without importing any.

    Args:
        name: to be checked.
        others: further names that the caller takes.

    Raises:
        UnknownNameError: no agent has this name; the message names the closest.
    """
    base = name.removeprefix(SMDP_PREFIX)
    others = tuple(others)
    if base in agents or name in others:
        return
    prefix = name[: len(name) - len(base)]
    note = "" if prefix else f"; each also with {SMDP_PREFIX} in front"
    known = (*list_agents(), *list_given_agents(), *list_offline_agents())
    raise UnknownNameError("agent", name, [*(prefix + each for each in known), *others], note)


def _is_agent(thing: Any) -> bool:
    return issubclass(type(thing), type) and issubclass(thing, Agent)  # 3.10: isinstance(dict[str, int], type)


def _load_shipped(module: str) -> type[Agent]:
    """The one concrete agent that a module defines."""
    (found,) = (thing for thing in vars(importlib.import_module(module)).values()
                if _is_agent(thing) and thing.__module__ == module and not inspect.isabstract(thing))
    return found


@cache
def _find_shipped() -> dict[str, str]:
    """Name -> module of every shipped algorithm: those of no family, then family by family; imports none of them."""
    found = walk_packages(importlib.import_module(CATALOGUE).__path__, f"{CATALOGUE}.")
    modules = sorted((module.name for module in found if not module.ispkg), key=lambda name: name.count("."))
    return {module.rpartition(".")[2].replace("_", "-"): module for module in modules}


def _list_made() -> list[str]:
    """Names of the algorithms that spaces and settings make."""
    return [name for name, module in _find_shipped().items() if module.split(".")[-2] not in ("given", "offline")]


def find_agent_module(name: str) -> str | None:
    """Module of a shipped agent, without importing it; None for an agent of a third party."""
    return _find_shipped().get(name.removeprefix(SMDP_PREFIX))


def list_recipes(name: str) -> dict[str, Any]:
    """Recipe -> the agent's settings under it, `corrected` first.

    `corrected` is what we recommend; `paper` is what keras-rl 0.4.2 and the published program did, for agents that it
    had. With the prefix `smdp-`, settings for options come before the general ones of the same recipe.

    Raises:
        UnknownNameError: no such agent.
    """
    agent_class, base = get_agent_class(name), name.removeprefix(SMDP_PREFIX)
    settings = agent_class.Settings()
    recipes = {"corrected": settings, **agent_class.recipes}
    if base in _find_shipped() and base in PAPER:
        recipes["paper"] = replace_settings(settings, PAPER.get(name, PAPER[base]))
    over_options = {recipe.removeprefix(SMDP_PREFIX): recipes.pop(recipe) for recipe in list(recipes)
                    if recipe.startswith(SMDP_PREFIX)}
    return recipes | over_options if name.startswith(SMDP_PREFIX) else recipes


def get_recipe(name: str, recipe: str = DEFAULT_RECIPE) -> Any:
    """The settings of an agent under a recipe; see `list_recipes`.

    Raises:
        UnknownNameError: no such agent, or it has no such recipe.
    """
    recipes = list_recipes(name)
    if recipe not in recipes:
        raise UnknownNameError(f"recipe of {name}", recipe, list(recipes))
    return recipes[recipe]


def make_agent(name: str, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
               recipe: str = DEFAULT_RECIPE, structure: Mapping[str, Any] | None = None, **settings: Any) -> Agent:
    """Make an agent by name.

    Args:
        name: one of `list_agents()`, with or without the prefix `smdp-`, or a label such as `smdp-dqn+objects+memory`.
            Its traits change settings; those about options describe the environment, whose spaces are given.
        observation_space: what it will see.
        action_space: Discrete.
        seed: 0 or more; all of the agent's randomness follows from it.
        recipe: `corrected` or `paper`; a label may name it too.
        structure: what the agent is given beside spaces and settings, such as a `hierarchy`; see `read_structure`.
        **settings: fields of the agent's settings to change, such as `gamma=0.995`; they come after the label's.

    Raises:
        UnknownNameError: no such agent, trait, recipe or setting.
        AgentSettingsError: a setting or the seed is not possible, the agent takes no such structure, or the label
            contradicts itself or `recipe`.
        UnsupportedSpaceError: the agent cannot use these spaces.
    """
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise AgentSettingsError("seed", seed, "a whole number of at least 0")
    label = AgentLabel.parse(name)
    name = label.name
    chosen = replace_settings(get_recipe(name, label.resolve_recipe(recipe)), {**label.settings, **settings})
    agent_class: Any = get_agent_class(name)
    taken = inspect.signature(agent_class).parameters
    given = {part: what for part, what in (structure or {}).items() if part != GOAL_RULE or part in taken}
    if unknown := [part for part in given if part not in taken]:
        takes = find_given_part(name)
        raise AgentSettingsError(f"structure of {name}", ", ".join(unknown),
                                 "none: this agent acts by no given hierarchy" if takes is None else
                                 f"{takes}, which this agent takes")
    return agent_class(observation_space, action_space, seed, chosen, **given)


def list_given_agents() -> list[str]:
    """Names of the shipped agents that act by a hierarchy that they are given."""
    return [name for name, module in _find_shipped().items() if module.startswith(f"{CATALOGUE}.given.")]


def list_offline_agents() -> list[str]:
    """Names of the shipped agents that learn from a data set."""
    return [name for name, module in _find_shipped().items() if module.startswith(f"{CATALOGUE}.offline.")]


def find_given_part(name: str) -> str | None:
    """Name of the structure that an agent can be given, such as `hierarchy`; None where it takes none.

    Raises:
        UnknownNameError: no such agent.
    """
    taken = inspect.signature(get_agent_class(name)).parameters
    return next((part for part in GIVEN_PARTS if part in taken), None)


def read_structure(env: gymnasium.Env) -> Mapping[str, Any]:
    """Structure for the agents in an environment: the attribute `structure` of one of its wrappers, and its `GoalRule`.

    The rule is under `goal_rule`, where observations have goals.
    """
    given = env.get_wrapper_attr("structure") if env.has_wrapper_attr("structure") else {}
    rule = read_goal_rule(env)
    return given if rule is None else {**given, GOAL_RULE: rule}


agents: Registry[type[Agent]] = Registry(
    "agent", "a class derived from hrl_escape.agents.Agent", _is_agent,
    {name: partial(_load_shipped, module) for name, module in _find_shipped().items()})
"""Classes of all agents by name, without the prefix `smdp-`."""
