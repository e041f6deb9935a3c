"""Cost-to-go fields that a batch of rooms looks up: for every press and the exit, at any pose.

Built with the planners' own collision model (`lattice/fields.py`: grid, sweeps, a first
estimate) and smoothed by value iteration (`relaxing.py`), once an instance, and kept for later batches. Body
presses only: what a hand still has to do depends on every joint of every room.
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

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.tensor_instances import Layout, pick
from hrl_escape.env.tensor_poses import TensorState
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.batched.relaxing import FAR, relax, trace_moves
from hrl_escape.options.goals import ExitGoal, Goal, PressGoal
from hrl_escape.options.lattice.areas import compute_area
from hrl_escape.options.lattice.fields import FieldMaker

__all__ = [
    "PENALTY",
    "Place",
    "Prices",
    "classify_headings",
    "compute_prices",
    "find_place",
    "look_up",
    "stack_prices",
]

PENALTY = 100.0
"""What beginning to touch another target costs: an option does it where nothing else leads to its goal."""
CACHE_BYTES = 512_000_000
_FINE_STATES = 600_000  # cells are halved, twice at most, while there are no more (cell, heading) states than that
_TOLERANCE, _SWEEPS, _BETWEEN = 0.02, 80, 4  # sweeps at most, and after how many states are put in order anew
_NONE = -1  # stored where the body does not stand, or where the goal cannot be reached from


@dataclasses.dataclass(frozen=True, eq=False)
class InstancePrices:
    """The fields of one instance.

    Attributes:
        values: int16 (fields, cells, classes): primitives to go over `scales`; -1 where there is no way. Fields are
            press 0 with the puzzle unsolved, press 0 with it solved, press 1 ..., and last the exit.
        scales: primitives that 1 stands for, float32 (fields,).
        low: corner of the grid, m.
        size: side of a cell, m.
        shape: columns and rows of cells.
        offset: the headings' offset from whole turn steps that it was made for, rad.
    """

    values: NDArray[np.int16]
    scales: NDArray[np.float32]
    low: tuple[float, float]
    size: float
    shape: tuple[int, int]
    offset: float


class Prices(NamedTuple):
    """Fields of all instances of a batch, on its device; the last axis is the instance.

    Attributes:
        values: all fields, one after the other, int16 (numbers,).
        begins: where in it each field begins, int64 (fields, instances).
        scales: primitives that 1 stands for, float32 (fields, instances).
        grid: x and y of the grid's corner, m, and cells a metre, float64 (3, instances).
        shape: columns and rows of cells, int64 (2, instances).
        offsets: heading offsets that fields were made for, rad, float64 (1, instances).
        classes: headings told apart, int64 ().
    """

    values: Tensor
    begins: Tensor
    scales: Tensor
    grid: Tensor
    shape: Tensor
    offsets: Tensor
    classes: Tensor


_CACHE: OrderedDict[str, InstancePrices] = OrderedDict()
_LOCK = threading.Lock()


def compute_prices(instance: RoomInstance) -> InstancePrices:
    """The fields of an instance, computed when first asked for (some tenths of a second) and kept by its id.

    Raises:
        UnsupportedError: targets of this room are pressed by hand.
    """
    if instance.dynamics.press_with == "hand":
        raise UnsupportedError("there are no cost-to-go fields for presses by hand: ask the room's planner")
    with _LOCK:
        found = _CACHE.get(instance.id)
        if found is None:
            found = _CACHE[instance.id] = _compute(instance)
            while len(_CACHE) > 1 and sum(prices.values.nbytes for prices in _CACHE.values()) > CACHE_BYTES:
                _CACHE.popitem(last=False)
        _CACHE.move_to_end(instance.id)
        return found


def _compute(instance: RoomInstance) -> InstancePrices:
    quiet = dataclasses.replace(instance.dynamics, noise=0.0, slip=0.0)
    rules = Kinematics(dataclasses.replace(instance, dynamics=quiet))
    offsets = {start.heading_offset for start in instance.starts}
    offset = offsets.pop() if len(offsets) == 1 and not instance.dynamics.noise else 0.0
    floors = [_Floor(instance, rules, offset, is_solved) for is_solved in (False, True)]
    goals: list[Goal] = [PressGoal(i) for i in range(len(instance.targets))]
    fields = [floors[is_solved].price(goal) for goal in goals for is_solved in (False, True)]
    fields.append(floors[instance.door is not None].price(ExitGoal()))
    maker = floors[0].maker
    scales = np.array([max(float(field[field < FAR].max(initial=1.0)), 1.0) / 32_000 for field in fields], np.float32)
    values = np.stack([np.where(field < FAR, np.rint(field / scale), _NONE).astype(np.int16)
                       for field, scale in zip(fields, scales, strict=True)])
    return InstancePrices(values, scales, (float(maker.low[0]), float(maker.low[1])), maker.size, maker.shape, offset)


class _Floor:
    """One room's grid with the puzzle solved or not, from which fields are made."""

    def __init__(self, instance: RoomInstance, rules: Kinematics, offset: float, is_solved: bool) -> None:
        self.instance, self.is_solved = instance, is_solved
        shut = not is_solved
        self.maker = FieldMaker(instance, rules, door_shut=shut)
        refinement = min(int(math.log(max(_FINE_STATES / self.maker.states, 1.0), 4)), 2)
        if refinement:
            self.maker = FieldMaker(instance, rules, door_shut=shut, refinement=refinement)
        maker, exit_ = self.maker, instance.exit
        angles = np.arange(maker.classes) * rules.turn_step + offset
        ahead = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
        moves = instance.robot.move_step * np.stack([ahead, -ahead, aside, -aside], axis=1)
        reaches = np.array([instance.compute_press_reach(target) for target in instance.targets], dtype=np.float64)
        self._links = trace_moves(maker.scene, maker.points, maker.standing, maker.shape[1], maker.low, maker.size,
                                  moves, maker.targets, reaches,
                                  np.array([exit_.x_min, exit_.x_max, exit_.y_min, exit_.y_max]))
        self._touched = self._links[-1]
        x, y = maker.points.T
        self._is_outside = (x < exit_.x_min) | (x > exit_.x_max) | (y < exit_.y_min) | (y > exit_.y_max)

    def price(self, goal: Goal) -> NDArray[np.float32]:
        """Primitives to a goal, float32 (cells, classes); `FAR` where there is no way."""
        maker = self.maker
        area = compute_area(goal, self.instance)
        target = goal.target if isinstance(goal, PressGoal) else -1
        leaves = self.is_solved and target >= 0
        others = self._touched & ~_make_bit(target) != 0
        stays = self._is_outside if leaves else maker.everywhere
        direct, any_way = (maker.make_field(area.footprint, area.reach, allowed=allowed).astype(np.float32)
                           for allowed in (stays & ~others, stays))
        values = np.where(direct >= 0, direct, np.where(any_way >= 0, any_way + PENALTY, FAR)).astype(np.float32)
        values = values.reshape(-1, maker.classes)
        values[~maker.standing] = FAR
        states = np.flatnonzero(np.repeat(maker.standing, maker.classes))
        for _ in range(_SWEEPS // _BETWEEN):
            order = states[np.argsort(values.ravel()[states], kind="stable")]
            if relax(values, order, *self._links, maker.shape[1], target, leaves, PENALTY, _TOLERANCE, _BETWEEN):
                break
        return values


def _make_bit(target: int) -> np.uint64:
    return np.uint64(1 << target if target >= 0 else 0)


def stack_prices(instances: Sequence[RoomInstance], device: torch.device) -> Prices:
    """Put the fields of several instances on a device; instances that are the same share theirs."""
    each = [compute_prices(instance) for instance in instances]
    unique = {id(prices): prices for prices in each}
    firsts, total = {}, 0
    for key, prices in unique.items():
        firsts[key] = total
        total += prices.values.size

    def column(rows: Sequence[Sequence[float]], dtype: torch.dtype) -> Tensor:
        return torch.tensor(rows, dtype=dtype).T.contiguous().to(device)

    return Prices(
        values=torch.from_numpy(np.concatenate([prices.values.ravel() for prices in unique.values()])).to(device),
        begins=column([[firsts[id(p)] + k * p.values[0].size for k in range(len(p.values))] for p in each],
                      torch.int64),
        scales=column([p.scales.tolist() for p in each], torch.float32),
        grid=column([(*p.low, 1.0 / p.size) for p in each], torch.float64),
        shape=column([p.shape for p in each], torch.int64),
        offsets=column([(p.offset,) for p in each], torch.float64),
        classes=torch.tensor(each[0].values.shape[2], device=device),
    )


class Place(NamedTuple):
    """Where positions lie in the grid, as far as looking up takes; all fields (..., rooms).

    Attributes:
        cell: the lowest of the four cells round the position, int64.
        across: share of the way to the next column, float32.
        along: share of the way to the next row, float32.
    """

    cell: Tensor
    across: Tensor
    along: Tensor


def find_place(layout: Layout, prices: Prices, instance: Tensor, x: Tensor, y: Tensor) -> Place:
    """Find the cells round positions (..., rooms) in each room's own grid."""
    low_x, low_y, per_metre = pick(layout, prices.grid, instance)
    columns, rows = pick(layout, prices.shape, instance)
    u, v = ((x - low_x) * per_metre - 0.5).clamp(min=0.0), ((y - low_y) * per_metre - 0.5).clamp(min=0.0)
    i, j = torch.minimum(u.to(torch.int64), columns - 2), torch.minimum(v.to(torch.int64), rows - 2)
    across, along = (u - i).clamp(max=1.0), (v - j).clamp(max=1.0)
    return Place(i * rows + j, across.to(torch.float32), along.to(torch.float32))


def look_up(layout: Layout, prices: Prices, instance: Tensor, field: Tensor, place: Place, heading: Tensor,
            between: Tensor | None) -> Tensor:
    """Primitives to go, interpolated among the cells from which there is a way; float32 (..., rooms).

    Args:
        layout: what the rooms have in common.
        prices: their fields.
        instance: index of each room's instance, int64 (rooms,).
        field: which of its fields, int64 (rooms,).
        place: where, from `find_place`.
        heading: class of the heading, int64 (..., rooms).
        between: share of the way to the next class, float32 (rooms,); None where all headings are classes.
    """
    column = torch.zeros_like(instance) if layout.is_shared else instance
    first = prices.begins[field, column] + place.cell * prices.classes
    aside = pick(layout, prices.shape, instance)[1] * prices.classes
    layers = [(heading, torch.ones_like(place.across))]
    if between is not None:
        layers = [(heading, 1.0 - between), (torch.remainder(heading + 1, prices.classes), between)]
    total, weight = torch.zeros_like(place.across), torch.zeros_like(place.across)
    for layer, part in layers:
        for far_x in (False, True):
            for far_y in (False, True):
                at = first + layer + (aside if far_x else 0) + (prices.classes if far_y else 0)
                value = prices.values[at].to(torch.float32)
                share = (place.across if far_x else 1.0 - place.across) * (place.along if far_y else 1.0 - place.along)
                share = torch.where(value < 0.0, 0.0, part * share)
                total, weight = total + share * value, weight + share
    worth = total / weight.clamp(min=1e-6) * prices.scales[field, column]
    return torch.where(weight > 1e-6, worth, FAR)


def classify_headings(layout: Layout, prices: Prices, state: TensorState) -> tuple[Tensor, Tensor | None]:
    """Class of each heading that fields were made for, int64 (rooms,), and the share of the way to the next one."""
    steps = state.heading_steps.to(torch.int64)
    if not layout.has_offsets:
        return torch.remainder(steps, prices.classes), None
    beyond = (state.heading_offset - pick(layout, prices.offsets, state.instance)[0]) * (layout.headings / math.tau)
    whole = torch.floor(beyond + 1e-9)
    share = (beyond - whole).clamp(min=0.0).to(torch.float32)
    return torch.remainder(steps + whole.to(torch.int64), prices.classes), share
