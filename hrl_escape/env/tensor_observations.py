"""The vector observations in tensors: the layouts of `observations.py`, for every room at once.

Spaces, names and bounds are those of `observations.py`; only the arithmetic is repeated here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Rules
from hrl_escape.env.observations import LIDAR_RAYS, make_observer
from hrl_escape.env.tensor_geometry import Shapes, cast_rays
from hrl_escape.env.tensor_instances import INSTEAD, Layout, Tables, pick
from hrl_escape.env.tensor_poses import TensorState, compute_angles, compute_heading, compute_rotation
from hrl_escape.env.tensor_puzzles import get_tensor_puzzle, unpack_bits
from hrl_escape.errors import UnknownNameError, UnsupportedError

__all__ = ["OBSERVATIONS", "check_observation", "compute_bounds", "observe"]


def observe(layout: Layout, tables: Tables, state: TensorState, kind: str) -> Tensor:
    """What each room shows, float32, shape (rooms, numbers)."""
    return torch.cat(OBSERVATIONS[kind](layout, tables, state)).T.contiguous()


def check_observation(kind: str) -> None:
    """Check that an observation can be had here.

    Raises:
        UnsupportedError: `pixels`, which only the Bullet engine renders.
        UnknownNameError: no observation of that name.
    """
    if kind == "pixels":
        raise UnsupportedError(f"the batched engine renders no pixels: {INSTEAD}")
    if kind not in OBSERVATIONS:
        raise UnknownNameError("observation", kind, OBSERVATIONS)


def compute_bounds(instances: Sequence[RoomInstance], kind: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Smallest and largest value of each number of an observation, wide enough for every instance."""
    observers = [make_observer(kind, Rules(instance)) for instance in instances]
    bounds = [(one.low, one.high) for one in observers if one is not None]
    low, high = (np.stack(side) for side in zip(*bounds, strict=True))
    return low.min(axis=0), high.max(axis=0)


def _observe_state(layout: Layout, tables: Tables, state: TensorState) -> list[Tensor]:
    x, y, heading = (number.to(torch.float32) for number in (state.x, state.y, compute_heading(layout, tables, state)))
    nought = torch.zeros_like(x)
    pose = torch.stack([x, y, nought, heading, nought, nought])
    return [pose, _observe_puzzle(layout, tables, state), compute_angles(layout, state).to(torch.float32)]


def _observe_features(layout: Layout, tables: Tables, state: TensorState) -> list[Tensor]:
    half_x, half_y = pick(layout, tables.half_sizes, state.instance)
    x, y, cos, sin = _round_pose(layout, tables, state)
    limits = [max(abs(low), abs(high)) for low, high in layout.arm.limits]
    angles = compute_angles(layout, state).to(torch.float32).unbind()
    joints = [angle / limit for angle, limit in zip(angles, limits, strict=True)]
    pose = torch.stack([x / half_x, y / half_y, sin, cos, *joints]).clamp(-1.0, 1.0)
    return [pose, _observe_puzzle(layout, tables, state)]


def _round_pose(layout: Layout, tables: Tables, state: TensorState) -> list[Tensor]:
    """Position, and cosine and sine of the heading, in single precision."""
    return [number.to(torch.float32) for number in (state.x, state.y, *compute_rotation(layout, tables, state))]


def _observe_egocentric(layout: Layout, tables: Tables, state: TensorState) -> list[Tensor]:
    targets = pick(layout, tables.targets, state.instance)
    x_min, x_max, y_min, y_max = pick(layout, tables.exits, state.instance)
    half_x, half_y = pick(layout, tables.half_sizes, state.instance)
    diagonal = 2 * torch.sqrt(half_x * half_x + half_y * half_y)
    _, _, cos, sin = _round_pose(layout, tables, state)

    def look_at(x: Tensor, y: Tensor) -> list[Tensor]:
        away_x, away_y = (x - state.x).to(torch.float32), (y - state.y).to(torch.float32)
        distance = torch.sqrt(away_x * away_x + away_y * away_y)
        is_here = distance == 0.0
        per_metre = 1.0 / torch.where(is_here, 1.0, distance)
        ahead, aside = torch.where(is_here, 1.0, away_x * per_metre), away_y * per_metre
        return [distance / diagonal, aside * cos - ahead * sin, ahead * cos + aside * sin]

    puzzle = pick(layout, tables.puzzle, state.instance)
    form = get_tensor_puzzle(layout.puzzle)
    lit = unpack_bits(form.get_lit(puzzle, state.puzzle), layout.targets, torch.float32)
    seen = torch.stack([*look_at(targets.x[: layout.targets], targets.y[: layout.targets]), lit], dim=1)
    way_out = torch.stack(look_at((x_min + x_max) / 2, (y_min + y_max) / 2))
    lidar = _measure_ranges(layout, tables, state, cos, sin, form.is_solved(puzzle, state.puzzle)) / diagonal
    return [part.clamp(-1.0, 1.0) for part in (seen.flatten(0, 1), way_out, lidar)]


def _measure_ranges(layout: Layout, tables: Tables, state: TensorState, cos: Tensor, sin: Tensor,
                    is_solved: Tensor) -> Tensor:
    """Lidar from straight ahead counter-clockwise, (rays, rooms), metres; infinity where nothing is met."""
    bearings = torch.arange(LIDAR_RAYS, device=state.x.device) * (math.tau / LIDAR_RAYS)
    ray_cos, ray_sin = torch.cos(bearings)[:, None, None], torch.sin(bearings)[:, None, None]
    ray_x, ray_y = cos * ray_cos - sin * ray_sin, sin * ray_cos + cos * ray_sin  # (rays, 1, rooms)
    solids: Shapes = pick(layout, tables.solids, state.instance)
    ranges = cast_rays(state.x, state.y, ray_x, ray_y, solids).amin(1)
    if layout.has_door:
        doors: Shapes = pick(layout, tables.doors, state.instance)
        door = cast_rays(state.x, state.y, ray_x, ray_y, doors).amin(1)
        ranges = torch.where(is_solved, ranges, torch.minimum(ranges, door))
    return ranges.clamp(min=0.0).to(torch.float32)


def _observe_puzzle(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    puzzle = pick(layout, tables.puzzle, state.instance)
    return get_tensor_puzzle(layout.puzzle).observe(puzzle, state.puzzle, layout.targets)


OBSERVATIONS = {"state": _observe_state, "features": _observe_features, "egocentric": _observe_egocentric}
