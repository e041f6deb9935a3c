"""Make the moving picture of the README: a robot presses buttons with its arm and leaves.

    python docs/make_picture.py

writes `docs/images/escape.webp` in some minutes. Bullet's software renderer draws it, so no display and no GPU are
needed. The planner finds the escape. Poses between two primitives are interpolated; the background is transparent.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pybullet
from PIL import Image

from hrl_escape.env import RoomInstance, generate
from hrl_escape.env.bullet.cameras import SUN, Stage
from hrl_escape.env.config import (
    DynamicsConfig,
    ExitConfig,
    ObstaclesConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
)
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.puzzles.base import Panels, Place
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.planning.planner import get_planner

KEPT = Path(__file__).parent / "images" / "escape.webp"
SIZE = (840, 424)
"""Width and height, pixels."""
FINE = 2
"""Every pixel is the mean of so many squared."""
SEED = 1
BETWEEN, FRAME, REST = 3, 42, 1600
"""Pictures a primitive, and how long a picture and the last one are shown, ms."""
WIDTH, DEPTH = 7.0, 5.0  # m
EYE, TARGET, FIELD = (0.0, -8.6, 6.9), (0.0, -0.2, 0.62), 27.6  # m, m and vertical degrees

ROOM = RoomConfig(
    name="picture",
    room=ShapeConfig(width=WIDTH, depth=DEPTH, wall_height=1.75, wall_thickness=0.14),
    robot=RobotConfig(kind="franka-panda", joints=7, body_radius=0.42, body_height=0.5, move_step=0.5,
                      hand_radius=0.07),
    puzzle=ButtonsConfig(
        count=3, graph=GraphConfig(kind="edges", edges=((1, 0), (0, 2))),
        buttons=Panels(width=0.8, height=0.7, centre_height=1.15, places=(
            Place(-1.7, DEPTH / 2 - 0.05), Place(WIDTH / 2 - 0.05, -0.5, 90.0), Place(0.05 - WIDTH / 2, -0.7, 90.0)))),
    obstacles=ObstaclesConfig(count=2, size_min=0.5, size_max=0.9, height=0.6),
    start=StartConfig(place="fixed", x=-0.6, y=-1.5, heading_deg=90.0),
    exit=ExitConfig(place="fixed", x=1.4, y=DEPTH / 2 - 0.6, width=1.6, depth=1.2),
    dynamics=DynamicsConfig(press_with="hand"),
)


def interpolate(rules: Kinematics, first: RoomState, then: RoomState, share: float) -> RoomState:
    """Return a pose between two states; lights change with the second."""
    turn = math.remainder(rules.get_heading(then) - rules.get_heading(first), math.tau)
    arms = zip(rules.get_angles(first), rules.get_angles(then), strict=True)
    return first._replace(
        x=first.x + share * (then.x - first.x), y=first.y + share * (then.y - first.y),
        heading_offset=first.heading_offset + share * turn,
        joint_offsets=tuple(share * (after - before) for before, after in arms))


def list_states(room: RoomInstance, between: int) -> list[RoomState]:
    """The planner's escape, with poses between any two states."""
    rules = Kinematics(room)
    states = get_planner(room).solve(rules.make_state(room.starts[0], 0)).states
    found = [interpolate(rules, first, then, part / between)
             for first, then in zip(states, states[1:], strict=False) for part in range(between)]
    return [*found, states[-1]]


def take_pictures(room: RoomInstance, states: list[RoomState]) -> Iterator[Image.Image]:
    """Picture of each state from one place, with the near wall cut open."""
    stage = Stage(room)
    for standing in stage.standing:
        if stage.roles[standing.whole[0]] == "wall" and standing.shape.y < -DEPTH / 2:
            stage.set_cut(standing, True)
    width, height = (FINE * side for side in SIZE)
    looking = pybullet.computeViewMatrix(EYE, TARGET, (0.0, 0.0, 1.0))
    lens = pybullet.computeProjectionMatrixFOV(FIELD, width / height, 1.0, 40.0)
    for state in states:
        stage.follow(state)
        _, _, colours, _, bodies = pybullet.getCameraImage(
            width, height, looking, lens, shadow=0, renderer=pybullet.ER_TINY_RENDERER, lightDirection=SUN,
            lightAmbientCoeff=0.74, lightDiffuseCoeff=0.27, lightSpecularCoeff=0.0, physicsClientId=stage.client)
        picture = np.reshape(colours, (height, width, 4)).astype(np.uint8)
        picture[..., 3] = np.where(np.reshape(bodies, (height, width)) < 0, 0, 255)
        yield Image.fromarray(picture).reduce(FINE)


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--path", type=Path, default=KEPT, help="where to write")
    parser.add_argument("--between", type=int, default=BETWEEN, help="pictures a primitive")
    options = parser.parse_args()
    room = generate(ROOM, SEED)
    first, *rest = take_pictures(room, list_states(room, options.between))
    times = [BETWEEN * FRAME // options.between] * len(rest) + [REST]
    first.save(options.path, save_all=True, append_images=rest, duration=times, loop=0, quality=62, method=6,
               alpha_quality=60, minimize_size=False, allow_mixed=False)
    print(f"{options.path}: {len(times)} pictures, {options.path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
