"""Task hierarchies by hand: a graph of named tasks, as in MAXQ (Dietterich 2000).

A task has a name, children, a predicate that ends it, the parts of the moment that it observes, and a
pseudo-reward at its end. Children are other tasks or numbers of primitives.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.task import BaseTask, Call, Frame, Hierarchy, LearnerSpec, Seen, Stack, allow_only
from hrl_escape.errors import AgentSettingsError, UnknownNameError

Until = Callable[[Seen], bool]
"""True if the task is over."""
View = Callable[[Seen], Any]
"""Part of a moment that matters: a number, a tuple of numbers, or an array."""
Pseudo = Callable[[Seen], float]
"""Pseudo-reward of a task's final state."""
TaskPolicy = Callable[[Seen], int | None]
"""Choice of a task with a given policy: number of the only legal child, or None for no child."""


class GraphTask(BaseTask):
    """A named task of a graph.

    Attributes:
        children: tasks and primitives, numbered as choices are.
        views: what matters to it: under None, for the task; under a choice, for that choice's completion.
        primitive_views: what matters to the value of a primitive, for all tasks.
        policy: makes its choice for it, or None to learn the choice.
    """

    def __init__(
        self,
        name: str,
        until: Until,
        views: Mapping[int | None, View],
        primitive_views: Mapping[int, View],
        pseudo: Pseudo | None,
        choices: int,
        policy: TaskPolicy | None,
        place: tuple[float, float] | None,
    ) -> None:
        super().__init__(name, choices)
        self.policy, self.place = policy, place
        self.until, self.views, self.primitive_views, self.pseudo = until, views, primitive_views, pseudo
        self.children: tuple[GraphTask | int, ...] = ()

    def view(self, seen: Seen, stack: Stack) -> Any:
        """Return the view of `see`, by default the observation."""
        view = self.views.get(None)
        return seen.observation if view is None else view(seen)

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Return legal primitives, and tasks that are not over and have legal choices themselves."""
        if self.policy is not None:
            return allow_only(self.policy(seen), np.ones(len(self.children), np.bool_))
        return np.array([seen.mask[child] if isinstance(child, int) else child.is_callable(seen, None)
                         for child in self.children], np.bool_)  # fmt: skip

    def find_place(self, context: Any) -> tuple[float, float] | None:
        """Return the given place of the task."""
        return self.place

    def is_callable(self, seen: Seen, context: Any) -> bool:
        """Return whether the task is not over here and has a legal choice."""
        if self.until(seen):
            return False
        if self.policy is not None:
            return self.policy(seen) is not None
        return any(seen.mask[child] if isinstance(child, int) else child.is_callable(seen, context)
                   for child in self.children)  # fmt: skip

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        """Return the child of this number."""
        return Call(self.children[choice])

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Return 1 if `until` holds, else 0."""
        return float(self.until(seen))

    def final(self, frame: Frame, seen: Seen) -> float:
        """Return the pseudo-reward of the state reached, 0 without one."""
        return 0.0 if self.pseudo is None else self.pseudo(seen)


def maxq(
    graph: Mapping[str, Sequence[str | int]],
    until: Mapping[str, Until],
    see: Mapping[str | int | tuple[str, str | int], View] | None = None,
    pseudo: Mapping[str, Pseudo] | None = None,
    *,
    policies: Mapping[str, TaskPolicy] | None = None,
    places: Mapping[str, tuple[float, float]] | None = None,
    learners: Mapping[str, LearnerSpec] | None = None,
    read: Callable[[Any], Any] | None = None,
    source: Literal["given", "synthesised"] = "given",
    privileges: tuple[str, ...] = (),
) -> Hierarchy:
    """Make a hierarchy from a graph of named tasks.

    Args:
        graph: task -> its children, tasks by name and primitives by number; the first task is the root.
        until: task -> predicate of its end; the root needs none.
        see: relevant part, the whole observation by default: task -> for its decisions; (task, child) -> for the
            completion of that one choice, MAXQ's finer abstraction; primitive -> for its own reward.
        pseudo: task -> pseudo-reward of the state it ended in.
        policies: task -> its policy, if it is given instead of learned.
        places: task -> x and y of its goal on the floor, m, for drawings.
        learners: task -> constructor of its agent, for `StackAgent`.
        read: makes `Seen.state` of an observation.
        source: where the graph comes from.
        privileges: information beyond graph and state.

    Raises:
        UnknownNameError: a child or a key is not the name of a task.
        AgentSettingsError: a task below the root has no `until`, or tasks call each other in a circle.
    """
    see, pseudo, policies, places = see or {}, pseudo or {}, policies or {}, places or {}
    names = list(graph)
    seeing = [key if isinstance(key, str) else key[0] for key in see if not isinstance(key, int)]
    for where, mentioned in (("until", until), ("pseudo", pseudo), ("policies", policies), ("places", places),
                             ("see", seeing)):
        for name in mentioned:
            if name not in graph:
                raise UnknownNameError(f"task in {where}", name, names)
    primitive_views = {key: view for key, view in see.items() if isinstance(key, int)}
    tasks: dict[str, GraphTask] = {}
    for name, children in graph.items():
        if name not in until and name != names[0]:
            raise AgentSettingsError("until", name, "a predicate for every task below the root")
        views: dict[int | None, View] = {None: see[name]} if name in see else {}
        views |= {index: see[name, child] for index, child in enumerate(children) if (name, child) in see}
        tasks[name] = GraphTask(name, until.get(name, lambda seen: False), views, primitive_views, pseudo.get(name),
                                len(children), policies.get(name), places.get(name))
    for name, children in graph.items():
        for child in children:
            if isinstance(child, str) and child not in tasks:
                raise UnknownNameError(f"child of {name}", child, names)
        tasks[name].children = tuple(tasks[child] if isinstance(child, str) else int(child) for child in children)
    root, *below = tasks.values()
    _refuse_circles(root, ())
    told = ("task graph", *(() if read is None else ("state",)), *privileges)
    return Hierarchy(root, tuple(below), learners or {}, source=source, privileges=told, read=read)


def flat(primitives: int) -> Hierarchy:
    """Make a hierarchy of one task that calls every primitive: a flat agent."""
    return Hierarchy(maxq({"root": range(primitives)}, {}).root)


def get_graph(hierarchy: Hierarchy, agent: str) -> GraphTask:
    """Return the root of a hierarchy that is a task graph.

    Raises:
        AgentSettingsError: a task is of another kind, without a list of children.
    """
    for task in hierarchy.tasks.values():
        if not isinstance(task, GraphTask):
            raise AgentSettingsError("hierarchy", task.name, f"tasks from maxq(graph, until); {agent} lists children")
    assert isinstance(hierarchy.root, GraphTask)
    return hierarchy.root


def get_task(stack: Stack) -> GraphTask:
    """Return the task of the last call, in a hierarchy that passed `get_graph`."""
    task = stack[-1].task
    assert isinstance(task, GraphTask)
    return task


def freeze(view: Any) -> Hashable:
    """Convert a view to a key: equal views have equal keys, and `repr` writes a key as a literal."""
    if isinstance(view, np.ndarray):
        return view.tobytes()
    if isinstance(view, np.generic):
        return view.item()
    if isinstance(view, (tuple, list)):
        return tuple(freeze(part) for part in view)
    if isinstance(view, dict):
        return tuple((key, freeze(view[key])) for key in sorted(view))
    return view


def _refuse_circles(task: GraphTask, callers: tuple[str, ...]) -> None:
    if task.name in callers:
        raise AgentSettingsError("graph", " -> ".join((*callers, task.name)), "a graph without cycles")
    for child in task.children:
        if not isinstance(child, int):
            _refuse_circles(child, (*callers, task.name))
