"""Landmarks of a room as goals of a manager: facts that every plan makes true, and the exit after them.

Which are left, and which of them come first, is found anew from the facts that hold, so that a landmark that was lost
is one again.

The landmarks of the symbolic model are exact for its delete relaxation, in which a true fact stays true (Keyder,
Richter and Helmert 2010, by the propagation of Zhu and Givan 2003). A forbidden fact is a fact of its own, which
deletes make true.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from gymnasium import spaces

from hrl_escape.agents.hierarchy.goal_space import GoalSet, GoalView
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.planning.goals import Goal
from hrl_escape.synthesis.situation import Situations

Literal: TypeAlias = tuple[str, bool]


def find_landmarks(model: SymbolicModel, facts: frozenset[str], goal: Iterable[str] | None = None
                   ) -> Mapping[str, frozenset[str]] | None:
    """Find the facts that do not hold here and that every plan makes true, for these goal facts or the model's own.

    Returns:
        Landmark -> the landmarks that every plan makes true before it; None if no plan leads to the goal, even without
        deletes.
    """
    before: dict[Literal, frozenset[Literal]] = {
        (fact, fact in facts): frozenset() for fact in model.propositions}
    grew = True
    while grew:
        grew = False
        for operator in itertools.chain(*map(_split, model.operators)):
            needs = [(fact, True) for fact in operator.preconditions] + [(fact, False) for fact in operator.forbidden]
            if any(need not in before for need in needs):
                continue
            led = frozenset().union(*(before[need] | {need} for need in needs))
            made = [(fact, True) for fact in operator.add] + [(fact, False) for fact in operator.delete - operator.add]
            for literal in made:
                least = led if literal not in before else before[literal] & led
                if before.get(literal) != least:
                    before[literal], grew = least, True
    wanted = [(fact, True) for fact in (model.goal if goal is None else goal)]
    if any(literal not in before for literal in wanted):
        return None
    found = {fact for literal in wanted for fact, holds in before[literal] | {literal} if holds and fact not in facts}
    return {fact: frozenset(each for each, holds in before[fact, True] if holds and each not in facts) - {fact}
            for fact in sorted(found)}


def _split(operator: Operator) -> list[Operator]:
    """Split an operator into one without conditional effects and one for each conditional effect."""
    parts = [dataclasses.replace(operator, preconditions=operator.preconditions | effect.condition,
                                 forbidden=operator.forbidden | effect.forbidden, add=effect.add, delete=effect.delete,
                                 when=()) for effect in operator.when]
    return [dataclasses.replace(operator, when=()), *parts]


EXIT = "exit"


class OpenLandmarks:
    """Landmarks that come next, and the target to press on the way to one.

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
