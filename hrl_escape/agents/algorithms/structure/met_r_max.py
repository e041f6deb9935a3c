"""Met-R-MAX: factored R-MAX whose sets of parents are judged by a statistical test, so that actions may fail.

Diuk, Li and Leffler (2009), The adaptive k-meteorologists problem. Exploration and plans are those of `factored-r-max`;
a set of parents is dropped when another has forecast better by more than chance allows, not at its first miss.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.factored.meteorologists import Meteorologists
from hrl_escape.agents.factored.optimistic_planner import OptimisticPlanner, OptimisticSettings
from hrl_escape.settings import Range

__all__ = ["MetRMax", "MetRMaxSettings"]


@dataclass(frozen=True)
class MetRMaxSettings(OptimisticSettings):
    """Settings of `met-r-max`."""

    visits: Annotated[int, Range(1)] = 3
    """Samples that make a context known, and its forecasts count."""
    delta: Annotated[float, Range(0, 1, open_low=True, open_high=True)] = 0.05
    """Error probability of one comparison between two sets of parents."""
    least_share: Annotated[float, Range(0, 0.5, open_low=True)] = 0.25
    """Share of the samples of a context from which on a change is what the action does there."""


class MetRMax(OptimisticPlanner):
    """Believes every set of parents that none has beaten, and looks where two of them differ."""

    name: ClassVar[str] = "met-r-max"
    Settings: ClassVar[type] = MetRMaxSettings
    settings: MetRMaxSettings

    def make_learner(
        self, sizes: NDArray[np.int64], actions: int, max_parents: int, all_on: bool
    ) -> Meteorologists:
        """One forecaster a set of parents."""
        settings = self.settings
        return Meteorologists(sizes, actions, max_parents, all_on, settings.visits, settings.delta,
                              settings.least_share)
