"""Recovery of a puzzle's dependency graph: edges that matter, and precision and recall of a believed graph."""

from __future__ import annotations

from collections.abc import Iterable

from hrl_escape.env.puzzles.graphs import find_ancestors

__all__ = ["EdgeSet", "compare_graphs", "compute_edge_depth", "find_edges_that_matter"]

EdgeSet = frozenset[tuple[int, int]]


def find_edges_that_matter(edges: Iterable[tuple[int, int]], goals: Iterable[int]) -> EdgeSet:
    """EdgeSet that some order of presses towards the goals can tell from none.

    Those are the edges among the ancestors of the goals that no longer way implies: with a before b and b before c,
    an edge from a to c changes nothing, so no agent can find it.

    Args:
        edges: (parent, child) pairs; a believed graph may have cycles.
        goals: targets that solve the puzzle.
    """
    every = set(edges)
    ancestors = find_ancestors(every, goals)
    kept = {(parent, child) for parent, child in every if child in ancestors}

    def is_implied(edge: tuple[int, int]) -> bool:
        reached, frontier = {edge[0]}, [edge[0]]
        while frontier:
            node = frontier.pop()
            for following in (other for other in kept if other[0] == node and other != edge):
                if following[1] not in reached:
                    reached.add(following[1])
                    frontier.append(following[1])
        return edge[1] in reached

    return frozenset(edge for edge in kept if not is_implied(edge))


def compute_edge_depth(edges: Iterable[tuple[int, int]], goals: Iterable[int]) -> int:
    """Most edges in a row that lead to a goal; edges are (parent, child) pairs without cycles."""
    every, level, depth = set(edges), set(goals), 0
    while level := {parent for parent, child in every if child in level}:
        depth += 1
    return depth


def compare_graphs(found: EdgeSet, true: EdgeSet) -> tuple[float, float]:
    """Precision (1 where nothing was found and nothing is there, else 0) and recall of edges."""
    hits = len(found & true)
    return hits / len(found) if found else float(not true), hits / len(true) if true else 1.0
