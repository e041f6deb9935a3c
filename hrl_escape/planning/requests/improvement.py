"""More plans for one request, in a fixed order: what an anytime call compares after the first plan.

Fewer primitives come from searches whose heuristic is lowered further and further; other objectives
also look at ways that keep away from solids by growing margins, and at ways round the paths of
path planners that shorten theirs. Which plan is kept is for the caller to say.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import PlanningFailed
from hrl_escape.planning.clock import Clock
from hrl_escape.planning.goals import Goal
from hrl_escape.planning.lattice.areas import grow_solids
from hrl_escape.planning.primitive_search import EFFORTS
from hrl_escape.planning.props import list_obstacles
from hrl_escape.planning.report import PlanningReport
from hrl_escape.planning.requests.request import PlanningRequest
from hrl_escape.planning.route import Route, SearchSettings

if TYPE_CHECKING:
    from hrl_escape.planning.route_finder import RouteFinder

__all__ = ["iterate_routes"]

WAY_MARGINS = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
"""Distances that ways keep from solids, m."""
PATH_PLANNERS = ("BITstar", "InformedRRTstar")
"""Path planners whose paths are short or become so."""


def iterate_routes(finder: RouteFinder, state: RoomState, goal: Goal, request: PlanningRequest,
                   settings: SearchSettings, clock: Clock) -> Iterator[Route]:
    """Routes to one goal after the first one, until the nodes of `settings.budget` are spent; failures are skipped."""
    left = settings.budget
    for number in range(_count_ways(request)):
        try:
            route = _find_way(finder, state, goal, number, settings._replace(budget=left), clock)
        except PlanningFailed as failure:
            left -= failure.expansions
        else:
            left -= route.expansions
            yield route
        if left <= 0 or clock.is_up():
            return


def _count_ways(request: PlanningRequest) -> int:
    return len(EFFORTS) + (len(WAY_MARGINS) + len(PATH_PLANNERS) if request.objective != "primitives" else 0)


def _find_way(finder: RouteFinder, state: RoomState, goal: Goal, number: int, settings: SearchSettings, clock: Clock
              ) -> Route:
    """Route number `number`: lower and lower heuristics, then growing margins, then path planners."""
    if number < len(EFFORTS):
        return finder.find_route(state, goal, None, clock, settings._replace(effort=number + 1))
    number -= len(EFFORTS)
    if number < len(WAY_MARGINS):
        keep_out = (*list_obstacles(state, finder.instance)[-1],
                    *grow_solids(finder.instance, state, goal, WAY_MARGINS[number]))
        return finder.find_route_around(state, goal, keep_out, settings.budget, PlanningReport(), refine=False,
                                        clock=clock)
    planner = PATH_PLANNERS[number - len(WAY_MARGINS)]
    return finder.find_route(state, goal, None, clock, settings._replace(method=planner))
