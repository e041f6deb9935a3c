"""Cost-to-go fields: the fewest primitives from anywhere on the floor to a goal, approximately.

The floor is cut into cells of a quarter of a move; from a representative place in each, every
move at every heading is swept exactly and its end rounded to a cell. A Dijkstra search from
the goal over these links, turned round, prices all cells and headings at once (Dial 1969).
Links are shared by all goals of a room and fields are cached by goal, so a field is the
memory that makes later searches short. Prices are estimates: `tracking.py` searches exact poses.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint, compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.options.collision import CollisionMap, list_cells
from hrl_escape.options.lattice import spreading
from hrl_escape.options.lattice.sweeps import Scene

__all__ = ["FieldMaker"]

MOST_STATES = 1_500_000
CACHE_BYTES = 256_000_000


class FieldMaker:
    """Links between the cells of one room, and the fields made from them.

    Headings matter modulo 90 degrees to a robot that strafes, so links know `classes`
    headings: the turn steps of a quarter turn, or all of them where 90 degrees is no whole
    number of turns. Cells are a quarter of a move wide, at most 0.25 m, and wider where a room
    would have more than 1.5 million (cell, class) states; links then stand for several moves
    in a row, so that a link still spans about four cells.

    Attributes:
        door_shut: whether there is a door and it stands.
        collision: the clearances it was built from.
        headings: turn steps of a whole turn.
        low: corner of the grid, shape (2,), m.
        size: side of a cell, m.
        macro: primitives that a link stands for.
        span: length of a link that nothing blocks, m.
        bin_size: what a search should tell poses apart by, m.
        shape: (columns, rows) of cells.
        classes: headings told apart.
        scene: the room for the compiled kernels.
        points: representative place of each cell, shape (cells, 2), m.
        standing: whether the body fits there, shape (cells,), bool.
        targets: footprints of the room's targets, shape (targets, 7).
    """

    def __init__(self, instance: RoomInstance, rules: Rules, *, door_shut: bool, refinement: int = 0) -> None:
        """Build the grid and its links.

        Args:
            instance: the room.
            rules: its rules, for headings and touching.
            door_shut: whether the exit door, if there is one, stands.
            refinement: halve the cells this often.
        """
        step = instance.robot.move_step
        self.door_shut = door_shut and instance.door is not None
        self.headings = rules.headings
        self.classes = rules.headings // math.gcd(rules.headings, 4)
        area = 4 * instance.reach_x * instance.reach_y
        self.size = max(min(step / 4, 0.25), math.sqrt(area * self.classes / MOST_STATES)) / 2**refinement
        self.macro = max(1, round(4 * self.size / step))
        self.bin_size = min(self.size / 2, step / 4)
        self._turn_step = rules.turn_step
        self.targets = stack_footprints([target.footprint for target in instance.targets])
        self.span = self.macro * step
        self.collision = CollisionMap(instance, door_shut=door_shut, reach=min(self.span, 2.0))
        self.low = self.collision.low
        self.shape = (math.ceil(2 * instance.reach_x / self.size), math.ceil(2 * instance.reach_y / self.size))
        door = len(instance.solids) if self.door_shut else -1
        self.scene = _make_scene(self.collision, door, self.span)
        self.points, self.standing = spreading.place_points(self.scene, self.low, self.size, *self.shape)
        angles = np.arange(self.classes) * rules.turn_step
        ahead = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
        self._moves = self.span * np.stack([ahead, -ahead, aside, -aside], axis=1)  # (classes, 4, 2)
        self._links = spreading.link_cells(
            self.scene, self.points, self.standing, self.shape[1], self.low, self.size, self._moves, self.macro
        )
        self._fields: OrderedDict[object, NDArray[np.int16]] = OrderedDict()

    @cached_property
    def everywhere(self) -> NDArray[np.bool_]:
        """Every cell allowed."""
        return np.ones(len(self.points), dtype=bool)

    def make_field(self, goal: Footprint, reach: float, *, facing: NDArray[np.bool_] | None = None,
                   allowed: NDArray[np.bool_] | None = None) -> NDArray[np.int16]:
        """Price the floor for a goal: the body's axis within `reach` of a footprint.

        Args:
            goal: footprint of the goal.
            reach: largest distance from it, m.
            facing: headings at which it is reached, shape (headings,); by default any heading will do.
            allowed: cells that may be used, shape (cells,); all of them by default.

        Returns:
            Shape (cells * classes,), int16, or (cells * headings,) if `facing` is given; -1 where the
            goal cannot be reached.
        """
        row = stack_footprints([goal])[0]
        away = compute_distance_many(self.points, row[None])
        inside = np.flatnonzero(self.standing & (away <= reach))
        close = np.flatnonzero(self.standing & (away > reach) & (away <= reach + self.span))
        last = spreading.find_last_moves(self.scene, self.points, close, self._moves, self.macro, row, reach)
        headings = np.arange(self.classes) if facing is None else np.flatnonzero(facing)
        layers = self.classes if facing is None else self.headings
        last = last[:, headings % self.classes]
        which, column = np.nonzero(last)
        states = (inside[:, None] * layers + headings).ravel()
        states = np.concatenate([states, close[which] * layers + headings[column]])
        costs = np.zeros(len(states), dtype=np.int64)
        costs[len(inside) * len(headings) :] = last[which, column]
        return self.spread(states, costs, layers, allowed)

    def spread(self, states: NDArray[np.int64], costs: NDArray[np.int64], headings: int,
               allowed: NDArray[np.bool_] | None = None) -> NDArray[np.int16]:
        """Price the floor from states (cell * headings + heading) with what remains to be paid there.

        Returns:
            Shape (cells * headings,), int16; -1 where none of the states can be reached. Cells
            in which the body does not fit take the least price beside them.
        """
        allowed = self.everywhere if allowed is None else allowed
        order = np.argsort(costs, kind="stable")
        seeds, seed_costs = states[order].astype(np.int64), costs[order].astype(np.int64)
        field = spreading.spread_costs(*self._links, self.classes, headings, allowed, seeds, seed_costs)
        return spreading.fill_gaps(field, self.standing & allowed, headings, self.shape[1])

    def get(self, key: object, make: Callable[[], NDArray[np.int16]]) -> NDArray[np.int16]:
        """A field by its key, made when first asked for; the least recently used go beyond 256 MB."""
        field = self._fields.get(key)
        if field is None:
            field = self._fields[key] = make()
            while len(self._fields) > 1 and sum(f.nbytes for f in self._fields.values()) > CACHE_BYTES:
                self._fields.popitem(last=False)
        self._fields.move_to_end(key)
        return field

    @property
    def states(self) -> int:
        """Number of (cell, class) states."""
        return len(self.points) * self.classes

    def get_cost(self, field: NDArray[np.int16], state: RoomState) -> int:
        """A field's price of a pose; -1 where the goal cannot be reached from there."""
        i, j = np.floor((np.array([state.x, state.y]) - self.low) / self.size).astype(int)
        if not (0 <= i < self.shape[0] and 0 <= j < self.shape[1]):
            return -1
        layers = len(field) // len(self.points)
        layer = (state.heading_steps + round(state.heading_offset / self._turn_step)) % layers
        return int(field[(i * self.shape[1] + j) * layers + layer])


def _make_scene(collision: CollisionMap, door: int, span: float) -> Scene:
    """Arrange a room's solids by floor cell for the sweeps."""
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
    return Scene(
        collision.solids, door, collision.radius, collision.low, size, np.array(shape), starts.astype(np.int64),
        (np.concatenate(items) if items else np.zeros(0, dtype=np.int32))[order], collision.distance,
        collision.resolution, collision.slack,
    )
