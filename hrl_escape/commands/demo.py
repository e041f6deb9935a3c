"""Plan and drive the way out of a room; draw a map, a filmstrip and an animation.

Examples:
    hrl-escape demo
    hrl-escape demo --preset arm-two-button --seed 1
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from rich.console import Console

from hrl_escape.commands.driving import drive_room
from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.env.drawing.maps import Trajectory, save_map
from hrl_escape.env.drawing.video import make_filmstrip, save_picture, save_video
from hrl_escape.env.engine import film
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.names import make_console_text
from hrl_escape.planning.planner import RoomPlanner


@dataclasses.dataclass(frozen=True)
class DemoArgs(RoomChoice):
    """Options of `hrl-escape demo`."""

    preset: str = "clutter"
    """Named schematic; `hrl-escape list presets` shows them."""
    seed: int = 3
    """Instance seed: selects one room of the schematic."""
    folder: Path = Path("demo")
    """Folder for the pictures. (`make demo` is a comparison and writes into runs/quickstart.)"""


def run(args: DemoArgs) -> None:
    """Plan, drive and draw."""
    console = Console(soft_wrap=True)
    instance = args.make_instance()
    start = instance.starts[0]
    plan = RoomPlanner(instance).solve(Kinematics(instance).make_state(start, 0))
    drive = drive_room(dataclasses.replace(instance, starts=(start,)), plan.primitives)
    parts = ", ".join(make_console_text(part.name) for part in plan.parts)
    console.print(f"[bold]{make_console_text(instance.name)}[/bold], seed {instance.seed}: {len(plan.primitives)} "
                  f"primitives for {parts}, found in {plan.seconds:.2f} s; driven in Bullet: {drive.end.words}, "
                  f"return {drive.total:g}")
    legs = [Trajectory(drive.path[part.start : part.stop + 1], part.name) for part in plan.parts]
    map_ = args.folder / "map.svg"
    save_map(map_, instance, drive.states[-1], legs)
    frames = list(film(instance, drive.states))
    captions = [f"after {number} primitives" for number in range(len(frames))]
    save_picture(args.folder / "filmstrip.png", make_filmstrip(frames, captions))
    save_video(args.folder / "escape.gif", frames)
    console.print(f"The way out: {map_.resolve()}", markup=False)
