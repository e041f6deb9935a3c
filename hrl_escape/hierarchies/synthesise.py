"""Synthesis of task hierarchies from a room's symbolic model.

Each operator becomes a task: its preconditions decide when the task is legal, its effects when it is over, and
relevance gives its state abstraction. The agent learns the order of tasks and, with a learned low level, the path to
each target. With a planned low level the planner moves the robot.

Landmarks are facts that every plan makes true, followed by the exit. They are the goals of a manager. The remaining
landmarks are computed from the current facts, so a fact that becomes false is a landmark again.

The tree of feudal learning divides the room's floor at several resolutions. A manager observes its cell and the current
facts. It orders a move to the next cell, or a search: make one of the open landmarks true, or escape.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from gymnasium import spaces

from hrl_escape.agents.algorithms.task_hierarchies.feudal_rl import DIRECTIONS, Quadtree
from hrl_escape.agents.hierarchy.goal_space import GoalSet, GoalSpace, GoalView
from hrl_escape.agents.hierarchy.machine import Machine, choose, do, machine
from hrl_escape.agents.hierarchy.task import Hierarchy, Seen
from hrl_escape.agents.hierarchy.task_graph import Until, View, maxq
from hrl_escape.agents.hierarchy_kinds import (
    KINDS,
    LOW_LEVELS,
    STRUCTURES,
    WITHOUT_PLANS,
    HierarchyKind,
    LowLevel,
    check_low_level,
)
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.errors import UnknownNameError
from hrl_escape.hierarchies.goal_points import make_displacement_space, make_event_space
from hrl_escape.hierarchies.situation import Situations
from hrl_escape.planning.goals import Goal, RegionGoal

_ROOT, EXIT = "escape", "exit"

Literal: TypeAlias = tuple[str, bool]
"""A fact, and whether it holds."""


def synthesise(instance: RoomInstance, kind: HierarchyKind = "maxq", low_level: LowLevel = "planned", *,
               abstract: bool = True, cell: float | None = None
               ) -> Hierarchy | Machine | GoalSet | Quadtree | GoalSpace:
    """Make a hierarchy for a room from its symbolic model.

    Args:
        instance: the room.
        kind: `maxq`, a task graph for `maxq-q`, `r-maxq` and `h-uct`; `ham`, a program for `hamq`;
            `landmarks`, goals for `h-dqn`; `feudal`, cells of the floor for `feudal-rl`; `events`, a goal space for
            `hac-finite`, `sol` and `option-keyboard`; `displacements`, one for `hiro-finite` and `hrac-finite`.
        low_level: `planned`, the planner moves to each target; `learned`, the agent learns to move by primitives.
        abstract: each task observes only what is relevant to it; otherwise all observe pose and facts.
        cell: size of the squares that discretise poses in a learned low level, m; the length of a move by default.

    Raises:
        UnknownNameError: no such kind or low level.
        UnsupportedError: the puzzle requires more than presses, or the low level of this kind cannot be planned.
    """
    structure = make_structure(Situations(instance, cell), kind, low_level, abstract)
    return structure[STRUCTURES[kind]]


def make_structure(situations: Situations, kind: HierarchyKind, low_level: str, abstract: bool = True
                   ) -> Mapping[str, Any]:
    """Return the arguments of an agent with this kind, besides spaces and settings; raises as `synthesise`."""
    for what, name, known in (("kind of hierarchy", kind, KINDS), ("low_level", low_level, LOW_LEVELS)):
        if name not in known:
            raise UnknownNameError(what, name, known)
    check_low_level(kind, low_level)
    planned = low_level == "planned"
    if kind in WITHOUT_PLANS:
        return {"goal_space": (make_event_space if kind == "events" else make_displacement_space)(situations)}
    if kind == "maxq":
        return {"hierarchy": _make_task_graph(situations, planned, abstract)}
    if kind == "landmarks":
        return {"goals": make_landmark_goals(situations, planned, abstract)}
    if kind == "feudal":
        return {"tree": make_region_tree(situations, planned)}
    see = situations.see_place if planned and abstract else situations.see_all
    return {"program": _make_program(situations, planned), "see": see, "read": situations.read,
            "find_place": _make_place_finder(situations)}


def _make_task_graph(rooms: Situations, planned: bool, abstract: bool) -> Hierarchy:
    """Root -> one task an operator, and the exit -> touch or leave a target -> primitives."""
    primitives = range(len(rooms.instance.robot.actions))
    graph: dict[str, list[str | int]] = {_ROOT: [*(operator.name for operator in rooms.operators), EXIT]}
    until: dict[str, Until] = {EXIT: lambda seen: not seen.state.is_open}
    goals: dict[str, int | None] = {EXIT: None}
    for operator in rooms.operators:
        target = rooms.target_names.index(operator.target)
        touch, leave = f"touch {operator.target}", f"leave {operator.target}"
        graph[operator.name] = [touch, leave]
        until[operator.name] = lambda seen, operator=operator: not operator.is_applicable(seen.state.facts)
        until[touch] = lambda seen, target=target: rooms.is_touching(seen, target)
        until[leave] = lambda seen, target=target: not rooms.is_touching(seen, target)
        goals[touch] = goals[leave] = target
    graph |= {name: list(primitives) for name in goals}
    see: dict[str | int | tuple[str, str | int], View] = {name: rooms.see_all for name in graph}
    if abstract:
        # The value of a planned path is its length, of a learned one a function of the pose. The press is part of it.
        see |= {name: _make_length_view(rooms, target) if planned else rooms.see_pose for name, target in goals.items()}
        see |= {operator.name: rooms.see_place for operator in rooms.operators} | {_ROOT: rooms.see_place}
    see |= {primitive: _make_primitive_view(rooms, primitive, planned) if abstract else rooms.see_all
            for primitive in primitives}
    places = {name: rooms.get_place(target) for name, target in goals.items()}
    places |= {operator.name: places[f"touch {operator.target}"] for operator in rooms.operators}
    policies = {name: _make_policy(rooms, target) for name, target in goals.items()} if planned else {}
    return maxq(graph, until, see, policies=policies, places=places, read=rooms.read, source="synthesised",
                privileges=("planner",) if planned else ())


def _make_policy(rooms: Situations, target: int | None) -> Callable[[Seen], int | None]:
    goal = rooms.get_goal(target)
    return lambda seen: rooms.plan_first(seen.state, goal)


def _make_length_view(rooms: Situations, target: int | None) -> View:
    goal = rooms.get_goal(target)

    def see(seen: Seen) -> int:
        route = rooms.find_route(seen.state, goal)
        return len(route.primitives) if route else 0

    return see


def _make_primitive_view(rooms: Situations, primitive: int, planned: bool) -> View:
    """View of primitives: the reward differs only at the exit, whose position a learned low level has to discover."""

    def see(seen: Seen) -> Any:
        if not seen.state.is_open:
            return None
        return rooms.can_escape(seen, primitive) if planned else rooms.see_pose(seen)

    return see


def _make_place_finder(rooms: Situations) -> Callable[[str, tuple[Any, ...]], tuple[float, float] | None]:
    """Return the position of a machine's goal: the operator or target of its call, or the exit."""
    targets: dict[str, int | None] = {name: number for number, name in enumerate(rooms.target_names)}
    targets |= {operator.name: targets[operator.target] for operator in rooms.operators} | {EXIT: None}

    def find(name: str, arguments: tuple[Any, ...]) -> tuple[float, float] | None:
        word = arguments[0] if arguments else EXIT if name == "leave_room" else ""
        return rooms.get_place(targets[word]) if word in targets else None

    return find


def _make_program(rooms: Situations, planned: bool) -> Machine:
    """Choose a legal operator or the open exit, and touch its target until the effect holds."""
    primitives = range(len(rooms.instance.robot.actions))
    operators = {operator.name: operator for operator in rooms.operators}
    goals = {EXIT: rooms.get_goal(None)} | {name: rooms.get_goal(i) for i, name in enumerate(rooms.target_names)}

    @machine
    def step(seen: Callable[[], Seen], target: str) -> Any:
        if planned:
            first = rooms.plan_first(seen().state, goals[target])
            yield do(rooms.instance.robot.actions.wait if first is None else first)
        else:
            yield do((yield choose(primitives)))

    @machine
    def touch(seen: Callable[[], Seen], target: str) -> Any:
        number = rooms.target_names.index(target)
        while rooms.is_touching(seen(), number):
            yield from step(target)
        while not rooms.is_touching(seen(), number):
            yield from step(target)

    @machine
    def apply(seen: Callable[[], Seen], name: str) -> Any:
        while operators[name].is_applicable(seen().state.facts):
            yield from touch(operators[name].target)

    @machine
    def leave_room(seen: Callable[[], Seen]) -> Any:
        while seen().state.is_open:
            yield from step(EXIT)

    @machine
    def escape(seen: Callable[[], Seen]) -> Any:
        while True:
            here = seen().state
            open_tasks = [name for name, operator in operators.items() if operator.is_applicable(here.facts)]
            chosen = yield choose([*open_tasks, *([EXIT] if here.is_open else [])])
            yield from leave_room() if chosen == EXIT else apply(chosen)

    return escape


# --- landmarks -----------------------------------------------------------------------------

def find_landmarks(model: SymbolicModel, facts: frozenset[str], goal: Iterable[str] | None = None
                   ) -> Mapping[str, frozenset[str]] | None:
    """Find the landmarks: false facts that every plan to the goal makes true.

    The result is exact for the delete relaxation of the model (Keyder, Richter and Helmert 2010, with the propagation
    of Zhu and Givan 2003). A negative precondition is a fact of its own, which deletes make true.

    Returns:
        Landmark -> the landmarks that every plan makes true before it, or None if the relaxation has no plan.
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


class OpenLandmarks:
    """Return the next landmarks and the target to press for each; `names` are all landmarks, the exit last."""

    def __init__(self, rooms: Situations) -> None:
        self._model = rooms.model
        made = frozenset[str]().union(*(operator.add for operator in rooms.operators))
        self.names = (*(fact for fact in self._model.propositions if fact in made), EXIT)
        self._rooms = rooms
        self.list_open, self.find_goal = lru_cache(None)(self._list_open), lru_cache(None)(self._find_goal)

    def _list_open(self, facts: frozenset[str]) -> frozenset[str]:
        """Return the landmarks without open predecessors; the exit if the goal holds; empty at a dead end."""
        found = find_landmarks(self._model, facts)
        if found is None:
            return frozenset()
        return frozenset(fact for fact, earlier in found.items() if not earlier) or frozenset({EXIT})

    def _find_goal(self, facts: frozenset[str], landmark: str) -> Goal | None:
        """Return the first goal on the path to a landmark: a target to press, or the exit; None at a dead end."""
        if landmark == EXIT:
            return self._rooms.get_goal(None)
        model = SymbolicModel(self._model.propositions, self._rooms.operators, frozenset({landmark}))
        first = next(iter(model.find_fewest(facts) or ()), None)
        return None if first is None else self._rooms.get_goal(self._rooms.target_names.index(first.target))


def make_landmark_goals(rooms: Situations, planned: bool, abstract: bool) -> GoalSet:
    """Make a hierarchy of two levels whose goals are landmarks.

    The manager observes facts and touched targets, the worker pose and open exit; without `abstract` both observe pose
    and facts. A planned low level moves to the target whose press begins the shortest path to the landmark; otherwise
    the worker learns to move by primitives.
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


# --- regions --------------------------------------------------------------------------------

MOST_LEVELS = 3
KEPT = 50_000
"""Size of the cache of plans: every manager checks before every primitive which orders are feasible."""
BORDER_MARGIN = 1e-3
"""Margin of a target region to its borders, as a share of its size, because a border belongs to one region only."""


def compute_depth(rooms: Situations, planned: bool) -> int:
    """Return the finest level: its cells are at least two moves wide, or quarters with a planned low level.

    A planner crosses a quarter as easily as a small cell, and each further level adds a manager to train.
    """
    if planned:
        return 1
    widths = 2 * rooms.instance.reach_x, 2 * rooms.instance.reach_y
    levels = int(math.log2(max(1.0, min(widths) / (2 * rooms.instance.robot.actions.stride))))
    return min(max(levels, 1), MOST_LEVELS)


def make_region_tree(rooms: Situations, planned: bool) -> Quadtree:
    """Make regions of the floor, divided into four at every level, once for a planned low level; north is +y.

    With a planned low level the planner executes orders: it moves into the next cell, or for a search to the nearest
    target in this cell.
    """
    half_width, half_depth = rooms.instance.reach_x, rooms.instance.reach_y
    landmarks, depth = OpenLandmarks(rooms), compute_depth(rooms, planned)
    most = math.nextafter(1.0, 0.0)

    def locate(x: float, y: float) -> tuple[float, float]:
        row, column = (half_depth - y) / (2 * half_depth), (half_width + x) / (2 * half_width)
        return min(max(row, 0.0), most), min(max(column, 0.0), most)

    def find_place(observation: Any) -> tuple[float, float]:
        here = rooms.read(observation).state
        return locate(here.x, here.y)

    def list_facts(observation: Any) -> tuple[int, ...]:
        facts = rooms.read(observation).facts
        return tuple(int(fact in facts) for fact in landmarks.names[:-1])

    def has_found(before: Any, after: Any) -> bool:
        return bool(landmarks.list_open(rooms.read(before).facts) & rooms.read(after).facts)

    def find_cell(x: float, y: float) -> tuple[int, ...]:
        return tuple(int(share * 2**depth) for share in locate(x, y))

    @lru_cache(KEPT)
    def find_obedience(packed: bytes, cell: tuple[int, int], order: int) -> int | None:
        here = rooms.read(np.frombuffer(packed))
        if order < len(DIRECTIONS):
            (down, right), size = DIRECTIONS[order], 2**depth
            row, column = cell[0] + down, cell[1] + right
            goal = RegionGoal(
                *(half_width * (2 * (column + side) / size - 1) for side in (BORDER_MARGIN, 1 - BORDER_MARGIN)),
                *(half_depth * (1 - 2 * (row + side) / size) for side in (1 - BORDER_MARGIN, BORDER_MARGIN)))
            return rooms.plan_first(here, goal)
        ways = []
        for landmark in sorted(landmarks.list_open(here.facts)):
            target = landmarks.find_goal(here.facts, landmark)
            route = None if target is None else rooms.find_route(here, target)
            if route and route.primitives and find_cell(*route.poses[-1][:2]) == cell:
                ways.append((len(route.primitives), route.primitives[0]))
        return min(ways)[1] if ways else None

    def obey(observation: Any, cell: tuple[int, int], order: int) -> int | None:
        return find_obedience(np.asarray(observation, np.float64).tobytes(), cell, order)

    return Quadtree(depth, find_place, list_facts, has_found, obey if planned else None)
