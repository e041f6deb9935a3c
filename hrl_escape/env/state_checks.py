"""Check of untrusted states: every number is possible in this room's episodes."""

from __future__ import annotations

import math
import numbers
from typing import Any

from hrl_escape.env.geometry import compute_distance
from hrl_escape.env.instance import is_on_floor
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.errors import StateError, show_value

_LARGEST_COUNT = 2**31
_SOFT_CONTACT = 0.1
"""Share of the body's radius by which physics lets it press into a solid."""
_SOFT_LIMIT = 0.1
"""Angle in rad by which physics lets a joint pass its limit."""


def check_state(rules: Rules, state: Any) -> None:
    """Raise `StateError` for a state that no episode in this room could be in; the message names the field.

    The engine's own part of a state, `physics`, is left to the engine.
    """
    check_fields(rules, state)
    soft = rules.instance.dynamics.kind == "physics"
    base, rotation = rules.instance.robot.base, rules.get_rotation(state.heading_steps, state.heading_offset)
    pressed_in = base.inner_radius * _SOFT_CONTACT if soft else 0.0
    if not is_on_floor(rules.instance, state.x, state.y, pressed_in + 1e-6):
        raise StateError(f"x = {state.x:g}, y = {state.y:g} is not possible: this is outside the walls")
    for solid in rules.instance.solids:
        if compute_distance(state.x, state.y, solid.footprint) < base.inner_radius - pressed_in or (
                base.measure_gap(state.x, state.y, rotation, (solid.footprint,)) < -pressed_in):
            raise StateError(f"x = {state.x:g}, y = {state.y:g} is not possible: the body stands in the {solid.role} "
                             f"at ({solid.x:g}, {solid.y:g})")


def check_fields(rules: Rules, state: RoomState) -> None:
    """Check a state's fields, each by its own range, wherever the body stands.

    Raises:
        StateError: it is no state, or one of its numbers is impossible; the message names the field.
    """
    if not isinstance(state, RoomState):
        raise StateError(f"a state is a RoomState, as get_state() returns it, not {show_value(state)}")
    instance, soft = rules.instance, rules.instance.dynamics.kind == "physics"
    top = instance.wall_height + instance.robot.body_height
    _check_number("x", state.x, -instance.reach_x, instance.reach_x)
    _check_number("y", state.y, -instance.reach_y, instance.reach_y)
    _check_whole("heading_steps", state.heading_steps, rules.headings)
    _check_number("heading_offset", state.heading_offset, -math.pi, math.pi)
    _check_joints(rules, state, _SOFT_LIMIT if soft else 1e-6)
    _check_whole("touching", state.touching, 1 << len(instance.targets))
    _check_whole("primitives", state.primitives, _LARGEST_COUNT)
    _check_whole("noise_key", state.noise_key, 2**64)
    _check_number("z", state.z, -1.0, top)
    _check_number("pitch", state.pitch, -math.pi, math.pi)
    _check_number("roll", state.roll, -math.pi, math.pi)
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


def _check_joints(rules: Rules, state: RoomState, slack: float) -> None:
    joints, robot = rules.instance.robot.joints, rules.robot
    for name, values, lengths in (("joint_steps", state.joint_steps, (joints,)),
                                  ("joint_offsets", state.joint_offsets, (0, joints))):
        if not isinstance(values, tuple) or len(values) not in lengths:
            raise StateError(f"{name} = {show_value(values)} is not possible: {joints} numbers, one a joint")
    for offset in state.joint_offsets:
        _check_number("joint_offsets", offset, -math.pi, math.pi)
    for joint, steps in enumerate(state.joint_steps):
        if isinstance(steps, bool) or not isinstance(steps, numbers.Integral) or abs(steps) > _LARGEST_COUNT:
            raise StateError(f"joint_steps = {show_value(state.joint_steps)} is not possible: whole numbers")
        offset = state.joint_offsets[joint] if state.joint_offsets else 0.0
        angle, (low, high) = robot.home[joint] + steps * robot.step + offset, robot.limits[joint]
        if not low - slack <= angle <= high + slack:
            raise StateError(f"joint_steps = {show_value(state.joint_steps)} is not possible: joint {joint + 1} would "
                             f"be at {angle:.3g} rad, beyond its limits {low:.3g} and {high:.3g}")
