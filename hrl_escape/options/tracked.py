"""Options over velocities: a trajectory to each goal, tracked step by step in the continuous environment."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import PlanningFailed, PlanningReason, UnsupportedError
from hrl_escape.options.meta_actions import AbsentOption, GoalOption, list_goals, name_object
from hrl_escape.options.option import Option
from hrl_escape.planning.goals import ExitGoal, Goal, GripGoal, PressGoal, is_reached, name_goal
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.sampled import WAY_PLANNER, MotionSampler
from hrl_escape.planning.motion.trajectory import TimedTrajectory, Tracker, make_trajectory
from hrl_escape.planning.planner import RoomPlanner, get_planner
from hrl_escape.planning.routes import check_method
from hrl_escape.planning.search.primitive_search import METHODS

if TYPE_CHECKING:
    from hrl_escape.env.continuous import EscapeRoomContinuousEnv

MOST_TRIES = 5
"""Maximum number of trajectories in one run of an option."""
HEADROOM = 0.9
"""Share of the environment's largest velocities that a trajectory uses; the rest is for feedback."""


class TrackedOption(GoalOption):
    """Option that reaches one goal by a trajectory, and by another if the first ends short of it.

    Trajectories keep the limits, and a step of the environment takes `time_step` seconds. The sampler plans them;
    without a sampler they follow plans of primitives.
    """

    def __init__(self, name: str, planner: RoomPlanner, goal: Goal, limits: MotionLimits, time_step: float,
                 sampler: MotionSampler | None = None) -> None:
        super().__init__(name, planner, goal)
        self.about = name_object(goal, planner.instance)
        self._sampler, self._limits, self._time_step = sampler, limits, time_step

    def start(self, state: RoomState) -> None:
        """Plan from this state. Raises `PlanningFailed`."""
        super().start(state)
        self._last, self._tries = state, 0
        self._plan(state)

    def _plan(self, state: RoomState) -> None:
        if self._tries == MOST_TRIES:
            raise self._planner.routes.make_failure(PlanningReason.BUDGET_EXHAUSTED, state, self.goal,
                                                    nearest=f"{MOST_TRIES} trajectories driven")
        self._tries += 1
        self._tracker = Tracker(self._find_trajectory(state), self._planner.rules, self._time_step, state)

    def _find_trajectory(self, state: RoomState) -> TimedTrajectory:
        """Return the sampler's trajectory if it finds one, otherwise the trajectory of a plan of primitives."""
        try:
            if self._sampler is not None:
                return self._sampler.plan(state, self.goal)
        except PlanningFailed:
            pass
        plan = self._planner.plan(state, self.goal)
        try:
            return make_trajectory(plan, self._limits)
        except UnsupportedError as error:
            raise self._planner.routes.make_failure(PlanningReason.UNREACHABLE_AT_RESOLUTION, state, self.goal,
                                                    nearest=str(error)) from None

    def policy(self, state: RoomState) -> NDArray[Any]:
        """Return the velocities of the next step."""
        if state is not self._last:
            self._tracker.see(state)
        if self._tracker.is_done:
            self._plan(state)
        self._last = state
        return self._tracker.choose()

    def termination(self, state: RoomState) -> float:
        """Return 1 once the goal is reached. A press counts at the step that begins the touch."""
        return float(is_reached(self.goal, self._last, state, self._planner.rules))


@dataclasses.dataclass(frozen=True)
class TrackedSource:
    """Makes the tracked options of any room, for one continuous environment's velocities and time step."""

    limits: MotionLimits
    time_step: float
    planner: str = "auto"
    """`auto` uses OMPL and Pinocchio (`MotionSampler`); the name of another OMPL planner sets the planner of the base.
    `fields` or `corridor` use trajectories of plans of primitives, which are found sooner."""

    @classmethod
    def of(cls, env: EscapeRoomContinuousEnv, planner: str) -> TrackedSource:
        """Make the source for an environment, within `HEADROOM` of its velocities."""
        speeds = {name: HEADROOM * getattr(env.velocities, name) for name in ("speed", "turn_speed", "joint_speed")}
        return cls(MotionLimits(**speeds), env.velocities.time_step, planner)

    def __call__(self, instance: RoomInstance) -> Sequence[Option]:
        """Make the options of a room: one per press, grip or push, named like its goal, and `go-to-exit`."""
        planner, way = get_planner(instance, self.planner if self.planner in METHODS else "auto"), self.planner
        check_method(way)
        sampler = None if way in METHODS and way != "auto" else MotionSampler(
            instance, self.limits, WAY_PLANNER if way == "auto" else way)
        goals = [goal for goal in list_goals(instance) if isinstance(goal, (PressGoal, GripGoal))]
        return [AbsentOption(name) if not isinstance(goal, ExitGoal) and goal.target >= len(instance.targets)
                else TrackedOption(name, planner, goal, self.limits, self.time_step, sampler)
                for goal in (*goals, ExitGoal()) for name in (name_goal(goal, instance),)]
