"""Choice of a few candidate postures for presses by hand: at the start of a press, and again without progress.

To weigh one takes an interpolation in its field, and there are dozens for each target. So a step of a batch weighs all
only where a press begins or did not get nearer, and elsewhere the few that were chosen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial

import torch
from torch import Tensor

from hrl_escape.env.batched.compilation import CompiledStep
from hrl_escape.env.batched.engine import TensorRoom, list_shapes
from hrl_escape.env.batched.poses import TensorState, compute_rotation
from hrl_escape.env.batched.tables import Layout, Tables, map_tensors
from hrl_escape.options.batched.cost_to_go import CostFields, classify_headings, interpolate_cost, locate
from hrl_escape.options.batched.decisions import CHOSEN, OpenDecisions
from hrl_escape.options.batched.hand_policy import displace, measure_drift

__all__ = ["PostureChooser", "weigh_postures"]

_PARTS = 8  # parts of a batch, weighed one at a time by a compiled kernel: about as many as primitives in a press


def weigh_postures(layout: Layout, tables: Tables, fields: CostFields, state: TensorState, goal: Tensor, rooms: Tensor
                   ) -> Tensor:
    """Find the postures with the least remaining joint steps plus way of the base; int64 (`CHOSEN`, some).

    Args:
        layout: properties that all rooms share.
        tables: their instances.
        fields: their fields.
        state: their states.
        goal: the targets to press, int64 (rooms,).
        rooms: numbers of the rooms to choose in, int64 (some,).
    """
    state = map_tensors(lambda field: field[..., rooms], state)
    column = torch.zeros_like(state.instance) if layout.is_shared else state.instance
    steps, _, shifts, numbers = (table[..., goal[rooms], column] for table in fields.postures)
    away = (steps - state.joint_steps.unsqueeze(1)).abs().sum(0).to(torch.float32)
    if layout.dynamics.noise:
        shifts = shifts + measure_drift(layout, state)[:2].unsqueeze(1)
    cos, sin = compute_rotation(layout, tables, state)
    place = locate(layout, fields, state.instance, *displace(state.x, state.y, cos, sin, *shifts))
    heading, between = classify_headings(layout, fields, state)
    way = interpolate_cost(layout, fields, state.instance, numbers, place, heading.expand_as(numbers), between)
    left, found = way.clamp(min=1.0) + away, []
    for _ in range(CHOSEN):
        found.append(left.argmin(0))
        left = left.scatter(0, found[-1].unsqueeze(0), math.inf)
    return torch.stack(found)


class PostureChooser:
    """Chooser of postures for the rooms of a batch.

    Args:
        room: the batch.
        fields: their fields.
        is_compiled: weigh in a compiled kernel.
    """

    def __init__(self, room: TensorRoom, fields: CostFields, is_compiled: bool) -> None:
        self._room = room
        self._part = max(room.count // _PARTS, 1) if is_compiled else 0
        self._weigh: Callable[[TensorState, Tensor, Tensor], Tensor]
        if is_compiled:
            shapes = (room.count, *list_shapes(room.tables), *list_shapes(fields))
            kernel = _compile_weighing(room.layout, room.device.type, torch.get_num_threads(), shapes)
            self._weigh = kernel.bind(room.tables, fields)
        else:
            self._weigh = partial(weigh_postures, room.layout, room.tables, fields)

    def choose(self, running: OpenDecisions, where: Tensor) -> OpenDecisions:
        """Choose postures where a press begins, or where its last primitive made no progress.

        Args:
            running: the decisions.
            where: rooms that follow their fields, bool (rooms,).
        """
        is_press = running.goal < self._room.layout.targets
        rooms = (where & is_press & ((running.age == 0) | (running.stalled > 0))).nonzero().squeeze(1)
        if len(rooms) == 0:
            return running
        goal = running.goal.clamp(0, self._room.layout.targets - 1)
        # a compiled kernel takes a fixed number of rooms
        part = self._part or len(rooms)
        padded = torch.cat([rooms, rooms.new_zeros(-len(rooms) % part)])
        found = torch.cat([self._weigh(self._room.state, goal, some) for some in padded.split(part)], dim=1)
        return running._replace(postures=running.postures.index_copy(1, rooms, found[:, : len(rooms)]))


@lru_cache(maxsize=64)
def _compile_weighing(layout: Layout, device: str, threads: int, shapes: tuple) -> CompiledStep:
    """Compile the weighing for one shape of batch."""
    return CompiledStep(partial(weigh_postures, layout), device, threads)
