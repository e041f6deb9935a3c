"""Result of a run of the scaling study: its room, how soon it escaped and was near the best, and the graph it found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hrl_escape.agents.training.results import load_result
from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.runs import get_training_folder
from hrl_escape.benchmark.solved_probe import find_edges_that_matter
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin

__all__ = ["RoomKind", "ScalingRun", "collect_scaling_runs", "compute_edge_depth"]


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
class ScalingRun:
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

    @property
    def place(self) -> tuple[RoomKind, str, int]:
        """Subject of the line."""
        return self.task, self.agent, self.run


def collect_scaling_runs(comparison: Comparison, rooms: Mapping[RoomKind, RoomInstance]) -> list[ScalingRun]:
    """Read the finished runs of a round.

    Args:
        comparison: a round's.
        rooms: task -> its room; tasks that share a room share its run.

    Raises:
        FileReadError: a run's log is missing or damaged.
    """
    found = []
    for run, result in comparison.runs:
        training = load_result(get_training_folder(comparison.out, run))
        assert result.solution is not None, "these grids have a rule for what is solved"
        measured: dict[str, Any] = {
            "agent": run.agent.label, "run": run.seed, "room": run.place_id,
            "best": float(np.mean(result.score_range.reachable)), "worst": result.score_range.worst,
            "budget": comparison.grid.primitives, "primitives": result.primitives, "decisions": result.decisions,
            "seconds": round(training.seconds, 1), "first_escape": training.first_escape, **vars(result.solution),
        }  # fmt: skip
        found += [ScalingRun(*task, **measured, depth=_measure_depth(room)) for task, room in rooms.items()
                  if room.id == run.place_id]
    return found


def _measure_depth(room: RoomInstance) -> int:
    graph = get_mixin(room.puzzle, Graphed)
    return compute_edge_depth(find_edges_that_matter(graph.edges, graph.goal_targets), graph.goal_targets)


def compute_edge_depth(edges: Iterable[tuple[int, int]], goals: Iterable[int]) -> int:
    """Most edges in a row that lead to a goal; edges are (parent, child) pairs without cycles."""
    every, level, depth = set(edges), set(goals), 0
    while level := {parent for parent, child in every if child in level}:
        depth += 1
    return depth
