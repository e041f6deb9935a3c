"""`Scene`: a room as named things that can be added, removed and moved, with the planner of each version.

A scene is a value: every edit returns a new one. `Scene.instance` is the edited room, which an
environment can be made of, so plans in a scene come true there.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from functools import cached_property

from typing_extensions import Self

from hrl_escape.env.geometry import Solid, compute_distance, make_footprint
from hrl_escape.env.instance import PlacedProp, RoomInstance, Start, Target, check_room
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import ConfigError, UnknownNameError, UnsupportedError
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.props import get_prop_poses

_SINK = 0.02
"""Largest overlap of a pushing base with its block, m."""


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """One version of a room.

    Walls, obstacles and the door are solids, named by their role: `obstacle-1`, `wall-3`, `door`. Targets and the
    puzzle's props keep their own names. Targets can be moved; the puzzle's rules say how many there are.

    Attributes:
        instance: the room with all edits so far.
        names: names of `instance.solids`, in order.
    """

    instance: RoomInstance
    names: tuple[str, ...]

    @classmethod
    def of(cls, instance: RoomInstance, state: RoomState | None = None) -> Self:
        """Make the scene of a room.

        Args:
            instance: the room.
            state: episodes of `Scene.instance` begin where the base and the props stand in this state; None for the
                room's own starts, which no edit may then cover.
        """
        counts: Counter[str] = Counter()
        names = []
        for solid in instance.solids:
            counts[solid.role] += 1
            names.append(f"{solid.role}-{counts[solid.role]}")
        if state is not None:
            start = Start(state.x, state.y, state.heading_steps, state.heading_offset)
            poses = get_prop_poses(state, instance)
            props = tuple(dataclasses.replace(placed, x=x, y=y, yaw=yaw)
                          for placed, (x, y, yaw) in zip(instance.props, poses, strict=True))
            instance = dataclasses.replace(instance, starts=(start,), props=props)
        return cls(instance, tuple(names))

    # --- looking -------------------------------------------------------------------------

    @property
    def things(self) -> dict[str, Solid | Target | PlacedProp]:
        """Every named object of the scene."""
        room = self.instance
        return {**dict(zip(self.names, room.solids, strict=True)), **({"door": room.door} if room.door else {}),
                **{target.name: target for target in room.targets},
                **{placed.prop.name: placed for placed in room.props}}

    @cached_property
    def planner(self) -> RoomPlanner:
        """Planner of this version."""
        return RoomPlanner(self.instance)

    # --- editing -------------------------------------------------------------------------

    def add(self, name: str, solid: Solid) -> Scene:
        """Add a box or cylinder that stands on the floor.

        Args:
            name: its name.
            solid: where it stands, and its size.

        Raises:
            ConfigError: the name is taken, or it covers a start.
        """
        if name in self.things:
            raise ConfigError("name", name, "a name that nothing else in the scene has")
        return self._edit((*self.instance.solids, solid), (*self.names, name))

    def remove(self, name: str) -> Scene:
        """Remove an obstacle or an interior wall.

        Raises:
            UnknownNameError: nothing has this name.
            UnsupportedError: it is a target, a prop or the door, which belong to the puzzle.
            ConfigError: without it the floor would not be walled in.
        """
        number = self._find_solid(name, "removed")
        solids = self.instance.solids
        return self._edit(solids[:number] + solids[number + 1 :], self.names[:number] + self.names[number + 1 :])

    def move(self, name: str, x: float | None = None, y: float | None = None, yaw: float | None = None) -> Scene:
        """Move a solid, a target or a prop; whatever is not given stays.

        Args:
            name: its name.
            x: new place of its centre, m.
            y: new place of its centre, m.
            yaw: new direction, rad.

        Raises:
            UnknownNameError: nothing has this name.
            UnsupportedError: it is the door.
            ConfigError: a start would be covered, a block would stand in a solid, or the floor would not be walled in.
        """
        room, thing = self.instance, self._get(name)
        new = {key: value for key, value in (("x", x), ("y", y), ("yaw", yaw)) if value is not None}
        if isinstance(thing, Target):
            targets = tuple(dataclasses.replace(t, **new) if t is thing else t for t in room.targets)
            return self._make(dataclasses.replace(room, targets=targets), self.names)
        if isinstance(thing, PlacedProp):
            props = tuple(dataclasses.replace(p, **new) if p is thing else p for p in room.props)
            return self._make(dataclasses.replace(room, props=props), self.names)
        number = self._find_solid(name, "moved")
        moved = dataclasses.replace(room.solids[number], **new)
        return self._edit((*room.solids[:number], moved, *room.solids[number + 1 :]), self.names)

    def _edit(self, solids: tuple[Solid, ...], names: tuple[str, ...]) -> Scene:
        return self._make(dataclasses.replace(self.instance, solids=solids), names)

    def _make(self, room: RoomInstance, names: tuple[str, ...]) -> Scene:
        check_room(room)
        _check_blocks(room)
        return type(self)(room, names)

    def _get(self, name: str) -> Solid | Target | PlacedProp:
        things = self.things
        if name not in things:
            raise UnknownNameError("thing in the scene", name, things)
        return things[name]

    def _find_solid(self, name: str, done: str) -> int:
        self._get(name)
        if name not in self.names:
            raise UnsupportedError(f"{name!r} cannot be {done}: targets, props and the door belong to the room's "
                                   f"puzzle ({self.instance.puzzle.kind}). Solids can: {', '.join(self.names)}")
        return self.names.index(name)

    def is_free(self, x: float, y: float) -> bool:
        """Return whether the base fits at a place while the puzzle is unsolved."""
        reach = self.instance
        inside = math.fabs(x) <= reach.reach_x and math.fabs(y) <= reach.reach_y
        return inside and self.planner.routes.get_field_maker().collision.is_free(x, y)


def _check_blocks(room: RoomInstance) -> None:
    """Check that no block stands in a solid or on a start. Raises `ConfigError`."""
    for placed in room.props:
        if placed.prop.kind != "block":
            continue
        half = placed.prop.half_size
        block = make_footprint(placed.x, placed.y, half, half, placed.yaw)
        covered = any(compute_distance(start.x, start.y, block) < room.robot.outer_radius - _SINK
                      for start in room.starts)
        if covered or any(compute_distance(placed.x, placed.y, solid.footprint) < half for solid in room.solids):
            raise ConfigError(f"props.{placed.prop.name}", (placed.x, placed.y),
                              "a place off the starts" if covered else "a place clear of walls and obstacles")
