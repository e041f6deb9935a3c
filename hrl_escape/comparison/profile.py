"""Profiles: efficiency by ability, on benchmarks that have axes in place of one order of rungs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from hrl_escape.comparison.reporting.figures import GREYS
from hrl_escape.env.drawing import palette
from hrl_escape.figures import STYLE
from hrl_escape.ladder.manifest import AxisRecord, RungReferences

REFERENCE_NAMES = "chance", "best searcher", "smdp-bayes"


class AxisScore(NamedTuple):
    """Result of one agent on one axis."""

    levels: tuple[float | None, ...]  # efficiency on each rung, from easy to hard; None on rungs that it was not run on

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


def draw_radar(profiles: Mapping[str, Mapping[str, AxisScore]], axes: Sequence[AxisRecord]) -> Figure:
    """Radar of profiles, a spoke an axis and a closed line an agent, broken at axes that it was not run on.

    Args:
        profiles: of each agent, by its name in the legend; references are grey.
        axes: of the benchmark.
    """
    names = [axis.name for axis in axes]
    angles = np.linspace(0, 2 * math.pi, len(names), endpoint=False)
    colours, shades = iter(palette.LINES * 3), iter(GREYS)
    with matplotlib.rc_context({**STYLE, "font.size": 9}):
        figure = Figure(figsize=(7.2, 4.8), facecolor=palette.BACKGROUND, layout="constrained")
        panel = figure.add_subplot(projection="polar")
        for agent, profile in profiles.items():
            values = [math.nan if (score := profile.get(name)) is None or score.value is None else score.value
                      for name in names]
            is_grey = agent in REFERENCE_NAMES
            colour = next(shades if is_grey else colours)
            panel.plot([*angles, angles[0]], [*values, values[0]], color=colour, label=agent, marker="o",
                       linewidth=1.0 if is_grey else 1.8, markersize=3 if is_grey else 4)
        panel.set(ylim=(0, 1), yticks=(0.25, 0.5, 0.75, 1.0), theta_direction=-1, theta_offset=math.pi / 2)
        panel.set_xticks(angles, names, color=palette.INK)
        panel.tick_params(axis="y", labelcolor=palette.MUTED, labelsize=7)
        panel.grid(color="#e5dfd2", linewidth=0.8)
        panel.spines["polar"].set_color("#e5dfd2")
        panel.legend(loc="center left", bbox_to_anchor=(1.15, 0.5), frameon=False)
    return figure
