"""Eigenoptions: options along the slow directions of the state graph, found without any reward.

Machado, Bellemare and Bowling (2017); from the successor representation by Machado et al. (2018). Q-learning explores
with them: an option to each end of each of the slowest directions of a random walk over the states met so far.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.discovery import (
    NOTHING,
    DiscoveringAgent,
    GraphDiscovery,
    GraphDiscoverySettings,
    StateModel,
    TableSkill,
    compute_successor_representation,
    find_slow_directions,
    find_slow_directions_of_successors,
    make_eigenoption,
)
from hrl_escape.settings import Range


@dataclass(frozen=True)
class EigenoptionsSettings(GraphDiscoverySettings):
    """Directions that `eigenoptions` follows, and where they come from."""

    directions: Annotated[int, Range(1)] = 8
    """Slow directions that have options, two each: one along it, one against it."""
    representation: Literal["random-walk", "normalised", "combinatorial", "successor"] = "random-walk"
    """Source of the directions: a Laplacian of the graph of states, made symmetric, or the successor representation
    of the uniform walk over the actions as they were seen to go."""
    option_gamma: Annotated[float, Range(0, 1, open_high=True)] = 0.9
    """Discount of an option's own reward, and of the successor representation."""


class EigenoptionDiscovery(GraphDiscovery):
    """Finds the slow directions of all states that are connected."""

    def __init__(self, settings: EigenoptionsSettings) -> None:
        super().__init__(settings, 2 * settings.directions)
        self._settings = settings

    def find(self, model: StateModel, adjacency: NDArray[np.float64], states: NDArray[np.int64]
             ) -> dict[int, TableSkill]:
        """Both options of each direction, the slowest first."""
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
    """P of the uniform walk over known actions, (states, states); a state without any stays."""
    states, actions = model.known.shape
    total = model.follow.toarray().reshape(states, actions, states).sum(axis=1)
    known = model.known.sum(axis=1)[:, None]
    return np.where(known > 0, total / np.maximum(known, 1), np.eye(states))


class Eigenoptions(DiscoveringAgent):
    """Q-learning that explores with options along the eigenvectors e of the slowest walk.

    An option is paid e(s') - e(s) and is optimal for it at `option_gamma`, with one further action, to end, worth 0. It
    ends where nothing more can be earned, and may begin everywhere else.
    """

    settings: EigenoptionsSettings
    Discovery = EigenoptionDiscovery
