"""One training run from a data set: sweeps or minibatches in place of episodes; folder, evaluations and result stay.

Primitives are counted when they are learned from: one pass over a data set of 10^5 counts 10^5.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pkgutil import resolve_name
from typing import Any, NamedTuple

import gymnasium

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.components.offline import OfflineAgent, OfflineData, Primitives, RecordedDecisions
from hrl_escape.agents.registry import get_agent_class, get_recipe, list_offline_agents
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.callbacks import Callback
from hrl_escape.agents.training.run import Means, Reporter, Run, RunArguments
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import replace_settings

DATA_LOADER = "hrl_escape.data.materialise:load_data"
"""Opens a data set by its name; it stands above the agents, which know no rooms, and is imported when asked for."""

SEGMENT_UPDATES = 50
"""Minibatches in a row of the log; a sweep over a table is one row."""


class Material(NamedTuple):
    """Material of a run that learns from a data set."""

    data: OfflineData  # the data set
    env: gymnasium.Env  # environment to be evaluated in
    decisions: RecordedDecisions  # what the agent learns from
    primitives: Primitives | None  # those inside the decisions, for agents that ask for them
    budget: int  # primitives of the agent's number of passes


def gather_material(agent: AgentSpec | type[Agent] | Agent, env: Any, data: Any, settings: Any) -> Material:
    """Read what an agent learns from; arguments as of `train`.

    Raises:
        AgentSettingsError: the agent learns from no data set, or the environment shows or takes something else.
    """
    spec = agent if isinstance(agent, AgentSpec) else None
    kind = type(agent) if isinstance(agent, Agent) else get_agent_class(spec.name) if spec else agent
    if not (isinstance(kind, type) and issubclass(kind, OfflineAgent)):
        known = ", ".join(list_offline_agents())
        raise AgentSettingsError("agent", str(agent), f"one that learns from a data set ({known}), or leave out data=")
    if isinstance(agent, Agent):
        chosen = agent.settings
    else:
        named = kind.Settings() if spec is None else get_recipe(spec.name, spec.recipe)
        chosen = replace_settings(named, {**(spec.settings if spec else {}), **(settings or {})})
    found: OfflineData = resolve_name(DATA_LOADER)(data) if isinstance(data, (str, os.PathLike)) else data
    options = found.level == "decisions" if spec is None else spec.chooses_options
    if options and kind.reads_both:
        raise AgentSettingsError("agent", str(agent), f"{kind.name}: it acts with primitives, and reads decisions too")
    env = found.make_env(options, chosen.gamma) if env is None else env
    primitives = None if options else found.read_primitives()
    if primitives is None or kind.reads_both:
        decisions = found.read_decisions(chosen.gamma)
    else:
        decisions = primitives.as_decisions(chosen.gamma, env.action_space.n)
    shown = decisions.observation.shape[1:]
    width = decisions.mask.shape[1] if primitives is None else env.unwrapped.action_space.n
    if shown != env.observation_space.shape or width != env.action_space.n:
        raise AgentSettingsError("env", str(env), f"one with observations of the shape {shown} and {width} actions, as "
                                 "in the data set")
    count = int(decisions.duration.sum())
    return Material(found, env, decisions, primitives if kind.reads_both else None, chosen.passes * count)


class OfflineRun(Run):
    """A run whose unit is some updates from a data set."""

    agent: OfflineAgent

    def __init__(self, agent: Any, arguments: RunArguments, material: Material, callbacks: Sequence[Callback] = ()
                 ) -> None:
        super().__init__(agent, material.env, material.env, arguments, callbacks=callbacks)
        self._identity = dict(material.data.identity)
        agent.begin(material.decisions, material.primitives)

    @property
    def identity(self) -> dict[str, Any]:
        """The data set, in addition to the environment of evaluations."""
        return super().identity | {"data": self._identity}

    @property
    def is_over(self) -> bool:
        """True also once a further sweep would change nothing."""
        return super().is_over or self.agent.is_fitted

    def run_unit(self, report: Reporter) -> dict[str, Any]:
        """Make some updates; returns their row of the log."""
        started, before, means = time.perf_counter(), self.primitives, Means()
        for _ in range(SEGMENT_UPDATES):
            metrics, decisions, primitives = self.agent.update()
            self.primitives, self.decisions = self.primitives + primitives, self.decisions + decisions
            means.note(metrics)
            report(self.primitives, self.describe_returns())
            if self.is_over or self.agent.is_table:
                break
        none = {"train/episodes": 0, "train/successes": None, "train/return": None, "train/length": None}
        return self.end_segment(none, means, started, before)
