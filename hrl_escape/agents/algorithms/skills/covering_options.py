"""Covering options: edges that connect the two ends of the slowest random walk, one after another.

Jinnai, Park, Abel and Konidaris (2019). Each option leads from one end of the slowest direction of the state graph to
the other. With it as an edge the graph is better connected, and the next one is computed. Q-learning explores with
them.
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
    """Settings of `covering-options`: number of edges, and share of exploration with their options."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive, or per decision if `discounting` is `decision`. Higher values look further ahead and
    learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma, as the
    paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination, as in the
    paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy` draws evenly with probability epsilon. `boltzmann` draws by exp(q / temperature)."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return. More explores more."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as in keras-rl 0.4.2; values beyond it are equally likely. 0
    sets none."""
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of the first update of a state and action. 1 suits deterministic environments; smaller values average
    noise."""
    learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """Power p in the step size learning_rate / n^p of the n-th update of a state and action. Values above 0.5 converge
    under noise."""
    initial_value: float = 0.0
    """Value of actions that were never tried, in units of return. Higher values explore more."""
    use: Literal["explore", "choose"] = "explore"
    """`explore`: options run in exploration only, and the policy is over primitives. `choose`: the policy chooses among
    primitives and options, valued by intra-option Q-learning."""
    option_share: Annotated[float, Range(0, 1)] = 1.0
    """Share of exploratory choices that begin an option, if one can begin, which few states allow."""
    discover_every: Annotated[int, Range(1)] = 1_000
    """Decisions between updates of all options. Fewer follow the data more closely and take longer."""
    most_states: Annotated[int, Range(2)] = 1_000
    """Number of states above which options are no longer updated, because eigenvectors take cubic time."""
    edges: Annotated[int, Range(1)] = 4
    """Number of added edges, with two options each: there and back."""


class CoveringDiscovery(GraphDiscovery):
    """Computes edges in the graph of all connected states."""

    def __init__(self, settings: CoveringOptionsSettings) -> None:
        super().__init__(settings, 2 * settings.edges)
        self._edges = settings.edges

    def find(self, model: StateModel, adjacency: NDArray[np.float64], states: NDArray[np.int64]
             ) -> dict[int, TableSkill]:
        """Return both options of each edge, in order; each edge changes the slowest direction for the next."""
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
    """Q-learning that explores with options between the two ends of the slowest random walk.

    An option begins in the state with the smallest value of the slowest eigenvector and ends in the state with the
    largest, by the fewest primitives; a second option leads back. Each pair raises the algebraic connectivity, which
    bounds the cover time.
    """

    settings: CoveringOptionsSettings
    Discovery = CoveringDiscovery
