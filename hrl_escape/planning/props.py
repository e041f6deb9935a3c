"""Movable props as obstacles: places of the blocks, and the blocks that a route must not touch.

A route never touches a block that stands where the puzzle wants it, and goes round all others too, if it can.
"""

from __future__ import annotations

from collections.abc import Sequence

from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.geometry import Footprint, compute_distance, compute_first_contact, make_footprint
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.poses import get_planar_pose

MARGIN = 0.1
"""Distance that routes keep from blocks where there is room, m: bodies under physics drift."""
GRAZE = 0.01
"""Depth of a contact with a block that hardly moves it, m."""


def get_prop_poses(state: RoomState, instance: RoomInstance) -> list[tuple[float, float, float]]:
    """Poses (x, y, yaw) of the props, m and rad."""
    if state.physics is None:
        return [(placed.x, placed.y, placed.yaw) for placed in instance.props]
    return [get_planar_pose(numbers) for numbers in state.physics.props]


def list_blocks(state: RoomState, instance: RoomInstance, *, grown: float = 0.0, only_done: bool = False,
                without: int | None = None) -> tuple[Footprint, ...]:
    """Footprints of the blocks, each side grown by some metres.

    A negative growth shrinks them. `only_done` leaves out blocks that do not stand where the puzzle wants them,
    `without` the prop of an index.
    """
    if not instance.props:
        return ()
    kept = _list_done(state, instance) if only_done else {placed.prop.name for placed in instance.props}
    return tuple(
        make_footprint(x, y, placed.prop.half_size + grown, placed.prop.half_size + grown, yaw)
        for i, (placed, (x, y, yaw)) in enumerate(zip(instance.props, get_prop_poses(state, instance), strict=True))
        if placed.prop.kind == "block" and placed.prop.name in kept and i != without
    )


def list_obstacles(state: RoomState, instance: RoomInstance) -> list[tuple[Footprint, ...]]:
    """List sets of footprints to keep out of, from the most careful to the least that is allowed.

    The first holds all blocks with a margin, the last only those whose motion would undo what is done.
    """
    radius = instance.robot.outer_radius + CONTACT_SKIN
    careful = []
    for block in list_blocks(state, instance):
        margin = min(MARGIN, compute_distance(state.x, state.y, block) - radius - GRAZE)  # never over the start itself
        margin = max(margin, -0.5 * block.half_x)
        careful.append(block._replace(half_x=block.half_x + margin, half_y=block.half_y + margin))
    sets = [tuple(careful), list_blocks(state, instance, grown=-GRAZE, only_done=True)]
    return sets if sets[0] else sets[1:]


def meets(x: float, y: float, to_x: float, to_y: float, keep_out: Sequence[Footprint], radius: float) -> bool:
    """Return whether a disc that moves from one place straight to another meets a footprint."""
    return any(compute_first_contact(x, y, to_x - x, to_y - y, radius, block) < 1.0 for block in keep_out)


def _list_done(state: RoomState, instance: RoomInstance) -> set[str]:
    """Names of the blocks that stand where the puzzle wants them."""
    facts = instance.puzzle.symbolic.get_facts(state.puzzle)
    return {op.target for op in instance.symbolic_model.operators
            if op.action == "push" and op.add <= facts}
