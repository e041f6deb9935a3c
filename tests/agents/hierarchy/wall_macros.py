"""The four macros of the 11 x 11 room: run to the wall."""

from __future__ import annotations

from hrl_escape.agents.algorithms.task_hierarchies.macro_q import Macro
from tests.classic.empty_room import GRID


def make_wall_macros() -> list[Macro]:
    """North, south, west, east until the wall; beside that wall one move that goes nowhere."""
    return [_make_macro(direction) for direction in range(4)]


def _make_macro(direction: int) -> Macro:
    return Macro(
        f"to wall {direction}",
        4,
        policy=lambda seen: direction,
        until=lambda seen: GRID.move(seen.observation, direction) == seen.observation,
    )
