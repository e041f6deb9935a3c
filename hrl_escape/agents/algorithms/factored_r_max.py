"""Factored R-MAX with structure learning: explore outcomes that the hypotheses leave open, then exploit.

SLF-R-MAX of Strehl, Diuk and Littman (2007), for semi-Markov decisions, with the priors of `structure.py`. As in R-MAX
(Brafman and Tennenholtz 2002) the unknown is worth more than anything known, here without bound: the agent goes to the
soonest open outcome while one is in reach, then to the best known end of the task. Plans come from forward search
(`search.py`), so states are never enumerated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hrl_escape.agents.factored.optimistic_planner import OptimisticPlanner, OptimisticSettings

__all__ = ["FactoredRMax", "FactoredRMaxSettings"]


@dataclass(frozen=True)
class FactoredRMaxSettings(OptimisticSettings):
    """Settings of `factored-r-max`."""


class FactoredRMax(OptimisticPlanner):
    """Believes every set of parents that leaves the fewest samples unexplained, and looks where two of them differ."""

    name: ClassVar[str] = "factored-r-max"
    Settings: ClassVar[type] = FactoredRMaxSettings
    settings: FactoredRMaxSettings
