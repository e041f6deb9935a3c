"""The view of a batch that observations read, and the observation of all its rooms at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.poses import TensorState, compute_angles, compute_heading, compute_rotation
from hrl_escape.env.batched.puzzles.base import unpack_bits
from hrl_escape.env.batched.rules import find_shut
from hrl_escape.env.batched.tables import INSTEAD, Layout, Tables, pick, pick_rules
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Rules
from hrl_escape.env.observations.base import BatchObservation, BatchView, Observer, get_observation, make_observer
from hrl_escape.env.tensor_geometry import Shapes, cast_rays
from hrl_escape.errors import UnsupportedError


def observe(layout: Layout, tables: Tables, state: TensorState, observation: BatchObservation) -> Tensor:
    """Observe every room, float32, shape (rooms, numbers); numbers of one kind lie together in memory, room by room."""
    return torch.cat(observation(cast("BatchView", _Rooms(layout, tables, state)))).T


def load_observation(name: str) -> BatchObservation:
    """Return the batched form of an observation.

    Raises:
        UnsupportedError: the observation has none.
        UnknownNameError: no observation of that name.
    """
    form = get_observation(name).observe_batch
    if form is Observer.observe_batch:
        raise UnsupportedError(f"the batched engine does not show {name!r}: {INSTEAD}")
    return form


def compute_bounds(instances: Sequence[RoomInstance], name: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Smallest and largest value of each number of an observation, wide enough for every instance."""
    observers = [make_observer(name, Rules(instance)) for instance in instances]
    low, high = (np.stack(side) for side in zip(*((one.low, one.high) for one in observers), strict=True))
    return low.min(axis=0), high.max(axis=0)


class _Rooms:
    """The `BatchView` of a batch; each value is computed on first use."""

    def __init__(self, layout: Layout, tables: Tables, state: TensorState) -> None:
        self._layout, self._tables, self._state = layout, tables, state
        self._form, self._columns = pick_rules(layout, tables, state.instance)
        self.x, self.y = state.x, state.y
        self.limits, self.are_cells = layout.arm.limits, layout.has_cells

    @property
    def heading(self) -> Tensor:
        return compute_heading(self._layout, self._tables, self._state)

    @property
    def rotation(self) -> tuple[Tensor, Tensor]:
        return compute_rotation(self._layout, self._tables, self._state)

    @property
    def angles(self) -> Tensor:
        return compute_angles(self._layout, self._state)

    @property
    def puzzle(self) -> Tensor:
        return self._form.observe(self._columns, self._state.puzzle, self._layout.targets)

    @property
    def is_solved(self) -> Tensor:
        return self._form.is_solved(self._columns, self._state.puzzle)

    @property
    def half_sizes(self) -> tuple[Tensor, Tensor]:
        half_x, half_y = pick(self._layout, self._tables.half_sizes, self._state.instance)
        return half_x, half_y

    @property
    def targets(self) -> Shapes:
        columns: Shapes = pick(self._layout, self._tables.targets, self._state.instance)
        return Shapes(*(column[: self._layout.targets] for column in columns))

    @property
    def is_present(self) -> Tensor:
        numbers = torch.arange(self._layout.targets, device=self.x.device).unsqueeze(1)
        return numbers < pick(self._layout, self._tables.target_counts, self._state.instance)

    @property
    def marks(self) -> Tensor:
        return pick(self._layout, self._tables.marks, self._state.instance)

    @property
    def lit(self) -> Tensor:
        return unpack_bits(self._form.get_lit(self._columns, self._state.puzzle), self._layout.targets, torch.bool)

    @property
    def exit(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        x_min, x_max, y_min, y_max = pick(self._layout, self._tables.exits, self._state.instance)
        return x_min, x_max, y_min, y_max

    def cast_rays(self, ray_x: Tensor, ray_y: Tensor, among: Literal["solids", "hiders"]) -> Tensor:
        layout, tables, instance = self._layout, self._tables, self._state.instance
        outlines: Shapes = pick(layout, tables.solids if among == "solids" else tables.hiders, instance)
        ranges = cast_rays(self.x, self.y, ray_x, ray_y, outlines).amin(1)
        if layout.inner_doors:
            inner: Shapes = pick(layout, tables.inner_doors, instance)
            stands = find_shut(layout, tables, self._state) & pick(layout, tables.inner_leaves, instance)
            met = cast_rays(self.x, self.y, ray_x, ray_y, inner)
            ranges = torch.minimum(ranges, torch.where(stands, met, math.inf).amin(1))
        if layout.has_door:
            doors: Shapes = pick(layout, tables.doors, instance)
            door = cast_rays(self.x, self.y, ray_x, ray_y, doors).amin(1)
            ranges = torch.where(self.is_solved, ranges, torch.minimum(ranges, door))
        return ranges
