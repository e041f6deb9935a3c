"""See it work: make a room, plan and drive the way out, leave a map, a filmstrip and an animation.

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
from hrl_escape.env.bullet_cameras import film
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.rendering import Trajectory, save_map
from hrl_escape.env.video import make_filmstrip, save_picture, save_video
from hrl_escape.options.planner import RoomPlanner


@dataclasses.dataclass(frozen=True)
class DemoArgs(RoomChoice):
    """Options of `hrl-escape demo`."""

    preset: str = "clutter"
    """Named schematic; `hrl-escape list presets` shows them."""
    seed: int = 3
    """Instance seed: which room of the schematic."""
    folder: Path = Path("demo")
    """Where the pictures go."""


def run(args: DemoArgs) -> None:
    """Plan, drive, draw."""
    console = Console(soft_wrap=True)
    instance = args.make_instance()
    start = instance.starts[0]
    plan = RoomPlanner(instance).solve(Kinematics(instance).make_state(start, 0))
    drive = drive_room(dataclasses.replace(instance, starts=(start,)), plan.primitives)
    parts = ", ".join(part.name for part in plan.parts)
    console.print(f"[bold]{instance.name}[/bold], seed {instance.seed}: {len(plan.primitives)} primitives for {parts}, "
                  f"found in {plan.seconds:.2f} s; driven in Bullet: {drive.describe_end()}, return {drive.total:g}")
    legs = [Trajectory(drive.path[part.start : part.stop + 1], part.name) for part in plan.parts]
    map_ = args.folder / "map.svg"
    save_map(map_, instance, drive.states[-1], legs)
    frames = list(film(instance, drive.states))
    captions = [f"after {number} primitives" for number in range(len(frames))]
    save_picture(args.folder / "filmstrip.png", make_filmstrip(frames, captions))
    save_video(args.folder / "escape.gif", frames)
    console.print(f"Look at the way out: {map_.resolve()}")
