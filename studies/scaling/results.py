"""Result of a run of the scaling study: its room, how soon it escaped and was near the best, and the graph it found."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.graphs import find_edges_that_matter
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin
from studies.store import Line

__all__ = ["RoomKind", "ScalingRun", "compute_edge_depth", "measure_depth"]


class RoomKind(NamedTuple):
    """Kind of room: graph, number of buttons, rule.

    Attributes:
        graph: family of the dependency graph.
        buttons: number of buttons.
        rule: effect of a press with unmet parents, `ignore` or `reset`; `ignore, noise` in rooms with noise and slip.
    """

    graph: str
    buttons: int
    rule: str


@dataclass(frozen=True)
class ScalingRun(Line):
    """Result of a run.

    Attributes:
        graph: see `RoomKind`; so the next two.
        agent: name, or label where agents of one name differ.
        run: seed of room, agent and episodes.
        room: content hash of the instance.
        best: best return known for these options.
        worst: return without escape.
        budget: most primitives of training; the last option may go beyond.
        primitives: trained for.
        decisions: trained for.
        seconds: of training.
        first_escape: primitives at the end of the first training episode that escaped; None if none did.
        near_best: primitives at the first of two checks in a row near the best; None without such a pair.
        edges: number of edges that matter.
        depth: most of these in a row.
        structure: (primitives, precision, recall) at every change; empty for agents without a graph.
    """

    graph: str
    buttons: int
    rule: str
    agent: str
    run: int
    room: str
    best: float
    worst: float
    budget: int
    primitives: int
    decisions: int
    seconds: float
    first_escape: int | None
    near_best: int | None
    edges: int
    depth: int
    structure: tuple[tuple[int, float, float], ...]

    @property
    def task(self) -> RoomKind:
        """Kind of its room."""
        return RoomKind(self.graph, self.buttons, self.rule)

    PLACE = ("task", "agent", "run")


def measure_depth(room: RoomInstance) -> int:
    """Most edges that matter in a row, in the room's graph."""
    graph = get_mixin(room.puzzle, Graphed)
    return compute_edge_depth(find_edges_that_matter(graph.edges, graph.goal_targets), graph.goal_targets)


def compute_edge_depth(edges: Iterable[tuple[int, int]], goals: Iterable[int]) -> int:
    """Most edges in a row that lead to a goal; edges are (parent, child) pairs without cycles."""
    every, level, depth = set(edges), set(goals), 0
    while level := {parent for parent, child in every if child in level}:
        depth += 1
    return depth
