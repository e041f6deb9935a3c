"""Messages of ROS 2 as dictionaries of their fields, for `json`, `yaml` or `rosidl_runtime_py.set_message_fields`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any


def make_header(frame: str, seconds: float = 0.0) -> dict[str, Any]:
    """Return a `std_msgs/Header`."""
    return {"stamp": make_time(seconds), "frame_id": frame}


def make_time(seconds: float) -> dict[str, int]:
    """Return a `builtin_interfaces/Time` or `Duration`."""
    whole, rest = divmod(round(seconds * 1e9), 10**9)
    return {"sec": whole, "nanosec": rest}


def make_point(x: float, y: float) -> dict[str, float]:
    """Return a `geometry_msgs/Point` or `Vector3` on the floor, m."""
    return {"x": x, "y": y, "z": 0.0}


def make_quaternion(heading: float) -> dict[str, float]:
    """Return a `geometry_msgs/Quaternion` of a heading, rad."""
    return {"x": 0.0, "y": 0.0, "z": math.sin(heading / 2), "w": math.cos(heading / 2)}


def make_twist(rates: Sequence[float]) -> dict[str, dict[str, float]]:
    """Return a `geometry_msgs/Twist` of rates along x and y and about z."""
    return {"linear": make_point(rates[0], rates[1]), "angular": {"x": 0.0, "y": 0.0, "z": rates[2]}}


def make_pose_stamped(x: float, y: float, heading: float, frame: str, seconds: float = 0.0) -> dict[str, Any]:
    """Return a `geometry_msgs/PoseStamped` of a place on the floor, m, and a heading, rad."""
    return {"header": make_header(frame, seconds),
            "pose": {"position": make_point(x, y), "orientation": make_quaternion(heading)}}
