"""Discovery in the graph of all states met, now and then: the base of those that look for directions or edges in it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.discovery.discovering_agent import Discovery, DiscoverySettings
from hrl_escape.agents.discovery.found_option import StateModel, TableSkill
from hrl_escape.agents.discovery.state_graph import StateGraph
from hrl_escape.settings import Range


@dataclass(frozen=True)
class GraphDiscoverySettings(DiscoverySettings):
    """Discovery in the graph of all states met, at equal distances."""

    discover_every: Annotated[int, Range(1)] = 1_000
    """Decisions after which all options are found anew."""
    most_states: Annotated[int, Range(2)] = 1_000
    """States beyond which none are found anew: eigenvectors take time in their cube."""


class GraphDiscovery(Discovery):
    """Base of discoveries that look at the graph now and then.

    Args:
        settings: say when.
        slots: most options at once.
    """

    STATE = ("_decisions",)

    def __init__(self, settings: GraphDiscoverySettings, slots: int) -> None:
        self._every, self._most_states, self.slots = settings.discover_every, settings.most_states, slots
        self._decisions = 0

    def observe(self, transition: SMDPTransition, before: int, after: int) -> None:
        """Count the decision; the graph holds the rest."""
        self._decisions += 1

    def propose(self, graph: StateGraph) -> Mapping[int, TableSkill]:
        """All options, whenever they are due and some states are connected."""
        if self._decisions % self._every or len(graph) > self._most_states:
            return {}
        adjacency = graph.make_adjacency()
        states = graph.find_component(adjacency)
        if len(states) < 3:
            return {}
        return self.find(graph.make_model(), adjacency[states][:, states].toarray(), states)

    @abstractmethod
    def find(
        self, model: StateModel, adjacency: NDArray[np.float64], states: NDArray[np.int64]
    ) -> Mapping[int, TableSkill]:
        """Find options by slot.

        Args:
            model: of all states.
            adjacency: of the largest connected part, (states, states).
            states: numbers of its states.
        """
