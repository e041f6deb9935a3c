"""Crisp top-down maps of a room as figures and files: the room, its targets' graph, paths and a legend.

`make_map` gives a matplotlib figure, `save_map` a PNG, SVG or PDF file (the same bytes every
time), `make_map_image` pixels. It opens no window and runs no engine; pictures through
Bullet's cameras are in `bullet/cameras.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from hrl_escape.env.drawing import palette
from hrl_escape.env.drawing.graph_inset import draw_graph
from hrl_escape.env.drawing.map_axes import Trajectory, draw_room, get_colour
from hrl_escape.env.drawing.meshes import compute_extent
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.puzzles.traits import Graphed, get_trait
from hrl_escape.figures import STYLE, save_figure

__all__ = ["Trajectory", "make_map", "make_map_image", "make_strip", "save_map"]

_MAP_INCHES = 6.6  # the longer side of the room
_PANEL_INCHES = 2.5
_TICK_INCHES = 0.25  # for numbers along the lower and left edge


def make_map(instance: RoomInstance, state: RoomState | None = None, trajectories: Sequence[Trajectory] = (),
             *, panel: bool = True) -> Figure:
    """Draw a room as a figure of its own.

    Args:
        instance: the room.
        state: robot and lit targets to draw; None draws the start of an episode.
        trajectories: paths, drawn under the robot.
        panel: add title, the targets' graph and the legend at the right.

    Returns:
        A figure that belongs to no window; `save_figure` writes it.
    """
    if state is None:
        state = Kinematics(instance).make_state(instance.starts[0], 0)
    x_min, x_max, y_min, y_max = compute_extent(instance)
    scale = _MAP_INCHES / max(x_max - x_min, y_max - y_min)  # inches a metre
    names = 0.4 + 0.075 * max((len(target.name) + 2 for target in instance.targets), default=0)  # inches
    wide, high = scale * (x_max - x_min) + 2 * names + _TICK_INCHES, scale * (y_max - y_min) + 2 * names + _TICK_INCHES
    total = wide + (_PANEL_INCHES if panel else 0.0)
    tall = max(high, 4.6) if panel else high
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(total, tall), dpi=150, facecolor=palette.BACKGROUND)
        axes = figure.add_axes((0.0, (tall - high) / 2 / tall, wide / total, high / tall))
        margin, ticks = names / scale, _TICK_INCHES / scale
        axes.set(xlim=(x_min - margin - ticks, x_max + margin), ylim=(y_min - margin - ticks, y_max + margin))
        draw_room(axes, instance, state, trajectories)
        if panel:
            _draw_panel(figure, instance, state, trajectories)
    return figure


def make_strip(instances: Sequence[RoomInstance], most: int = 4, inches: float = 2.2) -> Figure:
    """Draw the first rooms side by side at the start of their episodes, without names; the figure has no window."""
    with matplotlib.rc_context(STYLE):
        shown = [instances[number] for number in range(min(most, len(instances)))]
        figure = Figure(figsize=(inches * len(shown), inches), dpi=150, layout="constrained",
                        facecolor=palette.BACKGROUND)
        for axes, instance in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            x_min, x_max, y_min, y_max = compute_extent(instance)
            axes.set(xlim=(x_min - 0.5, x_max + 0.5), ylim=(y_min - 0.5, y_max + 0.5))
            draw_room(axes, instance, Kinematics(instance).make_state(instance.starts[0], 0), names=False)
    return figure


def save_map(path: str | Path, instance: RoomInstance, state: RoomState | None = None,
             trajectories: Sequence[Trajectory] = (), *, panel: bool = True) -> None:
    """Write `make_map`'s figure; as PNG, SVG or PDF by the ending of `path`.

    Raises:
        UnsupportedError: another ending.
        FileWriteError: the file could not be written.
    """
    save_figure(path, make_map(instance, state, trajectories, panel=panel))


def make_map_image(instance: RoomInstance, state: RoomState | None = None, trajectories: Sequence[Trajectory] = (),
                   *, panel: bool = True, dots_per_inch: int = 100) -> NDArray[np.uint8]:
    """Draw `make_map`'s figure as pixels, for videos: uint8, (height, width, 3)."""
    figure = make_map(instance, state, trajectories, panel=panel)
    figure.set_dpi(dots_per_inch)
    canvas = FigureCanvasAgg(figure)
    with matplotlib.rc_context(STYLE):
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


# --- the panel at the right ----------------------------------------------------------------


def _draw_panel(figure: Figure, instance: RoomInstance, state: RoomState, trajectories: Sequence[Trajectory]) -> None:
    """Title on top, legend at the bottom, the targets' graph in the space between."""
    wide, high = figure.get_size_inches()
    left, top = 1 - _PANEL_INCHES / wide, 1 - 0.45 / high
    figure.text(left, top, instance.name, fontsize=14, weight="bold", color=palette.INK, va="bottom")
    lines = _describe(instance, state)
    figure.text(left, top - 0.08 / high, "\n".join(lines), fontsize=8, color=palette.MUTED, va="top", linespacing=1.5)
    handles = _make_handles(instance, trajectories)
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(left, 0.3 / high), frameon=False, fontsize=8,
                  labelcolor=palette.INK, borderpad=0, borderaxespad=0, handletextpad=0.9, labelspacing=0.6)
    if get_trait(instance.puzzle, Graphed).edges:
        used = 0.62 + 0.17 * len(lines)  # inches
        bottom = 0.45 + 0.19 * len(handles)
        box = (left - 0.1 / wide, bottom / high, (_PANEL_INCHES - 0.1) / wide, (high - used - bottom) / high)
        draw_graph(figure.add_axes(box, anchor="NW"), instance.puzzle, state.puzzle)


def _describe(instance: RoomInstance, state: RoomState) -> list[str]:
    lines = [f"{2 * instance.half_width:g} \N{MULTIPLICATION SIGN} {2 * instance.half_depth:g} m", f"id {instance.id}"]
    if instance.seed is not None:
        lines[0] += f", seed {instance.seed}"
    if state.primitives:
        lines.append(f"after {state.primitives} primitives")
    if instance.targets:
        lit = sum(instance.puzzle.get_lit(state.puzzle))
        lines.append(f"{lit} of {len(instance.targets)} on")
    return lines


def _make_handles(instance: RoomInstance, trajectories: Sequence[Trajectory]) -> list[Line2D | Patch]:
    """Legend entries for the things in this room."""

    def mark(shape: str, label: str, fill: str, edge: str, size: float = 8) -> Line2D:
        return Line2D([], [], linestyle="", marker=shape, markersize=size, markerfacecolor=fill, label=label,
                      markeredgecolor=edge, markeredgewidth=1.0)

    body = "s" if instance.robot.base.corners else "o"
    handles: list[Line2D | Patch] = [mark(body, "robot", palette.BODY, palette.BODY_EDGE, 9),
                                     mark("o", "start", "white", palette.INK, 6)]
    if instance.targets:
        kinds = [("off", palette.OFF), ("off, waits for others", palette.WAITING), ("on", palette.LIT)]
        handles += [mark("s", label, look.fill, look.edge) for label, look in kinds
                    if look is not palette.WAITING or get_trait(instance.puzzle, Graphed).edges]
    if not instance.exit.is_flat:
        handles.append(Patch(facecolor=palette.EXIT_OPEN, alpha=0.45, edgecolor=palette.EXIT_OPEN, label="exit"))
    if instance.door is not None:
        handles.append(Patch(facecolor=palette.DOOR, label="door, open once solved"))
    for role, colour, label in (("door", palette.DOOR, "door, shut"), ("obstacle", palette.PROP, "thing in its cell")):
        if any(door.role == role for door in instance.inner_doors):
            handles.append(Patch(facecolor=colour, label=label))
    if any(solid.role == "obstacle" for solid in instance.solids):
        handles.append(Patch(facecolor=palette.OBSTACLE, edgecolor=palette.OBSTACLE_EDGE, label="obstacle"))
    handles += [Line2D([], [], color=get_colour(path, number), linewidth=2, label=path.label)
                for number, path in enumerate(trajectories) if path.label]
    return handles
