"""Top-down maps of a room as figures and files: the room, its targets' graph, paths and a legend.

`make_map` returns a matplotlib figure, `make_map_image` pixels; `save_map` writes a PNG, SVG or PDF file with
reproducible bytes; `draw_room` draws on given axes. Metres, the room frame, x to the right. `bullet/cameras.py` has
pictures through Bullet's cameras.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon
from matplotlib.patches import Rectangle as RectanglePatch
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import isotonic_regression

from hrl_escape.env.geometry import Footprint, make_footprint
from hrl_escape.env.instance import Rectangle, RoomInstance, Target
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.graph import draw_graph
from hrl_escape.env.pictures.meshes import compute_extent, outline_capsule, outline_footprint
from hrl_escape.env.pictures.model import RoomLook, RoomModel, RoomPose
from hrl_escape.env.puzzles.mixins import Depicted, Doored, Graphed, get_mixin
from hrl_escape.figures import STYLE, save_figure

_MAP_INCHES = 6.6  # longer side of the room
_PANEL_INCHES = 2.5
_TICK_INCHES = 0.25  # space for numbers along the lower and left edge
_LABEL_POINTS = 8.0
_HALO = (withStroke(linewidth=2.5, foreground="white"),)


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """A path to draw on a map.

    Attributes:
        points: positions (n, 2) of the body's axis, m.
        label: name in the legend; empty for no entry.
        colour: any matplotlib colour, or None for the next colour of the palette.
    """

    points: ArrayLike
    label: str = ""
    colour: str | None = None


def make_map(instance: RoomInstance, state: RoomState | None = None, trajectories: Sequence[Trajectory] = (),
             *, panel: bool = True, notes: Sequence[str] | None = None) -> Figure:
    """Draw a room as a figure.

    Args:
        instance: the room.
        state: state of robot and targets, or None for the start of an episode.
        trajectories: paths, drawn under the robot.
        panel: whether to add title, the targets' graph and the legend on the right.
        notes: lines below the title; by default the room's difficulty, if it has been measured.

    Returns:
        A figure without a window; `save_figure` writes it.
    """
    if state is None:
        state = Kinematics(instance).make_state(instance.starts[0], 0)
    x_min, x_max, y_min, y_max = compute_extent(instance)
    scale = _MAP_INCHES / max(x_max - x_min, y_max - y_min)  # inches per metre
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
            _draw_panel(figure, instance, state, trajectories, notes)
    return figure


def make_strip(instances: Sequence[RoomInstance], most: int = 4, inches: float = 2.2) -> Figure:
    """Draw the first rooms in a row at the start of their episodes, without names; the figure has no window."""
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
    """Draw `make_map`'s figure as pixels, for videos: uint8 (height, width, 3)."""
    figure = make_map(instance, state, trajectories, panel=panel)
    figure.set_dpi(dots_per_inch)
    canvas = FigureCanvasAgg(figure)
    with matplotlib.rc_context(STYLE):
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


# --- the panel at the right ----------------------------------------------------------------


def _draw_panel(figure: Figure, instance: RoomInstance, state: RoomState, trajectories: Sequence[Trajectory],
                notes: Sequence[str] | None) -> None:
    """Draw the title on top, the legend at the bottom, and the targets' graph between them."""
    wide, high = figure.get_size_inches()
    left, top = 1 - _PANEL_INCHES / wide, 1 - 0.45 / high
    figure.text(left, top, instance.name, fontsize=14, weight="bold", color=palette.INK, va="bottom")
    lines = [*_describe(instance, state), *(instance.notes if notes is None else notes)]
    figure.text(left, top - 0.08 / high, "\n".join(lines), fontsize=8, color=palette.MUTED, va="top", linespacing=1.5)
    handles = _make_handles(instance, trajectories)
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(left, 0.3 / high), frameon=False, fontsize=8,
                  labelcolor=palette.INK, borderpad=0, borderaxespad=0, handletextpad=0.9, labelspacing=0.6)
    if get_mixin(instance.puzzle, Graphed).edges:
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
                    if look is not palette.WAITING or get_mixin(instance.puzzle, Graphed).edges]
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


# --- the room ------------------------------------------------------------------------------


def draw_room(axes: Axes, instance: RoomInstance, state: RoomState, trajectories: Sequence[Trajectory] = (),
              names: bool = True) -> None:
    """Draw a room on axes with given limits, which must be wider than the room to leave space for names.

    Paths are drawn under the robot; `names` adds the targets' names, and metres along the edges.
    """
    axes.set_aspect("equal")
    if names:
        _draw_ticks(axes, instance)
    else:
        axes.set_axis_off()
    model = RoomModel(instance)
    _draw_floor(axes, model, state)
    for part in model.solids:
        fill, edge, order = ((palette.WALL, palette.WALL, 3.2) if part.role == "wall" else
                             (palette.OBSTACLE, palette.OBSTACLE_EDGE, 3))
        axes.add_patch(_make_outline(part.shape, facecolor=fill, edgecolor=edge, linewidth=0.8, zorder=order))
    _draw_props(axes, model, model.make_pose(state))
    sides = _draw_targets(axes, instance, state)
    for side, members in sides.items() if names else ():
        _draw_names(axes, instance, state, side, members)
    for number, trajectory in enumerate(trajectories):
        _draw_trajectory(axes, trajectory, get_colour(trajectory, number))
    _draw_starts(axes, instance)
    _draw_robot(axes, instance, state)


def _make_outline(shape: Footprint, **style: Any) -> Patch:
    return Circle((shape.x, shape.y), shape.half_x, **style) if shape.is_disc else Polygon(
        outline_footprint(shape), **style)


def _draw_props(axes: Axes, model: RoomModel, pose: RoomPose) -> None:
    """Draw blocks and plates where they are, with their names below."""
    for placed, part, (x, y, _, *turn) in zip(model.instance.props, model.props, pose.props, strict=True):
        half, plate = part.shape.half_x, part.role == "plate"
        yaw = 2 * math.atan2(turn[2], turn[3])  # rotation about z
        axes.add_patch(_make_outline(make_footprint(x, y, half, half, yaw), edgecolor=palette.PROP_EDGE, linewidth=1.0,
                                     facecolor=palette.PLATE if plate else palette.PROP,
                                     linestyle="--" if plate else "-", zorder=2 if plate else 5))
        axes.annotate(placed.prop.name, (x, y), (0, -7 - 72 * half * _get_scale(axes)), fontsize=_LABEL_POINTS,
                      textcoords="offset points", ha="center", va="top", color=palette.PROP_EDGE, zorder=8,
                      path_effects=_HALO)


def _get_scale(axes: Axes) -> float:
    """Inches of paper per metre of floor."""
    wide, high = axes.bbox.width / axes.figure.dpi, axes.bbox.height / axes.figure.dpi
    (x_min, x_max), (y_min, y_max) = axes.get_xlim(), axes.get_ylim()
    return min(wide / (x_max - x_min), high / (y_max - y_min))


def _draw_ticks(axes: Axes, instance: RoomInstance) -> None:
    """Draw metres along the lower and left edge, clear of the names."""
    size = 2 * max(instance.half_width, instance.half_depth)
    step = next(step for step in (1, 2, 5, 10, 20, 50, 1e9) if size / step <= 8)
    for set_ticks, half in ((axes.set_xticks, instance.half_width), (axes.set_yticks, instance.half_depth)):
        most = math.floor(half / step + 1e-9)
        ticks = [step * n for n in range(-most, most + 1)]
        set_ticks(ticks, [f"{tick:g}".replace("-", "\N{MINUS SIGN}") for tick in ticks])
    axes.tick_params(direction="in", pad=-11, labelsize=6.5, labelcolor=palette.MUTED, color=palette.MUTED, length=2)
    axes.tick_params(axis="y", pad=-16)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.annotate("x [m]", (1, 0), (-6, 4), xycoords="axes fraction", textcoords="offset points", fontsize=6.5,
                  color=palette.MUTED, ha="right")
    axes.annotate("y [m]", (0, 1), (4, -10), xycoords="axes fraction", textcoords="offset points", fontsize=6.5,
                  color=palette.MUTED)


def _draw_exit(axes: Axes, area: Rectangle, is_open: bool) -> None:
    colour = palette.EXIT_OPEN if is_open else palette.EXIT_LOCKED
    corner, wide, high = _measure(area)
    axes.add_patch(RectanglePatch(corner, wide, high, facecolor=colour, alpha=0.35, zorder=1))
    axes.add_patch(RectanglePatch(corner, wide, high, fill=False, edgecolor=colour, linewidth=1.4,
                                  linestyle="-" if is_open else (0, (4, 2)), zorder=2))
    points = max(6.0, min(10.0, 72 * _get_scale(axes) * min(wide, high) / 3.2))
    axes.text(*area.centre, "exit", fontsize=points, color=palette.EXIT_INK, ha="center", va="center",
              zorder=4, weight="bold", path_effects=_HALO)


def _draw_floor(axes: Axes, model: RoomModel, state: RoomState) -> None:
    instance, look = model.instance, model.make_look(state)
    for floor in model.floors:
        axes.add_patch(_make_outline(floor.shape, facecolor=palette.FLOOR, edgecolor="none", zorder=0))
    for puddle in get_mixin(instance.puzzle, Depicted).puddles:
        axes.add_patch(Polygon(outline_capsule(puddle), facecolor=palette.PUDDLE, alpha=0.6, zorder=0.5))
    if not instance.exit.is_flat:
        _draw_exit(axes, instance.exit, look.is_open)
    if instance.door is not None:
        style: dict[str, Any] = {"fill": False, "linestyle": ":"} if look.is_open else {"facecolor": palette.DOOR}
        axes.add_patch(_make_outline(instance.door.footprint, edgecolor=palette.DOOR, linewidth=1.2, zorder=4, **style))
    _draw_inner_doors(axes, model, look)


def _draw_inner_doors(axes: Axes, model: RoomModel, look: RoomLook) -> None:
    """Draw doors and things in cells; a door between rooms also has the name of the target that opens it."""
    instance = model.instance
    for part, is_shut in zip(model.inner_doors, look.shut, strict=True):
        colour = palette.LOOKS[part.role]
        if is_shut:
            axes.add_patch(_make_outline(part.shape, facecolor=colour, edgecolor=colour, zorder=5))
        elif part.role == "door":
            axes.add_patch(_make_outline(part.shape, fill=False, edgecolor=colour, linestyle=":", linewidth=1.2,
                                         zorder=5))
    facts = get_mixin(instance.puzzle, Doored).door_facts
    operators = instance.symbolic_model.operators if facts else ()
    for door, fact in zip(instance.inner_doors, facts, strict=bool(facts)):
        openers = " or ".join(dict.fromkeys(op.target for op in operators if fact in op.may_add))
        beside = -8 * math.sin(door.yaw), 8 * math.cos(door.yaw)
        axes.annotate(openers, (door.x, door.y), beside, textcoords="offset points", fontsize=6.5, color=palette.DOOR,
                      ha="center", va="center", rotation=math.degrees(door.yaw), zorder=6, path_effects=_HALO)


def _measure(area: Rectangle) -> tuple[tuple[float, float], float, float]:
    """Corner, width and height of a rectangle, m."""
    return (area.x_min, area.y_min), area.x_max - area.x_min, area.y_max - area.y_min


def _draw_starts(axes: Axes, instance: RoomInstance) -> None:
    turn = math.radians(instance.robot.turn_step_deg)
    many = len(instance.starts) > 12
    for start in instance.starts[:500]:
        axes.plot(start.x, start.y, "o", markersize=3 if many else 6, markerfacecolor="white", zorder=5,
                  markeredgecolor=palette.INK, markeredgewidth=1.0, alpha=0.5 if many else 1.0)
        if not many:
            heading = start.heading_steps * turn + start.heading_offset
            axes.annotate("", (start.x, start.y), (11 * math.cos(heading), 11 * math.sin(heading)), zorder=5,
                          textcoords="offset points",
                          arrowprops={"arrowstyle": "<-", "color": palette.INK, "shrinkA": 0, "shrinkB": 3})


def _draw_robot(axes: Axes, instance: RoomInstance, state: RoomState) -> None:
    """Draw the body with a heading mark, the arm's links from above, and the hand."""
    rules = Kinematics(instance)
    robot, radius, scale = rules.robot, instance.robot.inner_radius, 72 * _get_scale(axes)
    at, heading = np.array([state.x, state.y]), rules.get_heading(state)
    if 2 * radius * scale < 9:  # a robot that is a few points wide would be hard to find
        axes.plot(*at, "o", markersize=13, fillstyle="none", color=palette.BODY, markeredgewidth=1.0, zorder=7)
    style: dict[str, Any] = {"facecolor": palette.BODY, "edgecolor": palette.BODY_EDGE, "linewidth": 1.0, "zorder": 7}
    corners = instance.robot.base.find_corners_at(state.x, state.y, heading)
    axes.add_patch(Polygon(corners, **style) if corners else Circle((state.x, state.y), radius, **style))
    angles = heading + np.array([0.0, 2.5, math.pi, -2.5])
    reach = radius * np.array([0.85, 0.75, 0.3, 0.75])
    axes.add_patch(Polygon(at + reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1),
                           facecolor="white", linewidth=0, zorder=8))
    if not instance.robot.joints:
        return
    points = robot.trace_links(rules.get_angles(state))[:, :2]
    turned = points @ np.array([(math.cos(heading), math.sin(heading)), (-math.sin(heading), math.cos(heading))]) + at
    axes.plot(*turned.T, color=palette.ARM, linewidth=2.6, solid_capstyle="round", marker="o", markersize=3.4,
              markerfacecolor="white", markeredgewidth=0.8, zorder=9)
    size = max(5.0, 2 * scale * instance.robot.hand_radius)
    axes.plot(*turned[-1], "o", markersize=size, color=palette.HAND, markeredgecolor=palette.ARM,
              markeredgewidth=0.8, zorder=10)


def get_colour(trajectory: Trajectory, number: int) -> str:
    """Return the colour of trajectory `number`: its own, or the next of the palette."""
    return trajectory.colour or palette.LINES[number % len(palette.LINES)]


def _draw_trajectory(axes: Axes, trajectory: Trajectory, colour: str) -> None:
    points = np.asarray(trajectory.points, dtype=np.float64).reshape(-1, 2)
    if not len(points):
        return
    axes.plot(*points.T, color=colour, linewidth=1.7, alpha=0.95, solid_capstyle="round", solid_joinstyle="round",
              path_effects=[withStroke(linewidth=3.2, foreground="white")], zorder=6)
    axes.plot(*points.T, ".", color=colour, markersize=3.5, zorder=6)
    axes.plot(*points[-1], "X", color=colour, markersize=7, markeredgecolor="white", markeredgewidth=0.8, zorder=6.5)


# --- targets and their names ---------------------------------------------------------------


def _draw_targets(axes: Axes, instance: RoomInstance, state: RoomState) -> dict[str, list[int]]:
    """Draw panels as coloured bars and pads as areas; return the targets with names on each side."""
    puzzle, cues = instance.puzzle, palette.list_cues(instance.puzzle)
    sides: dict[str, list[int]] = {}
    for index, target in enumerate(instance.targets):
        fill, edge, _ = palette.get_target_look(puzzle, state.puzzle, index)
        corners = outline_footprint(target.footprint)
        axes.add_patch(Polygon(corners, facecolor=fill, edgecolor=edge, linewidth=4.0, joinstyle="round", zorder=3.8))
        axes.add_patch(Polygon(corners, facecolor=fill, edgecolor=fill, linewidth=2.4, joinstyle="round", zorder=4))
        if puzzle.get_lit(state.puzzle)[index]:
            axes.add_patch(Polygon(corners, fill=False, edgecolor=palette.LIT.fill, linewidth=10, alpha=0.4,
                                   zorder=3.7, joinstyle="round"))
        if cues:
            colour, outline = cues[index]
            size = 0.5 * max(0.6, target.half_x)
            x, y = (at + (target.half_y + 1.3 * size) * part for at, part in zip(
                (target.x, target.y), palette.find_front(instance, target), strict=True))
            axes.add_patch(Polygon([(x + size * u, y + size * v) for u, v in outline], facecolor=colour,
                                   edgecolor=palette.INK, linewidth=0.6, zorder=4.2))
        side = "inside" if target.kind == "pad" else _find_side(instance, target)
        sides.setdefault(side, []).append(index)
    return sides


def _find_side(instance: RoomInstance, target: Target) -> str:
    """Side of a target's name: outside its outer wall, or `inside`."""
    gaps = {"left": target.x + instance.half_width, "right": instance.half_width - target.x,
            "bottom": target.y + instance.half_depth, "top": instance.half_depth - target.y}
    side = min(gaps, key=gaps.__getitem__)
    near = max(0.5, 0.06 * (instance.half_width + instance.half_depth))
    return side if gaps[side] <= near else "inside"


def _draw_names(axes: Axes, instance: RoomInstance, state: RoomState, side: str, members: list[int]) -> None:
    scale = 72 * _get_scale(axes)  # points per metre
    line, x_min, x_max, y_min, y_max = 1.75 * _LABEL_POINTS / scale, *compute_extent(instance)
    names = [palette.name_target(instance.puzzle, state.puzzle, index) for index in members]
    along = [instance.targets[i].y if side in ("left", "right") else instance.targets[i].x for i in members]
    longest = 0.72 * _LABEL_POINTS * max(len(name) for name in names) / scale
    upright = side in ("top", "bottom") and min(np.diff(sorted(along)), default=math.inf) < longest
    places = _spread(along, longest if side in ("top", "bottom") and not upright else line)
    for index, name, place in zip(members, names, places, strict=True):
        target = instance.targets[index]
        fill, edge, ink = palette.get_target_look(instance.puzzle, state.puzzle, index)
        box = {"boxstyle": "round,pad=0.25", "facecolor": fill, "edgecolor": edge, "linewidth": 0.8}
        style: dict[str, Any] = {"fontsize": _LABEL_POINTS, "color": ink, "bbox": box, "zorder": 11}
        style["weight"] = "bold" if index in get_mixin(instance.puzzle, Graphed).goal_targets else "normal"
        gap = 12 / scale
        if target.kind == "pad":
            axes.annotate(name, (target.x, target.y), ha="center", va="center", **style)
            continue
        if side == "inside":
            behind = [-round(part) for part in palette.find_front(instance, target)]
            axes.annotate(name, (target.x, target.y), (12 * behind[0], 12 * behind[1]), textcoords="offset points",
                          annotation_clip=False, ha=("center", "left", "right")[behind[0]],
                          va=("center", "bottom", "top")[behind[1]], **style)
            continue
        where, anchor = {
            "left": ((x_min - gap, place), {"ha": "right", "va": "center"}),
            "right": ((x_max + gap, place), {"ha": "left", "va": "center"}),
            "bottom": ((place, y_min - gap), {"ha": "center", "va": "top"}),
            "top": ((place, y_max + gap), {"ha": "center", "va": "bottom"}),
        }[side]
        axes.annotate(name, (target.x, target.y), where, annotation_clip=False, rotation=90 if upright else 0,
                      arrowprops={"arrowstyle": "-", "color": edge, "linewidth": 0.7, "shrinkA": 0, "shrinkB": 0},
                      **anchor, **style)


def _spread(places: Sequence[float], gap: float) -> list[float]:
    """Move labels on a line as little as possible (least squares) while they keep their order and a gap."""
    order = np.argsort(places, kind="stable")
    ranks = gap * np.arange(len(places))
    moved = np.empty(len(places))
    moved[order] = isotonic_regression(np.asarray(places)[order] - ranks).x + ranks
    return moved.tolist()
