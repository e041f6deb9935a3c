"""Divisions of the state space: landmarks with their regions, and trees of cells within cells.

HDG walks from landmark to landmark; feudal learning commands from cell to cell. What a state is, a
user says by a function of the observation.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

from hrl_escape.errors import AgentSettingsError

__all__ = ["Landmarks"]


@dataclass(frozen=True)
class Landmarks:
    """States that stand for the region around them.

    Attributes:
        states: the landmarks' states.
        region: state -> number of the landmark whose region it lies in.
        state: observation -> state; the observation itself by default.
    """

    states: tuple[Hashable, ...]
    region: Callable[[Hashable], int]
    state: Callable[[Any], Hashable] = int

    def __post_init__(self) -> None:
        for number, state in enumerate(self.states):
            if self.region(state) != number:
                raise AgentSettingsError("Landmarks.region", state, f"{number}, its own region, for landmark {number}")
