"""List names: presets, environments, puzzles, observations, cameras, primitives, agents, comparisons.

Examples:
    hrl-escape list
    hrl-escape list presets --json
"""

from __future__ import annotations

import ast
import dataclasses
import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from hrl_escape.agents.registry import SMDP_PREFIX, list_agents
from hrl_escape.env.bullet_cameras import CAMERAS
from hrl_escape.env.observations import OBSERVATIONS
from hrl_escape.env.presets import PRESETS, get_preset, make_env_name
from hrl_escape.env.primitives import make_primitives
from hrl_escape.env.puzzles.base import get_puzzle_kind, list_puzzles
from hrl_escape.experiments.presets import GRIDS

Kind = Literal["presets", "environments", "puzzles", "observations", "cameras", "primitives",
               "agents", "comparisons"]


@dataclasses.dataclass(frozen=True)
class ListArgs:
    """Options of `hrl-escape list`."""

    kinds: Annotated[tuple[Kind, ...], tyro.conf.Positional] = ()
    """What to list; nothing lists everything."""
    json: bool = False
    """Print JSON instead of tables."""


def run(args: ListArgs) -> None:
    """Print names and one line about each."""
    makers = {
        "presets": lambda: {name: _describe_preset(name) for name in PRESETS},
        "environments": lambda: {f"hrl_escape/{make_env_name(name)}-v0": f"preset {name}" for name in PRESETS},
        "puzzles": lambda: {name: _describe_puzzle(name) for name in list_puzzles()},
        "observations": lambda: OBSERVATIONS,
        "cameras": lambda: CAMERAS,
        "primitives": _describe_primitives,
        "agents": lambda: {name: _describe_agent(name) for name in list_agents()},
        "comparisons": lambda: {grid.name: grid.description for grid in GRIDS.values()},
    }
    lists = {kind: makers[kind]() for kind in args.kinds or makers}
    if args.json:
        print(json.dumps(lists, indent=2))
        return
    console = Console()
    for kind, entries in lists.items():
        table = Table("name", "", title=kind, title_justify="left", title_style="bold", box=None, show_header=False,
                      padding=(0, 2), pad_edge=False)
        for name, line in entries.items():
            table.add_row(name, line)
        console.print(table, "")


def _describe_preset(name: str) -> str:
    config = get_preset(name)
    parts = [f"{config.room.width:g} x {config.room.depth:g} m"]
    if config.room.rooms > 1:
        parts.append(f"{config.room.rooms} rooms")
    puzzle = config.puzzle.make_puzzle(np.random.default_rng(0))
    count = len(puzzle.target_names)
    parts.append(f"{puzzle.kind} x {count}" if count else puzzle.kind)
    if config.obstacles.count:
        parts.append(f"{config.obstacles.count} obstacles")
    if config.robot.joints:
        parts.append(f"{config.robot.joints}-joint arm")
    if config.dynamics.press_with == "hand":
        parts.append("pressed by hand")
    if config.dynamics.kind == "physics":
        parts.append("physics")
    return ", ".join(parts)


def _describe_puzzle(name: str) -> str:
    """The first sentence of the puzzle's own file, or of its class."""
    kind = get_puzzle_kind(name).puzzle_type
    document = sys.modules[kind.__module__].__doc__ or kind.__doc__ or ""
    return " ".join(document.split()).split(". ")[0].rstrip(".")


def _describe_agent(name: str) -> str:
    """The first sentence of the agent's own file, which is not imported for it."""
    spec = find_spec(f"hrl_escape.agents.{name.replace('-', '_')}")
    source = Path(spec.origin).read_text(encoding="utf-8") if spec is not None and spec.origin is not None else ""
    document = ast.get_docstring(ast.parse(source))
    about = " ".join((document or "From another package.").split()).split(". ")[0].rstrip(".")
    return f"{about}; {SMDP_PREFIX}{name} chooses options"


def _describe_primitives() -> dict[str, str]:
    """The base's six, and the pair that each arm joint adds."""
    units = {"forward": "moves one move step", "back": "moves one move step", "turn": "turns one turn step",
             "strafe": "moves one move step", "joint": "moves the joint by one joint step, up to its limits"}
    return {primitive.name: f"action {number}: {units[primitive.name.split('-')[0]]}"
            for number, primitive in enumerate(make_primitives(1))}
