"""The look of the studies' figures."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator

from hrl_escape.env.pictures import palette

__all__ = ["FIGURE_STYLE", "finish_axes"]

FIGURE_STYLE: dict[Any, Any] = {"font.family": "DejaVu Sans", "font.size": 9, "svg.hashsalt": "hrl-escape"}


def finish_axes(axes: Axes) -> None:
    """Thousands on the x-axis, a light grid, no box."""
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True, steps=[1, 2, 5, 10]))
    axes.grid(axis="y", color="#e5dfd2", linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.tick_params(colors=palette.MUTED, labelcolor=palette.INK)
