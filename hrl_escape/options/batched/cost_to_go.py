"""Cost-to-go fields for a batch of rooms: for every press and for the exit, defined at any pose of the base.

Fields of one instance are found together by value iteration (`value_iteration.py`) on the planners' grid, halved, and
kept for later batches. The goal of a press by the body is a move that begins to touch the target. Arms of kinematic
rooms pass through everything, so the cost-to-go of a press by hand is the least, over a few dozen postures, of the
joint steps to a posture and the way of the base to where the hand then touches. Postures whose hands are close share a
field, and the base's place is shifted by the offset between their hands. Bases that cannot turn just anywhere have
fields of where they fit and turn; that a turn may press is left to the look before the next primitive.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.poses import TensorState
from hrl_escape.env.batched.tables import Layout, pick, pick_column
from hrl_escape.env.geometry import compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.puzzles.mixins import Doored
from hrl_escape.env.tensor_geometry import wrap
from hrl_escape.errors import UnsupportedError
from hrl_escape.floor.cost_to_go import count_classes, lay_grid, make_collision
from hrl_escape.floor.dijkstra import choose_headings, choose_points
from hrl_escape.floor.sweeps import SweepScene, make_presser, make_sweep_scene, turns_anywhere
from hrl_escape.options.batched.aims import Aims, make_aims
from hrl_escape.options.batched.value_iteration import (
    AT_GOAL,
    UNREACHABLE,
    Targets,
    encode_values,
    iterate_values,
    trace_moves,
)
from hrl_escape.planning.areas import get_presser
from hrl_escape.planning.arm.reacher import Reacher
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal

OTHER_PRESS_COST = 100.0
"""Cost of touching another target: an option does so only where nothing else leads to its goal."""
_FINE_STATES = 600_000  # cells are halved, at most twice, up to this many (cell, heading) states
_TOLERANCE, _SWEEPS = 0.5, 80
_NO_TARGET = 1 << 63  # bit of a goal that no move begins to touch
POSTURES = 64
"""Postures kept for a target."""
FAR = 20_000
"""Joint steps of postures that only pad a table, more than the length of any way."""
_MOST, _LEAST = 8, 2  # fields of one target
_NEAR = 0.15  # hands that are this close share a field, m


class PostureLibrary(NamedTuple):
    """Postures that press the targets of one instance."""

    steps: NDArray[np.int32]  # joint steps from home, int32 (targets, postures, joints)
    hands: NDArray[np.float64]  # hand in the base frame, m, float64 (targets, postures, 3)
    fields: NDArray[np.int64]  # number of the field of each, int64 (targets, postures)
    approaches: NDArray[np.float64]  # target of each field, and the hand that it is for, m: rows of (target, x, y, z)
    limit: float  # largest distance of the hand's centre from a target that touches, m


def choose_postures(instance: RoomInstance, fields: int) -> PostureLibrary:
    """Choose postures of all targets: most of them the cheapest from home, the others far apart.

    `fields` limits all fields together, approximately; every target has two to eight.
    """
    count, reacher = len(instance.targets), Reacher(instance)
    steps = np.full((count, POSTURES, instance.robot.joints), FAR, dtype=np.int32)
    hands = np.zeros((count, POSTURES, 3))
    numbers = np.zeros((count, POSTURES), dtype=np.int64)
    approaches: list[tuple[float, ...]] = []
    most = min(max(fields // max(count, 1), _LEAST), _MOST)
    for target in range(count):
        every, places = reacher.list_postures(target)
        if len(every) == 0:
            continue
        chosen = _spread(every, list(range(min(len(every), POSTURES * 7 // 8))), POSTURES, 0.0)
        every, places = every[chosen], places[chosen]
        shown = _spread(places[:, :2], [0], most, _NEAR)
        away = np.linalg.norm(places[:, None, :2] - places[shown, :2], axis=2)
        steps[target, : len(every)], hands[target, : len(every)] = every, places
        numbers[target, : len(every)] = len(approaches) + away.argmin(axis=1)
        approaches += [(target, *places[n].tolist()) for n in shown]
    return PostureLibrary(steps, hands, numbers, np.array(approaches).reshape(-1, 4), reacher.limit)


def _spread(points: NDArray[Any], chosen: list[int], most: int, near: float) -> list[int]:
    """Add the farthest point to those chosen, again and again, up to `most` or until none is farther than `near`."""
    away = np.abs(points[:, None] - points[chosen]).sum(axis=2).min(axis=1)
    while len(chosen) < most and away.max() > near:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.abs(points - points[chosen[-1]]).sum(axis=1))
    return chosen


MOST_BYTES = 512_000_000
_MOST_VALUES = 8_000_000  # largest size of all fields of an instance pressed by hand


@dataclasses.dataclass(frozen=True, eq=False)
class InstanceFields:
    """The fields of one instance."""

    values: NDArray[np.int16]
    """Int16 (fields, cells, classes): cost-to-go over `scales`; -1 where there is no way. The order is press 0 with the
    puzzle unsolved, press 0 with it solved, press 1 ..., and last the exit; by hand the postures' fields in their
    order, and last the exit."""
    scales: NDArray[np.float32]  # primitives per unit of `values`, float32 (fields,)
    low: tuple[float, float]  # corner of the grid, m
    size: float  # side of a cell, m
    shape: tuple[int, int]  # columns and rows of cells
    offset: float  # heading offset from whole turn steps that the fields are for, rad
    postures: PostureLibrary | None = None  # those that press by hand, or None if the body presses


class Postures(NamedTuple):
    """Postures that press the targets of all instances by hand; empty where the body presses."""

    steps: Tensor  # joint steps from home, int32 (joints, postures, targets, instances)
    hands: Tensor  # hand in the base frame, m, float32 (3, postures, targets, instances)
    shifts: Tensor
    """Offset of this hand from the one of the posture's field, m, float32 (2, postures, targets, instances)."""
    fields: Tensor  # number of this field, int64 (postures, targets, instances)


class CostFields(NamedTuple):
    """Fields of all instances of a batch, as tensors on its device; the last axis is the instance."""

    values: Tensor
    """All fields, one after the other, two int16 in each int32 (numbers / 2,), as compilers load no vectors of
    int16."""
    begins: Tensor  # index in `values` of the start of each field, int64 (fields, instances)
    scales: Tensor  # primitives per unit of `values`, float32 (fields, instances)
    grid: Tensor  # x and y of the grid's corner, m, and cells a metre, float64 (3, instances)
    shape: Tensor  # columns and rows of cells, int64 (2, instances)
    offsets: Tensor  # heading offsets that the fields are for, rad, float64 (1, instances)
    classes: Tensor  # heading classes, int64 ()
    postures: Postures  # those that press by hand
    aims: Aims  # what options go for and do there


_CACHE: OrderedDict[str, InstanceFields] = OrderedDict()
_LOCK = threading.Lock()


class FieldGrid:
    """Grid of one room with its door, if any, shut or open: the planners' (`floor/cost_to_go.py`) with cells halved.

    Its corner is `low`, (2,), its cells have the side `size`, m; `states` are cells times headings.
    """

    def __init__(self, instance: RoomInstance, rules: Kinematics, offset: float, door_shut: bool) -> None:
        self._instance, exit_, step = instance, instance.exit, rules.actions.longest
        by_hand = instance.dynamics.press_with == "hand"
        headings = rules.headings if by_hand else count_classes(rules)  # a hand points one way, so all headings differ
        states = lay_grid(instance, rules).cells * headings
        refinement = min(int(math.log(max(_FINE_STATES / states, 1.0), 4)), 2)
        grid = lay_grid(instance, rules, refinement)
        self.low, self.size, self.shape = grid
        collision = make_collision(instance, door_shut)
        scene = make_sweep_scene(collision, len(instance.solids) if door_shut and instance.door else -1, step)
        self._points, self._standing = np.empty((grid.cells, 2)), np.zeros(grid.cells, np.bool_)
        self.states = headings * len(self._points)
        choose_points(scene, self.low, self.size, self.shape[1], 0, self.shape[0],
                      np.ones_like(self._standing), self._points, self._standing)
        angles = np.arange(headings + 1) * rules.turn_step + offset
        self._angles = angles[:-1]
        turns = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        self._turn_steps = rules.actions.turn_steps
        self._fits, self._can_turn = self._choose_headings(scene, turns, rules.turn_step)
        pressed = () if by_hand else instance.targets
        goals = [PressGoal(number) for number in range(len(pressed))]
        targets = Targets(stack_footprints([target.footprint for target in pressed]),
                          np.array([instance.compute_press_reach(target) for target in pressed], dtype=np.float64),
                          np.array([not turns_anywhere(get_presser(goal, instance).outline) for goal in goals],
                                   dtype=np.bool_),
                          make_presser(instance.robot.base))
        moves = rules.actions.compute_moves(turns[:-1, 0], turns[:-1, 1])
        self._moves = trace_moves(scene, self._points, self._fits, turns, self.shape[1], self.low, self.size, moves,
                                  targets, np.array([exit_.x_min, exit_.x_max, exit_.y_min, exit_.y_max]),
                                  instance.dynamics.blocked == "stay")

    def _choose_headings(self, scene: SweepScene, turns: NDArray[np.float64], turn_step: float
                         ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """True where the body fits, (cells, headings), and where each turn is free, (turns, headings, cells).

        A base that turns anywhere has (cells, 1), and no turns.
        """
        headings, cells = len(self._angles), len(self._points)
        if turns_anywhere(scene.outline):
            return self._standing[:, None], np.zeros((0, headings, cells), dtype=np.bool_)
        fits, can_turn = np.zeros((2, cells, headings), dtype=np.bool_)
        choose_headings(scene, self._points, self._standing, turns, turn_step, 0, cells, fits.ravel(),
                        can_turn.ravel())
        free = np.ones((len(self._turn_steps), cells, headings), dtype=np.bool_)
        for number, step in enumerate(self._turn_steps.tolist()):
            for before in range(min(step, 0), max(step, 0)):  # single turns on the way
                free[number] &= np.roll(can_turn, -before, axis=1)
        return fits, np.ascontiguousarray(free.transpose(0, 2, 1))

    def compute_fields(self, goals: Sequence[tuple[Goal, bool]]) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """`values` and `scales` of `InstanceFields`; a goal's flag says that entering the exit ends the episode."""
        own = np.array([1 << goal.target if isinstance(goal, PressGoal) else 0 for goal, _ in goals], dtype=np.uint64)
        return self._iterate(self._make_values(len(goals)), own, [UNREACHABLE * leaves for _, leaves in goals])

    def compute_hand_fields(self, approaches: NDArray[np.float64], limit: float
                            ) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """The same for presses by hand, each in one posture, and last for the exit.

        `approaches` are rows of (target, x, y, z), the hand in the base frame, m; `limit` is the largest distance from
        its centre that touches, m.
        """
        values = self._make_values(len(approaches) + 1)
        for number, (target, *hand) in enumerate(approaches.tolist()):
            heading, cell = self._find_touching(int(target), hand, limit)
            values[heading, cell, number] = AT_GOAL
        own = np.full(len(approaches) + 1, _NO_TARGET, dtype=np.uint64)
        own[-1] = 0
        return self._iterate(values, own, [OTHER_PRESS_COST] * len(approaches) + [0.0])

    def _make_values(self, fields: int) -> NDArray[np.float32]:
        """Initial values, all `UNREACHABLE`, (headings, cells, fields)."""
        return np.full((len(self._angles), len(self._points), fields), UNREACHABLE, dtype=np.float32)

    def _iterate(self, values: NDArray[np.float32], own: NDArray[np.uint64], leaving: Sequence[float]
                 ) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Iterate fields, (headings, cells, fields), that hold the states of their goals; see `iterate_values`."""
        values = values.reshape(len(values), -1)
        iterate_values(values, self._moves, self._turn_steps, self._can_turn, own, np.array(leaving, dtype=np.float32),
                       np.float32(OTHER_PRESS_COST), np.float32(_TOLERANCE), _SWEEPS)
        return encode_values(values, len(own))

    def _find_touching(self, target: int, hand: Sequence[float], limit: float
                       ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Find the headings and cells of all states where a hand at rest touches a target."""
        goal = self._instance.targets[target]
        outline = stack_footprints([goal.footprint])
        beyond = max(abs(hand[2] - goal.z) - goal.half_z, 0.0)
        reach = math.sqrt(max(limit**2 - beyond**2, 0.0))
        cos, sin = np.cos(self._angles), np.sin(self._angles)
        offsets = np.stack([cos * hand[0] - sin * hand[1], sin * hand[0] + cos * hand[1]], axis=1)  # (headings, 2)
        away = compute_distance_many(self._points, outline)
        near = np.flatnonzero(self._standing & (away <= math.hypot(*hand[:2]) + reach))
        places = (self._points[near] + offsets[:, None]).reshape(-1, 2)
        touches = (compute_distance_many(places, outline) <= reach).reshape(len(offsets), -1)
        heading, which = np.nonzero(touches & self._fits[near].T)
        return heading, near[which]


def compute_instance_fields(instance: RoomInstance) -> InstanceFields:
    """Compute an instance's fields, some tenths of a second, or recall them by its id."""
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
    postures = None
    if instance.dynamics.press_with == "hand":
        grid = FieldGrid(instance, rules, offset, door_shut=False)
        postures = choose_postures(instance, _MOST_VALUES // grid.states)
        values, scales = grid.compute_hand_fields(postures.approaches, postures.limit)
        order = [*range(len(values))]
    else:
        presses: list[Goal] = [PressGoal(i) for i in range(len(instance.targets))]
        unsolved = [(goal, False) for goal in presses]
        solved = [*((goal, True) for goal in presses), (ExitGoal(), False)]
        grid = FieldGrid(instance, rules, offset, door_shut=True)
        if instance.door is None:
            values, scales = grid.compute_fields(unsolved + solved)
        else:
            opened = FieldGrid(instance, rules, offset, door_shut=False).compute_fields(solved)
            shut = grid.compute_fields(unsolved)
            values, scales = np.concatenate([shut[0], opened[0]]), np.concatenate([shut[1], opened[1]])
        order = [*np.arange(2 * len(presses)).reshape(2, -1).T.ravel(), 2 * len(presses)]
    low = (float(grid.low[0]), float(grid.low[1]))
    return InstanceFields(values[order], scales[order], low, grid.size, grid.shape, offset, postures)


def stack_fields(instances: Sequence[RoomInstance], device: torch.device) -> CostFields:
    """Put the fields of several instances on a device; equal instances share theirs.

    Raises:
        UnsupportedError: a room needs more than a batch's options support; raised before any field is computed.
    """
    if any(instance.inner_doors and not isinstance(instance.puzzle, Doored) for instance in instances):
        raise UnsupportedError("batched options do not support cells that shut again; use OptionsEnv over one room")
    aims = make_aims(instances, device)
    each = [compute_instance_fields(instance) for instance in instances]
    unique = {id(fields): fields for fields in each}
    firsts, total = {}, 0
    for key, fields in unique.items():
        firsts[key] = total
        total += fields.values.size

    most = max(2 * len(instances[0].frame.target_names) + 1, *(len(fields.values) for fields in each))

    def pad(fields: InstanceFields) -> list[int]:
        """Indices of a room's fields; those that only pad the table point to the exit's field."""
        last = len(fields.values) - 1
        return [*range(last), *[last] * (most - last)]

    def column(rows: Sequence[Sequence[float]], dtype: torch.dtype) -> Tensor:
        return torch.tensor(rows, dtype=dtype).T.contiguous().to(device)

    return CostFields(
        values=torch.from_numpy(np.concatenate([*(fields.values.ravel() for fields in unique.values()),
                                                np.zeros(total % 2, dtype=np.int16)]).view(np.int32)).to(device),
        begins=column([[firsts[id(p)] + k * p.values[0].size for k in pad(p)] for p in each], torch.int64),
        scales=column([p.scales[pad(p)].tolist() for p in each], torch.float32),
        grid=column([(*p.low, 1.0 / p.size) for p in each], torch.float64),
        shape=column([p.shape for p in each], torch.int64),
        offsets=column([(p.offset,) for p in each], torch.float64),
        classes=torch.tensor(each[0].values.shape[2], device=device),
        postures=_stack_postures([fields.postures for fields in each], len(instances[0].frame.target_names),
                                 instances[0].robot.joints, device),
        aims=aims,
    )


def _stack_postures(libraries: Sequence[PostureLibrary | None], targets: int, joints: int, device: torch.device
                    ) -> Postures:
    """Put the postures of several instances on a device; absent targets have none."""
    wide = POSTURES if libraries[0] is not None else 0
    steps = np.full((joints, wide, targets, len(libraries)), FAR, dtype=np.int32)
    hands, shifts = (np.zeros((n, wide, targets, len(libraries)), dtype=np.float32) for n in (3, 2))
    fields = np.zeros((wide, targets, len(libraries)), dtype=np.int64)
    for number, library in enumerate(libraries):
        if library is not None and len(library.approaches):
            count = len(library.steps)
            steps[:, :, :count, number], hands[:, :, :count, number] = library.steps.T, library.hands.T
            shifts[:, :, :count, number] = (library.hands - library.approaches[library.fields, 1:])[..., :2].T
            fields[:, :count, number] = library.fields.T
    return Postures(*(torch.from_numpy(table).to(device) for table in (steps, hands, shifts, fields)))


class GridPlace(NamedTuple):
    """Grid coordinates of positions, for interpolation; all fields (..., rooms)."""

    cell: Tensor  # the lowest of the four cells round the position, int64
    across: Tensor  # share of the way to the next column, float32
    along: Tensor  # share of the way to the next row, float32


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
    """Interpolate the cost-to-go among the cells with a way to the goal; float32 (..., rooms).

    `field` is its number in the room's instance, int64 (rooms,), `place` from `locate`, `heading` its class, int64
    (..., rooms), and `between` the share of the way to the next class, float32 (rooms,), or None if all headings are
    classes.
    """
    column = pick_column(layout, instance)
    first = fields.begins[field, column] + place.cell * fields.classes
    aside = pick(layout, fields.shape, instance)[1] * fields.classes
    layers = [(heading, torch.ones_like(place.across))]
    if between is not None:
        layers = [(heading, 1.0 - between), (wrap(heading + 1, fields.classes), between)]
    total, weight = torch.zeros_like(place.across), torch.zeros_like(place.across)
    for layer, part in layers:
        for far_x in (False, True):
            for far_y in (False, True):
                at = first + layer + (aside if far_x else 0) + (fields.classes if far_y else 0)
                value = _unpack(fields.values, at)
                share = (place.across if far_x else 1.0 - place.across) * (place.along if far_y else 1.0 - place.along)
                share = torch.where(value < 0.0, 0.0, part * share)
                total, weight = total + share * value, weight + share
    cost = total / weight.clamp(min=1e-6) * fields.scales[field, column]
    return torch.where(weight > 1e-6, cost, UNREACHABLE)


def _unpack(values: Tensor, at: Tensor) -> Tensor:
    """Read int16 values from where two are packed in an int32, the first in its low bits; float32."""
    return (values[at >> 1] << (16 * (1 - (at & 1))).to(torch.int32) >> 16).to(torch.float32)


def classify_headings(layout: Layout, fields: CostFields, state: TensorState) -> tuple[Tensor, Tensor | None]:
    """Heading class of each room, int64 (rooms,), and the share of the way to the next class."""
    steps = state.heading_steps.to(torch.int64)
    if not layout.has_offsets:
        return wrap(steps, fields.classes), None
    beyond = (state.heading_offset - pick(layout, fields.offsets, state.instance)[0]) * (layout.headings / math.tau)
    whole = torch.floor(beyond + 1e-9)
    share = (beyond - whole).clamp(min=0.0).to(torch.float32)
    return wrap(steps + whole.to(torch.int64), fields.classes), share
