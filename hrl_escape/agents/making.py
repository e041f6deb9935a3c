"""Construction of agents from specs."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

import gymnasium

from hrl_escape.agents.agent import Agent, read_goal_rule
from hrl_escape.agents.registry import find_hierarchy_part, get_agent_class, get_recipe
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import replace_settings

GOAL_RULE = "goal_rule"
"""Argument of agents for an environment's definition of goals; other agents do not use it."""


def make_agent(agent: str | AgentSpec | type[Agent], observation_space: gymnasium.Space,
               action_space: gymnasium.Space, seed: int, structure: Mapping[str, Any] | None = None, **settings: Any
               ) -> Agent:
    """Make an agent.

    Args:
        agent: spec such as `dqn`, `smdp-dqn+objects+memory` or `dqn@patient`, or a class. Its parts change settings;
            those about options describe the environment, whose spaces are given.
        observation_space: space of its observations.
        action_space: Discrete.
        seed: 0 or more; determines all of the agent's randomness.
        structure: further input of the agent, such as a `hierarchy`; see `read_structure`.
        **settings: fields of the agent's settings to change, such as `gamma=0.995`; they come after the spec's.

    Raises:
        UnknownNameError: no such agent, part, named settings or setting.
        AgentSettingsError: a setting or the seed is not possible, the agent takes no such structure, or the spec
            contradicts itself.
        UnsupportedSpaceError: the agent cannot use these spaces.
    """
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise AgentSettingsError("seed", seed, "a whole number of at least 0")
    if isinstance(agent, type):
        name, agent_class, chosen = agent.name, agent, replace_settings(agent.Settings(), settings)
    else:
        spec = AgentSpec.parse(agent)
        name, agent_class = spec.name, get_agent_class(spec.name)
        chosen = replace_settings(get_recipe(name, spec.recipe), {**spec.settings, **settings})
    taken = inspect.signature(agent_class).parameters
    given = {part: what for part, what in (structure or {}).items() if part != GOAL_RULE or part in taken}
    if unknown := [part for part in given if part not in taken]:
        takes = find_hierarchy_part(agent_class)
        raise AgentSettingsError(f"structure of {name}", ", ".join(unknown),
                                 "none: this agent does not use a task hierarchy" if takes is None else
                                 f"{takes}, which this agent takes")
    made: Any = agent_class
    return made(observation_space, action_space, seed, chosen, **given)


def read_structure(env: gymnasium.Env) -> Mapping[str, Any]:
    """Return the structure in an environment: the attribute `structure` of one of its wrappers, and its `GoalRule`.

    The rule is under the key `goal_rule`, if observations have goals.
    """
    given = env.get_wrapper_attr("structure") if env.has_wrapper_attr("structure") else {}
    rule = read_goal_rule(env)
    return given if rule is None else {**given, GOAL_RULE: rule}
