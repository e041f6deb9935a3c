"""The paper's figures, drawn from raw results: return against training, the paper's recipe beside the corrected one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from hrl_escape.comparison.inference import compute_interval
from hrl_escape.comparison.reporting.agent_style import GREYS
from hrl_escape.comparison.statistics import Floats, compute_iqm
from hrl_escape.comparison.studies.raw import RawRun
from hrl_escape.env.drawing import palette

__all__ = ["FIGURE_STYLE", "draw_figure", "finish_axes"]

FIGURE_STYLE: dict[Any, Any] = {"font.family": "DejaVu Sans", "font.size": 9, "svg.hashsalt": "hrl-escape"}
_COLOURS = {"dqn": palette.LINES[0], "sarsa": palette.LINES[1], "ddpg": palette.LINES[2], "random": GREYS[0]}
POINTS = 41


def draw_figure(runs: Sequence[RawRun]) -> Figure:
    """One panel a recipe: frozen weights in full lines with intervals, training episodes in dots, chance in grey."""
    labels = list(dict.fromkeys(run.agent for run in runs if _get_algorithm(run.agent) in _COLOURS))
    recipes = [recipe for recipe in ("paper", "corrected") if any(_get_recipe(label) == recipe for label in labels)]
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(4.4 * len(recipes) + 0.6, 3.3), facecolor=palette.BACKGROUND, layout="constrained")
        panels = figure.subplots(1, len(recipes), sharey=True, squeeze=False)[0]
        for axes, recipe in zip(panels, recipes, strict=True):
            for label in labels:
                if _get_recipe(label) in (recipe, "none"):
                    _draw_agent(axes, [run for run in runs if run.agent == label], _get_algorithm(label))
            axes.set_title(f"recipe {recipe}", fontsize=9, color=palette.INK, loc="left")
            axes.set_xlabel(f"{runs[0].axis} of training", color=palette.INK)
            axes.set_ylim(-4, 104)
            finish_axes(axes)
        panels[0].set_ylabel("return, % from -1,000 to best known", color=palette.INK)
        panels[-1].plot([], [], ":", color=palette.MUTED, linewidth=1.2, label="training\nepisodes")
        shown = {label: handle for axes in panels
                 for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        panels[-1].legend(list(shown.values()), list(shown), loc="center left", bbox_to_anchor=(1.01, 0.5),
                          frameon=False)
    return figure


def _get_algorithm(label: str) -> str:
    return label.removeprefix("smdp-").partition("@")[0]


def _get_recipe(label: str) -> str:
    if _get_algorithm(label) == "random":
        return "none"
    return label.partition("@")[2] or "corrected"


def _draw_agent(axes: Axes, runs: Sequence[RawRun], algorithm: str) -> None:
    budget, colour = runs[0].budget, _COLOURS[algorithm]
    grid = np.linspace(0, budget, POINTS)
    training = np.stack([run.training_scores for run in runs])
    seen = np.isfinite(training).any(axis=0)
    middle: Floats = np.full(training.shape[1], np.nan)
    middle[seen] = np.nanmean(training[:, seen], axis=0)
    if algorithm == "random":
        axes.axhline(100 * float(np.nanmean(training)), color=colour, linestyle="--", linewidth=1.4, label="random")
        return
    axes.plot(runs[0].training_at, 100 * middle, ":", color=colour, linewidth=1.2)
    curves = [np.stack([np.interp(grid, run.at, run.scores) for run in runs], axis=-1)]
    bounds = (min(0.0, float(curves[0].min())), max(1.0, float(curves[0].max())))
    low, high = compute_interval(compute_iqm, curves, bounds, np.random.default_rng(2019), 1_000)
    axes.fill_between(grid, 100 * low, 100 * high, color=colour, alpha=0.14, linewidth=0)
    axes.plot(grid, 100 * compute_iqm(curves), color=colour, linewidth=1.8, label=algorithm)


def finish_axes(axes: Axes) -> None:
    """Thousands on the x-axis, a light grid, no box."""
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True, steps=[1, 2, 5, 10]))
    axes.grid(axis="y", color="#e5dfd2", linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.tick_params(colors=palette.MUTED, labelcolor=palette.INK)
