"""Sweeps and clearances of the body in compiled code, bit for bit those of `Kinematics`.

The geometry is `env/geometry.py`'s own source, compiled by numba as it stands. Importing this
module imports numba. Kernels that loop over sweeps are in `dijkstra_kernels.py` and `a_star.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env import geometry
from hrl_escape.kernels import kernel_part

__all__ = ["SweepScene", "compile_geometry", "first_contact", "get_shape", "measure_clearance", "measure_distance",
           "sweep"]


def compile_geometry() -> tuple[Any, Any]:
    """Compile `compute_first_contact` and `compute_distance` of the room's geometry from their own source."""

    def compiled(function: Callable, **names: Any) -> Any:
        return kernel_part(FunctionType(function.__code__, {**function.__globals__, **names}, function.__name__))

    meet = compiled(geometry._meet_circle)
    return compiled(geometry.compute_first_contact, _meet_circle=meet), compiled(geometry.compute_distance)


first_contact, measure_distance = compile_geometry()


class SweepScene(NamedTuple):
    """Room for the sweeps: its solids, indexed by floor cell, and its clearances.

    Attributes:
        solids: rows of `stack_footprints`, shape (n, 7).
        door: row of the shut exit door, or -1.
        radius: body radius plus contact skin, m.
        low: corner of both grids, shape (2,), m.
        near_size: side of a cell of the grid of neighbour lists, m.
        near_shape: columns and rows of that grid, shape (2,).
        near_starts: start of each cell's list in `near_items`, row-major, shape (cells + 1,).
        near_items: rows of `solids` that a sweep from the cell can meet.
        distance: the clearance grid of `CollisionMap`, shape (columns, rows), float32, m.
        resolution: side of its cells, m.
        slack: largest difference between a place's clearance and its cell's distance, m.
    """

    solids: NDArray[np.float64]
    door: int
    radius: float
    low: NDArray[np.float64]
    near_size: float
    near_shape: NDArray[np.int64]
    near_starts: NDArray[np.int64]
    near_items: NDArray[np.int32]
    distance: NDArray[np.float32]
    resolution: float
    slack: float


@kernel_part
def get_shape(row):
    """Row of `stack_footprints` as a tuple for the geometry's functions."""
    return row[0] > 0.5, row[1], row[2], row[3], row[4], row[5], row[6]


@kernel_part
def sweep(scene, x, y, dx, dy, length):
    """Free fraction of a displacement, as `Kinematics.compute_free_fraction` computes it."""
    i = int(math.floor((x - scene.low[0]) / scene.resolution))
    j = int(math.floor((y - scene.low[1]) / scene.resolution))
    if 0 <= i < scene.distance.shape[0] and 0 <= j < scene.distance.shape[1]:
        if scene.distance[i, j] - scene.slack >= scene.radius + length:
            return 1.0
    i = min(max(int((x - scene.low[0]) / scene.near_size), 0), scene.near_shape[0] - 1)
    j = min(max(int((y - scene.low[1]) / scene.near_size), 0), scene.near_shape[1] - 1)
    cell = i * scene.near_shape[1] + j
    fraction = 1.0
    for k in range(scene.near_starts[cell], scene.near_starts[cell + 1]):
        item = scene.near_items[k]
        shape = get_shape(scene.solids[item])
        if item == scene.door and measure_distance(x, y, shape) < scene.radius - 1e-6:
            continue
        met = first_contact(x, y, dx, dy, scene.radius, shape)
        if met < fraction:
            fraction = met
    return fraction


@kernel_part
def measure_clearance(scene, x, y):
    """Distance to the nearest solid among those near the place."""
    nearest = 1e9
    i = min(max(int((x - scene.low[0]) / scene.near_size), 0), scene.near_shape[0] - 1)
    j = min(max(int((y - scene.low[1]) / scene.near_size), 0), scene.near_shape[1] - 1)
    cell = i * scene.near_shape[1] + j
    for k in range(scene.near_starts[cell], scene.near_starts[cell + 1]):
        nearest = min(nearest, measure_distance(x, y, get_shape(scene.solids[scene.near_items[k]])))
    return nearest
