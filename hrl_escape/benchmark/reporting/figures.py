"""Figures of a comparison as reproducible SVG files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.rung_references import RungReferences
from hrl_escape.benchmark.summary import AgentSummary, Summary, summarise
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.maps import make_map
from hrl_escape.figures import STYLE, get_figure_class, save_figure
from hrl_escape.sets.manifest import AxisRecord

GREYS = ("#8b8f98", "#5a5e67", "#b3b7bd")
"""Greys, for agents without training."""
SPARE = ("#882255", "#999933", "#332288", "#44aa99", "#661100", "#117733")
"""Colours of Tol (2021), after the six of `palette.LINES`."""


class AgentStyle(NamedTuple):
    """Colour of an agent's line, darker colour of its name, and whether the line is dashed."""

    colour: str
    text: str
    is_dashed: bool


def choose_styles(specs: Sequence[AgentSpec]) -> list[AgentStyle]:
    """Choose colours; flat and hierarchical forms of an algorithm share one."""
    colours: dict[tuple[str, str], str] = {}
    found: list[AgentStyle] = []
    for spec in specs:
        key, is_dashed = (spec.algorithm, spec.recipe), not spec.chooses_options
        colour = colours.get(key, "")
        if not colour or (colour, is_dashed) in [(look.colour, look.is_dashed) for look in found]:
            used = [*colours.values(), *(look.colour for look in found)]
            colour = min(GREYS if not spec.learns else (*palette.LINES, *SPARE), key=used.count)
            colours.setdefault(key, colour)
        found.append(AgentStyle(colour, _darken(colour), is_dashed))
    return found


def is_level(agent: AgentSummary) -> bool:
    """Return whether an agent does not learn and is drawn as a thin level line without a band."""
    return not agent.spec.learns and not (agent.spec.is_reference and agent.is_trained)


def _darken(colour: str) -> str:
    mixed = [round(255 * (0.72 * part + 0.28 * ink)) for part, ink in
             zip(palette.to_rgb(colour), palette.to_rgb(palette.INK), strict=True)]
    return "#{:02x}{:02x}{:02x}".format(*mixed)


AXES = {"primitives": "primitives of training", "decisions": "decisions of training", "seconds": "seconds of training"}
METRIC_LABELS = {"efficiency": "efficiency (IQM, 95 % interval)", "success": "episodes that escape",
                 "score": "return score (IQM, 95 % interval)"}
"""Metrics that are drawn in rooms, with the labels of their axes."""
ENV_LABELS = {"return": "return (mean, 95 % t interval)", "success": "episodes that succeed",
              "length": "primitives an episode"}
"""The same in an environment from elsewhere."""
_STYLE: dict[Any, Any] = {"font.family": "DejaVu Sans", "font.size": 9, "svg.hashsalt": "hrl-escape"}


def save_figures(summary: Summary, folder: Path) -> None:
    """Write learning curves, the performance profile and the rooms' maps."""
    with matplotlib.rc_context(_STYLE):
        for metric in list_metrics(summary):
            for against in AXES:
                save_figure(folder / f"{metric}-against-{against}.svg", draw_curves(summary, metric, against))
        save_figure(folder / "performance-profile.svg", draw_profile(summary))
    for room in summary.rooms if summary.grid.env is None else ():
        save_figure(folder / f"room-{room.instance.id}.svg", make_map(room.instance))


def list_metrics(summary: Summary) -> dict[str, str]:
    """Return the metrics that are drawn, with the labels of their axes; the measure of the comparison comes first."""
    return select_metrics(summary, METRIC_LABELS if summary.grid.env is None else ENV_LABELS)


def select_metrics(summary: Summary, words: Mapping[str, str]) -> dict[str, str]:
    """Return the words of the metrics that the curves have, the measure of the comparison first."""
    known = [name for name in words if name in summary.agents[0].curve.metrics]
    return {name: words[name] for name in sorted(known, key=lambda name: name != summary.measure.curve)}


def draw_comparison(comparison: Comparison) -> Figure:
    """Draw the measure of a comparison against primitives for all agents."""
    return draw_summary(summarise(comparison))


def draw_summary(summary: Summary) -> Figure:
    """Draw the measure of a comparison against primitives for all agents."""
    return draw_styled(summary, summary.measure.curve, "primitives")


def draw_styled(summary: Summary, metric: str, against: str) -> Figure:
    """Draw learning curves with the style of reports."""
    with matplotlib.rc_context(_STYLE):
        return draw_curves(summary, metric, against)


def draw_curves(summary: Summary, metric: str, against: str) -> Figure:
    """Draw learning curves over all rooms, or in an environment with its reference return."""
    figure, axes = _make_axes(AXES[against], list_metrics(summary)[metric])
    for agent, look in zip(summary.agents, choose_styles([a.spec for a in summary.agents]), strict=True):
        x = getattr(agent.curve, against)
        middle, low, high = agent.curve.metrics[metric]
        if not is_level(agent):
            axes.fill_between(x, low, high, color=look.colour, alpha=0.14, linewidth=0)
        axes.plot(x, middle, color=look.colour, linestyle="--" if look.is_dashed else "-", label=agent.spec.title,
                  linewidth=0.9 if is_level(agent) else 1.8)
    if metric == "return" and summary.grid.env is not None and summary.grid.env.reference is not None:
        axes.axhline(summary.grid.env.reference, color=palette.MUTED, linewidth=0.9, linestyle=":", label="reference")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    _finish(axes)
    return figure


def draw_profile(summary: Summary) -> Figure:
    """Draw the share of runs above each value of the measure."""
    figure, axes = _make_axes(summary.measure.name, "share of runs above")
    for agent, look in zip(summary.agents, choose_styles([a.spec for a in summary.agents]), strict=True):
        axes.step(summary.thresholds, agent.profile, where="post", color=look.colour, linewidth=1.8,
                  linestyle="--" if look.is_dashed else "-", label=agent.spec.title)
    axes.set_ylim(-0.02, 1.04)
    _finish(axes)
    return figure


def _make_axes(x: str, y: str) -> tuple[Figure, Axes]:
    figure = get_figure_class()(figsize=(7.2, 3.6), facecolor=palette.BACKGROUND, layout="constrained")
    axes = figure.add_subplot()
    axes.set_xlabel(x, color=palette.INK)
    axes.set_ylabel(y, color=palette.INK)
    return figure, axes


def _finish(axes: Axes) -> None:
    axes.grid(axis="y", color="#e5dfd2", linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.tick_params(colors=palette.MUTED, labelcolor=palette.INK)
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)


# --- profiles: efficiency by ability, on benchmarks that have axes in place of one order of rungs ------

REFERENCE_NAMES = "random policy", "best search baseline", "Bayes planner"


class AxisScore(NamedTuple):
    """Result of one agent on one axis."""

    levels: tuple[float | None, ...]  # efficiency on each rung, from easy to hard, or None for rungs without runs

    @property
    def value(self) -> float | None:
        """Mean over the rungs, or None unless all have runs."""
        known = [level for level in self.levels if level is not None]
        return float(np.mean(known)) if known and len(known) == len(self.levels) else None

    def __str__(self) -> str:
        levels = " ".join("-" if level is None else f"{level:.2f}" for level in self.levels)
        return f"{'' if self.value is None else f'{self.value:.2f}'} ({levels})".strip()


def make_profiles(axes: Sequence[AxisRecord], efficiencies: Mapping[str, Mapping[str, float]]
                  ) -> dict[str, dict[str, AxisScore]]:
    """Make the profile of each agent, axis -> score, from its efficiencies by rung."""
    return {agent: {axis.name: AxisScore(tuple(map(known.get, axis.rungs))) for axis in axes
                    if any(rung in known for rung in axis.rungs)} for agent, known in efficiencies.items()}


def list_references(references: Mapping[str, RungReferences]) -> dict[str, dict[str, float]]:
    """Return the efficiencies of random policy, best search baseline and Bayes planner, by rung."""
    columns = [{rung: value for rung, own in references.items() if (value := getattr(own, name)) is not None}
               for name in ("random", "search", "bayes")]
    return dict(zip(REFERENCE_NAMES, columns, strict=True)) if references else {}


def draw_radar(profiles: Mapping[str, Mapping[str, AxisScore]], axes: Sequence[AxisRecord]) -> Figure:
    """Draw a radar chart of profiles: a spoke for each axis, a closed line for each agent, references in grey.

    Lines are interrupted at axes without runs.
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
        panel.set(ylim=(0, 1), yticks=(0.25, 0.5, 0.75, 1.0), theta_direction=-1, theta_offset=math.pi / 2,
                  rlabel_position=180.0 / len(names))  # between two spokes
        panel.set_xticks(angles, names, color=palette.INK)
        panel.tick_params(axis="x", pad=9)
        panel.tick_params(axis="y", labelcolor=palette.MUTED, labelsize=7)
        panel.grid(color="#e5dfd2", linewidth=0.8)
        panel.spines["polar"].set_color("#e5dfd2")
        panel.legend(loc="center left", bbox_to_anchor=(1.15, 0.5), frameon=False)
    return figure
