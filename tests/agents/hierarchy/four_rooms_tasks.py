"""Tasks in Four Rooms: walk to a hallway, or home; for learners, and as nested tasks to be solved exactly."""

from __future__ import annotations

import numpy as np

from hrl_escape.agents.hierarchy.task import Hierarchy
from hrl_escape.agents.hierarchy.task_graph import maxq
from tests.classic.exact import NestedTask
from tests.classic.four_rooms import GRID, HALLWAYS

HOME = 0
WRONG_HALLWAY = -5.0
"""Pseudo-reward for ending in a hallway that was not asked for."""

STATES = np.arange(len(GRID))


def make_walks(away=lambda seen: False) -> Hierarchy:
    """Walk to a hallway, which ends in any of them; or home, which ends where one is `away`."""
    names = [f"to {hallway}" for hallway in HALLWAYS]
    return maxq(
        {"root": [*names, "home"], **{name: range(4) for name in names}, "home": range(4)},
        {**{name: lambda seen: seen.observation in HALLWAYS for name in names}, "home": away},
        pseudo={name: _make_pseudo(hallway) for name, hallway in zip(names, HALLWAYS, strict=True)},
    )


def _make_pseudo(hallway):
    return lambda seen: 1.0 if seen.observation == hallway else WRONG_HALLWAY


def make_nested_walks(away: np.ndarray = np.zeros(len(GRID), bool)) -> NestedTask:  # noqa: B008  # never changed
    over = np.isin(STATES, HALLWAYS)
    walks = [
        NestedTask(f"to {hallway}", range(4), over, np.where(STATES == hallway, 1.0, WRONG_HALLWAY) * over)
        for hallway in HALLWAYS
    ]
    never = np.zeros(len(GRID), bool)
    return NestedTask("root", [*walks, NestedTask("home", range(4), away)], never)
