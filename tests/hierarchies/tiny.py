"""A room with few enough poses to enumerate: quarter turns, two buttons on opposite walls, an exit in the corner."""

from __future__ import annotations

from benchmarks.optima import TabularModel, enumerate_model
from hrl_escape.env.config import ExitConfig, RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.puzzles.base import Panels, Place
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.hierarchies import HierarchyEnv

TINY = RoomConfig(
    name="tiny", room=ShapeConfig(width=5, depth=5), robot=RobotConfig(body_radius=0.4, turn_step_deg=90),
    puzzle=ButtonsConfig(2, graph=GraphConfig(relabel=False),
                         buttons=Panels(places=(Place(-2.5, 1, 90), Place(2.5, -1, 90)))),
    start=StartConfig(place="fixed"), exit=ExitConfig(place="fixed", x=1.5, y=2.0, width=1, depth=1), horizon=60,
)


def enumerate_tiny() -> TabularModel:
    """The room as every synthesised hierarchy sees it."""
    return enumerate_model(HierarchyEnv(EscapeRoomEnv(TINY)), lambda state: (
        round(state.x, 6), round(state.y, 6), state.heading_steps, state.puzzle, state.touching))
