"""Covering options: edges that bring the two ends of the slowest walk together, one after another.

Jinnai, Park, Abel and Konidaris (2019). Each option leads from one end of the slowest direction of the state graph to
the other; with it as an edge the graph is better connected, and the next is found. Q-learning explores with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.discovery import (
    DiscoveringAgent,
    GraphDiscovery,
    GraphDiscoverySettings,
    StateModel,
    TableSkill,
    find_covering_edge,
    make_point_option,
)
from hrl_escape.settings import Range


@dataclass(frozen=True)
class CoveringOptionsSettings(GraphDiscoverySettings):
    """Edges that `covering-options` adds, and the share of exploration that runs their options."""

    option_share: Annotated[float, Range(0, 1)] = 1.0
    """Share of exploratory choices that begin an option where one may begin, which is in a few states only."""
    edges: Annotated[int, Range(1)] = 4
    """Edges that are added, two options each: there and back."""


class CoveringDiscovery(GraphDiscovery):
    """Finds edges in the graph of all states that are connected."""

    def __init__(self, settings: CoveringOptionsSettings) -> None:
        super().__init__(settings, 2 * settings.edges)
        self._edges = settings.edges

    def find(self, model: StateModel, adjacency: NDArray[np.float64], states: NDArray[np.int64]
             ) -> dict[int, TableSkill]:
        """Both options of each edge, in order; the slowest direction is computed anew after each."""
        joined = adjacency.copy()
        found = {}
        for edge in range(self._edges):
            ends = find_covering_edge(joined)
            joined[ends], joined[ends[::-1]] = 1.0, 1.0
            for half, (start, goal) in enumerate((ends, ends[::-1])):
                found[2 * edge + half] = make_point_option(f"edge-{edge + 1}{'+-'[half]}", model, int(states[start]),
                                                           int(states[goal]))
        return found


class CoveringOptions(DiscoveringAgent):
    """Q-learning that explores with options between the two ends of the slowest walk.

    An option begins in the state of the least value of the slowest eigenvector and ends in that of the greatest, by the
    fewest primitives; its twin goes back. Each pair raises the algebraic connectivity, which bounds the cover time.
    """

    settings: CoveringOptionsSettings
    Discovery = CoveringDiscovery
