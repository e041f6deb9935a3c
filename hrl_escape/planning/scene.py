"""`Scene`: a room of named objects that can be added, removed, moved and held, with a planner for each version.

A scene is a value: every edit returns a new one. Make an environment of the edited room, `Scene.instance`, to execute
plans in it. `Scene.planner` reuses what the planner of the previous scene computed and the edit leaves valid.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence
from functools import cached_property
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.geometry import Solid, compute_distance, make_footprint
from hrl_escape.env.instance import PlacedProp, RoomInstance, Start, Target, check_room
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.placements import compute_roll_pitch_yaw
from hrl_escape.env.puzzles.mixins import Propped, get_mixin
from hrl_escape.env.robot import BASE_LINK, make_robot
from hrl_escape.errors import ConfigError, UnknownNameError, UnsupportedError
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.props import get_prop_poses

_SINK = 0.02
"""Largest overlap of a pushing base with its block, m."""


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """One version of a room.

    Walls, obstacles and the door are solids, named by their role: `obstacle-1`, `wall-3`, `door`. Targets and props
    keep their own names. Targets can be moved, and the puzzle fixes their number.

    Attributes:
        instance: the room with all edits so far.
        names: names of `instance.solids`, in order.
        held: the object in the hand, or None.
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
            state: start of the episodes of `Scene.instance`: base and props are where they are in this state. With
                None, the room's own starts, which edits must not cover.
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
        """Return every named object of the scene except the held one."""
        room = self.instance
        return {**dict(zip(self.names, room.solids, strict=True)), **({"door": room.door} if room.door else {}),
                **{target.name: target for target in room.targets},
                **{placed.prop.name: placed for placed in room.props}}

    @cached_property
    def planner(self) -> RoomPlanner:
        """Return the planner of this version. It plans as `RoomPlanner(scene.instance)` would, and is ready sooner."""
        return RoomPlanner(self.instance) if self._before is None else self._before.adapt(self.instance)

    # --- editing -------------------------------------------------------------------------

    def add(self, name: str, thing: Solid | PlacedProp) -> Scene:
        """Add a box or cylinder on the floor, or a block or plate of the puzzle.

        An added block is loose: a movable obstacle. A plate is the goal of the oldest loose block.

        Args:
            name: its name.
            thing: its place and size.

        Returns:
            The new scene.

        Raises:
            ConfigError: the name is taken, it covers a start, a block overlaps a solid, or a plate has no block.
            UnsupportedError: the puzzle has no blocks and plates.
        """
        if name in self.things or (self.held is not None and name == self.held.name):
            raise ConfigError("name", name, "a name that nothing else in the scene has")
        if isinstance(thing, Solid):
            return self._edit((*self.instance.solids, thing), (*self.names, name))
        pairs, loose = _split_props(self.instance.props)
        thing = dataclasses.replace(thing, prop=dataclasses.replace(thing.prop, name=name))
        if thing.prop.kind == "block":
            return self._place_props(pairs, [*loose, thing])
        if not loose:
            raise ConfigError("name", name, "a plate for a loose block: add the block first")
        return self._place_props([*pairs, loose[0], thing], loose[1:])

    def remove(self, name: str) -> Scene:
        """Remove an obstacle, an interior wall, a loose block, or a plate, whose block is then loose.

        Returns:
            The new scene.

        Raises:
            UnknownNameError: no thing of the scene has this name.
            UnsupportedError: it is a target or the door, which belong to the puzzle.
            ConfigError: the floor would be open, a plate would have no block, or the puzzle would have no plate.
        """
        thing = self._get(name)
        if isinstance(thing, PlacedProp):
            pairs, loose = _split_props(self.instance.props)
            if thing in loose:
                return self._place_props(pairs, [other for other in loose if other is not thing])
            at = pairs.index(thing)
            if thing.prop.kind == "block":
                raise ConfigError("name", name, f"a loose block: remove its plate {pairs[at + 1].prop.name!r} first")
            return self._place_props(pairs[: at - 1] + pairs[at + 1 :], [*loose, pairs[at - 1]])
        number = self._find_solid(name, "removed")
        solids = self.instance.solids
        return self._edit(solids[:number] + solids[number + 1 :], self.names[:number] + self.names[number + 1 :])

    def move(self, name: str, x: float | None = None, y: float | None = None, yaw: float | None = None) -> Scene:
        """Move a solid, a target or a prop. Coordinates that are not given stay.

        Args:
            name: its name.
            x: new place of its centre, m.
            y: new place of its centre, m.
            yaw: new direction, rad.

        Returns:
            The new scene.

        Raises:
            UnknownNameError: no thing of the scene has this name.
            UnsupportedError: it is the door.
            ConfigError: it would cover a start, a block would overlap a solid, or the floor would be open.
        """
        room, thing = self.instance, self._get(name)
        new = {key: value for key, value in (("x", x), ("y", y), ("yaw", yaw)) if value is not None}
        if isinstance(thing, Target):
            targets = tuple(dataclasses.replace(t, **new) if t is thing else t for t in room.targets)
            return self._make(dataclasses.replace(room, targets=targets), self.names, self.held)
        if isinstance(thing, PlacedProp):
            props = tuple(dataclasses.replace(p, **new) if p is thing else p for p in room.props)
            return self._make(dataclasses.replace(room, props=props), self.names, self.held)
        number = self._find_solid(name, "moved")
        moved = dataclasses.replace(room.solids[number], **new)
        return self._edit((*room.solids[:number], moved, *room.solids[number + 1 :]), self.names)

    def attach(self, name: str, state: RoomState) -> Scene:
        """Attach an obstacle to the hand. It then moves with the arm and collides as a link of it.

        Args:
            name: the obstacle.
            state: base and arm at the grip; the object keeps its place in the frame of the hand.

        Returns:
            The new scene.

        Raises:
            UnknownNameError: no thing of the scene has this name.
            UnsupportedError: it is not an obstacle, the robot has no arm, or the hand is full.
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

        Returns:
            The new scene.

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

    def _place_props(self, pairs: Sequence[PlacedProp], loose: Sequence[PlacedProp]) -> Scene:
        """Replace the props, and the puzzle by one with these props."""
        room, props = self.instance, (*pairs, *loose)
        puzzle = get_mixin(room.puzzle, Propped).with_props(tuple(placed.prop for placed in props))
        shared = room.shared
        if shared is not None and len(shared.bounds) < len(puzzle.bounds):
            shared = dataclasses.replace(shared, bounds=puzzle.bounds)
        return self._make(dataclasses.replace(room, props=props, puzzle=puzzle, shared=shared), self.names, self.held)

    def _make(self, room: RoomInstance, names: tuple[str, ...], held: HeldObject | None) -> Scene:
        check_room(room)
        _check_blocks(room)
        return type(self)(room, names, held, self.__dict__.get("planner", self._before))

    def _get(self, name: str) -> Solid | Target | PlacedProp:
        things = self.things
        if name not in things:
            raise UnknownNameError("thing in the scene", name, things)
        return things[name]

    def _find_solid(self, name: str, done: str) -> int:
        self._get(name)
        if name not in self.names:
            raise UnsupportedError(f"{name!r} cannot be {done}: targets and the door belong to the room's "
                                   f"puzzle ({self.instance.puzzle.kind}). Solids can: {', '.join(self.names)}")
        return self.names.index(name)

    def is_free(self, x: float, y: float) -> bool:
        """Return whether the base fits at a place while the puzzle is unsolved."""
        reach = self.instance
        inside = math.fabs(x) <= reach.reach_x and math.fabs(y) <= reach.reach_y
        return inside and self.planner.routes.get_field_maker().collision.is_free(x, y)


def _split_props(props: Sequence[PlacedProp]) -> tuple[list[PlacedProp], list[PlacedProp]]:
    """Return blocks with their plates, one after the other, and loose blocks."""
    paired = 2 * sum(placed.prop.kind == "plate" for placed in props)
    return list(props[:paired]), list(props[paired:])


def _check_blocks(room: RoomInstance) -> None:
    """Check that no block overlaps a solid or a start. Raises `ConfigError`."""
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


DENSITY = 100.0
"""Density of a held object, kg / m^3, as of a light box."""


@dataclasses.dataclass(frozen=True, eq=False)
class HeldObject:
    """An obstacle held by the hand."""

    name: str  # its name in the scene
    solid: Solid  # the obstacle as it stood
    placement: NDArray[np.float64]  # its centre in the frame of the hand's link, shape (4, 4)
    robot: RobotConfig  # the robot with an empty hand

    def put_down(self, rules: Kinematics, state: RoomState) -> Solid:
        """Return the obstacle on the floor below its place in a state; `rules` are the room's where it is held."""
        at = _place_hand(rules, state) @ self.placement
        return dataclasses.replace(self.solid, x=float(at[0, 3]), y=float(at[1, 3]),
                                   yaw=math.atan2(at[1, 0], at[0, 0]))


def grip(name: str, solid: Solid, rules: Kinematics, state: RoomState) -> HeldObject:
    """Make the description of an obstacle that the hand grips in a state."""
    at = np.eye(4)
    at[:2, :2] = [[math.cos(solid.yaw), -math.sin(solid.yaw)], [math.sin(solid.yaw), math.cos(solid.yaw)]]
    at[:3, 3] = solid.x, solid.y, solid.height / 2
    return HeldObject(name, solid, np.linalg.inv(_place_hand(rules, state)) @ at, rules.instance.robot)


def give_to_hand(robot: RobotConfig, held: HeldObject) -> RobotConfig:
    """Return the robot with an object fixed to its hand, as a new URDF."""
    made = make_robot(robot)
    whole = ElementTree.fromstring(made.urdf)
    for joint in whole.findall("joint"):
        parent = joint.find("parent")
        if parent is not None and parent.get("link") == BASE_LINK:
            whole.remove(joint)
    for link in whole.findall("link"):
        if link.get("name") == BASE_LINK:
            whole.remove(link)
    solid, name = held.solid, f"held-{held.name}"
    if solid.shape == "cylinder":
        shape, volume = f'<cylinder radius="{solid.half_x!r}" length="{solid.height!r}"/>', math.pi * solid.half_x**2
    else:
        shape = f'<box size="{2 * solid.half_x!r} {2 * solid.half_y!r} {solid.height!r}"/>'
        volume = 4 * solid.half_x * solid.half_y
    mass = DENSITY * volume * solid.height
    inertia = mass * (solid.half_x**2 + solid.half_y**2 + (solid.height / 2) ** 2) / 3
    x, y, z = held.placement[:3, 3].tolist()
    roll, pitch, yaw = compute_roll_pitch_yaw(held.placement[:3, :3])
    whole.append(ElementTree.fromstring(
        f'<link name="{name}"><inertial><mass value="{mass!r}"/><inertia ixx="{inertia!r}" iyy="{inertia!r}" '
        f'izz="{inertia!r}" ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry>{shape}</geometry></visual>'
        f"<collision><geometry>{shape}</geometry></collision></link>"))
    whole.append(ElementTree.fromstring(
        f'<joint name="{name}-grip" type="fixed"><parent link="{made.hand_link}"/><child link="{name}"/>'
        f'<origin xyz="{x!r} {y!r} {z!r}" rpy="{roll!r} {pitch!r} {yaw!r}"/></joint>'))
    text = ElementTree.tostring(whole, encoding="unicode")
    return dataclasses.replace(robot, kind="urdf", urdf=text, hand_link=made.hand_link)


def _place_hand(rules: Kinematics, state: RoomState) -> NDArray[np.float64]:
    """Return the placement of the hand's link in the room, (4, 4)."""
    from hrl_escape.planning.arm.model import ArmKinematics  # loads Pinocchio

    cos, sin = rules.get_rotation(state.heading_steps, state.heading_offset)
    base = np.eye(4)
    base[:2, :2], base[:3, 3] = [[cos, -sin], [sin, cos]], (state.x, state.y, state.z)
    return base @ ArmKinematics(rules.robot).compute_placement(rules.get_angles(state))
