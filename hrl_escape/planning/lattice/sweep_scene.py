"""One room as the arrays that compiled sweeps read."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import compute_distance_many, stack_footprints
from hrl_escape.planning.collision_map import CollisionMap, list_cells
from hrl_escape.planning.lattice.sweep_kernels import SweepScene

__all__ = ["make_sweep_scene"]


def make_sweep_scene(collision: CollisionMap, door: int, span: float) -> SweepScene:
    """Index a room's solids by floor cell, for the sweeps.

    Args:
        collision: clearances of the room.
        door: number of the shut exit door among its solids, or -1.
        span: length of the longest sweep, m.
    """
    width, depth = collision.resolution * np.array(collision.distance.shape)
    size = max(min(span, 2.0), 0.5, width / 128, depth / 128)
    shape = (math.ceil(width / size), math.ceil(depth / size))
    limit = collision.radius + span + size * math.sqrt(0.5) + 1e-6
    cells: list[NDArray[np.int64]] = []
    items: list[NDArray[np.int32]] = []
    for number, footprint in enumerate(collision.footprints):
        around = footprint.half_x if footprint.is_disc else math.hypot(footprint.half_x, footprint.half_y)
        middle = np.array([footprint.x, footprint.y])
        i0, j0 = np.maximum(np.floor((middle - around - limit - collision.low) / size).astype(int), 0)
        i1, j1 = np.minimum(np.ceil((middle + around + limit - collision.low) / size).astype(int), shape)
        if i0 >= i1 or j0 >= j1:
            continue
        grid = list_cells((i0, j0), (i1, j1))
        centres = np.add(collision.low, (grid + 0.5) * size, dtype=np.float64)
        away = compute_distance_many(centres, stack_footprints([footprint]))
        near = grid[away <= limit]
        cells.append(near[:, 0] * shape[1] + near[:, 1])
        items.append(np.full(len(near), number, dtype=np.int32))
    flat = np.concatenate(cells) if cells else np.zeros(0, dtype=np.int64)
    order = np.argsort(flat, kind="stable")
    starts = np.searchsorted(flat[order], np.arange(shape[0] * shape[1] + 1))
    return SweepScene(
        collision.solids, door, collision.radius, collision.inner, *collision.half_sizes, collision.low, size,
        np.array(shape), starts.astype(np.int64),
        (np.concatenate(items) if items else np.zeros(0, dtype=np.int32))[order], collision.distance,
        collision.resolution, collision.slack,
    )
