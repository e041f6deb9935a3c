"""Goals of planners: frozen, hashable values that serve as keys of cached plans.

A goal does not prescribe how it is reached. Positions are of the body's axis in the room frame, in m; headings are in
rad, counter-clockwise from +x.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import re
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, cast, get_args

from hrl_escape.env.instance import Rectangle, RoomInstance
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.errors import GoalError, UnknownNameError, show_value


@dataclasses.dataclass(frozen=True)
class PressGoal:
    """Begin to touch a target, given by its index. A target that is already touched must be left first."""

    target: int


@dataclasses.dataclass(frozen=True)
class ExitGoal:
    """Bring the body's axis into the rectangle of the exit, with the puzzle solved or not."""


@dataclasses.dataclass(frozen=True)
class PoseGoal:
    """Be at a place, with a given heading or any.

    Attributes:
        x: position, m.
        y: position, m.
        heading: direction, rad, or None for any.
        tolerance: largest distance from (x, y), m. Primitives are long, so a small tolerance can be unreachable.
        heading_tolerance: largest angle from `heading`, rad.
    """

    x: float
    y: float
    heading: float | None = None
    tolerance: float = 0.5
    heading_tolerance: float = math.radians(5.0)


@dataclasses.dataclass(frozen=True)
class RegionGoal:
    """Bring the body's axis into a closed rectangle, in m."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float


@dataclasses.dataclass(frozen=True)
class PushGoal:
    """Push one prop onto another, given by their indices (physics dynamics)."""

    prop: int
    destination: int


GripAction = Literal["grip", "release", "use", "push-east", "push-north", "push-west", "push-south"]


@dataclasses.dataclass(frozen=True)
class GripGoal:
    """Grip, release or use a target, or push it on a map, with the effect in the puzzle's symbolic model.

    It happens while touching the target; in a puzzle with a map, from the cell before it.

    Attributes:
        target: index of the target.
        action: name of the primitive, or the direction of the push.
    """

    target: int
    action: GripAction = "grip"


LEAVE = "go-to-exit"
"""Name of the goal that leaves the room."""
FARTHEST = 1e6
"""Largest size of a goal's numbers, m or rad; larger ones are rejected as infinite."""

Goal: TypeAlias = PressGoal | ExitGoal | PoseGoal | RegionGoal | PushGoal | GripGoal


def check_goal(goal: Goal, instance: RoomInstance) -> None:
    """Check that a value is a goal of this room. Raises `GoalError`, which says what is valid."""
    if isinstance(goal, PressGoal):
        _check_index("target", goal.target, len(instance.targets))
    elif isinstance(goal, GripGoal):
        _check_index("target", goal.target, len(instance.targets))
        if not list_grips(goal, instance, instance.symbolic_model):
            name = instance.targets[goal.target].name
            raise GoalError(f"the puzzle {instance.puzzle.kind!r} has no operator to {goal.action} at {name!r}")
    elif isinstance(goal, PushGoal):
        _check_index("prop", goal.prop, len(instance.props))
        _check_index("prop", goal.destination, len(instance.props))
        find_push(goal, instance)
    elif isinstance(goal, PoseGoal):
        heading = 0.0 if goal.heading is None else goal.heading
        if not (all(map(_is_finite, (goal.x, goal.y, heading, goal.tolerance, goal.heading_tolerance)))
                and goal.tolerance >= 0.0 and goal.heading_tolerance >= 0.0):
            raise GoalError(f"{show_value(goal)} must have finite numbers and tolerances of at least 0")
    elif isinstance(goal, RegionGoal):
        if not (all(map(_is_finite, (goal.x_min, goal.x_max, goal.y_min, goal.y_max)))
                and goal.x_min <= goal.x_max and goal.y_min <= goal.y_max):
            raise GoalError(f"{show_value(goal)} must have finite numbers, x_min <= x_max and y_min <= y_max")
    elif not isinstance(goal, ExitGoal):
        raise GoalError(f"{show_value(goal)} is not a goal: give a PressGoal, ExitGoal, PoseGoal, RegionGoal, PushGoal "
                        "or GripGoal, or its text")


def _check_index(kind: str, index: Any, count: int) -> None:
    if isinstance(index, bool) or not isinstance(index, numbers.Integral) or not 0 <= int(index) < count:
        raise GoalError(f"there is no {kind} {show_value(index)}: the room has {count}")


def _is_finite(value: Any) -> bool:
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    return is_number and abs(value) < FARTHEST  # pyright: ignore[reportOperatorIssue]


def parse_goal(text: str, instance: RoomInstance) -> Goal:
    """Parse a goal from its name, which is the name of the option that reaches it.

    Args:
        text: `press-button-2`; `go-to-exit`; `grip-red`, `release-red` or `use-red` for an action at a target;
            `push-east-box-1` to push a target one cell; `push-block-to-plate` to push one prop onto another; a place
            `x,y`; or a pose `x,y,heading_deg`.
        instance: the room with the targets and props.

    Raises:
        UnknownNameError: no goal has this name; the message lists the names of this room's goals.
        GoalError: the numbers are not a pose, or the value is not text.
    """
    if not isinstance(text, str):
        raise GoalError(f"{show_value(text)} is no text of a goal")
    word = text.strip()
    if word == LEAVE:
        return ExitGoal()
    targets = [target.name for target in instance.targets]
    for action in ("press", *get_args(GripAction)):
        name = word.removeprefix(f"{action}-")
        if name != word and name in targets:
            target = targets.index(name)
            return PressGoal(target) if action == "press" else GripGoal(target, cast("GripAction", action))
    if push := _parse_push(word, [placed.prop.name for placed in instance.props]):
        return push
    known = list_goal_names(instance)
    new = find_new_name(word, known)
    if new is None and "," in word:
        return _parse_pose(word.removeprefix("go-to-"))
    raise UnknownNameError("goal", text, known, closest=new)


def _parse_push(word: str, props: Sequence[str]) -> PushGoal | None:
    if word.startswith("push-"):
        words = word.removeprefix("push-").split("-to-")
        for count in range(1, len(words)):  # a prop's name may hold `-to-`
            prop, destination = "-to-".join(words[:count]), "-to-".join(words[count:])
            if prop in props and destination in props:
                return PushGoal(props.index(prop), props.index(destination))
    return None


def _parse_pose(word: str) -> PoseGoal:
    try:
        numbers = [float(part) for part in word.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise GoalError(f"{word!r} is not a pose: write x,y in metres, or x,y,heading with the heading in deg")
    heading = math.radians(numbers[2]) if len(numbers) == 3 else None
    return PoseGoal(numbers[0], numbers[1], heading)


def list_goal_names(instance: RoomInstance) -> tuple[str, ...]:
    """Return the names of the goals of a room: presses, other actions of its model, and leaving."""
    presses = (PressGoal(target) for target in range(len(instance.targets)))
    acts = (make_goal(operator, instance) for operator in instance.symbolic_model.operators)
    return tuple(dict.fromkeys(name_goal(goal, instance) for goal in (*presses, *acts, ExitGoal())))


def find_new_name(word: str, known: Sequence[str]) -> str | None:
    """Return the name of a goal or option for a name of version 0.3, such as `meta-01`, or None for any other text.

    Args:
        word: the text.
        known: names in the order of the options, the exit's last.
    """
    if word in ("exit", "leave", "meta-exit"):
        return LEAVE
    if number := re.fullmatch(r"meta-(\d{2,})", word):
        acts = [name for name in known if name != LEAVE]
        return acts[int(number[1]) - 1] if 1 <= int(number[1]) <= len(acts) else None
    dashed = re.sub(r"\((.*)\)$", r"-\1", re.sub(r"\s*->\s*|\s+onto\s+", "-to-", word)).replace(" ", "-")
    if dashed != word:
        return next((name for name in (dashed, f"push-{dashed}") if name in known), None)
    return next((name for name in known if name.endswith(f"-{word}")), None) if word else None


def name_goal(goal: Goal, instance: RoomInstance) -> str:
    """Return the name of a goal: a verb and its object, as `parse_goal` reads it (except regions)."""
    if isinstance(goal, PressGoal):
        return f"press-{instance.frame.target_names[goal.target]}"
    if isinstance(goal, ExitGoal):
        return LEAVE
    if isinstance(goal, GripGoal):
        return f"{goal.action}-{instance.frame.target_names[goal.target]}"
    if isinstance(goal, PushGoal):
        return f"push-{instance.props[goal.prop].prop.name}-to-{instance.props[goal.destination].prop.name}"
    if isinstance(goal, RegionGoal):
        return f"go-to-x-{goal.x_min:g}-to-{goal.x_max:g}-y-{goal.y_min:g}-to-{goal.y_max:g}"
    place = f"go-to-{goal.x:g},{goal.y:g}"
    return place if goal.heading is None else f"{place},{math.degrees(goal.heading):g}"


def get_region(goal: ExitGoal | RegionGoal, instance: RoomInstance) -> Rectangle | RegionGoal:
    """Return the rectangle of a goal on the floor: x_min, x_max, y_min, y_max, in m."""
    return instance.exit if isinstance(goal, ExitGoal) else goal


def is_reached(goal: Goal, before: RoomState, after: RoomState, rules: Rules) -> bool:
    """Return whether the primitive that led from `before` to `after` reached the goal.

    A press is an event and needs both states. For a state without a primitive before it, pass it twice; a press is then
    not reached. A push or a grip is reached when the facts that its operator adds hold. In a random puzzle, a grip is
    also reached once the facts that it deletes no longer hold.
    """
    if isinstance(goal, PressGoal):
        return bool(after.touching & ~before.touching & 1 << goal.target)
    if isinstance(goal, PoseGoal):
        if math.hypot(after.x - goal.x, after.y - goal.y) > goal.tolerance:
            return False
        if goal.heading is None:
            return True
        turn = (rules.get_heading(after) - goal.heading + math.pi) % math.tau - math.pi
        return abs(turn) <= goal.heading_tolerance + 1e-12
    if isinstance(goal, (ExitGoal, RegionGoal)):
        region = get_region(goal, rules.instance)
        return region.x_min <= after.x <= region.x_max and region.y_min <= after.y <= region.y_max
    get_facts = rules.instance.puzzle.symbolic.get_facts
    if isinstance(goal, GripGoal):
        if before is after:
            return False
        held, holds, is_random = get_facts(before.puzzle), get_facts(after.puzzle), rules.instance.puzzle.is_random
        model = rules.instance.find_model(before.puzzle)
        return any(op.is_applicable(held) and (op.add <= holds or (is_random and op.delete and not op.delete & holds))
                   for op in list_grips(goal, rules.instance, model))
    return find_push(goal, rules.instance).add <= get_facts(after.puzzle)


def make_goal(operator: Operator, instance: RoomInstance) -> Goal:
    """Return the goal of an operator of the puzzle's symbolic model."""
    if operator.action == "push":
        props = [placed.prop.name for placed in instance.props]
        return PushGoal(props.index(operator.target), props.index(operator.destination or ""))
    target = instance.puzzle.target_names.index(operator.target)
    return PressGoal(target) if operator.action == "press" else GripGoal(target, cast("GripAction", operator.action))


def list_grips(goal: GripGoal, instance: RoomInstance, model: SymbolicModel) -> tuple[Operator, ...]:
    """Return the operators with this action at this target.

    The model is the room's, or the model of a state, with objects at their present places. The latter has no operators
    for objects that cannot be reached.
    """
    name = instance.targets[goal.target].name
    return tuple(operator for operator in model.operators if (operator.target, operator.action) == (name, goal.action))


def find_push(goal: PushGoal, instance: RoomInstance) -> Operator:
    """Return the operator of the puzzle that pushes this prop there. Raises `GoalError` if there is none."""
    prop, destination = (instance.props[i].prop.name for i in (goal.prop, goal.destination))
    for operator in instance.symbolic_model.operators:
        if operator.action == "push" and (operator.target, operator.destination) == (prop, destination):
            return operator
    raise GoalError(f"the puzzle {instance.puzzle.kind!r} has no operator to push {prop!r} onto {destination!r}")
