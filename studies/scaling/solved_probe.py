"""Probe of the scaling study: ends a run once its agent has solved the room.

A room is solved when the frozen policy is near the best return twice in a row and the believed graph is the true one.
The probe records when that happened, and precision and recall of the believed graph over training.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.state import Kept, Stateful
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.agents.training.results import EpisodeRecord
from hrl_escape.benchmark.score_range import ScoreRange
from hrl_escape.benchmark.statistics import compute_score
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.graphs import EdgeSet, find_edges_that_matter, find_target_edges
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin

__all__ = ["SolvedProbe", "compare_graphs"]

CHECK_EVERY = 500
"""Primitives between checks of one episode each, from the first escape on."""
GRAPH_EVERY = 100
"""Primitives between comparisons of the graph."""


class SolvedProbe(Stateful):
    """Measures whether an agent has solved its room. For a random agent that is its first escape.

    Args:
        least: score near the best, from no escape (0) to the best return of the agent's actions (1).
        env: environment where the policy is checked, between training episodes.
        instance: its room.
        spec: of the agent.
        score_range: of the room for this agent.

    Attributes:
        near_best: primitives at the first of two checks in a row near the best; None without such a pair.
        structure: (primitives, precision, recall) at every change; empty for agents without a graph.
        edges: number of edges that matter in the room's graph.
    """

    STATE = ("_has_escaped", Kept("structure", pack=lambda steps: list(map(list, steps)),
                                  unpack=lambda saved: [(int(at), *found) for at, *found in saved]),
             "near_best", "_candidate", "_next_check", "_next_graph")

    def __init__(self, least: float, env: gymnasium.Env, instance: RoomInstance, spec: AgentSpec,
                 score_range: ScoreRange) -> None:
        graph = get_mixin(instance.puzzle, Graphed)
        self._least, self._env, self._range, self._goals = least, env, score_range, graph.goal_targets
        self._learns = spec.algorithm != "random"
        self._true = find_edges_that_matter(graph.edges, self._goals)
        room: Any = env.unwrapped
        self.edges, self._places = len(self._true), room.observer.light_places
        self._has_escaped = False
        self.structure: list[tuple[int, float, float]] = []
        self.near_best: int | None = None
        self._candidate: int | None = None
        self._next_check = self._next_graph = 0

    @property
    def identity(self) -> dict[str, Any]:
        """The rule, as a JSON value."""
        return {"until_solved": {"score": self._least, "check_every": CHECK_EVERY, "graph_every": GRAPH_EVERY}}

    @property
    def is_done(self) -> bool:
        """The room is solved."""
        if not self._learns:
            return self._has_escaped
        is_graph_known = not self.structure or self.structure[-1][1:] == (1.0, 1.0)
        return self.near_best is not None and is_graph_known

    def after_decision(self, agent: Agent, primitives: int) -> None:
        """Compare the believed graph with the true one, every so often."""
        if primitives < self._next_graph or (graph := agent.get_graph()) is None:
            return
        self._next_graph = primitives + GRAPH_EVERY
        believed = find_edges_that_matter(find_target_edges(graph, self._places), self._goals)
        precision, recall = compare_graphs(believed, self._true)
        now = round(precision, 4), round(recall, 4)
        if not self.structure or self.structure[-1][1:] != now:
            self.structure.append((primitives, *now))

    def after_episode(self, agent: Agent, episode: EpisodeRecord) -> None:
        """Check the frozen policy, every so often, from the first escape until it is near the best."""
        self._has_escaped = self._has_escaped or bool(episode.success)
        at = episode.primitives
        if not self._learns or not self._has_escaped or self.near_best is not None or at < self._next_check:
            return
        self._next_check = at + CHECK_EVERY
        found = evaluate(agent, self._env, episodes=1).mean_return
        if compute_score(found, self._range.worst, np.mean(self._range.reachable)) < self._least:
            self._candidate = None
        elif self._candidate is None:
            self._candidate = at
        else:
            self.near_best = self._candidate


def compare_graphs(found: EdgeSet, true: EdgeSet) -> tuple[float, float]:
    """Precision (1 where nothing was found and nothing is there, else 0) and recall of edges."""
    hits = len(found & true)
    return hits / len(found) if found else float(not true), hits / len(true) if true else 1.0
