"""Presets of published grid worlds: rooms of cells, whose primitives are the moves of the domain."""

from __future__ import annotations

from hrl_escape.env.config import (
    DynamicsConfig,
    ExitConfig,
    RewardConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
    Wall,
)
from hrl_escape.env.puzzles.base import Pads, Place
from hrl_escape.env.puzzles.foraging import ForagingConfig
from hrl_escape.env.puzzles.key_chest import KeyChestConfig
from hrl_escape.env.puzzles.mini_grid import DrawnLevel, MiniGridConfig
from hrl_escape.env.puzzles.pin_pad import PinPadConfig
from hrl_escape.env.puzzles.puddle_world import PuddleWorldConfig
from hrl_escape.env.puzzles.pushing import tidy_level
from hrl_escape.env.puzzles.sokoban import SokobanConfig
from hrl_escape.env.puzzles.taxi import TaxiConfig

__all__ = ["EVERYWHERE", "FOUR_ROOMS", "KEY_CHEST", "door_key", "foraging", "four_rooms", "key_chest", "key_corridor",
           "multi_room", "puddle_world", "sokoban", "taxi"]

EVERYWHERE = ExitConfig(place="fixed", width=200, depth=200)
"""An exit on the whole floor: the primitive that solves the puzzle ends the episode."""


def taxi(rainy: bool = False, fickle: bool = False) -> RoomConfig:
    """Taxi (Dietterich 2000; Gymnasium's Taxi-v4), cell by cell.

    Args:
        rainy: a move that is not blocked ahead goes to either side with probability 0.1 each.
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
    """Four Rooms (Sutton, Precup and Singh 1999), cell by cell: 1 on arrival at the goal, 0 for all else.

    Args:
        slip: `any` for the paper's moves, 1/9 for each other direction; `neighbour` for a free neighbour once in three
            moves (Bacon, Harb and Precup 2017); `none`.
        row: of the goal, from 0 at the top; by default the goal is the east hallway.
        column: of the goal.
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


KEY_CHEST = (" " * 15, " " * 15, "#############  ", " " * 15, " " * 15, "  ###########  ", " " * 15, " " * 15,
             "#############  ", " " * 15, " " * 15)
"""Map of HRAC's Key-Chest (Zhang et al. 2020), without its outer walls."""


def key_chest(random_start: bool = False) -> RoomConfig:
    """Key-Chest of HRAC (Zhang et al. 2020), cell by cell: 1 for the key, 5 for the chest, 0 for all else.

    One move in four is drawn from all four, so that one in 16 goes to each other side.

    Args:
        random_start: episodes begin in any cell, as the option of that name in HRAC's program.
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
        worms: number to eat before the episode ends, 1 to 100.
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
    """Puddle World (Boyan and Moore 1995; Sutton 1996) on the lattice of its moves, which are without noise here."""
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
        rooms: rooms above one another, or one after another.
        largest: largest side of one of several rooms, walls included.
    """
    wide, high = (3 * (size - 1) - 1, rooms * (size - 1) - 1) if level == "key-corridor" else (size - 2, size - 2)
    steps = {"door-key": 10 * size**2, "key-corridor": 30 * size**2, "multi-room": 20 * rooms}
    side = 2 if min(wide, high) > 2 else 5  # rooms are 5 m wide at the least
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
        rooms: rooms above one another; 1 to 3.
    """
    return mini_grid("key-corridor", size, rooms)


def multi_room(rooms: int = 4, largest: int = 5, size: int = 15) -> RoomConfig:
    """MiniGrid's MultiRoom: open door after door, to the goal in the last room.

    Args:
        rooms: number of rooms.
        largest: largest side of a room, walls included.
        size: side of the map, which is 25 in MiniGrid.
    """
    return mini_grid("multi-room", size, rooms, largest)


def sokoban(size: int = 6, boxes: int = 2, rows: tuple[str, ...] = ()) -> RoomConfig:
    """Sokoban, cell by cell, with the rewards of gym-sokoban; the instance seed draws the level, unless it is given.

    Args:
        size: side of drawn levels, without the outer walls.
        boxes: boxes of drawn levels, 1 to 7.
        rows: a level, such as one of Boxoban's.
    """
    level = tidy_level(rows) if rows else (" " * size,) * size
    wide, high = len(level[0]), len(level)
    side = 2 if min(wide, high) > 2 else 5  # rooms are 5 m wide at the least
    return RoomConfig(
        name="sokoban", puzzle=SokobanConfig(size, boxes, level if rows else ()),
        room=ShapeConfig(width=side * wide, depth=side * high, cell=side),
        robot=RobotConfig(body_radius=0.4, move_step=side, turn_step_deg=90),
        exit=EVERYWHERE, reward=RewardConfig(step=-0.1, exit=10.0),
        dynamics=DynamicsConfig(blocked="stay"), horizon=120,
    )
