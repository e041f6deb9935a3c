"""Where on the floor a goal is reached: within some distance of a footprint.

One description for all goals of the body's axis: a press by the body (near the target's
footprint), a rectangle, a disc. Fields, searches and path planners all read it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint, compute_distance_many, make_footprint, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.errors import GoalError, UnsupportedError
from hrl_escape.options.collision import CollisionMap
from hrl_escape.options.goals import ExitGoal, Goal, PoseGoal, PressGoal, PushGoal, RegionGoal, get_region, is_reached

__all__ = ["Area", "compute_area", "find_headings", "sample_places"]


class Area(NamedTuple):
    """Places whose distance from a footprint is at most `reach` metres; none where `reach` < 0."""

    footprint: Footprint
    reach: float


def compute_area(goal: Goal, instance: RoomInstance) -> Area:
    """Where the body's axis must be for a goal; where the hand presses, only which footprint is meant.

    Raises:
        GoalError: no such target.
        UnsupportedError: the goal is a push.
    """
    if isinstance(goal, PressGoal):
        if not 0 <= goal.target < len(instance.targets):
            raise GoalError(f"there is no target {goal.target}: the room has {len(instance.targets)}")
        target = instance.targets[goal.target]
        by_hand = instance.dynamics.press_with == "hand"
        return Area(target.footprint, -1.0 if by_hand else instance.compute_press_reach(target))
    if isinstance(goal, PoseGoal):
        return Area(make_footprint(goal.x, goal.y, 0.0, 0.0, 0.0, True), goal.tolerance)
    if isinstance(goal, (ExitGoal, RegionGoal)):
        region = get_region(goal, instance)
        half_x, half_y = (region.x_max - region.x_min) / 2, (region.y_max - region.y_min) / 2
        return Area(make_footprint(region.x_min + half_x, region.y_min + half_y, half_x, half_y), 0.0)
    assert isinstance(goal, PushGoal)
    raise UnsupportedError("a push is not a place to go to: plan to a PoseGoal behind the block, then drive on")


def find_headings(goal: Goal, state: RoomState, rules: Rules) -> NDArray[np.bool_] | None:
    """Headings on a state's lattice at which a goal is reached, shape (headings,); None where any will do."""
    if not isinstance(goal, PoseGoal) or goal.heading is None:
        return None
    at = state._replace(x=goal.x, y=goal.y)
    states = (at._replace(heading_steps=n) for n in range(rules.headings))
    return np.array([is_reached(goal, s, s, rules) for s in states])


def sample_places(area: Area, collision: CollisionMap, most: int = 64) -> NDArray[np.float64]:
    """Free places of an area, spread over it; the same ones every time.

    A grid over the area is thinned to those inside it where the body fits, at first coarsely
    and then finer, so that the strip along a wall in which a button is touched is found too.

    Returns:
        Shape (n, 2), m; empty where the body fits nowhere in the area, as far as 2 cm tell.
    """
    shape, reach = area
    if reach < 0.0:
        return np.zeros((0, 2))
    extent = np.array([shape.half_x, shape.half_y]) + reach
    row = stack_footprints([shape])
    spacing = max(0.02, float(extent.max()) / 8)
    while True:
        counts = np.minimum(np.maximum(np.ceil(2 * extent / spacing).astype(int), 1), 200)
        steps = [np.linspace(-e, e, 2 * n + 1) for e, n in zip(extent, counts, strict=True)]
        local = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
        points = local @ np.array([[shape.cos, shape.sin], [-shape.sin, shape.cos]]) + (shape.x, shape.y)
        points = points[compute_distance_many(points, row) <= reach]
        points = points[collision.are_free(points)]
        if len(points) or spacing <= 0.04:
            return points[np.linspace(0, len(points) - 1, min(most, len(points))).astype(int)]
        spacing = max(0.02, spacing / 3)
