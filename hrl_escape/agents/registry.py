"""Names of agents: which there are, how a name becomes an agent, and how others add theirs.

`smdp-dqn` and `dqn` are one implementation; the prefix only says which view of an environment
is meant, and lets a recipe differ where the published program's did. Third-party agents arrive
through the entry-point group `hrl_escape.agents`. No algorithm is imported before it is asked for.
"""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points
from typing import Any

import gymnasium

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.settings import replace_settings
from hrl_escape.errors import AgentSettingsError, UnknownNameError

__all__ = ["ENTRY_POINT_GROUP", "SMDP_PREFIX", "get_agent_class", "get_recipe", "list_agents", "make_agent"]

ENTRY_POINT_GROUP = "hrl_escape.agents"
SMDP_PREFIX = "smdp-"

_SHIPPED = {
    "random": "hrl_escape.agents.random:RandomAgent",
    "q-learning": "hrl_escape.agents.q_learning:QLearning",
    "intra-option-q": "hrl_escape.agents.intra_option_q:IntraOptionQ",
    "dqn": "hrl_escape.agents.dqn:DQN",
    "sarsa": "hrl_escape.agents.sarsa:Sarsa",
    "ddpg": "hrl_escape.agents.ddpg:DDPG",
    "ppo": "hrl_escape.agents.ppo:PPO",
    "r-max": "hrl_escape.agents.r_max:RMax",
    "factored-r-max": "hrl_escape.agents.factored_r_max:FactoredRMax",
    "monte-carlo-model": "hrl_escape.agents.monte_carlo_model:MonteCarloModel",
}


def list_agents() -> list[str]:
    """Names of all agents, shipped ones first; each also exists with the prefix `smdp-`."""
    return [*_SHIPPED, *sorted(_find_others())]


def get_agent_class(name: str) -> type[Agent]:
    """The class behind a name, with or without the prefix `smdp-`.

    Raises:
        UnknownNameError: no agent has this name; the message names the closest.
    """
    base = name.removeprefix(SMDP_PREFIX)
    if base in _SHIPPED:
        module, _, attribute = _SHIPPED[base].partition(":")
        return getattr(importlib.import_module(module), attribute)
    others = _find_others()
    if base not in others:
        known = list_agents()
        raise UnknownNameError("agent", name, [*known, *(SMDP_PREFIX + other for other in known)])
    return others[base].load()


def get_recipe(name: str, recipe: str = "corrected") -> Any:
    """The settings of an agent under a recipe.

    `corrected` is what we recommend; `paper` is what keras-rl 0.4.2 and the published program did. With the prefix
    `smdp-`, a recipe of that name with the prefix comes first: the program had other layer widths for meta-actions.

    Raises:
        UnknownNameError: no such agent, or it has no such recipe.
    """
    agent_class = get_agent_class(name)
    recipes = getattr(agent_class, "recipes", None) or {"corrected": agent_class.Settings()}
    if name.startswith(SMDP_PREFIX) and SMDP_PREFIX + recipe in recipes:
        return recipes[SMDP_PREFIX + recipe]
    if recipe not in recipes:
        known = [key for key in recipes if not key.startswith(SMDP_PREFIX)]
        raise UnknownNameError(f"recipe of {name}", recipe, known)
    return recipes[recipe]


def make_agent(
    name: str,
    observation_space: gymnasium.Space,
    action_space: gymnasium.Space,
    seed: int,
    recipe: str = "corrected",
    **settings: Any,
) -> Agent:
    """Make an agent by name.

    Args:
        name: one of `list_agents()`, with or without the prefix `smdp-`.
        observation_space: what it will see.
        action_space: Discrete.
        seed: 0 or more; all of the agent's randomness follows from it.
        recipe: `corrected` or `paper`.
        **settings: fields of the agent's settings to change, such as `gamma=0.995`.

    Raises:
        UnknownNameError: no such agent, recipe or setting.
        AgentSettingsError: a setting or the seed is not possible.
        UnsupportedSpaceError: the agent cannot use these spaces.
    """
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise AgentSettingsError("seed", seed, "it must be a whole number, 0 or more")
    chosen = replace_settings(get_recipe(name, recipe), settings)
    agent_class: Any = get_agent_class(name)
    return agent_class(observation_space, action_space, seed, chosen)


def _find_others() -> dict[str, Any]:
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name not in _SHIPPED}
