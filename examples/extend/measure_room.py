"""A command: print the floor area of a room and its obstacles.

Examples:
    python -m measure_room --room clutter#3
    python -m measure_room --room clutter#3 --set room.width=12 --density
"""

import dataclasses

from hrl_escape.cli import run_script
from hrl_escape.commands.room_choice import RoomChoice


@dataclasses.dataclass(frozen=True)
class MeasureArgs(RoomChoice):
    """Options of the command, next to those that choose a room."""

    density: bool = False
    """Print obstacles per 100 square metres."""


def run(args: MeasureArgs) -> None:
    """Print one line."""
    room = args.make_instance()
    area, count = 4 * room.half_width * room.half_depth, sum(solid.role == "obstacle" for solid in room.solids)
    print(f"{area:g} m2, {100 * count / area:.1f} obstacles per 100 m2" if args.density else
          f"{area:g} m2, {count} obstacles")


if __name__ == "__main__":
    raise SystemExit(run_script(run))
