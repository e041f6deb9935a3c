"""OMPL's roadmap planners: a graph of free places, grown once for a room and searched by every query."""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base, geometric

from hrl_escape.planning.paths.ompl_plane import add_states, find_straight_path, make_information, set_seed
from hrl_escape.planning.paths.problem import PathProblem

__all__ = ["ROADMAPS", "Roadmap"]

ROADMAPS = ("PRM", "PRMstar")
MILESTONES = (200, 800, 3200)
MOST_ROADMAPS = 16
NEIGHBOURS = 8


class Roadmap:
    """OMPL's probabilistic roadmap (Kavraki et al. 1996), grown once for a room and searched by every query.

    A query tries roadmaps of 200, 800 and 3200 milestones in turn, each grown from nothing with the
    seed, until one connects it. Its path does not depend on earlier queries.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._stages: dict[tuple[int, int], tuple[NDArray[np.float64], list[list[tuple[float, int]]], int]] = {}

    def __call__(self, problem: PathProblem) -> NDArray[np.float64] | None:
        """Find a path, shape (n, 2), m, or None."""
        straight = find_straight_path(problem)
        if straight is not None:
            return straight
        for milestones in MILESTONES:
            places, links, calls = self._grow(problem, milestones)
            problem.spend(calls)
            path = _search_roadmap(problem, places, links)
            if path is not None:
                return _shorten(problem, path)
        return None

    def _grow(self, problem: PathProblem, milestones: int) -> tuple[NDArray[np.float64], list, int]:
        key = (problem.seed, milestones)
        if key in self._stages:
            return self._stages[key]
        before = problem.calls
        set_seed(problem)
        information = make_information(problem)
        roadmap = getattr(geometric, self._kind)(information)
        definition = base.ProblemDefinition(information)
        add_states(problem.goals[:1], definition.addStartState)  # growing needs a start, and leaves it out
        roadmap.setProblemDefinition(definition)
        roadmap.setup()
        roadmap.growRoadmapPtc(base.PlannerTerminationCondition(lambda: roadmap.milestoneCount() >= milestones))
        data = base.PlannerData(information)
        roadmap.getPlannerData(data)
        states: list[Any] = [data.getVertex(i).getState() for i in range(data.numVertices())]
        places = np.array([(state[0], state[1]) for state in states])
        links: list[list[tuple[float, int]]] = [[] for _ in states]
        for i in range(len(states)):
            for j in data.getEdges(i):
                length = float(np.hypot(*(places[i] - places[j])))
                links[i].append((length, j))
                links[j].append((length, i))
        calls, problem.calls = problem.calls - before, before  # the caller charges them to every query alike
        if len(self._stages) >= MOST_ROADMAPS:
            del self._stages[next(iter(self._stages))]
        self._stages[key] = places, links, calls
        return self._stages[key]


def _search_roadmap(problem: PathProblem, places: NDArray[np.float64], links: list) -> NDArray[np.float64] | None:
    """Dijkstra's search from the goals' nearest milestones in sight to those of the start."""

    def see(place: NDArray[np.float64]) -> list[tuple[float, int]]:
        away = np.hypot(*(places - place).T)
        near = np.argsort(away, kind="stable")[:NEIGHBOURS]
        return [(float(away[i]), int(i)) for i in near if problem.is_move_free(*place.tolist(), *places[i].tolist())]

    last = {i: length for length, i in see(problem.start)}
    if not last:
        return None
    best: dict[int, tuple[float, int]] = {}
    queue = [(length, i, -1 - k) for k, goal in enumerate(problem.goals) for length, i in see(goal)]
    heapq.heapify(queue)
    arrivals: list[tuple[float, int]] = []
    while queue:
        length, i, before = heapq.heappop(queue)
        if i in best:
            continue
        best[i] = (length, before)
        if i in last:
            heapq.heappush(arrivals, (length + last[i], i))
        if arrivals and length >= arrivals[0][0]:
            break
        for more, j in links[i]:
            if j not in best:
                heapq.heappush(queue, (length + more, j, i))
    if not arrivals:
        return None
    path, at = [problem.start], arrivals[0][1]
    while at >= 0:
        path.append(places[at])
        at = best[at][1]
    return np.array([*path, problem.goals[-1 - at]])


def _shorten(problem: PathProblem, path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shortcut the path: go straight to the last place in sight."""
    kept, at = [0], 0
    while at < len(path) - 1:
        at = next(j for j in range(len(path) - 1, at, -1)
                  if j == at + 1 or problem.is_move_free(*path[at].tolist(), *path[j].tolist()))
        kept.append(at)
    return path[kept]
