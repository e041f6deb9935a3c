"""Eigenoptions: options along the slow directions of the state graph, computed without any reward.

Machado, Bellemare and Bowling (2017), and with the successor representation Machado et al. (2018). Q-learning explores
with one option to each end of each of the slowest directions of a random walk over the visited states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.discovery import (
    NOTHING,
    DiscoveringAgent,
    GraphDiscovery,
    StateModel,
    TableSkill,
    compute_successor_representation,
    find_slow_directions,
    find_slow_directions_of_successors,
    make_eigenoption,
)
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class EigenoptionsSettings(AgentSettings):
    """Settings of `eigenoptions`: number of directions, and their source."""

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
    option_share: Annotated[float, Range(0, 1)] = 0.2
    """Share of exploratory choices that begin an option, if one can begin; the others are primitives."""
    discover_every: Annotated[int, Range(1)] = 1_000
    """Decisions between updates of all options. Fewer follow the data more closely and take longer."""
    most_states: Annotated[int, Range(2)] = 1_000
    """Number of states above which options are no longer updated, because eigenvectors take cubic time."""
    directions: Annotated[int, Range(1)] = 8
    """Number of slow directions, with two options each: one in each direction. More reach more parts of the graph."""
    representation: Literal["random-walk", "normalised", "combinatorial", "successor"] = "random-walk"
    """Source of the directions: a Laplacian of the symmetrised state graph, or the successor representation of the
    uniform random walk over observed transitions."""
    option_gamma: Annotated[float, Range(0, 1, open_high=True)] = 0.9
    """Discount of an option's own reward, and of the successor representation. Higher values make options longer."""


class EigenoptionDiscovery(GraphDiscovery):
    """Computes the slow directions of all connected states."""

    def __init__(self, settings: EigenoptionsSettings) -> None:
        super().__init__(settings, 2 * settings.directions)
        self._settings = settings

    def find(self, model: StateModel, adjacency: NDArray[np.float64], states: NDArray[np.int64]
             ) -> dict[int, TableSkill]:
        """Return both options of each direction, the slowest first."""
        settings = self._settings
        count = min(settings.directions, len(states) - 1)
        if settings.representation == "successor":
            walk = _make_uniform_walk(model)[np.ix_(states, states)]
            successors = compute_successor_representation(walk, settings.option_gamma)
            directions = find_slow_directions_of_successors(successors, count)
        else:
            directions = find_slow_directions(adjacency, count, settings.representation)
        everything = len(model.known)
        found = {}
        for number, vector in enumerate(directions.vectors.T):
            purpose = np.zeros(everything)
            purpose[states] = vector
            for half, sign in enumerate((1.0, -1.0)):
                name = f"direction-{number + 1}{'+-'[half]}"
                skill = make_eigenoption(name, model, sign * purpose, settings.option_gamma)
                actions = np.where(np.isin(np.arange(everything), states), skill.actions, NOTHING)
                found[2 * number + half] = TableSkill(name, actions, actions != NOTHING)
        return found


def _make_uniform_walk(model: StateModel) -> NDArray[np.float64]:
    """P of the uniform random walk over known actions, (states, states); states without any action stay."""
    states, actions = model.known.shape
    total = model.follow.toarray().reshape(states, actions, states).sum(axis=1)
    known = model.known.sum(axis=1)[:, None]
    return np.where(known > 0, total / np.maximum(known, 1), np.eye(states))


class Eigenoptions(DiscoveringAgent):
    """Q-learning that explores with options along the eigenvectors e of the slowest random walk.

    The reward of an option is e(s') - e(s), and the option is optimal for it at `option_gamma`, with an additional
    action to end, worth 0. It ends where no more reward is possible, and can begin everywhere else.
    """

    settings: EigenoptionsSettings
    Discovery = EigenoptionDiscovery
