"""The vector observations in tensors: the layouts of `observations.py`, for every room at once.

Spaces, names and bounds are those of `observations.py`; only the arithmetic is repeated here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pkgutil import resolve_name
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.geometry import Shapes, cast_rays
from hrl_escape.env.batched.poses import TensorState, compute_angles, compute_heading, compute_rotation
from hrl_escape.env.batched.puzzles.base import unpack_bits
from hrl_escape.env.batched.rules import find_shut
from hrl_escape.env.batched.tables import INSTEAD, Layout, Tables, pick, pick_rules
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Rules
from hrl_escape.env.observations import LIDAR_RAYS, OBJECT_WORDS, get_observation, make_observer
from hrl_escape.env.sight import SIGHT_SLACK
from hrl_escape.errors import UnsupportedError

__all__ = ["TensorObservation", "compute_bounds", "load_observation", "observe", "observe_egocentric",
           "observe_features", "observe_objects", "observe_state"]

TensorObservation: TypeAlias = Callable[[Layout, Tables, TensorState], list[Tensor]]


def observe(layout: Layout, tables: Tables, state: TensorState, observation: TensorObservation) -> Tensor:
    """Observe every room, float32, shape (rooms, numbers); numbers of one kind lie together in memory, room by room."""
    return torch.cat(observation(layout, tables, state)).T


def load_observation(name: str) -> TensorObservation:
    """Load the tensor function that the registry of observations names.

    Raises:
        UnsupportedError: the observation has none.
        UnknownNameError: no observation of that name.
    """
    path = get_observation(name).tensor
    if path is None:
        raise UnsupportedError(f"the batched engine does not show {name!r}: {INSTEAD}")
    return resolve_name(path)


def compute_bounds(instances: Sequence[RoomInstance], name: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Smallest and largest value of each number of an observation, wide enough for every instance."""
    observers = [make_observer(name, Rules(instance)) for instance in instances]
    low, high = (np.stack(side) for side in zip(*((one.low, one.high) for one in observers), strict=True))
    return low.min(axis=0), high.max(axis=0)


def observe_state(layout: Layout, tables: Tables, state: TensorState) -> list[Tensor]:
    """Parts of `state`, (numbers, rooms) each."""
    x, y, heading = (number.to(torch.float32) for number in (state.x, state.y, compute_heading(layout, tables, state)))
    nought = torch.zeros_like(x)
    pose = torch.stack([x, y, nought, heading, nought, nought])
    return [pose, _observe_puzzle(layout, tables, state), compute_angles(layout, state).to(torch.float32)]


def observe_features(layout: Layout, tables: Tables, state: TensorState) -> list[Tensor]:
    """Parts of `features`, (numbers, rooms) each."""
    half_x, half_y = pick(layout, tables.half_sizes, state.instance)
    x, y, cos, sin = _round_pose(layout, tables, state)
    limits = [max(abs(low), abs(high)) for low, high in layout.arm.limits]
    angles = compute_angles(layout, state).to(torch.float32).unbind()
    joints = [angle / limit for angle, limit in zip(angles, limits, strict=True)]
    x, y, *joints = (number.clamp(-1.0, 1.0) for number in (x / half_x, y / half_y, *joints))
    return [*(number.unsqueeze(0) for number in (x, y, sin, cos, *joints)), _observe_puzzle(layout, tables, state)]


def _round_pose(layout: Layout, tables: Tables, state: TensorState) -> list[Tensor]:
    """Position, and cosine and sine of the heading, in single precision."""
    return [number.to(torch.float32) for number in (state.x, state.y, *compute_rotation(layout, tables, state))]


def observe_egocentric(layout: Layout, tables: Tables, state: TensorState) -> list[Tensor]:
    """Parts of `egocentric`, (numbers, rooms) each."""
    targets = pick(layout, tables.targets, state.instance)
    x_min, x_max, y_min, y_max = pick(layout, tables.exits, state.instance)
    half_x, half_y = pick(layout, tables.half_sizes, state.instance)
    diagonal = 2 * torch.sqrt(half_x * half_x + half_y * half_y)
    cos, sin = compute_rotation(layout, tables, state)
    form, puzzle = pick_rules(layout, tables, state.instance)
    is_solved = form.is_solved(puzzle, state.puzzle)

    def look_at(x: Tensor, y: Tensor, slack: Tensor) -> tuple[Tensor, Tensor]:
        """Range, sine and cosine of points (points, rooms), and if they are in sight."""
        away_x, away_y = x - state.x, y - state.y
        distance = torch.sqrt(away_x * away_x + away_y * away_y)
        is_here = distance == 0.0
        per_metre = 1.0 / torch.where(is_here, 1.0, distance)
        ahead, aside = torch.where(is_here, 1.0, away_x * per_metre), away_y * per_metre
        free = _cast_rays(layout, tables, state, ahead.unsqueeze(1), aside.unsqueeze(1), tables.hiders, is_solved)
        looks = torch.stack([distance / diagonal, aside * cos - ahead * sin, ahead * cos + aside * sin], dim=1)
        return looks.to(torch.float32), free >= distance - slack

    lit = unpack_bits(form.get_lit(puzzle, state.puzzle), layout.targets, torch.float32)
    numbers = torch.arange(layout.targets, device=lit.device).unsqueeze(1)
    is_present = numbers < pick(layout, tables.target_counts, state.instance)
    half = torch.hypot(targets.half_x, targets.half_y) if layout.has_cells else targets.half_y
    looks, in_sight = look_at(targets.x[: layout.targets], targets.y[: layout.targets],
                              SIGHT_SLACK + half[: layout.targets])
    seen = torch.where((is_present & in_sight).unsqueeze(1), torch.cat([looks, lit.unsqueeze(1)], dim=1), 0.0)
    way_out, in_sight = look_at(((x_min + x_max) / 2).unsqueeze(0), ((y_min + y_max) / 2).unsqueeze(0),
                                torch.full_like(half_x, SIGHT_SLACK, dtype=torch.float64))
    way_out = torch.where(in_sight, way_out[0], 0.0)
    limits = torch.tensor([max(abs(low), abs(high)) for low, high in layout.arm.limits], device=lit.device)
    joints = compute_angles(layout, state).to(torch.float32) / limits.unsqueeze(1)
    lidar = _measure_ranges(layout, tables, state, cos, sin, is_solved) / diagonal
    return [part.clamp(-1.0, 1.0) for part in (seen.flatten(0, 1), way_out, joints, lidar)]


def observe_objects(layout: Layout, tables: Tables, state: TensorState) -> list[Tensor]:
    """Parts of `objects`, (numbers, rooms) each."""
    targets = pick(layout, tables.targets, state.instance)
    half_x, half_y = pick(layout, tables.half_sizes, state.instance)
    x_min, x_max, y_min, y_max = pick(layout, tables.exits, state.instance)
    diagonal = 2 * torch.sqrt(half_x * half_x + half_y * half_y).to(torch.float64)
    cos, sin = compute_rotation(layout, tables, state)
    form, puzzle = pick_rules(layout, tables, state.instance)

    def make_rows(kind: str, x: Tensor, y: Tensor, thing_cos: Tensor, thing_sin: Tensor, width: Tensor, depth: Tensor,
                  lit: Tensor) -> Tensor:
        away_x, away_y = (x - state.x) / diagonal, (y - state.y) / diagonal
        one = torch.ones_like(away_x)
        numbers = {
            "present": one, kind: one, "ahead": cos * away_x + sin * away_y, "left": cos * away_y - sin * away_x,
            "sin": thing_sin * cos - thing_cos * sin, "cos": thing_cos * cos + thing_sin * sin,
            "half-x": width / diagonal * one, "half-y": depth / diagonal * one, "lit": lit * one,
        }
        rows = torch.stack([numbers.get(word, torch.zeros_like(one)) for word in OBJECT_WORDS], dim=1)
        return rows.to(torch.float32)  # (objects, words, rooms)

    own = Shapes(*(column[: layout.targets] for column in targets))
    lit = unpack_bits(form.get_lit(puzzle, state.puzzle), layout.targets, torch.float64)
    rows = make_rows("target", own.x, own.y, own.cos, own.sin, own.half_x, own.half_y, lit)
    numbers = torch.arange(layout.targets, device=lit.device).unsqueeze(1)
    is_present = numbers < pick(layout, tables.target_counts, state.instance)
    rows = torch.where(is_present.unsqueeze(1), rows, 0.0)
    nought, is_open = torch.zeros_like(state.x), form.is_solved(puzzle, state.puzzle).to(torch.float64)
    exit_ = [((x_min + x_max) / 2, (y_min + y_max) / 2), (nought + 1.0, nought), ((x_max - x_min) / 2,
             (y_max - y_min) / 2), (is_open,)]
    way_out = make_rows("exit", *(part.unsqueeze(0) for pair in exit_ for part in pair))
    limits = torch.tensor([max(abs(low), abs(high)) for low, high in layout.arm.limits], device=lit.device)
    joints = compute_angles(layout, state).to(torch.float32) / limits.unsqueeze(1)
    return [part.clamp(-1.0, 1.0) for part in (rows.flatten(0, 1), way_out.flatten(0, 1), joints)]


def _measure_ranges(layout: Layout, tables: Tables, state: TensorState, cos: Tensor, sin: Tensor,
                    is_solved: Tensor) -> Tensor:
    """Lidar from straight ahead counter-clockwise, (rays, rooms), metres; infinity where nothing is met."""
    bearings = torch.arange(LIDAR_RAYS, dtype=torch.float64, device=state.x.device) * (math.tau / LIDAR_RAYS)
    ray_cos, ray_sin = torch.cos(bearings)[:, None, None], torch.sin(bearings)[:, None, None]
    ray_x, ray_y = cos * ray_cos - sin * ray_sin, sin * ray_cos + cos * ray_sin  # (rays, 1, rooms)
    ranges = _cast_rays(layout, tables, state, ray_x, ray_y, tables.solids, is_solved)
    return ranges.clamp(min=0.0).to(torch.float32)


def _cast_rays(layout: Layout, tables: Tables, state: TensorState, ray_x: Tensor, ray_y: Tensor, table: Shapes,
               is_solved: Tensor) -> Tensor:
    """Range of rays (rays, 1, rooms) to the first of a table's outlines or the shut door, (rays, rooms), float64."""
    ranges = cast_rays(state.x, state.y, ray_x, ray_y, pick(layout, table, state.instance)).amin(1)
    if layout.inner_doors:
        inner: Shapes = pick(layout, tables.inner_doors, state.instance)
        stands = find_shut(layout, tables, state) & pick(layout, tables.inner_leaves, state.instance)
        met = cast_rays(state.x, state.y, ray_x, ray_y, inner)
        ranges = torch.minimum(ranges, torch.where(stands, met, math.inf).amin(1))
    if layout.has_door:
        doors: Shapes = pick(layout, tables.doors, state.instance)
        door = cast_rays(state.x, state.y, ray_x, ray_y, doors).amin(1)
        ranges = torch.where(is_solved, ranges, torch.minimum(ranges, door))
    return ranges


def _observe_puzzle(layout: Layout, tables: Tables, state: TensorState) -> Tensor:
    form, puzzle = pick_rules(layout, tables, state.instance)
    return form.observe(puzzle, state.puzzle, layout.targets)

