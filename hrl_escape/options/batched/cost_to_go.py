"""Cost-to-go fields for a batch of rooms: one for every press and one for the exit, defined at any pose.

Each instance's fields start from estimates on the planners' grid (`lattice/cost_to_go.py`), are
found together by value iteration on a finer one (`value_iteration.py`), and are kept for later batches. Body
presses only: the cost-to-go of a hand depends on every joint of every room.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.poses import TensorState
from hrl_escape.env.batched.tables import Layout, pick
from hrl_escape.env.geometry import compute_distance_many
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.batched.value_iteration import UNREACHABLE, encode_values, iterate_values, trace_moves
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.lattice.areas import compute_goal_area
from hrl_escape.planning.lattice.cost_to_go import FieldMaker, lay_grid
from hrl_escape.planning.lattice.dijkstra_kernels import choose_points

__all__ = [
    "OTHER_PRESS_COST",
    "GridPlace",
    "CostFields",
    "check_presses",
    "classify_headings",
    "compute_instance_fields",
    "locate",
    "interpolate_cost",
    "stack_fields",
]

OTHER_PRESS_COST = 100.0
"""Cost of touching another target: an option does so only where nothing else leads to its goal."""
MOST_BYTES = 512_000_000
_FINE_STATES = 600_000  # cells are halved, at most twice, up to this many (cell, heading) states
_TOLERANCE, _SWEEPS = 0.02, 80


@dataclasses.dataclass(frozen=True, eq=False)
class InstanceFields:
    """The fields of one instance.

    Attributes:
        values: int16 (fields, cells, classes): cost-to-go over `scales`; -1 where there is no way. The order is
            press 0 with the puzzle unsolved, press 0 with it solved, press 1 ..., and last the exit.
        scales: primitives per unit of `values`, float32 (fields,).
        low: corner of the grid, m.
        size: side of a cell, m.
        shape: columns and rows of cells.
        offset: heading offset from whole turn steps that the fields are for, rad.
    """

    values: NDArray[np.int16]
    scales: NDArray[np.float32]
    low: tuple[float, float]
    size: float
    shape: tuple[int, int]
    offset: float


class CostFields(NamedTuple):
    """Fields of all instances of a batch, as tensors on its device; the last axis is the instance.

    Attributes:
        values: all fields, one after the other, int16 (numbers,).
        begins: index in `values` of the start of each field, int64 (fields, instances).
        scales: primitives per unit of `values`, float32 (fields, instances).
        grid: x and y of the grid's corner, m, and cells a metre, float64 (3, instances).
        shape: columns and rows of cells, int64 (2, instances).
        offsets: heading offsets that the fields are for, rad, float64 (1, instances).
        classes: heading classes, int64 ().
    """

    values: Tensor
    begins: Tensor
    scales: Tensor
    grid: Tensor
    shape: Tensor
    offsets: Tensor
    classes: Tensor


_CACHE: OrderedDict[str, InstanceFields] = OrderedDict()
_LOCK = threading.Lock()


def check_presses(instance: RoomInstance) -> None:
    """Check that presses and the exit are all that there is to do in a room.

    Raises:
        UnsupportedError: things are gripped or pushed, or stand behind inner doors, or the base is a rectangle.
    """
    if instance.robot.footprint == "rectangle":
        raise UnsupportedError("batched options drive discs: use OptionsEnv over rooms with a rectangular base")
    if instance.inner_doors:
        raise UnsupportedError("batched options know no inner doors: use OptionsEnv over one room")
    if any(operator.action != "press" for operator in instance.symbolic_model.operators):
        raise UnsupportedError("batched options press and leave, they do not grip: use OptionsEnv over one room")


def compute_instance_fields(instance: RoomInstance) -> InstanceFields:
    """Compute the fields of an instance, some tenths of a second, once; later calls find them by its id.

    Raises:
        UnsupportedError: targets of this room are pressed by hand, asked to be gripped, or behind inner doors; or the
            base is a rectangle.
    """
    if instance.dynamics.press_with == "hand":
        raise UnsupportedError("there are no cost-to-go fields for presses by hand: ask the room's planner")
    check_presses(instance)
    with _LOCK:
        found = _CACHE.get(instance.id)
        if found is None:
            found = _CACHE[instance.id] = _compute(instance)
            while len(_CACHE) > 1 and sum(fields.values.nbytes for fields in _CACHE.values()) > MOST_BYTES:
                _CACHE.popitem(last=False)
        _CACHE.move_to_end(instance.id)
        return found


def _compute(instance: RoomInstance) -> InstanceFields:
    rules = Kinematics(instance, is_still=True)
    offsets = {start.heading_offset for start in instance.starts}
    offset = offsets.pop() if len(offsets) == 1 and not instance.dynamics.noise else 0.0
    presses: list[Goal] = [PressGoal(i) for i in range(len(instance.targets))]
    unsolved = [(goal, False) for goal in presses]
    solved = [*((goal, True) for goal in presses), (ExitGoal(), False)]
    grid = _FieldGrid(instance, rules, offset, door_shut=True)
    if instance.door is None:
        values, scales = grid.compute_fields(unsolved + solved)
    else:
        opened = _FieldGrid(instance, rules, offset, door_shut=False).compute_fields(solved)
        shut = grid.compute_fields(unsolved)
        values, scales = np.concatenate([shut[0], opened[0]]), np.concatenate([shut[1], opened[1]])
    order = [*np.arange(2 * len(presses)).reshape(2, -1).T.ravel(), 2 * len(presses)]
    return InstanceFields(values[order], scales[order], (float(grid.maker.low[0]), float(grid.maker.low[1])),
                          grid.size, grid.shape, offset)


class _FieldGrid:
    """Grid of one room with its door, if any, shut or open, on which fields are computed."""

    def __init__(self, instance: RoomInstance, rules: Kinematics, offset: float, door_shut: bool) -> None:
        self._instance, exit_ = instance, instance.exit
        self.maker = maker = FieldMaker(instance, rules, door_shut=door_shut)
        self._refinement = min(int(math.log(max(_FINE_STATES / maker.states, 1.0), 4)), 2)
        _, self.size, self.shape = lay_grid(instance, rules, self._refinement)
        points, standing = np.empty((math.prod(self.shape), 2)), np.zeros(math.prod(self.shape), dtype=np.bool_)
        choose_points(maker.scene, maker.low, self.size, self.shape[1], 0, self.shape[0], np.ones_like(standing),
                      points, standing)
        self._standing = standing
        angles = np.arange(maker.classes) * rules.turn_step + offset
        moves = instance.robot.move_step * rules.actions.compute_moves(np.cos(angles), np.sin(angles))
        reaches = np.array([instance.compute_press_reach(target) for target in instance.targets], dtype=np.float64)
        self._moves = trace_moves(maker.scene, points, standing, self.shape[1], maker.low, self.size, moves,
                                  maker.targets, reaches,
                                  np.array([exit_.x_min, exit_.x_max, exit_.y_min, exit_.y_max]))
        self._touches = np.array([compute_distance_many(maker.points, row[None]) <= reach
                                  for row, reach in zip(maker.targets, reaches, strict=True)]
                                 ).reshape(-1, len(maker.points))
        x, y = maker.points.T
        self._is_outside = (x < exit_.x_min) | (x > exit_.x_max) | (y < exit_.y_min) | (y > exit_.y_max)

    def compute_fields(self, goals: Sequence[tuple[Goal, bool]]) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Compute the cost-to-go of goals, each beside whether entering the exit ends the episode without it.

        Returns:
            `values` and `scales` of `InstanceFields`.
        """
        columns, rows = (np.arange(side) >> self._refinement for side in self.shape)
        cells = (columns[:, None] * self.maker.shape[1] + rows).ravel()
        estimates = {goal: self._estimate(goal) for goal in dict.fromkeys(goal for goal, _ in goals)}
        values = np.stack([estimates[goal][leaves].T[:, cells] for goal, leaves in goals], axis=2)
        values = np.where(self._standing[:, None], values, np.float32(UNREACHABLE)).reshape(self.maker.classes, -1)
        own = np.array([1 << goal.target if isinstance(goal, PressGoal) else 0 for goal, _ in goals], dtype=np.uint64)
        iterate_values(values, self._moves, own, np.array([leaves for _, leaves in goals]),
                       np.float32(OTHER_PRESS_COST), np.float32(_TOLERANCE), _SWEEPS)
        return encode_values(values, len(goals))

    def _estimate(self, goal: Goal) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Estimate the cost-to-go of a goal on the planners' grid, float32 (cells, classes), twice.

        Presses go round the exit, in the first estimate where that is possible, in the second always.
        """
        maker = self.maker
        is_press = isinstance(goal, PressGoal)
        others = np.delete(self._touches, goal.target, axis=0) if is_press else self._touches
        seeds = maker.find_seeds(*compute_goal_area(goal, self._instance))
        stays = self._is_outside if is_press else maker.everywhere
        allowed = stays & ~others.any(axis=0)
        costs = [maker.make_field(seeds, allowed)] * 2
        if (costs[0].reshape(-1, maker.classes)[maker.standing & allowed] < 0).any():
            # some places can be left only past another target or through the exit
            wider = maker.make_field(seeds), maker.make_field(seeds, stays)
            costs = [np.where((least < 0) & (more >= 0), more + np.int16(OTHER_PRESS_COST), least)
                     for least, more in zip(costs, wider, strict=True)]
        first, second = (np.where(cost >= 0, cost, np.float32(UNREACHABLE)).reshape(-1, maker.classes)
                         for cost in costs)
        return first, second


def stack_fields(instances: Sequence[RoomInstance], device: torch.device) -> CostFields:
    """Put the fields of several instances on a device; equal instances share theirs."""
    each = [compute_instance_fields(instance) for instance in instances]
    unique = {id(fields): fields for fields in each}
    firsts, total = {}, 0
    for key, fields in unique.items():
        firsts[key] = total
        total += fields.values.size

    most = 2 * len(instances[0].frame.target_names) + 1

    def pad(fields: InstanceFields) -> list[int]:
        """Numbers of a room's fields; absent targets, whose presses are masked, take that of the exit."""
        last = len(fields.values) - 1
        return [*range(last), *[last] * (most - last)]

    def column(rows: Sequence[Sequence[float]], dtype: torch.dtype) -> Tensor:
        return torch.tensor(rows, dtype=dtype).T.contiguous().to(device)

    return CostFields(
        values=torch.from_numpy(np.concatenate([fields.values.ravel() for fields in unique.values()])).to(device),
        begins=column([[firsts[id(p)] + k * p.values[0].size for k in pad(p)] for p in each], torch.int64),
        scales=column([p.scales[pad(p)].tolist() for p in each], torch.float32),
        grid=column([(*p.low, 1.0 / p.size) for p in each], torch.float64),
        shape=column([p.shape for p in each], torch.int64),
        offsets=column([(p.offset,) for p in each], torch.float64),
        classes=torch.tensor(each[0].values.shape[2], device=device),
    )


class GridPlace(NamedTuple):
    """Grid coordinates of positions, for interpolation; all fields (..., rooms).

    Attributes:
        cell: the lowest of the four cells round the position, int64.
        across: share of the way to the next column, float32.
        along: share of the way to the next row, float32.
    """

    cell: Tensor
    across: Tensor
    along: Tensor


def locate(layout: Layout, fields: CostFields, instance: Tensor, x: Tensor, y: Tensor) -> GridPlace:
    """Find the cells round positions (..., rooms) in each room's own grid."""
    low_x, low_y, per_metre = pick(layout, fields.grid, instance)
    columns, rows = pick(layout, fields.shape, instance)
    u, v = ((x - low_x) * per_metre - 0.5).clamp(min=0.0), ((y - low_y) * per_metre - 0.5).clamp(min=0.0)
    i, j = torch.minimum(u.to(torch.int64), columns - 2), torch.minimum(v.to(torch.int64), rows - 2)
    across, along = (u - i).clamp(max=1.0), (v - j).clamp(max=1.0)
    return GridPlace(i * rows + j, across.to(torch.float32), along.to(torch.float32))


def interpolate_cost(layout: Layout, fields: CostFields, instance: Tensor, field: Tensor, place: GridPlace,
                     heading: Tensor, between: Tensor | None) -> Tensor:
    """Interpolate the cost-to-go among the cells from which there is a way; float32 (..., rooms).

    Args:
        layout: properties that all rooms share.
        fields: their fields.
        instance: index of each room's instance, int64 (rooms,).
        field: index of the field in its instance, int64 (rooms,).
        place: position, from `locate`.
        heading: class of the heading, int64 (..., rooms).
        between: share of the way to the next class, float32 (rooms,); None if all headings are classes.
    """
    column = torch.zeros_like(instance) if layout.is_shared else instance
    first = fields.begins[field, column] + place.cell * fields.classes
    aside = pick(layout, fields.shape, instance)[1] * fields.classes
    layers = [(heading, torch.ones_like(place.across))]
    if between is not None:
        layers = [(heading, 1.0 - between), (torch.remainder(heading + 1, fields.classes), between)]
    total, weight = torch.zeros_like(place.across), torch.zeros_like(place.across)
    for layer, part in layers:
        for far_x in (False, True):
            for far_y in (False, True):
                at = first + layer + (aside if far_x else 0) + (fields.classes if far_y else 0)
                value = fields.values[at].to(torch.float32)
                share = (place.across if far_x else 1.0 - place.across) * (place.along if far_y else 1.0 - place.along)
                share = torch.where(value < 0.0, 0.0, part * share)
                total, weight = total + share * value, weight + share
    cost = total / weight.clamp(min=1e-6) * fields.scales[field, column]
    return torch.where(weight > 1e-6, cost, UNREACHABLE)


def classify_headings(layout: Layout, fields: CostFields, state: TensorState) -> tuple[Tensor, Tensor | None]:
    """Heading class of each room, int64 (rooms,), and the share of the way to the next class."""
    steps = state.heading_steps.to(torch.int64)
    if not layout.has_offsets:
        return torch.remainder(steps, fields.classes), None
    beyond = (state.heading_offset - pick(layout, fields.offsets, state.instance)[0]) * (layout.headings / math.tau)
    whole = torch.floor(beyond + 1e-9)
    share = (beyond - whole).clamp(min=0.0).to(torch.float32)
    return torch.remainder(steps + whole.to(torch.int64), fields.classes), share
