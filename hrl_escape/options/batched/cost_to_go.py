"""Cost-to-go fields for a batch of rooms: one for every press and one for the exit, defined at any pose.

Each instance's fields start from the planners' grid and first estimate (`lattice/cost_to_go.py`),
are smoothed by value iteration (`value_iteration.py`), and are kept for later batches. Body
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
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.batched.value_iteration import UNREACHABLE, iterate_values, trace_moves
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.lattice.areas import compute_goal_area
from hrl_escape.planning.lattice.cost_to_go import FieldMaker, lay_grid

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
_NONE = -1  # stored where the body does not fit or the goal cannot be reached


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
    shut = _FieldGrid(instance, rules, offset, door_shut=True)
    grids = shut, shut if instance.door is None else _FieldGrid(instance, rules, offset, door_shut=False)
    maker = shut.maker
    goals: list[Goal] = [PressGoal(i) for i in range(len(instance.targets))]
    costs: list[NDArray[np.float32]] = []
    for goal in goals:
        unsolved = shut.compute_costs(goal, is_solved=False)
        costs += unsolved, grids[True].compute_costs(goal, True, unsolved if instance.door is None else None)
    costs.append(grids[True].compute_costs(ExitGoal(), is_solved=True))
    largest = [max(float(field[field < UNREACHABLE].max(initial=1.0)), 1.0) for field in costs]
    scales = np.array([value / 32_000 for value in largest], np.float32)
    values = np.stack([np.where(field < UNREACHABLE, np.rint(field / scale), _NONE).astype(np.int16)
                       for field, scale in zip(costs, scales, strict=True)])
    return InstanceFields(values, scales, (float(maker.low[0]), float(maker.low[1])), maker.size, maker.shape, offset)


class _FieldGrid:
    """Grid of one room with its door, if any, shut or open, on which fields are computed."""

    def __init__(self, instance: RoomInstance, rules: Kinematics, offset: float, door_shut: bool) -> None:
        states = lay_grid(instance, rules).states
        refinement = min(int(math.log(max(_FINE_STATES / states, 1.0), 4)), 2)
        self.instance, exit_ = instance, instance.exit
        self.maker = maker = FieldMaker(instance, rules, door_shut=door_shut, refinement=refinement)
        angles = np.arange(maker.classes) * rules.turn_step + offset
        moves = instance.robot.move_step * rules.actions.compute_moves(np.cos(angles), np.sin(angles))
        reaches = np.array([instance.compute_press_reach(target) for target in instance.targets], dtype=np.float64)
        self._links = trace_moves(maker.scene, maker.points, maker.standing, maker.shape[1], maker.low, maker.size,
                                  moves, maker.targets, reaches,
                                  np.array([exit_.x_min, exit_.x_max, exit_.y_min, exit_.y_max]))
        self._touched = self._links[-1]
        self._states = np.flatnonzero(np.repeat(maker.standing, maker.classes))
        x, y = maker.points.T
        self._is_outside = (x < exit_.x_min) | (x > exit_.x_max) | (y < exit_.y_min) | (y > exit_.y_max)

    def compute_costs(self, goal: Goal, is_solved: bool, unsolved: NDArray[np.float32] | None = None
                      ) -> NDArray[np.float32]:
        """Compute the cost-to-go of a goal, float32 (cells, classes); `UNREACHABLE` where there is no way.

        Args:
            goal: a press, or the exit.
            is_solved: the exit is open, and entering it for a press ends the episode.
            unsolved: costs of the same press on this grid where it is not: most of them are right.
        """
        maker = self.maker
        area = compute_goal_area(goal, self.instance)
        target = goal.target if isinstance(goal, PressGoal) else -1
        leaves = is_solved and target >= 0
        if unsolved is not None:
            values = np.where(self._is_outside[:, None], unsolved, np.float32(UNREACHABLE))  # nobody stays in the exit
            if self._iterate(values, target, leaves, is_near=True):
                return values
        others = self._touched & ~_make_bit(target) != 0
        stays = self._is_outside if leaves else maker.everywhere
        seeds = maker.find_seeds(*area)
        costs = maker.make_field(seeds, stays & ~others)
        if (costs.reshape(-1, maker.classes)[maker.standing & stays & ~others] < 0).any():
            # some places can be left only past another target
            any_way = maker.make_field(seeds, stays)
            costs = np.where((costs < 0) & (any_way >= 0), any_way + np.int16(OTHER_PRESS_COST), costs)
        values = np.where(costs >= 0, costs, np.float32(UNREACHABLE)).reshape(-1, maker.classes)
        values[~maker.standing] = UNREACHABLE
        self._iterate(values, target, leaves, is_near=False)
        return values

    def _iterate(self, values: NDArray[np.float32], target: int, leaves: bool, is_near: bool) -> bool:
        """Run value iteration in place; returns True if it has come to an end."""
        order = self._states[np.argsort(values.ravel()[self._states].astype(np.int16), kind="stable")]
        return iterate_values(values, order, *self._links, self.maker.shape[1], target, leaves, OTHER_PRESS_COST,
                              _TOLERANCE, _SWEEPS, is_near)


def _make_bit(target: int) -> np.uint64:
    return np.uint64(1 << target if target >= 0 else 0)


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
