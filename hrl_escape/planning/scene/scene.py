"""`Scene`: a room as named things that can be added, removed, moved and held, with the planner of each version.

A scene is a value: every edit returns a new one. `Scene.instance` is the edited room, which an
environment can be made of, so plans in a scene come true there. `Scene.planner` takes over what
the planner of the scene before had computed, as far as the edit leaves it valid.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from functools import cached_property

from typing_extensions import Self

from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import PlacedProp, RoomInstance, Start, Target
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.room_checks import check_room
from hrl_escape.errors import ConfigError, UnknownNameError, UnsupportedError
from hrl_escape.planning.room_planner import RoomPlanner
from hrl_escape.planning.scene.held_object import HeldObject, give_to_hand, grip

__all__ = ["Scene"]


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """One version of a room.

    Walls, obstacles and the door are solids, named by their role: `obstacle-1`, `wall-3`, `door`. Targets and the
    puzzle's props keep their own names; they can be moved, but the puzzle's rules say how many there are.

    Attributes:
        instance: the room as it stands.
        names: names of `instance.solids`, in order.
        held: the object in the hand; None for an empty hand.
    """

    instance: RoomInstance
    names: tuple[str, ...]
    held: HeldObject | None = None
    _before: RoomPlanner | None = None

    @classmethod
    def of(cls, instance: RoomInstance, state: RoomState | None = None) -> Self:
        """Make the scene of a room.

        Args:
            instance: the room.
            state: episodes of `Scene.instance` begin where the base stands in this state; None for the room's own
                starts, which no edit may then cover.
        """
        counts: Counter[str] = Counter()
        names = []
        for solid in instance.solids:
            counts[solid.role] += 1
            names.append(f"{solid.role}-{counts[solid.role]}")
        if state is not None:
            start = Start(state.x, state.y, state.heading_steps, state.heading_offset)
            instance = dataclasses.replace(instance, starts=(start,))
        return cls(instance, tuple(names))

    # --- looking -------------------------------------------------------------------------

    @property
    def things(self) -> dict[str, Solid | Target | PlacedProp]:
        """Everything that has a name, but for the held object."""
        room = self.instance
        return {**dict(zip(self.names, room.solids, strict=True)), **({"door": room.door} if room.door else {}),
                **{target.name: target for target in room.targets},
                **{placed.prop.name: placed for placed in room.props}}

    @cached_property
    def planner(self) -> RoomPlanner:
        """Planner of this version; it plans as `RoomPlanner(scene.instance)` would, and is ready sooner."""
        return RoomPlanner(self.instance) if self._before is None else self._before.adapt(self.instance)

    # --- editing -------------------------------------------------------------------------

    def add(self, name: str, solid: Solid) -> Scene:
        """Add a box or cylinder that stands on the floor.

        Raises:
            ConfigError: the name is taken, or the solid covers a start.
        """
        if name in self.things or (self.held is not None and name == self.held.name):
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
            ConfigError: a start would be covered, or the floor would not be walled in.
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

    def attach(self, name: str, state: RoomState) -> Scene:
        """Attach an obstacle to the hand; it moves with the arm from then on and collides as a link of it.

        Args:
            name: the obstacle.
            state: base and arm when the hand grips it; the object keeps its place in the hand's frame.

        Raises:
            UnknownNameError: nothing has this name.
            UnsupportedError: it is no obstacle, the robot has no arm, or the hand is full.
        """
        number = self._find_solid(name, "held")
        solid, room = self.instance.solids[number], self.instance
        if self.held is not None or room.robot.joints == 0 or solid.role != "obstacle":
            why = ("the robot has no arm" if room.robot.joints == 0 else "it is no obstacle" if self.held is None
                   else f"the hand holds {self.held.name!r}")
            raise UnsupportedError(f"{name!r} cannot be held: {why}")
        held = grip(name, solid, Kinematics(room), state)
        solids = room.solids[:number] + room.solids[number + 1 :]
        without = dataclasses.replace(room, solids=solids, robot=give_to_hand(room.robot, held))
        return self._make(without, self.names[:number] + self.names[number + 1 :], held)

    def detach(self, state: RoomState) -> Scene:
        """Put the held object down: upright on the floor below its place in a state.

        Raises:
            UnsupportedError: the hand is empty.
            ConfigError: it would cover a start.
        """
        held = self.held
        if held is None:
            raise UnsupportedError("nothing can be put down: the hand is empty")
        solid = held.put_down(Kinematics(self.instance), state)
        room = dataclasses.replace(self.instance, solids=(*self.instance.solids, solid), robot=held.robot)
        return self._make(room, (*self.names, held.name), None)

    def _edit(self, solids: tuple[Solid, ...], names: tuple[str, ...]) -> Scene:
        room = dataclasses.replace(self.instance, solids=solids)
        return self._make(room, names, self.held)

    def _make(self, room: RoomInstance, names: tuple[str, ...], held: HeldObject | None = None) -> Scene:
        check_room(room)
        return type(self)(room, names, held, self.__dict__.get("planner", self._before))

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
        return inside and self.planner.get_field_maker(True).collision.is_free(x, y)
