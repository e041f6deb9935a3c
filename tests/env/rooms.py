"""Room configurations that reach into every corner of the knobs, for tests that walk over rooms."""

import dataclasses

from hrl_escape.env.config import (
    DynamicsConfig,
    ExitConfig,
    ObstaclesConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
)
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig

EXTREMES = {
    "smallest": RoomConfig(room=ShapeConfig(width=5, depth=5), robot=RobotConfig(body_radius=0.2),
                           puzzle=ButtonsConfig(count=1, buttons=Panels(width=0.3))),
    "largest": RoomConfig(room=ShapeConfig(width=200, depth=200, rooms=16, doorway_width=6),
                          obstacles=ObstaclesConfig(count=200, size_max=4)),
    "sixteen-rooms": RoomConfig(room=ShapeConfig(width=40, depth=40, rooms=16), robot=RobotConfig(body_radius=0.4),
                                puzzle=ButtonsConfig(count=8, graph=GraphConfig(kind="tree"))),
    "many-obstacles": RoomConfig(room=ShapeConfig(width=30, depth=30), robot=RobotConfig(body_radius=0.3),
                                 obstacles=ObstaclesConfig(count=120, size_max=1.5)),
    "sixty-four-buttons": RoomConfig(room=ShapeConfig(width=60, depth=60),
                                     puzzle=ButtonsConfig(count=64, graph=GraphConfig(kind="random", max_parents=3))),
    "seven-joints": RoomConfig(room=ShapeConfig(width=12, depth=12),
                               robot=RobotConfig(body_radius=0.3, joints=7, link_length=0.3),
                               puzzle=ButtonsConfig(count=3, buttons=Panels(width=0.5, height=0.5, centre_height=1.3)),
                               dynamics=DynamicsConfig(press_with="hand")),
    "noisy": RoomConfig(robot=RobotConfig(joints=2), dynamics=DynamicsConfig(noise=0.2, slip=0.2),
                        obstacles=ObstaclesConfig(count=20, aligned=True), start=StartConfig(choices=20)),
    "door": RoomConfig(exit=ExitConfig(door=True, width=2.4), room=ShapeConfig(rooms=2),
                       puzzle=ButtonsConfig(count=2, allow_off=True, on_violation="reset")),
    "coarse-steps": RoomConfig(robot=RobotConfig(move_step=3.7, turn_step_deg=45), obstacles=ObstaclesConfig(count=10),
                               start=StartConfig(place="fixed", heading_deg=17)),
}


RECTANGLE = RoomConfig(room=ShapeConfig(width=8, depth=8), obstacles=ObstaclesConfig(count=4),
                       robot=RobotConfig(footprint="rectangle", body_length=1.2, body_width=0.6),
                       puzzle=ButtonsConfig(count=2, buttons=Panels(width=0.8)))
"""A small cluttered room for a base longer than wide."""


def make_ordered_chain() -> RoomConfig:
    """The room of `four-button-chain` with its buttons numbered in the order in which they must be pressed."""
    preset = get_preset("four-button-chain")
    graph = GraphConfig(kind="chain", relabel=False)
    return dataclasses.replace(preset, puzzle=dataclasses.replace(preset.puzzle, graph=graph))


def all_configs() -> dict[str, RoomConfig]:
    """Every preset and every extreme, by name."""
    return {name: get_preset(name) for name in PRESETS} | EXTREMES
