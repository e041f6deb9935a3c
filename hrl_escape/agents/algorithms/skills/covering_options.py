"""Covering options: edges that bring the two ends of the slowest walk together, one after another.

Jinnai, Park, Abel and Konidaris (2019). Each option leads from one end of the slowest direction of the state graph to
the other; with it as an edge the graph is better connected, and the next is found. Q-learning explores with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.discovery import (
    DiscoveringAgent,
    GraphDiscovery,
    StateModel,
    TableSkill,
    find_covering_edge,
    make_point_option,
)
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class CoveringOptionsSettings(AgentSettings):
    """Edges that `covering-options` adds, and the share of exploration that runs their options."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive; per decision if `discounting` is `decision`."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive`: an action of k primitives is worth sum gamma^i r_i and discounts by gamma^k. `decision`: it is
    worth the plain sum and discounts by gamma, as if it were one step, as the paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the state in which an episode was truncated; otherwise truncation counts as termination, as in
    the paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit in which warm-up, update and exploration schedules count. With primitives, flat and option-level agents do
    the same work on the same experience."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Steps of the clock over which epsilon falls linearly."""
    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy`: uniform over legal actions with probability epsilon, else greedy. `boltzmann`: probability
    proportional to exp(q / temperature)."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as keras-rl 0.4.2 has it: values beyond it are equally
    likely. 0 sets no bound."""
    bins: Annotated[int, Range(2)] = 11
    """A component with bounds low, high is rounded to the nearest of this many evenly spaced points, both ends
    included: 11 over a 20 m room is 2 m; a bit stays a bit."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """A component without bounds is rounded to multiples of this, in its own unit."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size alpha at a state and action's first update; 1 suits deterministic environments."""
    learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """The n-th update of a state and action uses learning_rate / n^power; above 0.5 converges under noise."""
    initial_value: float = 0.0
    """Value of actions that were never tried, in units of return."""
    use: Literal["explore", "choose"] = "explore"
    """`explore`: options are run in exploration alone, and the policy is over primitives. `choose`: they are choices
    beside the primitives, valued by intra-option Q-learning."""
    option_share: Annotated[float, Range(0, 1)] = 1.0
    """Share of exploratory choices that begin an option where one may begin, which is in a few states only."""
    discover_every: Annotated[int, Range(1)] = 1_000
    """Decisions after which all options are found anew."""
    most_states: Annotated[int, Range(2)] = 1_000
    """States beyond which none are found anew: eigenvectors take time in their cube."""
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
