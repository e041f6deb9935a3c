"""Path planners by name: OMPL's, and those that a user registers."""

from __future__ import annotations

from hrl_escape.errors import PathPlannerError, UnknownNameError
from hrl_escape.planning.paths.problem import PlannerFactory
from hrl_escape.planning.paths.roadmap import ROADMAPS, Roadmap
from hrl_escape.planning.paths.single_query import SINGLE_QUERY_PLANNERS, SingleQueryPlanner

__all__ = ["get_factory", "list_planners", "register_planner"]

_FACTORIES: dict[str, PlannerFactory] = {
    **{kind: lambda collision, kind=kind: SingleQueryPlanner(kind) for kind in SINGLE_QUERY_PLANNERS},
    **{kind: lambda collision, kind=kind: Roadmap(kind) for kind in ROADMAPS},
}


def register_planner(name: str, factory: PlannerFactory) -> None:
    """Register a path planner under a name; try it with `hrl_escape.checks.check_path_planner` first.

    Args:
        name: unused so far.
        factory: called once for each room and door, with its `CollisionMap`; returns the planner. The
            same problem must give the same path, independent of earlier queries.

    Raises:
        PathPlannerError: another planner has that name.
    """
    if _FACTORIES.setdefault(name, factory) is not factory:
        raise PathPlannerError(f"a path planner named {name!r} is registered already; choose another name")


def list_planners() -> tuple[str, ...]:
    """Names of all path planners, OMPL's and registered ones."""
    return tuple(sorted(_FACTORIES))


def get_factory(name: str) -> PlannerFactory:
    """The factory registered under a name.

    Raises:
        UnknownNameError: there is none.
    """
    if not isinstance(name, str) or name not in _FACTORIES:
        raise UnknownNameError("path planner", name, _FACTORIES)
    return _FACTORIES[name]
