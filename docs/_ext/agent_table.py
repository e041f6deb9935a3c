"""`{agents}`: one row an agent, with what it learns, what it needs, and its best results.

Support of spaces and of many environments, and privileged information are read from the registry. Efficiencies
are means of the best variant of an agent over the test rooms of a kind (`studies/canon/raw.jsonl`).
"""

from __future__ import annotations

import statistics
from collections import defaultdict
from functools import cache
from pathlib import Path

import tomllib
from gallery import read_lines
from sphinx.application import Sphinx
from tables import Table, list_hierarchical, make_table

from hrl_escape.agents.registry import (
    get_agent_class,
    list_across_rooms_agents,
    list_agents,
    list_continuous_agents,
    list_hierarchy_agents,
    list_many_env_agents,
    list_offline_agents,
    split_name,
)
from hrl_escape.agents.spec import AgentSpec

CANON = Path(__file__).parents[2] / "studies/canon/study.toml"
FEWEST_ROOMS = 10
"""Test rooms of a kind that a result needs."""
VALUE, POLICY, MODEL, BOTH = "value", "policy", "model", "value and policy"
LEARNS = {
    "ddpg": (BOTH, "network"), "dqn": (VALUE, "network"), "factored-r-max": (MODEL, "table"),
    "intra-option-q": (VALUE, "table"), "monte-carlo-model": (MODEL, "table"), "ppo": (BOTH, "network"),
    "q-learning": (VALUE, "table"), "r-max": (MODEL, "table"), "rainbow": (VALUE, "network"), "random": ("", ""),
    "sarsa": (VALUE, "network"), "torchrl-dqn": (VALUE, "network"), "torchrl-ppo": (BOTH, "network"),
    "torchrl-sac": (BOTH, "network"), "a2oc": (BOTH, "network"), "dac": (BOTH, "network"), "fun": (BOTH, "network"),
    "option-critic": (BOTH, "table"), "ppoc": (BOTH, "network"), "covering-options": (VALUE, "table"),
    "diayn": (BOTH, "network"), "eigenoptions": (VALUE, "table"), "skill-chaining": (VALUE, "table"),
    "hrc": (MODEL, "table"), "met-r-max": (MODEL, "table"), "vigorito-barto": (MODEL, "table"),
    "deep-abstract-q": ("value and model", "network or table"), "feudal-rl": (VALUE, "table"),
    "h-dqn": (VALUE, "network or table"), "h-uct": (MODEL, "table"), "hac-finite": (VALUE, "table"),
    "hamq": (VALUE, "table"), "hdg": (VALUE, "table"), "hiro-finite": (VALUE, "table"), "hq-learning": (VALUE, "table"),
    "hrac-finite": (VALUE, "table"), "macro-q": (VALUE, "table"), "maxq-q": (VALUE, "table"),
    "option-keyboard": (VALUE, "table"), "r-maxq": (MODEL, "table"), "sol": (BOTH, "network"),
    "behaviour-cloning": (POLICY, "network or table"), "cql": (VALUE, "network or table"),
    "decision-transformer": (POLICY, "network"), "fitted-q": (VALUE, "network or table"), "hiql": (BOTH, "network"),
    "iql": (BOTH, "network or table"), "sharsa": (BOTH, "network or table"),
    "sac": (BOTH, "network"), "td3": (BOTH, "network"), "hiro": (BOTH, "network"), "hrac": (BOTH, "network"),
    "hac": (BOTH, "network"), "press-model": (MODEL, "table"),
}
"""Agent -> what it learns, and its representation."""
ACTIONS = {"discrete": "discrete", "box": "continuous"}
FOR_OPTIONS = ("factored-r-max", "hrc", "met-r-max", "monte-carlo-model", "press-model", "vigorito-barto")
"""Agents whose models are of options and buttons."""


SHOWN = ("ladder-1/pair", "ladder-1/lattice")
"""Kinds of rooms with a column."""


@cache
def read_kinds() -> dict[str, str]:
    """Rung -> words for its kind of rooms."""
    return tomllib.loads(CANON.read_text(encoding="utf-8"))["kinds"]


@cache
def list_results(rung: str) -> dict[str, float]:
    """Algorithm -> mean efficiency of its best variant in the test rooms of a rung."""
    scores: dict[str, dict[str, float]] = defaultdict(dict)
    for run in read_lines("canon"):
        if run["room"].startswith(f"{rung}/test#"):
            scores[run["agent"]][run["room"]] = run["efficiency"]
    best: dict[str, float] = {}
    for spec, rooms in scores.items():
        if len(rooms) >= FEWEST_ROOMS:
            found, name = statistics.fmean(rooms.values()), split_name(AgentSpec.parse(spec).name)[0]
            best[name] = max(best.get(name, found), found)
    return best


def describe_result(name: str, rung: str) -> str:
    """Efficiency as a cell; empty where the agent was not run."""
    result = list_results(rung).get(name)
    return f"{result:.2f}" if result is not None else ""


def describe_learning(name: str) -> str:
    """Describe the learned parts of an agent, with the form in parentheses."""
    learns, form = LEARNS[name]
    return f"{learns} ({form})" if form else learns


def list_needs(name: str) -> str:
    """What an agent needs besides an environment."""
    needs = ["options"] if name in FOR_OPTIONS else []
    needs += ["a data set"] if name in list_offline_agents() else []
    needs += ["primitives within options"] if get_agent_class(name).needs_trace else []
    given = list_hierarchical().get(name, "").partition("privileged: ")[2]
    return ", ".join([*needs, *([given] if given not in ("", "none") else [])])


class Agents(Table):
    """`{agents}`."""

    def write(self) -> str:
        """One row an agent."""
        many, rows = list_many_env_agents(), []
        for name in dict.fromkeys([*list_agents(), *list_hierarchy_agents(), *list_offline_agents(),
                                   *list_continuous_agents(), *list_across_rooms_agents()]):
            page = "offline" if name in list_offline_agents() else name
            rows.append((
                f"[{AgentSpec.parse(name).title}]({page}.md) `{name}`", describe_learning(name),
                ", ".join(ACTIONS[space] for space in get_agent_class(name).acts_in), list_needs(name),
                "yes" if name in many else "", *(describe_result(name, rung) for rung in SHOWN)))
        return make_table(("agent", "learns", "actions", "needs", "many environments",
                           *(f"efficiency, {read_kinds()[rung]}" for rung in SHOWN)), rows)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("agents", Agents)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
