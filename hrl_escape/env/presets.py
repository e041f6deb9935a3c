"""Named room configurations: the paper's rooms, the published 2019 code's, and a ladder of difficulty.

A preset is a function that returns a `RoomConfig`; `larg-2019` and others take arguments. Gymnasium ids are the names
in CamelCase, such as `hrl_escape/PaperTwoButton-v1`.

Presets of published grid worlds come first: rooms of cells, with the moves of the domain as primitives.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from hrl_escape.env.config import (
    Between,
    DynamicsConfig,
    ExitConfig,
    ObstaclesConfig,
    RewardConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
    Wall,
)
from hrl_escape.env.puzzles.base import Pads, Panels, Place, PuzzleConfig
from hrl_escape.env.puzzles.bit_flip import BitFlipConfig
from hrl_escape.env.puzzles.blocks_world import BlocksWorldConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.codes import CodeLockConfig, KeyChestConfig, PinPadConfig
from hrl_escape.env.puzzles.deep_sea import DeepSeaConfig
from hrl_escape.env.puzzles.factored import FactoredConfig
from hrl_escape.env.puzzles.foraging import ForagingConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.puzzles.hanoi import HanoiConfig
from hrl_escape.env.puzzles.light_box import LightBoxConfig
from hrl_escape.env.puzzles.lights_out import LightsOutConfig
from hrl_escape.env.puzzles.mini_grid import DrawnLevel, MiniGridConfig
from hrl_escape.env.puzzles.potions import PotionsConfig
from hrl_escape.env.puzzles.puddle_world import PuddleWorldConfig
from hrl_escape.env.puzzles.push_block import PushBlockConfig
from hrl_escape.env.puzzles.recipes import Craft, RecipesConfig
from hrl_escape.env.puzzles.sokoban import SokobanConfig, tidy_level
from hrl_escape.env.puzzles.taxi import TaxiConfig
from hrl_escape.errors import ConfigError, UnknownNameError

ConfigForm: TypeAlias = str | RoomConfig | dict[str, Any]
"""Name of a preset, a room configuration, or the dict form of one."""
EVERYWHERE = ExitConfig(place="fixed", width=200, depth=200)
"""An exit that covers the whole floor: the primitive that solves the puzzle ends the episode."""


def taxi(rainy: bool = False, fickle: bool = False) -> RoomConfig:
    """Taxi (Dietterich 2000; Gymnasium's Taxi-v4), cell by cell.

    Args:
        rainy: a move that is not blocked ahead slips to either side with probability 0.1 each.
        fickle: the passenger may change the destination once, on the first ride of one cell.
    """
    places = tuple(Place(x, y) for x, y in ((-4, 4), (4, 4), (-4, -4), (2, -4)))
    return RoomConfig(
        name="taxi",
        room=ShapeConfig(width=10, depth=10, cell=2,
                         walls=(Wall(-1, 5, -1, 1), Wall(-3, -1, -3, -5), Wall(1, -1, 1, -5))),
        robot=RobotConfig(body_radius=0.4, move_step=2, turn_step_deg=90, gripper=True),
        puzzle=TaxiConfig(fickleness=0.3 if fickle else 0.0, depots=Pads(1.6, 1.6, places)),
        start=StartConfig(place="cells"), exit=EVERYWHERE,
        reward=RewardConfig(exit=20, exit_replaces_step=True),
        dynamics=DynamicsConfig(blocked="stay", slip=0.2 if rainy else 0.0,
                                slip_kind="lateral-if-free" if rainy else "stay"),
        horizon=200,
    )


FOUR_ROOMS = ("     #     ", "     #     ", "           ", "     #     ", "     #     ", "# ####     ", "     ### ##",
              "     #     ", "     #     ", "           ", "     #     ")
"""Map of the four rooms of Sutton, Precup and Singh (1999), without its outer walls."""


def four_rooms(slip: str = "any", row: int = 6, column: int = 8) -> RoomConfig:
    """Four Rooms (Sutton, Precup and Singh 1999), cell by cell: reward 1 at the goal, 0 otherwise.

    Args:
        slip: `any` for the paper's moves, with probability 1/9 for each other direction; `neighbour` for a free
            neighbouring cell in one of three moves (Bacon, Harb and Precup 2017); `none`.
        row: row of the goal, from 0 at the top; by default the goal is the east hallway.
        column: column of the goal.
    """
    goal = Place(column - 5.0, 5.0 - row)
    return RoomConfig(
        name="four-rooms",
        room=ShapeConfig(width=11, depth=11, map=FOUR_ROOMS),
        robot=RobotConfig(body_radius=0.2, move_step=1, turn_step_deg=90),
        puzzle=PinPadConfig(count=1, floor=Pads(0.6, 0.6, (goal,))),
        start=StartConfig(place="cells"),
        exit=ExitConfig(place="fixed", x=goal.x, y=goal.y, width=1, depth=1),
        reward=RewardConfig(step=0.0, exit=1.0, exit_replaces_step=True),
        dynamics=DynamicsConfig(blocked="stay", slip=0.0 if slip == "none" else 1 / 3,
                                slip_kind="stay" if slip == "none" else slip),  # type: ignore[arg-type]  # checked there
    )


def continuous_four_rooms(reward: float = 0.0, random_start: bool = True) -> RoomConfig:
    """Four rooms in metres, for velocities: from anywhere to the exit in the north-east room.

    The map is that of `four-rooms`, with a disc that strafes. The button at the exit opens it.

    Args:
        reward: of the exit, in addition to the cost of time.
        random_start: episodes begin in any cell and last 50 s; False begins in the south-west room, for 100 s.
    """
    goal = Place(4.0, 4.0)
    return RoomConfig(
        name="continuous-four-rooms",
        room=ShapeConfig(width=11, depth=11, map=FOUR_ROOMS),
        robot=RobotConfig(body_radius=0.2, move_step=0.5, turn_step_deg=90, drive="strafing"),
        puzzle=PinPadConfig(count=1, floor=Pads(0.9, 0.9, (goal,))),
        start=StartConfig(place="cells") if random_start else StartConfig(place="fixed", x=-4.0, y=-4.0),
        exit=ExitConfig(place="fixed", x=goal.x, y=goal.y, width=1, depth=1),
        reward=RewardConfig(step=-1.0, exit=reward),
        horizon=50 if random_start else 100,
    )


KEY_CHEST = (" " * 15, " " * 15, "#############  ", " " * 15, " " * 15, "  ###########  ", " " * 15, " " * 15,
             "#############  ", " " * 15, " " * 15)
"""Map of HRAC's Key-Chest (Zhang et al. 2020), without its outer walls."""


def key_chest(random_start: bool = False) -> RoomConfig:
    """Key-Chest of HRAC (Zhang et al. 2020), cell by cell: reward 1 for the key, 5 for the chest, 0 otherwise.

    One move in four goes in a random direction, and each wrong direction therefore has probability 1/16.

    Args:
        random_start: episodes begin in any cell, like the option of that name in HRAC's code.
    """
    return RoomConfig(
        name="key-chest",
        room=ShapeConfig(width=15, depth=11, map=KEY_CHEST),
        robot=RobotConfig(body_radius=0.2, move_step=1, turn_step_deg=90),
        puzzle=KeyChestConfig(Pads(0.6, 0.6, (Place(-7, 0), Place(-7, 4)))),
        start=StartConfig(place="cells") if random_start else StartConfig(place="fixed", x=-1, y=-5),
        exit=EVERYWHERE,
        reward=RewardConfig(step=0.0, exit=5.0, exit_replaces_step=True),
        dynamics=DynamicsConfig(blocked="stay", slip=3 / 16, slip_kind="any"), horizon=500,
    )


def foraging(worms: int = 4) -> RoomConfig:
    """Foraging (Singh, Lewis, Barto and Sorg 2010), cell by cell: three corridors of three cells, joined at the left.

    Args:
        worms: number of worms to eat before the episode ends, 1 to 100.
    """
    ends = Pads(1.2, 1.2, tuple(Place(2, y) for y in (2, 0, -2)))
    return RoomConfig(
        name="foraging",
        room=ShapeConfig(width=6, depth=6, cell=2, walls=(Wall(-1, 1, 3, 1), Wall(-1, -1, 3, -1))),
        robot=RobotConfig(body_radius=0.4, move_step=2, turn_step_deg=90, gripper=True),
        puzzle=ForagingConfig(worms=worms, ends=ends),
        start=StartConfig(place="cells"), exit=EVERYWHERE,
        reward=RewardConfig(step=0.0, exit=0.0),
        dynamics=DynamicsConfig(blocked="stay"),
    )


def puddle_world() -> RoomConfig:
    """Puddle World (Boyan and Moore 1995; Sutton 1996) on the lattice of its moves, without noise."""
    return RoomConfig(
        name="puddle-world",
        room=ShapeConfig(width=21, depth=21),
        robot=RobotConfig(body_radius=0.2, move_step=1, turn_step_deg=90),
        puzzle=PuddleWorldConfig(),
        start=StartConfig(place="cells"),
        exit=ExitConfig(place="fixed", x=9, y=9, width=3, depth=3),
        reward=RewardConfig(exit=0.0),
        dynamics=DynamicsConfig(blocked="stay"),
    )


def mini_grid(level: DrawnLevel, size: int, rooms: int = 3, largest: int = 5) -> RoomConfig:
    """Level of MiniGrid (Chevalier-Boisvert et al. 2023), cell by cell; the instance seed draws the map.

    Args:
        level: `door-key`, `key-corridor` or `multi-room`.
        size: side of the map with its outer walls, or of each room of a corridor.
        rooms: number of rooms above each other, or in a row.
        largest: largest side of a room in a row, walls included.
    """
    wide, high = (3 * (size - 1) - 1, rooms * (size - 1) - 1) if level == "key-corridor" else (size - 2, size - 2)
    steps = {"door-key": 10 * size**2, "key-corridor": 30 * size**2, "multi-room": 20 * rooms}
    side = 2 if min(wide, high) > 2 else 5  # rooms are at least 5 m wide
    return RoomConfig(
        name=level, puzzle=MiniGridConfig(level, size, rooms, largest),
        room=ShapeConfig(width=side * wide, depth=side * high, cell=side),
        robot=RobotConfig(body_radius=0.4, move_step=side, turn_step_deg=90, drive="differential", gripper=True,
                          use=True),
        exit=EVERYWHERE, reward=RewardConfig(step=0.0, exit=1.0, exit_replaces_step=True),
        dynamics=DynamicsConfig(blocked="stay"), horizon=steps[level],
    )


def door_key(size: int = 8) -> RoomConfig:
    """MiniGrid's DoorKey: fetch the key, open the door, go to the goal.

    Args:
        size: side of the map with its outer walls; MiniGrid registers 5, 6, 8 and 16.
    """
    return mini_grid("door-key", size)


def key_corridor(size: int = 4, rooms: int = 3) -> RoomConfig:
    """MiniGrid's KeyCorridor: find the key, open the locked door, put the key down, take the ball.

    Args:
        size: side of each room, walls included; MiniGrid registers 3 to 6.
        rooms: number of rooms above each other, 1 to 3.
    """
    return mini_grid("key-corridor", size, rooms)


def multi_room(rooms: int = 4, largest: int = 5, size: int = 15) -> RoomConfig:
    """MiniGrid's MultiRoom: open one door after another to reach the goal in the last room.

    Args:
        rooms: number of rooms.
        largest: largest side of a room, walls included.
        size: side of the map, which is 25 in MiniGrid.
    """
    return mini_grid("multi-room", size, rooms, largest)


def sokoban(size: int = 6, boxes: int = 2, rows: tuple[str, ...] = ()) -> RoomConfig:
    """Sokoban, cell by cell, with the rewards of gym-sokoban. The instance seed draws the level, unless it is given.

    Args:
        size: side of generated levels, without the outer walls.
        boxes: number of boxes in generated levels, 1 to 7.
        rows: an explicit level, such as a level of Boxoban.
    """
    level = tidy_level(rows) if rows else (" " * size,) * size
    wide, high = len(level[0]), len(level)
    side = 2 if min(wide, high) > 2 else 5  # rooms are at least 5 m wide
    return RoomConfig(
        name="sokoban", puzzle=SokobanConfig(size, boxes, level if rows else ()),
        room=ShapeConfig(width=side * wide, depth=side * high, cell=side),
        robot=RobotConfig(body_radius=0.4, move_step=side, turn_step_deg=90),
        exit=EVERYWHERE, reward=RewardConfig(step=-0.1, exit=10.0),
        dynamics=DynamicsConfig(blocked="stay"), horizon=120,
    )


def paper_room(buttons: int) -> RoomConfig:
    """The room of the paper's text: 20 x 20 m, steps of 1 m and 10 degrees, large buttons, start in the middle.

    The best known returns are 91 (one button: nine strafes to the left) and 66 (two buttons).
    """
    side = 10.0 if buttons == 1 else 6.0
    return RoomConfig(
        name="paper-one-button" if buttons == 1 else "paper-two-button",
        room=ShapeConfig(width=20, depth=20, wall_height=3),
        robot=RobotConfig(body_radius=0.75),
        puzzle=ButtonsConfig(
            count=buttons,
            graph=GraphConfig(relabel=False),
            buttons=Panels(width=side, height=side, thickness=0.1, centre_height=side / 2, inset=1.0, places="paper"),
        ),
        start=StartConfig(place="fixed"),
        exit=ExitConfig(place="fixed", x=9.5 - side / 2, y=9.0 - side / 2, width=side, depth=side),
    )


def paper_random(most: int = 4) -> RoomConfig:
    """The paper's room with random number, sizes and places of buttons, graph, goal, start and exit.

    Args:
        most: largest number of buttons, 1 to 16. The walls hold fewer if buttons are large.
    """
    if not isinstance(most, int) or not 1 <= most <= 16:
        raise ConfigError("paper-random most", most, "a whole number from 1 to 16")
    paper = paper_room(2)
    return RoomConfig(
        name="paper-random", room=paper.room, robot=paper.robot,
        puzzle=ButtonsConfig(
            count=Between(1, most),
            graph=GraphConfig(kind="layered", max_parents=Between(1, 3)),
            buttons=Panels(width=Between(1.0, min(6.0, 40 / most)), height=1.5),
        ),
        exit=ExitConfig(width=Between(2.0, 6.0), depth=Between(2.0, 6.0)),
    )


def larg_2019(size: int = 2, seed: int = 14, handicap: float = 6.0) -> RoomConfig:
    """The room of the published 2019 code: geometry, displacements, graph, reset rule, reward and horizon.

    Args:
        size: number of buttons, 1 to 4.
        seed: seed of the button graph.
        handicap: side of buttons and exit, m.
    """
    if not isinstance(size, int) or not 1 <= size <= 4:
        raise ConfigError("larg-2019 size", size, "a whole number from 1 to 4")
    places = (Place(0, 9, 0), Place(-9, 0, 90), Place(9, -5, 90), Place(0, -9, 0))
    return RoomConfig(
        name="larg-2019",
        room=ShapeConfig(width=18, depth=18, wall_height=3, wall_thickness=1),
        robot=RobotConfig(body_radius=0.75, joints=1, link_length=7.05, move_step=0.75, turn_step_deg=15,
                          joint_step_deg=3),
        puzzle=ButtonsConfig(
            count=size,
            graph=GraphConfig(kind="larg-2019", max_parents=1, seed=seed, relabel=False),
            on_violation="reset",
            buttons=Panels(width=handicap, height=handicap, thickness=0.1 * handicap, centre_height=handicap / 2,
                           places=places),
        ),
        start=StartConfig(place="fixed"),
        exit=ExitConfig(place="fixed", x=9.5 - handicap / 2, y=9.0 - handicap / 2, width=handicap, depth=handicap),
        reward=RewardConfig(exit_replaces_step=True),
        horizon=1001,
    )


def ladder_room(name: str, count: int, graph: GraphConfig, size: float = 20.0, dead_ends: int = 0, **parts: Any
                ) -> RoomConfig:
    """Return a rung of the ladder: small buttons anywhere on the walls, random start and exit."""
    puzzle = ButtonsConfig(count=count, graph=graph, buttons=Panels(width=1.5), dead_ends=dead_ends)
    settings: dict[str, Any] = {"robot": RobotConfig(body_radius=0.5), "puzzle": puzzle,
                                "room": ShapeConfig(width=size, depth=size)}
    return RoomConfig(name=name, **(settings | parts))


def inner_doors() -> RoomConfig:
    """Four rooms with three doors between them, each opened by a button of its own."""
    puzzle = ButtonsConfig(count=5, graph=GraphConfig(kind="tree"), buttons=Panels(width=1.5), doors=3)
    return ladder_room("inner-doors", 5, puzzle.graph, room=ShapeConfig(width=20, depth=20, rooms=4), puzzle=puzzle)


def clutter() -> RoomConfig:
    """Obstacles and two interior walls: four buttons in three rooms, a door at the exit."""
    return ladder_room(
        "clutter", 4, GraphConfig(kind="layered", max_parents=2),
        room=ShapeConfig(width=20, depth=20, rooms=3), obstacles=ObstaclesConfig(count=15),
        exit=ExitConfig(door=True, width=2.5, depth=1.5),
    )


def arm_two_button() -> RoomConfig:
    """Two small buttons at different heights, which require the hand of a 3-joint arm."""
    return RoomConfig(
        name="arm-two-button",
        room=ShapeConfig(width=12, depth=12),
        robot=RobotConfig(body_radius=0.4, body_height=0.8, joints=3, link_length=0.5),
        puzzle=ButtonsConfig(count=2, buttons=Panels(width=0.4, height=0.4, centre_height=1.2, height_spread=0.5)),
        dynamics=DynamicsConfig(press_with="hand"),
    )


def bit_flip() -> RoomConfig:
    """BitFlip (Diuk et al. 2006) with four bits on wall panels."""
    return RoomConfig(name="bit-flip", puzzle=BitFlipConfig(), robot=RobotConfig(body_radius=0.5),
                      room=ShapeConfig(width=12, depth=12))


def blocks_world(count: int = 4, hand: bool = False, problem: str | None = None) -> RoomConfig:
    """Blocks World: take towers apart and build them with a gripper.

    Args:
        count: number of blocks, 2 to 12; larger rooms hold more.
        hand: the hand of a 3-joint arm grips, instead of the body.
        problem: a PDDL problem of the domain with four operators, instead of random towers.
    """
    if not hand:
        return RoomConfig(name="blocks-world", puzzle=BlocksWorldConfig(count, problem),
                          robot=RobotConfig(body_radius=0.4, gripper=True), room=ShapeConfig(width=12, depth=12))
    arm, places = arm_two_button(), Panels(width=0.4, height=0.4, centre_height=1.2, height_spread=0.5)
    return dataclasses.replace(arm, name="blocks-world", robot=dataclasses.replace(arm.robot, gripper=True),
                               puzzle=BlocksWorldConfig(count, problem, places))


def push_block() -> RoomConfig:
    """Push a block onto a plate: the continuous state of the puzzle requires physics dynamics."""
    return RoomConfig(name="push-block", puzzle=PushBlockConfig(), robot=RobotConfig(body_radius=0.4, move_step=0.5),
                      room=ShapeConfig(width=10, depth=10), dynamics=DynamicsConfig(kind="physics"))


def _panel_puzzle(name: str, puzzle: PuzzleConfig, **parts: Any) -> RoomConfig:
    return RoomConfig(name=name, puzzle=puzzle, robot=RobotConfig(body_radius=0.4),
                      room=ShapeConfig(width=12, depth=12), **parts)


def recipes(goal: Craft = "diamond") -> RoomConfig:
    """A recipe game after Crafter: materials, a table and a furnace, and tools.

    Args:
        goal: name of the material or thing that opens the exit.
    """
    return _panel_puzzle("recipes", RecipesConfig(goal))


def deep_sea(size: int = 10) -> RoomConfig:
    """Deep Sea of bsuite on two panels, without additional rewards of the room.

    Args:
        size: number of rows and columns, 2 to 50.
    """
    return _panel_puzzle("deep-sea", DeepSeaConfig(size=size), exit=EVERYWHERE, reward=RewardConfig(step=0.0, exit=0.0))


PRESETS: dict[str, Callable[..., RoomConfig]] = {
    "paper-one-button": lambda: paper_room(1),
    "paper-two-button": lambda: paper_room(2),
    "paper-random": paper_random,
    "larg-2019": larg_2019,
    "four-button-chain": lambda: ladder_room("four-button-chain", 4, GraphConfig(kind="chain")),
    "arm-two-button": arm_two_button,
    "clutter": clutter,
    "ten-button": lambda: ladder_room("ten-button", 10, GraphConfig(kind="layered", max_parents=2)),
    "twenty-button": lambda: ladder_room("twenty-button", 20, GraphConfig(kind="layered", max_parents=2), 30.0),
    "dead-ends": lambda: ladder_room("dead-ends", 6, GraphConfig(kind="layered", max_parents=2), dead_ends=4),
    "inner-doors": inner_doors,
    "bit-flip": bit_flip,
    "lights-out": lambda: _panel_puzzle("lights-out", LightsOutConfig(scramble=4)),
    "hanoi": lambda: _panel_puzzle("hanoi", HanoiConfig()),
    "code-lock": lambda: _panel_puzzle("code-lock", CodeLockConfig()),
    "light-box": lambda: _panel_puzzle("light-box", LightBoxConfig()),
    "random-lights": lambda: _panel_puzzle("random-lights", LightBoxConfig(
        count=8, graph=GraphConfig(kind="random", max_parents=3))),
    "factored": lambda: _panel_puzzle("factored", FactoredConfig()),
    "potions": lambda: _panel_puzzle("potions", PotionsConfig()),
    "recipes": recipes,
    "deep-sea": deep_sea,
    "four-rooms": four_rooms,
    "continuous-four-rooms": continuous_four_rooms,
    "taxi": taxi,
    "puddle-world": puddle_world,
    "foraging": foraging,
    "door-key": door_key,
    "key-corridor": key_corridor,
    "multi-room": multi_room,
    "blocks-world": blocks_world,
    "key-chest": key_chest,
    "sokoban": sokoban,
    "pin-pad": lambda: _panel_puzzle("pin-pad", PinPadConfig()),
    "push-block": push_block,
}


TAGS: dict[str, tuple[str, ...]] = {
    "paper-one-button": ("paper", "buttons"),
    "paper-two-button": ("paper", "buttons"),
    "paper-random": ("paper", "buttons", "varied"),
    "larg-2019": ("paper", "buttons", "arm", "reset"),
    "four-button-chain": ("buttons",),
    "arm-two-button": ("buttons", "arm"),
    "clutter": ("buttons", "obstacles", "doors"),
    "ten-button": ("buttons", "many buttons"),
    "twenty-button": ("buttons", "many buttons"),
    "dead-ends": ("buttons", "irreversible"),
    "inner-doors": ("buttons", "doors"),
    "bit-flip": ("classic puzzle", "reset"),
    "lights-out": ("classic puzzle",),
    "hanoi": ("classic puzzle",),
    "code-lock": ("classic puzzle", "reset"),
    "light-box": ("classic puzzle", "many buttons", "stochastic", "reset"),
    "random-lights": ("random domain", "stochastic", "reset"),
    "factored": ("random domain", "stochastic"),
    "potions": ("random domain", "memory"),
    "recipes": ("classic puzzle",),
    "deep-sea": ("classic puzzle", "irreversible"),
    "four-rooms": ("grid world", "stochastic"),
    "continuous-four-rooms": ("velocities",),
    "taxi": ("grid world", "gripper"),
    "puddle-world": ("grid world",),
    "foraging": ("grid world", "gripper", "stochastic"),
    "door-key": ("grid world", "gripper", "doors"),
    "key-corridor": ("grid world", "gripper", "doors"),
    "multi-room": ("grid world", "gripper", "doors"),
    "blocks-world": ("classic puzzle", "gripper"),
    "key-chest": ("grid world", "stochastic"),
    "sokoban": ("grid world", "irreversible"),
    "pin-pad": ("classic puzzle",),
    "push-block": ("physics",),
}
"""Words to search presets by: properties of their rooms that matter to an agent."""


def list_presets(*tags: str) -> list[str]:
    """Return the names of the presets that have all the given tags, all presets without a tag.

    Raises:
        UnknownNameError: no preset has such a tag.
    """
    known = sorted({tag for found in TAGS.values() for tag in found})
    for tag in tags:
        if tag not in known:
            raise UnknownNameError("tag of presets", tag, known)
    return [name for name in PRESETS if set(tags) <= set(TAGS[name])]


def get_preset(name: str, **arguments: Any) -> RoomConfig:
    """Return a named room configuration.

    Raises:
        UnknownNameError: no preset of that name.
        ConfigError: the preset has no such argument, or the value is not valid.
    """
    if not isinstance(name, str) or name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    try:
        return PRESETS[name](**arguments)
    except TypeError as error:
        raise ConfigError(f"preset {name!r}", arguments, str(error)) from None


def read_config(form: ConfigForm) -> RoomConfig:
    """Read a room configuration in any of its forms.

    Raises:
        UnknownNameError: no preset of that name, or no such field.
        ConfigError: a value is not valid.
    """
    if isinstance(form, RoomConfig):
        return form
    if isinstance(form, str):
        return get_preset(form)
    if isinstance(form, Mapping):
        return RoomConfig.from_dict(form)
    raise ConfigError("config", form, "the name of a preset, a RoomConfig, or the dict form of one")


def make_env_name(preset: str) -> str:
    """Return the CamelCase name in a preset's environment id: `paper-two-button` gives `PaperTwoButton`."""
    return "".join(word.capitalize() for word in preset.split("-"))


def describe_config(config: RoomConfig) -> str:
    """Return one line about a room configuration: sizes, puzzle, obstacles, robot, dynamics."""
    parts = [f"{config.room.width:g} x {config.room.depth:g} m"]
    if config.room.rooms != 1:
        parts.append(f"{config.room.rooms} rooms")
    count = getattr(config.puzzle, "count", None) if config.puzzle.panels is not None else None
    parts.append(config.puzzle.kind if count is None else f"{config.puzzle.kind} x {count}")
    if config.obstacles.count != 0:
        parts.append(f"{config.obstacles.count} obstacles")
    if config.robot.joints:
        parts.append(f"{config.robot.joints}-joint arm")
    if config.dynamics.press_with == "hand":
        parts.append("pressed by hand")
    if config.dynamics.kind == "physics":
        parts.append("physics")
    if config.dynamics.is_random:
        parts.append(f"noise {config.dynamics.noise:g}, slip {config.dynamics.slip:g}")
    return ", ".join(parts)
