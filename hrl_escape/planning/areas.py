"""Goal areas: places of the body's axis within some distance of a footprint, for fields, searches and paths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import NO_LIMIT, Clock
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.floor_grid import compute_extent_radius
from hrl_escape.env.geometry import Footprint, compute_distance, compute_distance_many, make_footprint, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.errors import GoalError, UnsupportedError
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.floor.sweeps import POINT, Presser, make_presser
from hrl_escape.planning.goals import (
    ExitGoal,
    Goal,
    GripGoal,
    PoseGoal,
    PressGoal,
    PushGoal,
    RegionGoal,
    get_region,
    is_reached,
)

PLACES = 2_000
"""Places tested between two checks of a clock."""


class Area(NamedTuple):
    """Places whose distance from a footprint is at most `reach` metres; none where `reach` < 0."""

    footprint: Footprint
    reach: float


def compute_goal_area(goal: Goal, instance: RoomInstance) -> Area:
    """Area where the body's axis reaches a goal; of a press by hand, only the footprint is meaningful.

    For a press by a rectangular base it is where the base touches the target at some heading, or nearly so. Raises
    `GoalError` for no target of the room, `UnsupportedError` for a push.
    """
    if isinstance(goal, (PressGoal, GripGoal)):
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
    raise UnsupportedError("a push is not a goal of a path: plan to a PoseGoal behind the block, then drive on")


def get_presser(goal: Goal, instance: RoomInstance) -> Presser:
    """Return the shape that must touch a goal; a point where the goal's area alone decides."""
    is_touch = isinstance(goal, PressGoal) and instance.targets[goal.target].kind == "panel"
    by_base = is_touch and instance.dynamics.press_with == "body" and not instance.robot.base.turns_anywhere
    return make_presser(instance.robot.base) if by_base else POINT


def find_headings(goal: Goal, state: RoomState, rules: Rules) -> NDArray[np.bool_] | None:
    """Headings of a state's lattice that reach a goal, bool (headings,), or None if every heading does."""
    if not isinstance(goal, PoseGoal) or goal.heading is None:
        return None
    at = state._replace(x=goal.x, y=goal.y)
    states = (at._replace(heading_steps=n) for n in range(rules.headings))
    return np.array([is_reached(goal, s, s, rules) for s in states])


def sample_places(area: Area, collision: CollisionMap, most: int = 64, clock: Clock = NO_LIMIT
                  ) -> NDArray[np.float64]:
    """Free places spread over an area, deterministically, (n, 2), m; empty where a grid of 2 cm has none.

    They are the points of a grid that is refined until there are some, so that the narrow strip along a wall that
    touches a button is found too. Raises `OutOfTime`.
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
        free = [points[:0]]
        for part in np.array_split(points, 1 + len(points) // PLACES):
            clock.check()
            free.append(part[collision.are_free(part)])
        points = np.concatenate(free)
        if len(points) or spacing <= 0.04:
            return points[np.linspace(0, len(points) - 1, min(most, len(points))).astype(int)]
        spacing = max(0.02, spacing / 3)


def grow_solids(instance: RoomInstance, state: RoomState, goal: Goal, margin: float) -> tuple[Footprint, ...]:
    """Footprints of the solids grown by a margin, which is smaller where the start or the goal is nearer."""
    radius = instance.robot.outer_radius + 2 * CONTACT_SKIN
    area = compute_goal_area(goal, instance)
    grown = []
    for solid in instance.solids:
        shape = solid.footprint
        to_goal = compute_distance(area.footprint.x, area.footprint.y, shape) - compute_extent_radius(area.footprint)
        room = min(compute_distance(state.x, state.y, shape), to_goal - max(area.reach, 0.0)) - radius
        if min(room, margin) > 0.0:
            extra = min(room, margin)
            grown.append(shape._replace(half_x=shape.half_x + extra, half_y=shape.half_y + extra))
    return tuple(grown)
