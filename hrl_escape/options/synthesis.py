"""Options made from a room by its planner: `meta-01` to `meta-NN`, `meta-exit`, and their parts.

Each follows its plan closed-loop: where noise, slip or physics have led elsewhere, the rest
of the plan is replayed from there, and planned anew if it no longer arrives. What a meta-action
means comes from the puzzle's symbolic model (Menashe and Stone 2019, section 5.3).
"""

from __future__ import annotations

import math

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.noise import philox
from hrl_escape.errors import PlanningReason, UnknownNameError
from hrl_escape.options.goals import ExitGoal, Goal, PressGoal, PushGoal, is_reached, make_goal
from hrl_escape.options.option import Decision, Option
from hrl_escape.options.planner import RoomPlanner, get_planner
from hrl_escape.options.routes import get_pose

__all__ = ["FLAVOURS", "AncestorsOption", "PlannedOption", "list_goals", "make_meta_options", "make_option"]

FLAVOURS = ("press", "press-with-ancestors")
PATIENCE = 40
"""Primitives without coming nearer after which it gives up; more where primitives slip."""
JAM, SHAKE = 8, 3
"""Under physics: primitives without coming nearer that count as a jam; how many others then shake it loose at first."""


class PlannedOption(Option):
    """Reaches one goal by plan, and plans anew when it is off the plan.

    Args:
        name: stable name.
        planner: the room's planner.
        goal: what is to be reached.
        max_replans: plans that may be made after the first in one run.
    """

    def __init__(self, name: str, planner: RoomPlanner, goal: Goal, max_replans: int = 100) -> None:
        super().__init__(name)
        self.instance = planner.instance
        self.goal = goal
        self.targets = (goal.target,) if isinstance(goal, PressGoal) else ()
        self.max_replans = max_replans
        self._planner = planner
        slip = planner.instance.dynamics.slip
        self._patience = math.ceil(PATIENCE / (1.0 - slip))
        is_rigid = planner.instance.dynamics.kind == "physics"
        self._jam = math.ceil(JAM / (1.0 - slip)) if is_rigid else self._patience + 2  # elsewhere nothing jams

    def initiation(self, state: RoomState) -> bool:
        """Where it is not there already and planning from here is not known to fail."""
        return self._planner.can_start(state, self.goal)

    def start(self, state: RoomState) -> None:
        """Plan from here. Raises `PlanningFailed`."""
        super().start(state)
        self._last = state
        self._plan(state)
        self._left, self._waited, self._shake = math.inf, 0, 0

    def policy(self, state: RoomState) -> int:
        """The plan's next primitive; what comes next is decided by where the last one really led."""
        poses, here = self._route.poses, get_pose(state)
        if self._at + 1 < len(poses) and here == poses[self._at + 1]:
            self._at += 1
        elif here != poses[self._at]:
            self._recover(state)
        left = len(self._route.primitives) - self._at
        if left == 0:  # the plan says we are there, the room says we are not
            self._replan(state)
            left = len(self._route.primitives)
        self._waited = 0 if left < self._left else self._waited + 1
        self._left = min(left, self._left)
        if self._waited % self._jam == self._jam - 1:
            self._shake = SHAKE * (self._waited // self._jam + 1)
        if self._waited > self._patience:
            raise self._planner.make_failure(
                PlanningReason.BUDGET_EXHAUSTED, state, self.goal,
                nearest=f"{self._left:g} primitives short, no nearer for {self._patience} primitives",
            )
        self._last = state
        return self._route.primitives[self._at] if self._shake == 0 else self._draw_shake(state)

    def _draw_shake(self, state: RoomState) -> int:
        """Something else than the plan, to come free of what rigid bodies have jammed; it presses nothing."""
        self._shake -= 1
        rules = self._planner.rules
        for attempt in range(2 * len(rules.primitives)):
            word, *_ = philox((state.primitives, attempt, 0, 0), (len(self.name), 0))
            primitive = word % len(rules.primitives)
            if not rules.step(state, primitive).pressed:
                return primitive
        return self._route.primitives[self._at]

    def termination(self, state: RoomState) -> float:
        """1 once the goal is reached; a press counts at the primitive where touching begins."""
        return float(is_reached(self.goal, self._last, state, self._planner.rules))

    def _plan(self, state: RoomState) -> None:
        self._route, self._at = self._planner.find_route(state, self.goal, self.report), 0
        self.report.unavoidable = tuple(
            dict.fromkeys((*self.report.unavoidable, *(self._name(i) for i in self._route.also_pressed)))
        )

    def _name(self, target: int) -> str:
        return self._planner.instance.targets[target].name

    def _recover(self, state: RoomState) -> None:
        """Off the plan: go on with the rest of it if it still arrives, else plan anew."""
        rest = self._route.primitives[self._at + 1 :]
        route = self._planner.replay(state, rest, self.goal) if rest else None
        if route is not None and set(route.also_pressed) <= set(self._route.also_pressed):
            self._route, self._at = route, 0
        else:
            self._replan(state)

    def _replan(self, state: RoomState) -> None:
        if self.report.replans >= self.max_replans:
            raise self._planner.make_failure(
                PlanningReason.BUDGET_EXHAUSTED, state, self.goal, nearest=f"{self.report.replans} plans made",
                advice="Raise max_replans, or lower noise",
            )
        self._plan(state)
        self.report.replans += 1


class AncestorsOption(Option):
    """Does what must be done before an operator, in the cheapest order, then the operator itself.

    Operators that are done already are not done again, but the last one always is (the
    published 2019 code's meta-actions).

    Args:
        name: stable name.
        planner: the room's planner.
        goal: what the operator is about.
        parts: the plain option for each goal that an operator can have.
    """

    def __init__(self, name: str, planner: RoomPlanner, goal: Goal, parts: dict[Goal, Option]) -> None:
        super().__init__(name)
        self.instance = planner.instance
        self.goal = goal
        self._planner, self._parts = planner, parts
        self.targets = tuple(i for i in range(len(planner.instance.targets)) if PressGoal(i) in parts)
        self._order: list[Goal] = []
        self._part = parts[goal]

    def initiation(self, state: RoomState) -> bool:
        """Where the goal's own option may start: what comes before it is found out at the start."""
        return self._parts[self.goal].initiation(state)

    def start(self, state: RoomState) -> None:
        """Find the cheapest order of what is still to be done. Raises `PlanningFailed`."""
        super().start(state)
        self._order = self._planner.find_ancestors(state, self.goal, self.report)

    def policy(self, state: RoomState) -> Decision:
        """The next part."""
        goal = self._order.pop(0)
        self._part = self._parts[goal]
        return self._part

    def termination(self, state: RoomState) -> float:
        """1 after the last part."""
        return float(not self._order)


def list_goals(instance: RoomInstance) -> list[Goal]:
    """What there is to do in a room: every target, then what is to be pushed, in the model's order."""
    goals: list[Goal] = [PressGoal(i) for i in range(len(instance.targets))]
    for op in instance.puzzle.make_symbolic_model().operators:
        goal = make_goal(op, instance)
        if goal not in goals:
            goals.append(goal)
    return goals


def make_option(name: str, planner: RoomPlanner, goal: Goal) -> Option:
    """Make the option that reaches one goal of any kind."""
    if isinstance(goal, PushGoal):
        from hrl_escape.options.pushing import PushOption  # brings scipy in, which pressing does without

        return PushOption(name, planner, goal)
    return PlannedOption(name, planner, goal)


def make_meta_options(instance: RoomInstance, flavour: str = "press", planner: RoomPlanner | None = None
                      ) -> tuple[Option, ...]:
    """Make `meta-01` to `meta-NN`, one a target (or thing to push), and `meta-exit`.

    Args:
        instance: the room.
        flavour: `press` does that one thing; `press-with-ancestors` first what the puzzle's symbolic model
            says must be done before it.
        planner: the room's planner; None shares one with whoever plans in this room.

    Raises:
        UnknownNameError: no such flavour.
    """
    if flavour not in FLAVOURS:
        raise UnknownNameError("flavour", flavour, FLAVOURS)
    planner = planner or get_planner(instance)
    goals = list_goals(instance)
    parts = {goal: make_option(f"meta-{n:02d}", planner, goal) for n, goal in enumerate(goals, 1)}
    options: list[Option] = list(parts.values())
    if flavour == "press-with-ancestors":
        options = [AncestorsOption(option.name, planner, goal, parts) for goal, option in parts.items()]
    return (*options, PlannedOption("meta-exit", planner, ExitGoal()))
