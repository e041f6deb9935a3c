"""Skills finer than the planned options of a room: go to a pose, reach a target with the hand, press a target.

They nest: a press goes to a place within reach of the target, then reaches. With an arm the last part consists of joint
steps; without one it is the primitive that touches.
"""

from __future__ import annotations

import math
from functools import lru_cache

from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import PlanningReason, UnknownNameError, UnsupportedError
from hrl_escape.options.meta_actions import PlannedOption
from hrl_escape.options.option import Option, OptionAction
from hrl_escape.planning.goals import Goal, PoseGoal, PressGoal, check_goal, name_goal, parse_goal
from hrl_escape.planning.planner import RoomPlanner

ARRIVAL, ARRIVAL_NOISE = 0.02, 3.0
"""Tolerance of a place: at least this many metres, and this many standard deviations of a move's noise."""
KEPT_REACHES = 10_000


def make_go_to(planner: RoomPlanner, goal: Goal | str, name: str | None = None) -> PlannedOption:
    """Make an option that goes to a place, as in `make_go_to(planner, "3,4,90")`, or to any other goal.

    Raises:
        UnknownNameError, GoalError: the room has no such goal.
    """
    goal = parse_goal(goal, planner.instance) if isinstance(goal, str) else goal
    check_goal(goal, planner.instance)
    return PlannedOption(name or name_goal(goal, planner.instance), planner, goal)


def make_reach(planner: RoomPlanner, target: int | str) -> ReachOption:
    """Make an option that moves only the arm until the hand touches a target.

    Raises:
        UnsupportedError: the body presses the targets of this room.
        UnknownNameError: no target has this name.
    """
    return ReachOption(planner, _find_target(planner, target))


def make_press(planner: RoomPlanner, target: int | str) -> PressOption:
    """Make an option that goes to a place within reach of a target, then reaches.

    Raises:
        UnknownNameError: no target has this name.
    """
    return PressOption(planner, _find_target(planner, target))


def _find_target(planner: RoomPlanner, target: int | str) -> int:
    names = [t.name for t in planner.instance.targets]
    if isinstance(target, str) and target in names:
        return names.index(target)
    if isinstance(target, int) and 0 <= target < len(names):
        return target
    raise UnknownNameError("target", target, names)


class ReachOption(Option):
    """Option with the fewest joint steps until the hand touches the target, with the base at rest.

    The policy is a function of the state: after noise it searches again.
    """

    is_markov = True

    def __init__(self, planner: RoomPlanner, target: int) -> None:
        name = planner.instance.targets[target].name
        if planner.instance.dynamics.press_with != "hand":
            raise UnsupportedError(f"reach-{name} needs an arm that presses (dynamics.press_with = 'hand'); this "
                                   f"room's targets are pressed with the body: use press-{name}")
        super().__init__(f"reach-{name}")
        self.instance, self.targets = planner.instance, (target,)
        self._planner, self._target = planner, target
        self._find = lru_cache(KEPT_REACHES)(self._search)

    def _search(self, state: RoomState) -> tuple[int, ...]:
        """Return the joint primitives from this state to the touch; empty if there are none."""
        reacher = self._planner.routes.get_reacher()
        found = reacher.get_configuration(
            state.x, state.y, state.heading_steps, state.joint_steps, self._target,
            joint_offsets=state.joint_offsets, heading_offset=state.heading_offset)
        return (found is not None and reacher.order_steps(state, (), found, self._target)) or ()

    def _get_steps(self, state: RoomState) -> tuple[int, ...]:
        return self._find(state._replace(primitives=0, noise_key=0, physics=None))

    def initiation(self, state: RoomState) -> bool:
        """Return whether some posture touches the target and the hand does not touch it yet."""
        return not state.touching >> self._target & 1 and bool(self._get_steps(state))

    def policy(self, state: RoomState) -> int:
        """Return the first of the fewest joint steps from this state."""
        steps = self._get_steps(state)
        if not steps:
            raise self._planner.routes.make_failure(PlanningReason.NO_POSTURE, state, PressGoal(self._target))
        return steps[0]

    def termination(self, state: RoomState) -> float:
        """Return 1 once the hand touches the target."""
        return float(state.touching >> self._target & 1)


class PressOption(Option):
    """Option of two lower-level options: go to a place within reach of the target, then reach."""

    def __init__(self, planner: RoomPlanner, target: int) -> None:
        name = planner.instance.targets[target].name
        super().__init__(f"press-{name}")
        self.instance, self.targets = planner.instance, (target,)
        self._planner, self._goal = planner, PressGoal(target)
        by_hand = planner.instance.dynamics.press_with == "hand"
        self._reach = ReachOption(planner, target) if by_hand else None
        self._touch = PlannedOption(f"touch-{name}", planner, self._goal)
        self._has_gone = self._is_last = False

    def start(self, state: RoomState) -> None:
        """Start a run; the first call of the policy plans."""
        super().start(state)
        self._has_gone = self._is_last = False

    def policy(self, state: RoomState) -> OptionAction:
        """Go to the last place of the base in the plan.

        From there reach, or press by plan if noise led elsewhere.
        """
        route = self._planner.routes.find_route(state, self._goal, self.report)
        by_arm = [p not in self._planner.rules.actions.base for p in route.primitives]
        going = [p for p, arm in zip(route.primitives, by_arm, strict=True) if not arm]
        if self._reach is None:
            going.pop()
        if going and not self._has_gone:
            self._has_gone = True
            place = self._find_place(state, going)
            if self._planner.routes.remember(state, place, going):
                return make_go_to(self._planner, place)
        self._is_last = True
        return self._reach if self._reach is not None and all(by_arm) else self._touch

    def _find_place(self, state: RoomState, going: list[int]) -> PoseGoal:
        rules, dynamics, robot = self._planner.rules, self._planner.instance.dynamics, self._planner.instance.robot
        state = self._planner.routes.follow(state, going)[-1]
        away = max(ARRIVAL, ARRIVAL_NOISE * dynamics.noise * rules.actions.longest)
        turned = math.radians(max(1.0, ARRIVAL_NOISE * dynamics.noise * robot.turn_step_deg))
        return PoseGoal(state.x, state.y, rules.get_heading(state), away, turned)

    def termination(self, state: RoomState) -> float:
        """Return 1 after the last part, else 0."""
        return float(self._is_last)
