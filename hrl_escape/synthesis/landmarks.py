"""Landmarks of a room as goals of a manager: facts that every plan makes true, and the exit after them.

Which are left, and which of them come first, is found anew from the facts that hold, so that a landmark that was lost
is one again.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from gymnasium import spaces

from hrl_escape.agents.hierarchy.goals import GoalSet, GoalView
from hrl_escape.env.puzzles.symbolic import SymbolicModel
from hrl_escape.planning.goals import Goal
from hrl_escape.planning.symbolic.landmarks import find_landmarks
from hrl_escape.synthesis.situation import Situations

__all__ = ["OpenLandmarks", "make_landmark_goals"]

EXIT = "exit"


class OpenLandmarks:
    """Landmarks that come next, and the target to press on the way to one.

    Args:
        rooms: the room.

    Attributes:
        names: facts that may be landmarks somewhere, and last the exit.
    """

    def __init__(self, rooms: Situations) -> None:
        self._model = rooms.model
        made = frozenset[str]().union(*(operator.add for operator in rooms.operators))
        self.names = (*(fact for fact in self._model.propositions if fact in made), EXIT)
        self._rooms = rooms
        self._find = lru_cache(None)(self._search)
        self._find_goal = lru_cache(None)(self._search_goal)

    def list_open(self, facts: frozenset[str]) -> frozenset[str]:
        """Landmarks with none before them that does not hold; the exit where the goal holds; none at a dead end."""
        return self._find(facts)

    def _search(self, facts: frozenset[str]) -> frozenset[str]:
        found = find_landmarks(self._model, facts)
        if found is None:
            return frozenset()
        return frozenset(fact for fact, earlier in found.items() if not earlier) or frozenset({EXIT})

    def find_goal(self, facts: frozenset[str], landmark: str) -> Goal | None:
        """Goal that comes first on the way to a landmark: a target to press, or the exit; None at a dead end."""
        return self._find_goal(facts, landmark)

    def _search_goal(self, facts: frozenset[str], landmark: str) -> Goal | None:
        if landmark == EXIT:
            return self._rooms.get_goal(None)
        model = SymbolicModel(self._model.propositions, self._rooms.operators, frozenset({landmark}))
        first = next(iter(model.find_fewest(facts) or ()), None)
        return None if first is None else self._rooms.get_goal(self._rooms.target_names.index(first.target))


def make_landmark_goals(rooms: Situations, planned: bool, abstract: bool) -> GoalSet:
    """Landmarks as the goals of two levels.

    The manager sees facts and touched targets; the worker the pose, what is touched, and an open door. With planned
    leaves the planner walks to the target whose press begins the shortest way to the landmark.

    Args:
        rooms: the room.
        planned: the planner walks; else walking is learned over primitives.
        abstract: let each level see only what is relevant to it; without, both see pose and facts.
    """
    landmarks = OpenLandmarks(rooms)
    names = landmarks.names

    def is_reached(observation: Any, goal: int) -> bool:
        return names[goal] in rooms.read(observation).facts

    def is_open(observation: Any, goal: int) -> bool:
        return names[goal] in landmarks.list_open(rooms.read(observation).facts)

    def choose(observation: Any, goal: int) -> int | None:
        here = rooms.read(observation)
        target = landmarks.find_goal(here.facts, names[goal])
        return None if target is None else rooms.plan_first(here, target)

    def find_place(fact: str) -> tuple[float, float] | None:
        maker = next((operator for operator in rooms.operators if fact in operator.add), None)
        return rooms.get_place(None if maker is None else rooms.target_names.index(maker.target))

    views = [GoalView(spaces.Box(-np.inf, np.inf, (size,), np.float64),
                      lambda observation, see=see: see(rooms.read(observation)))
             for see, size in ((rooms.list_facts, rooms.fact_count), (rooms.list_pose, rooms.pose_count))]
    manager, worker = views if abstract else (None, None)
    return GoalSet(len(names), is_reached, is_open, choose if planned else None, manager, worker, names,
                   tuple(map(find_place, names)), "synthesised",
                   ("landmarks", "state", "planner") if planned else ("landmarks", "state"))
