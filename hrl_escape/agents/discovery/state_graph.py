"""Graph of the states that an agent has met, and the model of its actions that goes with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from hrl_escape.agents.discovery.found_option import StateModel
from hrl_escape.agents.state import Kept, Stateful, pack_keys, unpack_keys

__all__ = ["StateGraph"]


def _list_edges(counts: dict[tuple[int, int, int], int]) -> NDArray[np.int64]:
    """Before, action, after, count of each, (edges, 4)."""
    return np.array([(*edge, count) for edge, count in counts.items()], np.int64).reshape(-1, 4)


class StateGraph(Stateful):
    """States by number in order of first meeting, and counts of what actions did.

    Args:
        actions: how many there are.
    """

    STATE = (
        Kept("_numbers", "keys", pack_keys, lambda keys: {key: number for number, key in enumerate(unpack_keys(keys))}),
        Kept("_counts", "edges", _list_edges,
             lambda edges: {(int(b), int(a), int(n)): int(count) for b, a, n, count in edges}),
    )

    def __init__(self, actions: int) -> None:
        self.actions = actions
        self._numbers: dict[bytes, int] = {}
        self._counts: dict[tuple[int, int, int], int] = {}

    def __len__(self) -> int:
        return len(self._numbers)

    def find(self, key: bytes) -> int | None:
        """Number of a state; None for one never met."""
        return self._numbers.get(key)

    def number(self, key: bytes) -> int:
        """Number of a state, a new one at the first meeting."""
        return self._numbers.setdefault(key, len(self._numbers))

    def add(self, before: bytes, action: int, after: bytes) -> None:
        """Count one decision, between states by key."""
        edge = self.number(before), action, self.number(after)
        self._counts[edge] = self._counts.get(edge, 0) + 1

    def make_model(self) -> StateModel:
        """Empirical model of the actions."""
        before, action, after, count = _list_edges(self._counts).T
        states, pairs = len(self), before * self.actions + action
        totals = np.bincount(pairs, count, states * self.actions)
        follow = sparse.csr_matrix((count / totals[pairs], (pairs, after)), (states * self.actions, states))
        return StateModel(follow, (totals > 0).reshape(states, self.actions))

    def make_adjacency(self) -> sparse.csr_matrix:
        """1 between different states where some action led from one to the other, either way."""
        before, _, after, _ = _list_edges(self._counts).T
        moves = before != after
        pairs = np.concatenate([np.stack([before, after]), np.stack([after, before])], axis=1)[:, np.tile(moves, 2)]
        edges = sparse.csr_matrix((np.ones(pairs.shape[1]), pairs), (len(self), len(self)))
        edges.data[:] = 1.0
        return edges

    def find_component(self, adjacency: sparse.csr_matrix) -> NDArray[np.int64]:
        """States of the largest connected part, in order."""
        _, parts = csgraph.connected_components(adjacency, directed=False)
        return np.flatnonzero(parts == np.bincount(parts).argmax())
