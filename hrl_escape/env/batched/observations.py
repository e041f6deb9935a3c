"""The view of a batch for observations, and the observation of all its rooms at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, cast

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
    """Observe every room, float32 (rooms, numbers); values of one kind are contiguous in memory, room by room."""
    return torch.cat(observation(cast("BatchView", _Rooms(layout, tables, state)))).T


def load_observation(name: str) -> BatchObservation:
    """Return the batched form of an observation.

    Raises:
        UnsupportedError: the observation has no batched form.
        UnknownNameError: no observation of that name.
    """
    form = get_observation(name).observe_batch
    if form is Observer.observe_batch:
        raise UnsupportedError(f"the batched engine does not support the observation {name!r}: {INSTEAD}")
    return form


def compute_bounds(instances: Sequence[RoomInstance], name: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the smallest and largest value of each number of an observation over all instances."""
    observers = [make_observer(name, Rules(instance)) for instance in instances]
    low, high = (np.stack(side) for side in zip(*((one.low, one.high) for one in observers), strict=True))
    return low.min(axis=0), high.max(axis=0)


class _Rooms:
    """The `BatchView` of a batch; values are computed at first use."""

    def __init__(self, layout: Layout, tables: Tables, state: TensorState) -> None:
        self._layout, self._tables, self._state = layout, tables, state
        self._form, self._columns = pick_rules(layout, tables, state.instance)
        self.x, self.y = state.x, state.y
        self.limits, self.are_cells = layout.arm.limits, layout.has_cells

    heading = property(lambda self: compute_heading(self._layout, self._tables, self._state))
    rotation = property(lambda self: compute_rotation(self._layout, self._tables, self._state))
    angles = property(lambda self: compute_angles(self._layout, self._state))
    puzzle = property(lambda self: self._form.observe(self._columns, self._state.puzzle, self._layout.targets))
    is_solved = property(lambda self: self._form.is_solved(self._columns, self._state.puzzle))
    half_sizes = property(lambda self: self._pick("half_sizes").unbind())
    targets = property(lambda self: Shapes(*(column[: self._layout.targets] for column in self._pick("targets"))))
    is_present = property(lambda self: torch.arange(
        self._layout.targets, device=self.x.device).unsqueeze(1) < self._pick("target_counts"))
    cues = property(lambda self: self._pick("cues"))
    lit = property(lambda self: unpack_bits(
        self._form.get_lit(self._columns, self._state.puzzle), self._layout.targets, torch.bool))
    exit = property(lambda self: self._pick("exits").unbind())

    def _pick(self, table: str) -> Any:
        """Return each room's column of a table."""
        return pick(self._layout, getattr(self._tables, table), self._state.instance)

    def cast_rays(self, ray_x: Tensor, ray_y: Tensor, among: Literal["solids", "hiders"]) -> Tensor:
        ranges = cast_rays(self.x, self.y, ray_x, ray_y, self._pick(among)).amin(1)
        if self._layout.inner_doors:
            stands = find_shut(self._layout, self._tables, self._state) & self._pick("inner_leaves")
            met = cast_rays(self.x, self.y, ray_x, ray_y, self._pick("inner_doors"))
            ranges = torch.minimum(ranges, torch.where(stands, met, math.inf).amin(1))
        if self._layout.has_door:
            door = cast_rays(self.x, self.y, ray_x, ray_y, self._pick("doors")).amin(1)
            ranges = torch.where(self.is_solved, ranges, torch.minimum(ranges, door))
        return ranges
