"""The kinematic Escape Room MDP as pure rules: one state and one primitive give the next state.

`Kinematics` compiles an instance into tables and steps it exactly; it holds no state of an episode. The Bullet engine
steps with it and planners simulate with it, which makes the predicted states of a plan equal to the executed ones.
`Rules` holds the rules that all dynamics share: presses, puzzle, reward, exit and horizon.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Hashable, Mapping
from enum import Enum
from functools import partial
from typing import Any, NamedTuple

from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.geometry import Footprint, NearCells, compute_distance
from hrl_escape.env.instance import RoomInstance, Start, is_on_floor
from hrl_escape.env.memo import Memo
from hrl_escape.env.noise import compute_noise, draw_chance, draw_puzzle_start
from hrl_escape.env.poses import RobotPoses, RoomState, list_touched
from hrl_escape.env.primitives import list_slips
from hrl_escape.env.puzzles.base import PUSH, Contacts, Puzzle
from hrl_escape.env.puzzles.mixins import Barring, Pushing, get_mixin
from hrl_escape.env.rewards import Events, RewardState
from hrl_escape.errors import StateError, show_value
from hrl_escape.names import count_nouns

__all__ = ["EpisodeEnd", "Glide", "Kinematics", "RoomState", "Rules", "Transition", "check_fields", "check_state"]

_AHEAD = (1.0, 0.0)
ROUNDING = 1e-12
"""Angle, rad, within which the sum of small motions counts as a whole step despite rounding."""


class EpisodeEnd(str, Enum):
    """End of an episode; `STOPPED` means that the episode could continue."""

    ESCAPED = "escaped"
    """The puzzle is solved and the robot is in the exit."""
    FAILED = "failed"
    """The puzzle has failed, such as Deep Sea after its last row without the treasure."""
    TRUNCATED = "truncated"
    """The horizon was reached."""
    STOPPED = "stopped"
    """No primitive ended the episode; the caller stopped it."""

    @classmethod
    def of_step(cls, success: bool, terminated: bool, truncated: bool) -> EpisodeEnd:
        """Return the end from the flags of a step. `success` is `info["is_success"]`, and required for an escape."""
        if terminated:
            return cls.ESCAPED if success else cls.FAILED
        return cls.TRUNCATED if truncated else cls.STOPPED

    @property
    def is_over(self) -> bool:
        """True if the episode cannot continue."""
        return self is not EpisodeEnd.STOPPED

    @property
    def words(self) -> str:
        """Text for pages and commands."""
        return {"truncated": "out of time", "stopped": "still inside"}.get(self.value, self.value)


class Transition(NamedTuple):
    """Outcome of one primitive."""

    state: RoomState
    reward: float
    terminated: bool
    truncated: bool
    events: Events

    @property
    def pressed(self) -> tuple[int, ...]:
        """Ascending indices of the targets that the primitive pressed."""
        return list_touched(self.events.pressed) if self.events.pressed else ()


QUIET = Events(0, 0, 0, 0, 0, False, False)
"""Events of a primitive without any event."""


class Glide(NamedTuple):
    """A short motion of base and arm in continuous coordinates, followed by an act of the hand."""

    dx: float  # displacement of the base's axis in the room frame, m
    dy: float  # same along y, m
    turn: float  # turn of the base, rad
    joints: tuple[float, ...]  # change of each joint's angle, rad
    seconds: float  # duration (physics)
    grip: int = 0  # 1 to grip at its end, -1 to release, 2 to use


class InnerDoors:
    """Inner doors of a room: which are shut in a state of the puzzle, and which a step can meet.

    A door that shuts while the body is in its doorway does not block that body.
    """

    def __init__(self, instance: RoomInstance) -> None:
        self.footprints = tuple(door.footprint for door in instance.inner_doors)
        self._puzzle, self._radius = instance.puzzle, instance.robot.outer_radius + CONTACT_SKIN
        self._stride = instance.robot.actions.stride
        self._shut = Memo(get_mixin(instance.puzzle, Barring).get_shut)
        reach = self._radius + 1.5 * instance.robot.actions.longest * (2.0 if instance.dynamics.noise else 1.0)
        self._near = NearCells(enumerate(self.footprints), ((door, reach) for door in self.footprints))
        self._shut_near = Memo(partial(_list_shut, self._near))
        at = NearCells(enumerate(self.footprints), ((door, 0.0) for door in self.footprints), 0.25)
        self._at = Memo(partial(_find_at, at))
        self._pushes = isinstance(instance.puzzle, Pushing)

    def get_shut(self, puzzle: Hashable) -> int:
        """Return the bits of the shut doors in a state of the puzzle; cached."""
        return self._shut[puzzle]

    def find_blocking(self, x: float, y: float, puzzle: Hashable) -> int:
        """Return the bits of the shut doors, without doors that the body overlaps."""
        shut = self.get_shut(puzzle)
        for number, door in enumerate(self.footprints if shut else ()):
            if shut >> number & 1 and compute_distance(x, y, door) < self._radius - 1e-6:
                shut &= ~(1 << number)
        return shut

    def list_near(self, x: float, y: float, puzzle: Hashable, is_step: bool = True) -> tuple[Footprint, ...]:
        """Return the outlines of the shut doors that a motion from a place could meet: a step, or one of any length."""
        if not is_step:
            shut = self.find_blocking(x, y, puzzle)
            return tuple(door for number, door in enumerate(self.footprints) if shut >> number & 1)
        near = self._shut_near[math.floor(x), math.floor(y), self.get_shut(puzzle)]
        least = self._radius - 1e-6
        return tuple([door for door in near if compute_distance(x, y, door) >= least]) if near else ()

    def push(self, x: float, y: float, dx: float, dy: float, puzzle: Hashable) -> Hashable:
        """Return the puzzle state after a move from a place has pushed the thing in its way, if that is possible."""
        ahead = self._at[x + dx, y + dy] if self._pushes else -1
        if ahead < 0 or not self.get_shut(puzzle) >> ahead & 1:
            return puzzle
        beyond = self._at[x + 2.0 * dx, y + 2.0 * dy]
        return self._puzzle.update(puzzle, Contacts((), grip=PUSH, ahead=ahead, beyond=beyond))

    def find_ahead(self, x: float, y: float, cos: float, sin: float) -> int:
        """Return the index of the door one stride ahead of the body's axis; -1 if there is none."""
        return self._at[x + self._stride * cos, y + self._stride * sin]

    def find_at(self, x: float, y: float) -> int:
        """Return the index of the door at a place; -1 if there is none."""
        return self._at[x, y]


def _list_shut(doors: NearCells[tuple[int, Footprint]], key: tuple[int, int, int]) -> tuple[Footprint, ...]:
    """Outlines of the doors near a cell of the floor whose bits are set: x and y of the cell, and the bits."""
    return tuple(door for number, door in doors[key[:2]] if key[2] >> number & 1)


def _find_at(doors: NearCells[tuple[int, Footprint]], place: tuple[float, float]) -> int:
    """Index of the door at a place; -1 if there is none."""
    x, y = place
    for number, door in doors[math.floor(4.0 * x), math.floor(4.0 * y)]:
        if compute_distance(x, y, door) == 0.0:
            return number
    return -1


def _compute_lit(puzzle: Puzzle, state: Hashable) -> int:
    """Bits of the targets that are on in a state of the puzzle."""
    return sum(1 << i for i, is_on in enumerate(puzzle.get_lit(state)) if is_on)


class Rules(RobotPoses):
    """Rules that all dynamics share: touching, presses, the puzzle, reward, exit and horizon.

    Args:
        instance: the room.
        is_still: if true, remove all randomness, as planners do: no noise, no slips, and the most likely outcomes of a
            random puzzle.
    """

    def __init__(self, instance: RoomInstance, is_still: bool = False) -> None:
        super().__init__(instance.robot)
        self.instance = instance
        self.actions = instance.robot.actions
        self._puzzle = instance.puzzle
        self._puzzle_starts = instance.puzzle.list_starts()
        self._is_random = instance.puzzle.is_random and not is_still
        self._is_watching = instance.puzzle.is_watching
        self._exit = instance.exit
        self._reward = instance.reward
        self._step_reward, self._exit_reward = instance.reward.step, instance.reward.on_exit
        self._pays_extra = not instance.reward.is_sparse
        self._lights = Memo(partial(_compute_lit, instance.puzzle))
        self._solved = Memo(instance.puzzle.is_solved)
        self._horizon = instance.horizon
        self._by_hand = instance.dynamics.press_with == "hand"
        entries = [(i, t.footprint, instance.compute_press_reach(t), t) for i, t in enumerate(instance.targets)]
        by_hand = instance.robot.hand_radius + instance.dynamics.press_margin
        self._near_targets = NearCells(entries, ((shape, by_hand if self._by_hand else reach)
                                                 for _, shape, reach, _ in entries))
        self._presser = None if self._by_hand or instance.robot.base.turns_anywhere else instance.robot.base
        self.inner_doors = InnerDoors(instance) if instance.inner_doors else None

    # --- touching --------------------------------------------------------------------

    def compute_touching(self, x: float, y: float, heading_steps: int, heading_offset: float,
                         joint_steps: tuple[int, ...], joint_offsets: tuple[float, ...]) -> int:
        """Return the bits of the targets that the presser touches at a pose of base and arm."""
        touching = 0
        if not self._by_hand:
            for i, footprint, reach, target in self._near_targets[math.floor(x), math.floor(y)]:
                if compute_distance(x, y, footprint) <= reach:
                    if self._presser is not None and target.kind == "panel" and self._presser.measure_distance(
                            x, y, self.get_rotation(heading_steps, heading_offset), footprint
                    ) > self.instance.compute_press_margin(target):
                        continue
                    touching |= 1 << i
            return touching
        hand_x, hand_y, hand_z = self.get_hand_in_base(joint_steps, joint_offsets)
        cos, sin = self.get_rotation(heading_steps, heading_offset)
        at_x, at_y = x + cos * hand_x - sin * hand_y, y + sin * hand_x + cos * hand_y
        for i, footprint, _, target in self._near_targets[math.floor(at_x), math.floor(at_y)]:
            if compute_distance(at_x, at_y, footprint) <= self.instance.compute_press_reach(target, hand_z):
                touching |= 1 << i
        return touching

    # --- the episode -----------------------------------------------------------------

    def make_state(self, start: Start, noise_key: int = 0) -> RoomState:
        """Return the state at the beginning of an episode. Targets touched there do not count as pressed."""
        steps = (0,) * self.instance.robot.joints
        touching = self.compute_touching(start.x, start.y, start.heading_steps, start.heading_offset, steps, ())
        starts = self._puzzle_starts
        puzzle = starts[draw_puzzle_start(noise_key, len(starts)) if len(starts) > 1 else 0]
        if self.instance.props:
            puzzle = self._puzzle.update(puzzle, Contacts((), tuple((p.x, p.y, p.yaw) for p in self.instance.props)))
        return RoomState(start.x, start.y, start.heading_steps, start.heading_offset, steps, (),
                         puzzle, touching, 0, noise_key)

    def judge(self, before: RoomState, moved: RoomState,
              prop_poses: tuple[tuple[float, float, float], ...] = (), grip: int = 0) -> Transition:
        """Complete a motion: apply presses, puzzle, reward, exit and horizon.

        `moved` is the state after the motion and what it pushed, with the current contacts but the old number of
        primitives. `grip` is 1 if the primitive grips, -1 if it releases, 2 if it uses. Under physics, props have
        poses.
        """
        x, y, steps, offset, joint_steps, joint_offsets, puzzle, touching, _, key, z, pitch, roll, physics = moved
        begun = touching & ~before.touching
        more, failed = 0.0, False
        if begun or prop_poses or grip or self._is_watching or puzzle != before.puzzle:
            chance = draw_chance(before.noise_key, before.primitives) if self._is_random else 0.0
            ahead = -1 if not grip or self.inner_doors is None else self.inner_doors.find_ahead(
                x, y, *self.get_rotation(steps, offset))
            contacts = Contacts(list_touched(begun) if begun else (), prop_poses, chance,
                                list_touched(touching) if touching else (), grip, x != before.x or y != before.y,
                                x, y, ahead)
            puzzle = self._puzzle.update(puzzle, contacts)
            more = self._puzzle.compute_reward(before.puzzle, puzzle, contacts)
            failed = self._puzzle.is_failed(puzzle)
        count = before.primitives + 1
        escaped = self._exit.contains(x, y) and self.is_solved(puzzle)
        terminated = escaped or failed
        state = RoomState(x, y, steps, offset, joint_steps, joint_offsets, puzzle, touching, count, key, z, pitch, roll,
                          physics)
        reward = (self._exit_reward if escaped else self._step_reward) + more
        events = QUIET
        if begun or terminated or puzzle != before.puzzle:
            events = self._list_events(before.puzzle, puzzle, begun, escaped, failed)
        if self._pays_extra:
            reward += self._reward.compute_extra(self._show(before), self._show(state), events)
        return Transition(state, reward, terminated, not terminated and count >= self._horizon, events)

    def _list_events(self, before: Hashable, after: Hashable, pressed: int, escaped: bool, failed: bool) -> Events:
        """Events of a primitive that changed the puzzle from one state to another."""
        if after == before:
            return Events(pressed, 0, 0, 0, 0, escaped, failed)
        was_lit, is_lit = self._lights[before], self._lights[after]
        was_shut, is_shut = ((self.inner_doors.get_shut(before), self.inner_doors.get_shut(after))
                             if self.inner_doors else (0, 0))
        return Events(pressed, is_lit & ~was_lit, was_lit & ~is_lit, was_shut & ~is_shut, is_shut & ~was_shut,
                      escaped, failed)

    def _show(self, state: RoomState) -> RewardState:
        return RewardState(state.x, state.y, state.heading_steps,
                           self._lights[state.puzzle].bit_count() / max(1, len(self.instance.targets)),
                           self.is_solved(state.puzzle))

    def has_escaped(self, state: RoomState) -> bool:
        """Return whether the exit is open and the robot is in it."""
        return self.is_solved(state.puzzle) and self._exit.contains(state.x, state.y)

    def is_solved(self, puzzle: Hashable) -> bool:
        """Return whether the exit is open in a state of the puzzle; cached."""
        return self._solved[puzzle]


class Kinematics(Rules):
    """The kinematic MDP of an instance: exact first contact, no sliding, and arms that pass through solids.

    If a solid blocks any part of a turn, the base does not turn.
    """

    def __init__(self, instance: RoomInstance, is_still: bool = False) -> None:
        super().__init__(instance, is_still)
        robot, dynamics = instance.robot, instance.dynamics
        self._radius = robot.outer_radius + CONTACT_SKIN
        self._base = robot.base.grow(CONTACT_SKIN)
        self._noise, self._slip = (0.0, 0.0) if is_still else (dynamics.noise, dynamics.slip)
        self._slip_kind, self._stays = dynamics.slip_kind, dynamics.blocked == "stay"
        self._slips = tuple(list_slips(dynamics.slip_kind, self.actions, action) for action in range(len(self.actions)))
        self.footprints = tuple(solid.footprint for solid in instance.solids)
        self._door = instance.door and instance.door.footprint
        doors = () if self._door is None else (self._door,)
        self._span = self.actions.longest * (2.0 if self._noise else 1.0)
        reach = self._radius + 0.75 * self._span  # from the middle of a step
        self._near_solids = NearCells(self.footprints, ((shape, reach) for shape in self.footprints), 0.5)
        self._near_door = NearCells(doors, ((door, reach) for door in doors), 0.5)
        self._is_grid = self._stays and self._base.turns_anywhere
        self._free: dict[tuple[float, float, float, float, int], float] = {}
        self._barred = Memo(partial(_find_barred, self.inner_doors, None if self._door is None else self._solved))
        self._primitives = self.actions.primitives
        self._moves = tuple(
            tuple(primitive.compute_move(cos, sin) for cos, sin in self.rotations) for primitive in self._primitives)

    def step(self, state: RoomState, action: int) -> Transition:
        """Apply one primitive. The function is pure: equal arguments give equal transitions."""
        primitive, scale = self._primitives[action], 1.0
        if self._noise or self._slip:
            normal, uniform = compute_noise(state.noise_key, state.primitives)
            scale += self._noise * normal
            if uniform < self._slip:
                if self._slip_kind == "stay":
                    return self.judge(state, state)
                action = self._slide(state, action, scale, uniform / self._slip)
        if primitive.joint >= 0:
            moved = self._move_joint(state, primitive.joint, primitive.joint_change, scale)
        elif primitive.turn:
            moved = self._turn(state, primitive.turn, scale)
        elif primitive.grip:
            moved = state
        else:
            moved = self._translate(state, action, scale)
        return self.judge(state, moved, grip=primitive.grip)

    def glide(self, state: RoomState, motion: Glide) -> Transition:
        """Apply a short motion instead of a primitive. The function is pure.

        The base moves straight until its first contact, then turns on the spot if the turn is free. Joints stop at
        their limits. The hand acts last. Noise and slips apply as to a primitive; a motion that slips has no effect.

        If a thing that can be pushed stops the base, it is pushed as by a move of one stride in the nearest of the
        map's four directions, provided that the base then reaches its destination.
        """
        scale, grip = 1.0, motion.grip
        if self._noise or self._slip:
            normal, uniform = compute_noise(state.noise_key, state.primitives)
            scale, grip = (0.0, 0) if uniform < self._slip else (1.0 + self._noise * normal, grip)
        x, y, steps, offset = state.x, state.y, state.heading_steps, state.heading_offset
        dx, dy, turn = scale * motion.dx, scale * motion.dy, scale * motion.turn
        puzzle = state.puzzle
        if dx or dy:
            fraction, pushed = self.compute_advance(state, dx, dy)
            if fraction >= 1.0 or not self._stays:
                x, y, puzzle = x + fraction * dx, y + fraction * dy, pushed
        if turn:
            to = self.split_heading(steps * self.turn_step + offset + turn)
            to = to if abs(to[1]) > ROUNDING else (to[0], 0.0)
            if self.can_turn(state._replace(x=x, y=y, puzzle=puzzle), self.get_rotation(*to), turn):
                steps, offset = to
        joint_steps, joint_offsets = state.joint_steps, state.joint_offsets
        if any(motion.joints):
            pairs = zip(self.get_angles(state), motion.joints, self.robot.limits, strict=True)
            joint_steps, joint_offsets = self.split_angles(
                min(max(angle + scale * change, low), high) for angle, change, (low, high) in pairs)
            joint_offsets = joint_offsets if max(map(abs, joint_offsets)) > ROUNDING else ()
        touching = self.compute_touching(x, y, steps, offset, joint_steps, joint_offsets)
        moved = state._replace(x=x, y=y, heading_steps=steps, heading_offset=offset, touching=touching, puzzle=puzzle,
                               joint_steps=joint_steps, joint_offsets=joint_offsets)
        return self.judge(state, moved, grip=grip)

    def compute_advance(self, state: RoomState, dx: float, dy: float) -> tuple[float, Hashable]:
        """Return the free fraction, in [0, 1], of a short displacement, and the puzzle state after its push."""
        x, y, puzzle = state.x, state.y, state.puzzle
        rotation = self.get_rotation(state.heading_steps, state.heading_offset)
        fraction = self.compute_free_fraction(x, y, dx, dy, puzzle, rotation)
        if fraction < 1.0 and self.inner_doors is not None and isinstance(self._puzzle, Pushing):
            stride = self.actions.stride
            side = (math.copysign(stride, dx), 0.0) if abs(dx) >= abs(dy) else (0.0, math.copysign(stride, dy))
            pushed = self.inner_doors.push(x + fraction * dx, y + fraction * dy, *side, puzzle)
            if pushed != puzzle and self.compute_free_fraction(x, y, dx, dy, pushed, rotation) >= 1.0:
                return 1.0, pushed
        return fraction, puzzle

    def _slide(self, state: RoomState, action: int, scale: float, share: float) -> int:
        """Translation after a slip, chosen by a uniform number; other primitives are unchanged."""
        others = self._slips[action]
        if self._slip_kind == "neighbour":
            others = tuple(n for n in others if self._is_free(state, n, scale))
        elif self._slip_kind == "lateral-if-free" and others and not self._is_free(state, action, scale):
            return action
        return others[min(int(share * len(others)), len(others) - 1)] if others else action

    def _is_free(self, state: RoomState, action: int, scale: float) -> bool:
        dx, dy = self._compute_displacement(state, action, scale)
        turned = self.get_rotation(state.heading_steps, state.heading_offset)
        return self.compute_free_fraction(state.x, state.y, dx, dy, state.puzzle, turned) >= 1.0

    def _compute_displacement(self, state: RoomState, action: int, scale: float) -> tuple[float, float]:
        """Displacement (x, y) of a translation before any contact, m."""
        steps, offset = state.heading_steps, state.heading_offset
        if offset == 0.0:
            dx, dy = self._moves[action][steps]
        else:
            dx, dy = self._primitives[action].compute_move(*self.get_rotation(steps, offset))
        return (scale * dx, scale * dy) if scale != 1.0 else (dx, dy)

    def _translate(self, state: RoomState, action: int, scale: float) -> RoomState:
        steps, offset = state.heading_steps, state.heading_offset
        dx, dy = self._compute_displacement(state, action, scale)
        puzzle = self.inner_doors.push(state.x, state.y, dx, dy, state.puzzle) if self.inner_doors else state.puzzle
        fraction = self.compute_free_fraction(state.x, state.y, dx, dy, puzzle, self.get_rotation(steps, offset))
        if fraction < 1.0:
            if self._stays:
                return state
            dx, dy = fraction * dx, fraction * dy
        x, y = state.x + dx, state.y + dy
        touching = self.compute_touching(x, y, steps, offset, state.joint_steps, state.joint_offsets)
        return RoomState(x, y, steps, offset, state.joint_steps, state.joint_offsets, puzzle, touching,
                         state.primitives, state.noise_key, state.z, state.pitch, state.roll, state.physics)

    def compute_free_fraction(self, x: float, y: float, dx: float, dy: float, puzzle: Hashable,
                              rotation: tuple[float, float] = _AHEAD) -> float:
        """Return the fraction, in [0, 1], of a displacement that keeps the body's clearance at this rotation."""
        if not self._is_grid:  # places rarely repeat
            return self._find_free_fraction(x, y, dx, dy, puzzle, rotation)
        motion = x, y, dx, dy, self._barred[puzzle]
        fraction = self._free.get(motion)
        if fraction is None:
            if len(self._free) > 4096:
                self._free.clear()
            fraction = self._free[motion] = self._find_free_fraction(x, y, dx, dy, puzzle, rotation)
        return fraction

    def _find_free_fraction(self, x: float, y: float, dx: float, dy: float, puzzle: Hashable,
                            rotation: tuple[float, float]) -> float:
        is_step, middle = abs(dx) + abs(dy) <= 1.5 * self._span, (math.floor(2.0 * x + dx), math.floor(2.0 * y + dy))
        near = self._near_solids[middle] if is_step else self.footprints
        fraction = self._base.find_free_fraction(x, y, rotation, dx, dy, near)
        if self.inner_doors is None and (self._door is None or (is_step and not self._near_door[middle])):
            return fraction
        shut = self._list_shut(x, y, puzzle, rotation, is_step)
        return min(fraction, self._base.find_free_fraction(x, y, rotation, dx, dy, shut)) if shut else fraction

    def can_turn(self, state: RoomState, to: tuple[float, float], turn: float) -> bool:
        """Return whether the base can turn on the spot by an angle in rad to a rotation."""
        if self._base.turns_anywhere:
            return True
        x, y, rotation = state.x, state.y, self.get_rotation(state.heading_steps, state.heading_offset)
        near = self._near_solids[math.floor(2.0 * x), math.floor(2.0 * y)]
        shapes = (*near, *self._list_shut(x, y, state.puzzle, rotation))
        return self._base.can_turn(x, y, rotation, to, turn, shapes)

    def _list_shut(self, x: float, y: float, puzzle: Hashable, rotation: tuple[float, float],
                   is_step: bool = True) -> tuple[Footprint, ...]:
        """Shut doors that a motion from a place can meet: the exit door and the inner doors."""
        doors = self.inner_doors.list_near(x, y, puzzle, is_step) if self.inner_doors else ()
        return (self._door, *doors) if self._door and self.is_door_shut(x, y, puzzle, rotation) else doors

    def is_door_shut(self, x: float, y: float, puzzle: Hashable, rotation: tuple[float, float] = _AHEAD) -> bool:
        """Return whether the exit has a shut door. It does not block a body that overlaps it."""
        if self._door is None or self.is_solved(puzzle):
            return False
        return not self._base.stands_in(x, y, rotation, self._door)

    def _turn(self, state: RoomState, turn: int, scale: float) -> RoomState:
        steps = (state.heading_steps + turn) % self.headings
        offset = state.heading_offset
        if scale != 1.0:
            offset = (offset + (scale - 1.0) * turn * self.turn_step + math.pi) % math.tau - math.pi
        touching = state.touching
        if not self._base.turns_anywhere and not self.can_turn(state, self.get_rotation(steps, offset),
                                                        scale * turn * self.turn_step):
            return state
        if self._by_hand or self._presser is not None:
            touching = self.compute_touching(state.x, state.y, steps, offset, state.joint_steps, state.joint_offsets)
        return RoomState(state.x, state.y, steps, offset, state.joint_steps, state.joint_offsets, state.puzzle,
                         touching, state.primitives, state.noise_key, state.z, state.pitch, state.roll, state.physics)

    def _move_joint(self, state: RoomState, joint: int, change: int, scale: float) -> RoomState:
        steps, offsets = list(state.joint_steps), state.joint_offsets
        steps[joint] += change
        if scale == 1.0 and not offsets:
            if not self.robot.step_low[joint] <= steps[joint] <= self.robot.step_high[joint]:
                return state
        else:
            extra = list(offsets or (0.0,) * len(steps))
            extra[joint] += (scale - 1.0) * change * self.robot.step
            offsets = tuple(extra)
            low, high = self.robot.limits[joint]
            if not low - 1e-9 <= self.robot.compute_angles(tuple(steps), offsets)[joint] <= high + 1e-9:
                return state
        touching = state.touching
        if self._by_hand:
            touching = self.compute_touching(state.x, state.y, state.heading_steps, state.heading_offset,
                                             tuple(steps), offsets)
        return RoomState(state.x, state.y, state.heading_steps, state.heading_offset, tuple(steps), offsets,
                         state.puzzle, touching, state.primitives, state.noise_key, state.z, state.pitch, state.roll,
                         state.physics)


def _find_barred(inner_doors: InnerDoors | None, solved: Mapping[Hashable, bool] | None, puzzle: Hashable) -> int:
    """Bits of the shut doors in a state of the puzzle: the exit door, which `solved` opens, then the inner doors."""
    shut = 0 if inner_doors is None else inner_doors.get_shut(puzzle)
    return shut << 1 | (solved is not None and not solved[puzzle])


# --- untrusted states ----------------------------------------------------------------------


_LARGEST_COUNT = 2**31
_SOFT_CONTACT = 0.1
"""Depth to which physics lets the body penetrate a solid, as a fraction of its radius."""
SOFT_LIMIT = 0.1
"""Angle, rad, beyond a joint's limit that physics allows."""


def check_state(rules: Rules, state: Any) -> None:
    """Raise `StateError` for a state that is impossible in this room; the message names the field.

    The engine checks its own part of a state, `physics`.
    """
    check_fields(rules, state)
    soft = rules.instance.dynamics.kind == "physics"
    base, rotation = rules.instance.robot.base, rules.get_rotation(state.heading_steps, state.heading_offset)
    pressed_in = base.inner_radius * _SOFT_CONTACT if soft else 0.0
    if not is_on_floor(rules.instance, state.x, state.y, pressed_in + 1e-6):
        raise StateError(f"x = {state.x:g}, y = {state.y:g} is not possible: it is outside the walls")
    for solid in rules.instance.solids:
        if compute_distance(state.x, state.y, solid.footprint) < base.inner_radius - pressed_in or (
                base.measure_gap(state.x, state.y, rotation, (solid.footprint,)) < -pressed_in):
            raise StateError(f"x = {state.x:g}, y = {state.y:g} is not possible: the body overlaps the {solid.role} "
                             f"at ({solid.x:g}, {solid.y:g})")


def check_fields(rules: Rules, state: RoomState) -> None:
    """Check each field of a state by its own range, independent of where the body is.

    Raises:
        StateError: the value is not a state, or a number is out of range; the message names the field.
    """
    if not isinstance(state, RoomState):
        raise StateError(f"a state must be a RoomState from get_state(), got {show_value(state)}")
    instance, soft = rules.instance, rules.instance.dynamics.kind == "physics"
    top = instance.wall_height + instance.robot.body_height
    _check_number("x", state.x, -instance.reach_x, instance.reach_x)
    _check_number("y", state.y, -instance.reach_y, instance.reach_y)
    _check_whole("heading_steps", state.heading_steps, rules.headings)
    _check_number("heading_offset", state.heading_offset, -math.pi, math.pi)
    _check_joints(rules, state, SOFT_LIMIT if soft else 1e-6)
    _check_whole("touching", state.touching, 1 << len(instance.targets))
    _check_whole("primitives", state.primitives, _LARGEST_COUNT)
    _check_whole("noise_key", state.noise_key, 2**64)
    _check_number("z", state.z, -1.0, top)
    _check_number("pitch", state.pitch, -math.pi, math.pi)
    _check_number("roll", state.roll, -math.pi, math.pi)
    if soft and state.physics is not None:
        _check_props(len(instance.props), state.physics)
    if not instance.puzzle.is_state(state.puzzle):
        raise StateError(f"puzzle = {show_value(state.puzzle)} is not possible: a state of this room's "
                         f"{instance.puzzle.kind} puzzle")


def _check_number(name: str, value: Any, low: float, high: float) -> None:
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if not is_number or not low <= value <= high:  # pyright: ignore[reportOperatorIssue]
        raise StateError(f"{name} = {show_value(value)} is not possible: a number from {low:g} to {high:g}")


def _check_whole(name: str, value: Any, count: int) -> None:
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or not 0 <= int(value) < count:
        raise StateError(f"{name} = {show_value(value)} is not possible: a whole number from 0 to {count - 1}")


def _check_props(count: int, physics: Any) -> None:
    """Check the part of a state under physics that planners read; the engine checks all of it."""
    try:
        poses = [tuple(map(float, numbers[:7])) for numbers in physics.props]
    except (AttributeError, TypeError, ValueError, OverflowError):
        poses = []
    if len(poses) != count or not all(len(pose) == 7 and all(map(math.isfinite, pose)) for pose in poses):
        raise StateError(f"physics = {show_value(physics)} is not possible: None, or the saved physics of a state of "
                         f"this room, with position and orientation of {count_nouns(count, 'prop')}")


def _check_joints(rules: Rules, state: RoomState, slack: float) -> None:
    joints, robot = rules.instance.robot.joints, rules.robot
    for name, values, lengths in (("joint_steps", state.joint_steps, (joints,)),
                                  ("joint_offsets", state.joint_offsets, (0, joints))):
        if not isinstance(values, tuple) or len(values) not in lengths:
            raise StateError(f"{name} = {show_value(values)} is not possible: {joints} numbers, one per joint")
    for offset in state.joint_offsets:
        _check_number("joint_offsets", offset, -math.pi, math.pi)
    for joint, steps in enumerate(state.joint_steps):
        if isinstance(steps, bool) or not isinstance(steps, numbers.Integral) or abs(steps) > _LARGEST_COUNT:
            raise StateError(f"joint_steps = {show_value(state.joint_steps)} is not possible: whole numbers")
        offset = state.joint_offsets[joint] if state.joint_offsets else 0.0
        angle, (low, high) = robot.home[joint] + steps * robot.step + offset, robot.limits[joint]
        if not low - slack <= angle <= high + slack:
            raise StateError(f"joint_steps = {show_value(state.joint_steps)} is not possible: joint {joint + 1} would "
                             f"be at {angle:.3g} rad, outside its limits {low:.3g} to {high:.3g}")
