"""Sweeps and clearances of the body in compiled code, with the same bits as `Kinematics`.

The geometry is the source of `env/geometry.py` and of the bases, compiled unchanged by numba, which this loads.
"""

from __future__ import annotations

import inspect
import math
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from hrl_escape.env import geometry
from hrl_escape.env.bases import Base, bases
from hrl_escape.env.floor_grid import FloorGrid
from hrl_escape.errors import UnsupportedError
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.kernels import PART, hash_code, kernel_part


def _compile(function: Callable) -> Any:
    """Compile a pure function from its own source, with the functions of its module that it calls; each only once."""
    if function not in _COMPILED:
        parts = {name: _compile(part) for name in function.__code__.co_names
                 if isinstance(part := function.__globals__.get(name), FunctionType)}
        _COMPILED[function] = kernel_part(
            FunctionType(function.__code__, {**function.__globals__, **parts}, function.__name__))
    return _COMPILED[function]


_COMPILED: dict[Callable, Any] = {}


def compile_geometry() -> tuple[Any, Any]:
    """Compile `compute_first_contact` and `compute_distance` of the room's geometry from their own source."""
    return _compile(geometry.compute_first_contact), _compile(geometry.compute_distance)


_BASES = bases.load_all()


def __getattr__(name: str) -> Any:
    """Make the type of an outline by its name; the cache also names outlines of bases that have changed since."""
    if not name.startswith("Outline_"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals().setdefault(name, namedtuple(name, ("size",), module=__name__))


def _make_outline_type(name: str, *sharing: type[Base]) -> Any:
    """Make a type for the sizes of some bases. Kernels for it contain their functions, and its name their code."""
    return __getattr__(f"Outline_{name}_{hash_code(Path(inspect.getfile(base)) for base in sharing)}")


Round = _make_outline_type("round", *(base for base in _BASES.values() if base.turns_anywhere))
"""The outline of a base that turns anywhere, or of a point: the distance from its axis decides."""
_OUTLINES = {base: Round if base.turns_anywhere else _make_outline_type(name, base) for name, base in _BASES.items()}
first_contact, measure_distance = compile_geometry()


def _compile_choice(name: str) -> Any:
    """Compile a function that every base defines, called with an outline, a pose and further values."""
    own = {outline: getattr(base, name) for base, outline in _OUTLINES.items()}

    def call(outline, *values):
        return own[type(outline)](*values)

    @overload(call, jit_options=PART)
    def choose(outline, *values):
        chosen = _compile(own[outline.instance_class])
        return lambda outline, *values: chosen(*values)

    return call


def turns_anywhere(outline: Any) -> bool:
    """Return whether the distance from its axis decides for an outline; a constant in compiled code."""
    return isinstance(outline, Round)


@overload(turns_anywhere, jit_options=PART)
def _know_whether_it_turns_anywhere(outline):
    known = outline.instance_class is Round
    return lambda outline: known


_base_contact, _base_gap = _compile_choice("contact"), _compile_choice("gap")
_base_distance, _is_turn_blocked = _compile_choice("distance"), _compile_choice("blocks_turn")


class Presser(NamedTuple):
    """The thing that must touch a goal: a base at a heading, or a point."""

    outline: Any  # `Round` for a point, and for bases whose axis distance decides
    inner: float  # radius of the largest disc within it, m
    outer: float  # radius of the smallest disc round it, m


POINT = Presser(Round(np.zeros(1)), 0.0, 0.0)


def make_outline(base: Base) -> Any:
    """Return a base's size as compiled code takes it; `UnsupportedError` for a base that was added too late."""
    if base.turns_anywhere:
        return Round(np.array(base.size))
    if type(base) not in _OUTLINES:
        raise UnsupportedError(f"planners do not know the base {type(base).__name__}: add it to "
                               "hrl_escape.env.bases.bases before they are imported")
    return _OUTLINES[type(base)](np.array(base.size))


def make_presser(base: Base) -> Presser:
    """Make the presser of a base that presses with its outline."""
    return Presser(make_outline(base), base.inner_radius, base.outer_radius)


class SweepScene(NamedTuple):
    """Arrays of a room for the sweeps: its solids, indexed by floor cell, and its clearances."""

    solids: NDArray[np.float64]  # rows of `stack_footprints`, shape (n, 7)
    door: int  # row of the shut exit door, or -1
    radius: float  # radius of the smallest disc that holds the base, plus contact skin, m
    inner: float  # radius of the largest disc within the base, m
    outline: Any  # of the base, plus contact skin
    low: NDArray[np.float64]  # corner of both grids, shape (2,), m
    near_size: float  # side of a cell of the grid of neighbour lists, m
    near_shape: NDArray[np.int64]  # columns and rows of that grid, shape (2,)
    near_starts: NDArray[np.int64]  # start of each cell's list in `near_items`, row-major, shape (cells + 1,)
    near_items: NDArray[np.int32]  # rows of `solids` that a sweep from the cell can meet
    distance: NDArray[np.float32]  # the clearance grid of `CollisionMap`, shape (columns, rows), float32, m
    resolution: float  # side of its cells, m
    slack: float  # largest difference between a place's clearance and its cell's distance, m


@kernel_part
def get_shape(row):
    """Row of `stack_footprints` as a tuple for the geometry's functions."""
    return row[0] > 0.5, row[1], row[2], row[3], row[4], row[5], row[6]


@kernel_part
def is_clear_of_all(scene, x, y, length):
    """Return whether no solid is within a distance of the base at a place, by the grid of clearances.

    A test from the middle of a move needs half its length, one from its start all of it.
    """
    i = int(math.floor((x - scene.low[0]) / scene.resolution))
    j = int(math.floor((y - scene.low[1]) / scene.resolution))
    inside = 0 <= i < scene.distance.shape[0] and 0 <= j < scene.distance.shape[1]
    return inside and scene.distance[i, j] - scene.slack >= scene.radius + length


@kernel_part
def _list_near(scene, x, y):
    """First and last place in `near_items` of the solids near a place."""
    i = min(max(int((x - scene.low[0]) / scene.near_size), 0), scene.near_shape[0] - 1)
    j = min(max(int((y - scene.low[1]) / scene.near_size), 0), scene.near_shape[1] - 1)
    cell = i * scene.near_shape[1] + j
    return scene.near_starts[cell], scene.near_starts[cell + 1]


@kernel_part
def measure_clearance(scene, x, y):
    """Distance to the nearest solid among those near the place."""
    nearest = 1e9
    first, last = _list_near(scene, x, y)
    for k in range(first, last):
        nearest = min(nearest, measure_distance(x, y, get_shape(scene.solids[scene.near_items[k]])))
    return nearest


@kernel_part
def _lets_out(scene, item, x, y, turn, shape):
    """Return whether a base is in the shut exit door, which does not block a body inside it."""
    if item != scene.door:
        return False
    if turns_anywhere(scene.outline):
        return measure_distance(x, y, shape) < scene.radius - 1e-6
    return _base_gap(scene.outline, x, y, turn[0], turn[1], scene.outline.size, shape) < -1e-6


@kernel_part
def sweep_body(scene, x, y, turn, dx, dy, length):
    """Free fraction of a displacement at a heading, as `Kinematics.compute_free_fraction` computes it."""
    if is_clear_of_all(scene, x + 0.5 * dx, y + 0.5 * dy, 0.5 * length):
        return 1.0
    fraction = 1.0
    first, last = _list_near(scene, x, y)
    for k in range(first, last):
        shape = get_shape(scene.solids[scene.near_items[k]])
        if _lets_out(scene, scene.near_items[k], x, y, turn, shape):
            continue
        if turns_anywhere(scene.outline):
            fraction = min(fraction, first_contact(x, y, dx, dy, scene.radius, shape))
        else:
            fraction = min(fraction, _base_contact(scene.outline, x, y, turn[0], turn[1], scene.outline.size, dx, dy,
                                                   shape))
    return fraction


@kernel_part
def does_fit(scene, x, y, turn):
    """Return whether a base that does not turn anywhere fits at a pose."""
    if is_clear_of_all(scene, x, y, 0.0):
        return True
    first, last = _list_near(scene, x, y)
    for k in range(first, last):
        shape = get_shape(scene.solids[scene.near_items[k]])
        if _base_gap(scene.outline, x, y, turn[0], turn[1], scene.outline.size, shape) < 0.0:
            return False
    return True


@kernel_part
def can_turn_body(scene, x, y, turn, to, angle):
    """Return whether a base can turn on the spot from one heading to another by an angle in rad."""
    if turns_anywhere(scene.outline) or is_clear_of_all(scene, x, y, 0.0):
        return True
    first, last = _list_near(scene, x, y)
    for k in range(first, last):
        shape = get_shape(scene.solids[scene.near_items[k]])
        if not _lets_out(scene, scene.near_items[k], x, y, turn, shape) and _is_turn_blocked(
                scene.outline, x, y, turn[0], turn[1], to[0], to[1], angle, scene.outline.size, shape):
            return False
    return True


@kernel_part
def is_touched(x, y, turn, presser, shape, reach):
    """Return whether a presser at a place and heading (cosine, sine) touches a footprint.

    `reach` is the largest distance from the place, m: beyond the base it is less by its outer radius.
    """
    if measure_distance(x, y, shape) > reach:
        return False
    if turns_anywhere(presser.outline):
        return True
    margin = reach - presser.outer + 1e-12
    return _base_distance(presser.outline, x, y, turn[0], turn[1], presser.outline.size, shape) <= margin


def make_sweep_scene(collision: CollisionMap, door: int, span: float) -> SweepScene:
    """Index a room's solids by floor cell, for sweeps up to `span` m; `door` numbers the shut exit door, or is -1."""
    width, depth = collision.resolution * np.array(collision.distance.shape)
    size = max(min(span, 2.0), 0.5, width / 128, depth / 128)
    grid = FloorGrid(collision.low, size, (math.ceil(width / size), math.ceil(depth / size)))
    limit = collision.radius + span + size * math.sqrt(0.5) + 1e-6
    cells: list[NDArray[np.int64]] = []
    items: list[NDArray[np.int32]] = []
    for number, footprint in enumerate(collision.footprints):
        (columns, rows), away = grid.measure(footprint, limit)
        i, j = np.nonzero(away <= limit)
        cells.append((i + columns.start) * grid.shape[1] + j + rows.start)
        items.append(np.full(len(i), number, dtype=np.int32))
    flat = np.concatenate(cells) if cells else np.zeros(0, dtype=np.int64)
    order = np.argsort(flat, kind="stable")
    starts = np.searchsorted(flat[order], np.arange(grid.cells + 1))
    return SweepScene(
        collision.solids, door, collision.radius, collision.inner, make_outline(collision.base), collision.low, size,
        np.array(grid.shape), starts.astype(np.int64),
        (np.concatenate(items) if items else np.zeros(0, dtype=np.int32))[order], collision.distance,
        collision.resolution, collision.slack,
    )
