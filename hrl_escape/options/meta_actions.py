"""Planned options of a room, such as `press-button-1` and `go-to-exit`.

The puzzle's symbolic model defines them (Menashe and Stone 2019, section 5.3, "meta-actions"). Each follows its plan in
closed loop. Off the plan, the rest of it is replayed from the new state, and a new plan is made if it no longer reaches
the goal.
"""

from __future__ import annotations

import dataclasses
import math

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.noise import philox
from hrl_escape.env.puzzles.mixins import Mapped
from hrl_escape.errors import OptionError, PlanningFailed, PlanningReason
from hrl_escape.options.option import Option, OptionAction
from hrl_escape.options.option_sets import DEFAULT_SET, check_option_set, option_sets
from hrl_escape.planning.goals import (
    LEAVE,
    ExitGoal,
    Goal,
    GripGoal,
    PressGoal,
    PushGoal,
    is_reached,
    make_goal,
    name_goal,
)
from hrl_escape.planning.planner import RoomPlanner, get_planner
from hrl_escape.planning.route import Route, get_pose
from hrl_escape.planning.routes import is_way_open

PATIENCE = 40
"""Primitives without progress until an option fails; more where primitives slip."""
JAM, SHAKE = 8, 3
"""Under physics: primitives without progress that count as a jam, and the number of random primitives in the first
shake."""
PRESSING, LEAVING = 7, 9
"""Purposes of the random numbers of shakes, a part of their key."""


class GoalOption(Option):
    """Option that reaches one goal of a room by its planner."""

    def __init__(self, name: str, planner: RoomPlanner, goal: Goal) -> None:
        super().__init__(name)
        self.instance, self.goal, self._planner = planner.instance, goal, planner
        self.targets = (goal.target,) if isinstance(goal, (PressGoal, GripGoal)) else ()

    def initiation(self, state: RoomState) -> bool:
        """Return whether the option can start: the goal is not reached, and planning from here is not known to fail."""
        return self._planner.routes.can_start(state, self.goal)


class PlannedOption(GoalOption):
    """Option that follows a plan to one goal, and plans again when off the plan.

    Args:
        name: stable name.
        planner: the room's planner.
        goal: goal of the option.
        max_replans: maximum number of plans after the first one in a run.
    """

    def __init__(self, name: str, planner: RoomPlanner, goal: Goal, max_replans: int = 100) -> None:
        super().__init__(name, planner, goal)
        self.max_replans = max_replans
        slip = planner.instance.dynamics.slip
        self._patience = math.ceil(PATIENCE / (1.0 - slip))
        is_rigid = planner.instance.dynamics.kind == "physics"
        self._jam = math.ceil(JAM / (1.0 - slip)) if is_rigid else self._patience + 2  # never jams

    def start(self, state: RoomState) -> None:
        """Plan from this state. Raises `PlanningFailed`."""
        super().start(state)
        self._first = self._last = state
        self._plan(state)
        self._left, self._waited, self._shake = math.inf, 0, 0

    def policy(self, state: RoomState) -> int:
        """Return the next primitive of the plan, given the state that the last one led to."""
        if self._planner.routes.has_undone(self._first, state):
            raise self._planner.routes.make_failure(PlanningReason.PRECONDITION_UNMET, state, self.goal,
                                             advice="A prop was moved from its place on the way")
        poses, here = self._route.poses, get_pose(state)
        if self._at + 1 < len(poses) and here == poses[self._at + 1]:
            self._at += 1
        elif here != poses[self._at]:
            self._recover(state)
        left = len(self._route.primitives) - self._at
        if left == 0:  # at the end of the plan, but not at the goal
            self._replan(state)
            left = len(self._route.primitives)
        self._waited = 0 if left < self._left else self._waited + 1
        self._left = min(left, self._left)
        if self._waited % self._jam == self._jam - 1:
            self._shake = SHAKE * (self._waited // self._jam + 1)
        if self._waited > self._patience:
            raise self._planner.routes.make_failure(
                PlanningReason.BUDGET_EXHAUSTED, state, self.goal,
                nearest=f"{self._left:g} primitives short, no progress for {self._patience} primitives",
            )
        self._last = state
        return self._route.primitives[self._at] if self._shake == 0 else self._draw_shake(state)

    def _draw_shake(self, state: RoomState) -> int:
        """Draw a random primitive that presses nothing, to free the robot from a jam between rigid bodies."""
        self._shake -= 1
        rules, purpose = self._planner.rules, LEAVING if isinstance(self.goal, ExitGoal) else PRESSING
        for attempt in range(2 * len(rules.actions)):
            word, *_ = philox((state.primitives, attempt, 0, 0), (purpose, 0))
            primitive = word % len(rules.actions)
            if not rules.step(state, primitive).pressed:
                return primitive
        return self._route.primitives[self._at]

    def termination(self, state: RoomState) -> float:
        """Return 1 once the goal is reached. A press counts at the primitive that begins the touch."""
        is_undone = self._planner.routes.has_undone(self._first, state)
        return float(not is_undone and is_reached(self.goal, self._last, state, self._planner.rules))

    def _plan(self, state: RoomState) -> None:
        self._route, self._at = self._find_route(state), 0
        _report_unavoidable(self, self._planner.instance, self._route)

    def _find_route(self, state: RoomState) -> Route:
        return self._planner.routes.find_route(state, self.goal, self.report)

    def _recover(self, state: RoomState) -> None:
        """Continue with the rest of the plan if it still reaches the goal from here; otherwise plan again."""
        rest = self._route.primitives[self._at + 1 :]
        route = self._planner.routes.replay(state, rest, self.goal) if rest else None
        if route is not None and set(route.also_pressed) <= set(self._route.also_pressed):
            self._route, self._at = route, 0
        else:
            self._replan(state)

    def _replan(self, state: RoomState) -> None:
        if self.report.replans >= self.max_replans:
            raise self._planner.routes.make_failure(PlanningReason.BUDGET_EXHAUSTED, state, self.goal,
                                                    nearest=f"{self.report.replans} plans made",
                                                    advice="Raise max_replans, or lower noise")
        self._plan(state)
        self.report.replans += 1


class MarkovOption(GoalOption):
    """Option that takes the first primitive of the shortest route to one goal from every state.

    The route is searched from every state along the goal's cost-to-go field, and cached by pose. The policy is
    therefore a function of the state, as intra-option learning requires, and noise needs no replanning. A target that
    is already touched is left first and then pressed again. The goal cannot be a push, because one state alone does not
    show its completion.
    """

    is_markov = True

    def __init__(self, name: str, planner: RoomPlanner, goal: Goal) -> None:
        super().__init__(name, planner, goal)
        self._settings = planner.routes.settings._replace(effort=-1)  # the next state can have a shorter route

    def initiation(self, state: RoomState) -> bool:
        """Return whether a route leads to the goal and the goal is not reached."""
        if not super().initiation(state):
            return False
        try:
            return bool(self._planner.routes.find_route(state, self.goal, settings=self._settings).primitives)
        except PlanningFailed:
            return False

    def policy(self, state: RoomState) -> int:
        """Return the first primitive of the route. Raises `PlanningFailed`."""
        route = self._planner.routes.find_route(state, self.goal, self.report, settings=self._settings)
        _report_unavoidable(self, self._planner.instance, route)
        return route.primitives[0]

    def termination(self, state: RoomState) -> float:
        """Return 1 if the target is touched, a grip, release or use has happened, or the goal region is reached."""
        if isinstance(self.goal, PressGoal):
            return float(state.touching >> self.goal.target & 1)
        if isinstance(self.goal, GripGoal):
            return float(not self._planner.routes.can_start(state, self.goal))
        return float(is_reached(self.goal, state, state, self._planner.rules))


def _report_unavoidable(option: Option, instance: RoomInstance, route: Route) -> None:
    """Add the targets that a route has to press to the option's report."""
    names = (instance.targets[target].name for target in route.also_pressed)
    option.report.unavoidable = tuple(dict.fromkeys((*option.report.unavoidable, *names)))


class AncestorsOption(GoalOption):
    """Option that carries out an operator's missing preconditions in the cheapest order, then the operator.

    Operators that are done are not repeated, except the last one, which always runs (as in the published 2019 code).
    `parts` are the options for the goal of each operator.
    """

    def __init__(self, name: str, planner: RoomPlanner, goal: Goal, parts: dict[Goal, Option]) -> None:
        super().__init__(name, planner, goal)
        self._parts = parts
        own = {part.target for part in parts if isinstance(part, (PressGoal, GripGoal))}
        self.targets = tuple(i for i in range(len(planner.instance.targets)) if i in own)
        self._order: list[Goal] = []
        self._part = parts[goal]

    def initiation(self, state: RoomState) -> bool:
        """Return whether the goal's own option can start or doors block the way. `start` finds the order."""
        return self._parts[self.goal].initiation(state) or not is_way_open(self._planner.rules, state, self.goal)

    def start(self, state: RoomState) -> None:
        """Find the cheapest order of the remaining operators. Raises `PlanningFailed`."""
        super().start(state)
        self._order = self._planner.orders.find_ancestors(state, self.goal, self.report)

    def policy(self, state: RoomState) -> OptionAction:
        """Return the next part of the order: the option of the next ancestor that is not on."""
        goal = self._order.pop(0)
        self._part = self._parts[goal]
        return self._part

    def termination(self, state: RoomState) -> float:
        """Return 1 after the last part, else 0."""
        return float(not self._order)


class AbsentOption(Option):
    """Option of a target that this instance lacks and other rooms of the configuration have. It is always masked."""

    def initiation(self, state: RoomState) -> bool:
        """Return false: the option is never available."""
        return False

    def policy(self, state: RoomState) -> OptionAction:
        """Raise `OptionError`, because this option can never start."""
        raise OptionError(f"option {self.name!r} belongs to a target that this room does not have")

    def termination(self, state: RoomState) -> float:
        """Return 1."""
        return 1.0


def list_goals(instance: RoomInstance) -> list[Goal]:
    """Return the goals of a room.

    These are presses of its targets, unless they are cells of a map, and the other goals of the model. A goal other
    than a press, such as a grip, exists for every target of the frame.
    """
    own, every = len(instance.targets), len(instance.frame.target_names)
    goals: list[Goal] = [PressGoal(i) for i in (() if isinstance(instance.puzzle, Mapped) else range(every))]
    for op in instance.symbolic_model.operators:
        goal = make_goal(op, instance)
        if goal not in goals:
            goals.append(goal)
    grips = {goal.action: goal for goal in goals if isinstance(goal, GripGoal)}
    return goals + [dataclasses.replace(grip, target=i) for i in range(own, every) for grip in grips.values()]


def make_option(name: str, planner: RoomPlanner, goal: Goal) -> Option:
    """Make the option that reaches one goal of any kind."""
    if isinstance(goal, PushGoal):
        from hrl_escape.options.pushing import PushOption  # loads scipy, which presses do not need

        return PushOption(name, planner, goal)
    if isinstance(goal, (PressGoal, GripGoal)) and goal.target >= len(planner.instance.targets):
        return AbsentOption(name)
    return PlannedOption(name, planner, goal)


def make_meta_options(instance: RoomInstance, option_set: str = DEFAULT_SET, planner: RoomPlanner | None = None
                      ) -> tuple[Option, ...]:
    """Make the options of a room by the name of an option set.

    All instances of a room configuration have options of the same names. The options of targets that a room lacks are
    masked.

    Args:
        instance: the room.
        option_set: name of an option set. `press` reaches one goal each. `press-with-ancestors` first carries out what
            the puzzle's symbolic model requires. `press-reactive` reaches the goal by a policy that is a function of
            the state, except for pushes.
        planner: the room's planner, or None for the planner that this process shares.

    Returns:
        The options, in the order of their actions.

    Raises:
        UnknownNameError: no option set has this name.
    """
    check_option_set(option_set)
    return tuple(option_sets.get(option_set)(planner or get_planner(instance)))


def make_presses(planner: RoomPlanner) -> tuple[Option, ...]:
    """Make options that reach one goal each, such as the press of one button, or the exit."""
    return _name_objects(planner, [*_make_parts(planner).values(), PlannedOption(LEAVE, planner, ExitGoal())])


def make_presses_with_ancestors(planner: RoomPlanner) -> tuple[Option, ...]:
    """Make options that first carry out what the puzzle requires before their goal, as the published 2019 code does."""
    parts = _make_parts(planner)
    options = [option if isinstance(option, AbsentOption) else AncestorsOption(option.name, planner, goal, parts)
               for goal, option in parts.items()]
    return _name_objects(planner, [*options, PlannedOption(LEAVE, planner, ExitGoal())])


def make_reactive_presses(planner: RoomPlanner) -> tuple[Option, ...]:
    """Make options that reach one goal each by a policy that is a function of the state, for intra-option learning."""
    options = [MarkovOption(option.name, planner, goal)
               if isinstance(option, PlannedOption) and not (
                   isinstance(goal, GripGoal) and goal.action.startswith("push-")) else option
               for goal, option in _make_parts(planner).items()]
    return _name_objects(planner, [*options, MarkovOption(LEAVE, planner, ExitGoal())])


def _make_parts(planner: RoomPlanner) -> dict[Goal, Option]:
    room = planner.instance
    return {goal: make_option(name_goal(goal, room), planner, goal) for goal in list_goals(room)}


def _name_objects(planner: RoomPlanner, options: list[Option]) -> tuple[Option, ...]:
    """Set the object of each option."""
    for option, goal in zip(options, [*list_goals(planner.instance), ExitGoal()], strict=True):
        option.about = name_object(goal, planner.instance)
    return tuple(options)


def name_object(goal: Goal, instance: RoomInstance) -> str | None:
    """Return the name of the object of a goal: a target, the prop to push, or `exit`, or None for a place."""
    if isinstance(goal, (PressGoal, GripGoal)):
        return instance.frame.target_names[goal.target]
    if isinstance(goal, PushGoal):
        return instance.props[goal.prop].prop.name
    return "exit" if isinstance(goal, ExitGoal) else None
