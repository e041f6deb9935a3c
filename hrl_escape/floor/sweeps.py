"""Sweeps and clearances of the body in compiled code, with the same bits as `Kinematics`.

The geometry is the source of `env/geometry.py` and of the bases, compiled unchanged by numba, which this loads.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env import geometry
from hrl_escape.env.bases import Base, bases
from hrl_escape.env.floor_grid import FloorGrid
from hrl_escape.errors import UnsupportedError
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.kernels import add_sources, kernel_part


def _compile(function: Callable) -> Any:
    """Compile a pure function from its own source, with the functions of its module that it calls."""
    parts = {name: part for name in function.__code__.co_names
             if isinstance(part := function.__globals__.get(name), FunctionType)}
    for name, part in parts.items():
        if part not in _COMPILED:
            _COMPILED[part] = _compile(part)
        parts[name] = _COMPILED[part]
    return kernel_part(FunctionType(function.__code__, {**function.__globals__, **parts}, function.__name__))


def compile_geometry() -> tuple[Any, Any]:
    """Compile `compute_first_contact` and `compute_distance` of the room's geometry from their own source."""
    return _compile(geometry.compute_first_contact), _compile(geometry.compute_distance)


def _compile_choice(name: str) -> Any:
    """Compile a function that every base defines, called with a base's number and size."""
    chosen = None
    for number, base in reversed(list(enumerate(_BASES))):
        chosen = _choose(number, _compile(getattr(base, name)), chosen)
    return chosen


def _choose(number: int, own: Any, others: Any) -> Any:
    if others is None:
        return kernel_part(lambda kind, *values: own(*values))

    def choose(kind, *values):
        return own(*values) if kind == number else others(kind, *values)

    return kernel_part(choose)


_BASES = tuple(bases.load_all().values())
add_sources(Path(inspect.getfile(base)) for base in _BASES)
_COMPILED: dict[FunctionType, Any] = {}
first_contact, measure_distance = compile_geometry()
_base_contact, _base_gap = _compile_choice("contact"), _compile_choice("gap")
_base_distance, _is_turn_blocked = _compile_choice("distance"), _compile_choice("blocks_turn")


class Presser(NamedTuple):
    """The thing that must touch a goal: a base at a heading, or a point."""

    kind: int  # number of the base in `bases`; -1 for a point, and for bases whose axis distance decides
    size: NDArray[np.float64]  # of the base, without clearance, m
    inner: float  # radius of the largest disc within it, m
    outer: float  # radius of the smallest disc round it, m


POINT = Presser(-1, np.zeros(1), 0.0, 0.0)


def number_base(base: Base) -> int:
    """Number of a base in compiled code, -1 for one that turns anywhere; `UnsupportedError` for one added too late."""
    if base.turns_anywhere:
        return -1
    if type(base) not in _BASES:
        raise UnsupportedError(f"planners do not know the base {type(base).__name__}: add it to "
                               "hrl_escape.env.bases.bases before they are imported")
    return _BASES.index(type(base))


def make_presser(base: Base) -> Presser:
    """Make the presser of a base that presses with its outline."""
    return Presser(number_base(base), np.array(base.size), base.inner_radius, base.outer_radius)


class SweepScene(NamedTuple):
    """Arrays of a room for the sweeps: its solids, indexed by floor cell, and its clearances."""

    solids: NDArray[np.float64]  # rows of `stack_footprints`, shape (n, 7)
    door: int  # row of the shut exit door, or -1
    radius: float  # radius of the smallest disc that holds the base, plus contact skin, m
    inner: float  # radius of the largest disc within the base, m
    kind: int  # number of the base in `bases`; -1 for one that turns anywhere
    size: NDArray[np.float64]  # of the base, plus contact skin, m
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
    if scene.kind < 0:
        return measure_distance(x, y, shape) < scene.radius - 1e-6
    return _base_gap(scene.kind, x, y, turn[0], turn[1], scene.size, shape) < -1e-6


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
        if scene.kind < 0:
            fraction = min(fraction, first_contact(x, y, dx, dy, scene.radius, shape))
        else:
            fraction = min(fraction, _base_contact(scene.kind, x, y, turn[0], turn[1], scene.size, dx, dy, shape))
    return fraction


@kernel_part
def does_fit(scene, x, y, turn):
    """Return whether a base that does not turn anywhere fits at a pose."""
    if is_clear_of_all(scene, x, y, 0.0):
        return True
    first, last = _list_near(scene, x, y)
    for k in range(first, last):
        shape = get_shape(scene.solids[scene.near_items[k]])
        if _base_gap(scene.kind, x, y, turn[0], turn[1], scene.size, shape) < 0.0:
            return False
    return True


@kernel_part
def can_turn_body(scene, x, y, turn, to, angle):
    """Return whether a base can turn on the spot from one heading to another by an angle in rad."""
    if scene.kind < 0 or is_clear_of_all(scene, x, y, 0.0):
        return True
    first, last = _list_near(scene, x, y)
    for k in range(first, last):
        shape = get_shape(scene.solids[scene.near_items[k]])
        if not _lets_out(scene, scene.near_items[k], x, y, turn, shape) and _is_turn_blocked(
                scene.kind, x, y, turn[0], turn[1], to[0], to[1], angle, scene.size, shape):
            return False
    return True


@kernel_part
def is_touched(x, y, turn, presser, shape, reach):
    """Return whether a presser at a place and heading (cosine, sine) touches a footprint.

    `reach` is the largest distance from the place, m: beyond the base it is less by its outer radius.
    """
    if measure_distance(x, y, shape) > reach:
        return False
    if presser.kind < 0:
        return True
    margin = reach - presser.outer + 1e-12
    return _base_distance(presser.kind, x, y, turn[0], turn[1], presser.size, shape) <= margin


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
        collision.solids, door, collision.radius, collision.inner, number_base(collision.base),
        np.array(collision.base.size), collision.low, size, np.array(grid.shape), starts.astype(np.int64),
        (np.concatenate(items) if items else np.zeros(0, dtype=np.int32))[order], collision.distance,
        collision.resolution, collision.slack,
    )
