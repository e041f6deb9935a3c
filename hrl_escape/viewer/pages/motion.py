"""A trajectory as one HTML page that plays offline: the robot in 3D, at its true speed.

The base's way is drawn on the floor and, where the robot has an arm, the way of its hand in the air. A
trajectory is motion only: panels and exit stay as they are in the state it begins in. `replay.py` shows episodes.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from markupsafe import escape

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.errors import ConfigError
from hrl_escape.files import write_text
from hrl_escape.planning.motion.trajectory import TimedTrajectory
from hrl_escape.viewer.pages.policy import add_policy
from hrl_escape.viewer.scene.room_scene import RoomPose, RoomScene, make_pose
from hrl_escape.viewer.server import open_server

FRAME_RATE = 30.0
"""Most frames of a saved page for each second of the motion."""
MOST_SAMPLES = 12_000
"""Number of frames above which there are fewer a second, so that pages stay small."""
PAUSE = 2.0
"""Rest at the end before the page plays again, s."""


def save_motion(path: str | Path, trajectory: TimedTrajectory, instance: RoomInstance, state: RoomState | None = None
                ) -> None:
    """Write the page of a trajectory, atomically; see `make_motion`.

    Raises:
        FileWriteError: the file could not be written.
    """
    write_text(path, make_motion(trajectory, instance, state))


def make_motion(trajectory: TimedTrajectory, instance: RoomInstance, state: RoomState | None = None) -> str:
    """One HTML document that plays a trajectory without a network.

    Args:
        trajectory: of the base, the arm, or both.
        instance: the room.
        state: everything that the trajectory does not move, and the lights; None for the room's first start.

    Raises:
        ConfigError: the room's robot has none of the joints that move.
        MissingExtraError: the extra `viewer` is not installed.
    """
    server = open_server(port=0)
    try:
        scene = RoomScene(server, instance)
        state = scene.rules.make_state(instance.starts[0]) if state is None else state
        times, positions, _ = trajectory.sample(min(FRAME_RATE, MOST_SAMPLES / trajectory.duration))
        still = make_pose(scene.rules, state)
        poses = [_move(still, trajectory.names, row, scene.rules) for row in positions.tolist()]
        scene.show(state)
        scene.pose(poses[0])
        scene.draw_path([(pose.x, pose.y) for pose in poses])
        if instance.robot.joints:
            scene.draw_hand_path([_place_hand(pose, scene.rules) for pose in poses])
        serializer = server.get_scene_serializer()
        for seconds, pose in zip(np.diff(times).tolist(), poses[1:], strict=True):
            serializer.insert_sleep(seconds)
            scene.pose(pose)
        serializer.insert_sleep(PAUSE)
        page = serializer.as_html()
    finally:
        server.stop()
    title = f"{instance.name}: {trajectory.duration:.1f} s"
    return add_policy(page.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1))


def _move(still: RoomPose, names: tuple[str, ...], row: list[float], rules: Rules) -> RoomPose:
    """Pose with the coordinates of a trajectory in place of its own."""
    own = {"x": still.x, "y": still.y, "heading": still.heading,
           **dict(zip(rules.robot.joint_names, still.angles, strict=True))}
    strangers = [name for name in names if name not in own]
    if strangers:
        raise ConfigError("trajectory.names", strangers, f"coordinates of this room's robot: {', '.join(own)}")
    own |= zip(names, row, strict=True)
    angles = tuple(own[name] for name in rules.robot.joint_names)
    return still._replace(x=own["x"], y=own["y"], heading=own["heading"], angles=angles)


def _place_hand(pose: RoomPose, rules: Rules) -> tuple[float, float, float]:
    """Position of the hand in the room, m."""
    ahead, left, up = rules.robot.compute_hand(pose.angles).tolist()
    cos, sin = math.cos(pose.heading), math.sin(pose.heading)
    return pose.x + cos * ahead - sin * left, pose.y + sin * ahead + cos * left, pose.z + up
