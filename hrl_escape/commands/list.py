"""List names: presets, environments, agents, references, comparisons and other kinds.

Examples:
    hrl-escape list
    hrl-escape list presets --json
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import re
import sys
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Literal

import gymnasium
import tyro
from rich.console import Console
from rich.table import Table

from hrl_escape.agents.recommended import RECOMMENDED
from hrl_escape.agents.registry import (
    SMDP_PREFIX,
    find_agent_module,
    get_agent_class,
    list_agents,
    list_all_agents,
    list_continuous_agents,
    list_hierarchy_agents,
    list_many_env_agents,
    list_offline_agents,
    list_recipes,
)
from hrl_escape.agents.spec import PARTS, REFERENCES
from hrl_escape.benchmark.presets import GRIDS
from hrl_escape.benchmark.references.registry import describe_rule
from hrl_escape.env.engine import CAMERAS
from hrl_escape.env.observations.base import list_observations
from hrl_escape.env.presets import PRESETS, describe_config, get_preset
from hrl_escape.env.primitives import make_action_table
from hrl_escape.env.puzzles.base import get_puzzle_kind, list_puzzles
from hrl_escape.names import join_words
from hrl_escape.options.option_sets import option_sets

Kind = Literal["recommended", "presets", "environments", "puzzles", "observations", "cameras", "primitives",
               "option-sets", "agents", "velocities", "parts", "recipes", "batched", "hierarchical", "offline",
               "references", "comparisons"]

TITLES = {"option-sets": "option sets: see --option-set of `hrl-escape train`",
          "recommended": "recommended: which agent to begin with",
          "parts": "parts of an agent's spec, as in smdp-ppo+objects+memory",
          "recipes": "recipes: named settings of agents that have several, as in smdp-dqn@keras-rl-2019",
          "batched": "batched: agents that learn in many rooms at once, see --num-envs of `hrl-escape train`",
          "agents": f"agents; with {SMDP_PREFIX} in front they choose among options",
          "velocities": "velocities: agents that act in a Box, in one environment or many",
          "hierarchical": "hierarchical: agents that are given a hierarchy, as in maxq-q+planned",
          "offline": "offline: agents that learn from a data set, `hrl-escape train smdp-iql --data pair-play-v1`",
          "references": "references: agents without training, for comparison with learners"}

SLOW = ("recipes", "batched", "option-sets", "velocities")
"""Kinds that import every algorithm or the planners, which takes seconds; listed on request."""

PRIVILEGES = {"hierarchy": "task graph", "program": "program", "goals": "goals", "landmarks": "landmarks",
              "macros": "macro-actions", "tree": "cells", "simulator": "simulator", "goal_space": "goals",
              "count_steps": "adjacency", "abstraction": "abstraction"}
"""Arguments of agents with a task hierarchy -> privileged information in them."""


@dataclasses.dataclass(frozen=True)
class ListArgs:
    """Options of `hrl-escape list`."""

    kinds: Annotated[tuple[Kind, ...], tyro.conf.Positional] = ()
    """Kinds of names to list; by default all except recipes, batched, velocities and option-sets, which are
    slow to import."""
    json: bool = False
    """Print JSON instead of tables."""


def run(args: ListArgs) -> None:
    """Print names with a line of description."""
    makers = {
        "recommended": lambda: {choice.label: f"{choice.use}: {choice.reason}" for choice in RECOMMENDED},
        "presets": lambda: {name: describe_config(get_preset(name)) for name in PRESETS},
        "environments": _describe_environments,
        "puzzles": lambda: {name: _describe_puzzle(name) for name in list_puzzles()},
        "observations": lambda: {observation.name: observation.doc for observation in list_observations()},
        "cameras": lambda: CAMERAS,
        "primitives": _describe_primitives,
        "option-sets": _describe_option_sets,
        "agents": lambda: {name: _summarise(_parse_agent(name)) for name in list_all_agents()
                           if name not in list_offline_agents()},
        "velocities": lambda: {name: _summarise(_parse_agent(name)) for name in (
            *(name for name in list_agents() if "box" in get_agent_class(name).acts_in), *list_continuous_agents())},
        "parts": lambda: {f"+{name}": part.about for name, part in PARTS.items()},
        "recipes": _describe_recipes,
        "batched": lambda: {name: _summarise(_parse_agent(name)) for name in list_many_env_agents()},
        "hierarchical": lambda: {name: _describe_hierarchical(name) for name in list_hierarchy_agents()},
        "offline": lambda: {name: _summarise(_parse_agent(name)) for name in list_offline_agents()},
        "references": lambda: {name: describe_rule(name) for name in REFERENCES},
        "comparisons": lambda: {grid.name: grid.description for grid in GRIDS.values()},
    }
    lists = {kind: makers[kind]() for kind in args.kinds or [kind for kind in makers if kind not in SLOW]}
    if args.json:
        print(json.dumps(lists, indent=2))
        return
    console = Console()
    for kind, entries in lists.items():
        table = Table("name", "", title=TITLES.get(kind, kind), title_justify="left", title_style="bold", box=None,
                      show_header=False, padding=(0, 2), pad_edge=False)
        for name, line in entries.items():
            table.add_row(name, line)
        console.print(table, "")


def _describe_recipes() -> dict[str, str]:
    """Return the named settings of every agent with several, the default first."""
    found = {name: list(list_recipes(name)) for name in list_all_agents()}
    return {name: join_words(recipes, "or") for name, recipes in found.items() if len(recipes) > 1}


def _describe_option_sets() -> dict[str, str]:
    return {name: _get_sentence(inspect.getdoc(make) or "") for name, make in option_sets.load_all().items()}


def _describe_environments() -> dict[str, str]:
    """Return every registered id with its preset, or the first sentence of its environment."""
    found = {}
    for name, spec in gymnasium.registry.items():
        if spec.namespace != "hrl_escape":
            continue
        source = spec.entry_point
        made = resolve_name(source) if isinstance(source, str) else source
        about = _get_sentence(inspect.getdoc(made) or "")
        preset = spec.kwargs.get("config")
        found[name] = about if preset is None else f"preset {preset}{', with options' if 'Options' in name else ''}"
    return found


def _describe_puzzle(name: str) -> str:
    """Return the first sentence of the docstring of the puzzle's module or class."""
    kind = get_puzzle_kind(name).puzzle_type
    return _get_sentence(sys.modules[kind.__module__].__doc__ or kind.__doc__ or "")


def _describe_hierarchical(name: str) -> str:
    """Describe an agent with a task hierarchy and its privileged information."""
    source = _parse_agent(name)
    taken = {node.arg for node in ast.walk(source) if isinstance(node, ast.arg)}
    told = [privilege for part, privilege in PRIVILEGES.items() if part in taken]
    return f"{_summarise(source)}; privileged: {', '.join(told) or 'none'}"


def _parse_agent(name: str) -> ast.Module:
    """Return the source of the agent's module without importing it."""
    module = find_agent_module(name)
    spec = None if module is None else find_spec(module)
    source = Path(spec.origin).read_text(encoding="utf-8") if spec is not None and spec.origin is not None else ""
    return ast.parse(source)


def _summarise(module: ast.Module) -> str:
    """Return the first sentence of a module's docstring."""
    return _get_sentence(ast.get_docstring(module) or "From another package.")


def _get_sentence(document: str) -> str:
    """Return the first sentence of a docstring without its full stop; `et al.` and initials do not end it."""
    return re.split(r"(?<!\bet al)(?<!\b[A-Z])\.(?:\s|$)", " ".join(document.split()), maxsplit=1)[0]


def _describe_primitives() -> dict[str, str]:
    """Return the primitives of the base and of an arm joint."""
    units = {"forward": "moves one move step", "back": "moves one move step", "turn": "turns one turn step",
             "strafe": "moves one move step", "joint": "moves the joint by one joint step, up to its limits"}
    return {primitive.name: f"action {number}: {units[primitive.name.split('-')[0]]}"
            for number, primitive in enumerate(make_action_table(1).primitives)}
