"""Profiles: efficiency by ability, on benchmarks that have axes in place of one order of rungs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hrl_escape.ladder.manifest import AxisRecord
from hrl_escape.ladder.references import RungReferences

REFERENCE_NAMES = "chance", "best searcher", "smdp-bayes"


class AxisScore(NamedTuple):
    """Result of one agent on one axis.

    Attributes:
        levels: efficiency on each rung, from easy to hard; None on rungs that it was not run on.
    """

    levels: tuple[float | None, ...]

    @property
    def value(self) -> float | None:
        """Mean over the rungs; None unless it was run on all of them."""
        known = [level for level in self.levels if level is not None]
        return float(np.mean(known)) if known and len(known) == len(self.levels) else None

    def __str__(self) -> str:
        levels = " ".join("-" if level is None else f"{level:.2f}" for level in self.levels)
        return f"{'' if self.value is None else f'{self.value:.2f}'} ({levels})".strip()


def make_profiles(axes: Sequence[AxisRecord], efficiencies: Mapping[str, Mapping[str, float]]
                  ) -> dict[str, dict[str, AxisScore]]:
    """Profile of each agent: axis -> score; axes on no rung of which it was run are left out.

    Args:
        axes: of the benchmark.
        efficiencies: agent -> rung -> efficiency.
    """
    return {agent: {axis.name: AxisScore(tuple(map(known.get, axis.rungs))) for axis in axes
                    if any(rung in known for rung in axis.rungs)} for agent, known in efficiencies.items()}


def list_references(references: Mapping[str, RungReferences]) -> dict[str, dict[str, float]]:
    """Efficiencies of chance, of the best searcher that learns nothing, and of `smdp-bayes`, by rung."""
    columns = [{rung: value for rung, own in references.items() if (value := getattr(own, name)) is not None}
               for name in ("chance", "searcher", "ceiling")]
    return dict(zip(REFERENCE_NAMES, columns, strict=True)) if references else {}
