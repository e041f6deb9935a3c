"""Cost-to-go fields: approximate fewest primitives to a goal from anywhere on the floor.

The floor is a grid with cells of a quarter of a move. From a representative place in each cell,
every move at every heading is swept exactly and its end rounded to a cell. Dijkstra's search from
the goal over the reversed links gives the cost-to-go of all cells and headings (Dial 1969). All
goals of a room share the links, and fields are cached by goal, which makes later searches short.
Fields are estimates: `primitive_search.py` searches exact poses.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.geometry import Footprint, compute_distance_many, make_footprint, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.planning.clock import NO_LIMIT, Clock
from hrl_escape.planning.collision_map import CollisionMap, list_cells
from hrl_escape.planning.lattice import dijkstra_kernels
from hrl_escape.planning.lattice.sweep_kernels import SweepScene

__all__ = ["FieldMaker", "make_collision"]

MOST_STATES = 1_500_000
CACHE_BYTES = 256_000_000
SLICE = 100_000
"""States that a kernel works on between two looks at a clock."""


def make_collision(instance: RoomInstance, door_shut: bool) -> CollisionMap:
    """Compute the clearances of a room that searches need."""
    return CollisionMap(instance, door_shut=door_shut, reach=2.0)


class FieldMaker:
    """Grid of one room with the links between its cells, and the fields computed on it.

    A robot that strafes has the same moves at headings 90 degrees apart, so links distinguish
    only `classes` headings: the turn steps of a quarter turn, or all of them where 90 degrees is no
    whole number of turns. Cells are a quarter of a move wide, at most 0.25 m, and wider where a
    room would have more than 1.5 million (cell, class) states; a link then stands for several
    moves in a row, so that it still spans about four cells.

    Attributes:
        door_shut: True if there is a door and it is shut.
        collision: clearances of the room.
        headings: turn steps of a full turn.
        low: corner of the grid, shape (2,), m.
        size: side of a cell, m.
        macro: primitives of a link.
        span: length of a link that nothing blocks, m.
        bin_size: resolution of poses for a search, m.
        shape: (columns, rows) of cells.
        classes: heading classes.
        scene: the room for the compiled kernels.
        points: representative place of each cell, shape (cells, 2), m.
        standing: True where the body fits there, shape (cells,), bool.
        targets: footprints of the room's targets, shape (targets, 7).
    """

    def __init__(self, instance: RoomInstance, rules: Rules, *, door_shut: bool, refinement: int = 0,
                 collision: CollisionMap | None = None, path: NDArray[np.float64] | None = None, width: float = 0.0,
                 clock: Clock = NO_LIMIT) -> None:
        """Build the grid and its links. Raises `OutOfTime`.

        Args:
            instance: the room.
            rules: its rules, for headings and touching.
            door_shut: True to shut the exit door, if there is one.
            refinement: number of times that the cells are halved.
            collision: clearances of the room with the door like that; None to compute them.
            path: places (n, 2) of a path, m; the grid then holds only cells in a corridor round it.
            width: half width of the corridor, in moves.
            clock: time limit.
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
        self.collision = collision or make_collision(instance, door_shut)
        self.low = self.collision.low
        self.shape = (math.ceil(2 * instance.reach_x / self.size), math.ceil(2 * instance.reach_y / self.size))
        door = len(instance.solids) if self.door_shut else -1
        self.scene = _make_scene(self.collision, door, self.span)
        angles = np.arange(self.classes) * rules.turn_step
        self._moves = self.span * rules.actions.compute_moves(np.cos(angles), np.sin(angles))
        self._choose_points(self._find_corridor(path, width * max(step, 2 * self.size)), clock)
        self._links = self._link_cells(clock)
        self._fields: OrderedDict[object, NDArray[np.int16]] = OrderedDict()

    def _find_corridor(self, path: NDArray[np.float64] | None, width: float) -> NDArray[np.bool_]:
        """Cells whose centres are within a distance of a path; all without one."""
        if path is None:
            return np.ones(self.shape[0] * self.shape[1], dtype=np.bool_)
        legs = np.diff(path, axis=0)
        shapes = stack_footprints([
            make_footprint(x, y, math.hypot(dx, dy) / 2, 0.0, math.atan2(dy, dx))
            for (x, y), (dx, dy) in zip((path[:-1] + legs / 2).tolist(), legs.tolist(), strict=True)
        ])
        centres = self.low + (list_cells((0, 0), self.shape) + 0.5) * self.size
        return compute_distance_many(centres, shapes) <= width

    def _choose_points(self, within: NDArray[np.bool_], clock: Clock) -> None:
        columns, rows = self.shape
        self.points, self.standing = np.empty((columns * rows, 2)), np.zeros(columns * rows, dtype=np.bool_)
        stride = max(1, SLICE // rows)
        for first in range(0, columns, stride):
            clock.check()
            dijkstra_kernels.choose_points(self.scene, self.low, self.size, rows, first, min(first + stride, columns),
                                           within, self.points, self.standing)

    def _link_cells(self, clock: Clock) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int16]]:
        cells, translations = len(self.points), self._moves.shape[1]
        landing = np.full(self.states * translations, -1, dtype=np.int32)
        link_cost = np.zeros(self.states * translations, dtype=np.int16)
        starts = np.zeros(self.states + 1, dtype=np.int32)
        stride = max(1, SLICE // self.classes)
        for first in range(0, cells, stride):
            clock.check()
            dijkstra_kernels.find_landings(self.scene, self.points, self.standing, self.shape[1], self.low, self.size,
                                           self._moves, self.macro, first, min(first + stride, cells), landing,
                                           link_cost, starts)
        clock.check()
        return (starts, *dijkstra_kernels.link_cells(landing, link_cost, starts, self.classes, translations))

    @cached_property
    def everywhere(self) -> NDArray[np.bool_]:
        """Mask that allows every cell."""
        return np.ones(len(self.points), dtype=bool)

    def make_field(self, goal: Footprint, reach: float, *, facing: NDArray[np.bool_] | None = None,
                   allowed: NDArray[np.bool_] | None = None, clock: Clock = NO_LIMIT) -> NDArray[np.int16]:
        """Compute the field of a goal: the body's axis within `reach` of a footprint. Raises `OutOfTime`.

        Args:
            goal: footprint of the goal.
            reach: largest distance from it, m.
            facing: headings that reach it, shape (headings,); by default any heading will do.
            allowed: cells that may be used, shape (cells,); by default all.
            clock: time limit.

        Returns:
            Shape (cells * classes,), int16, or (cells * headings,) if `facing` is given; -1 where the
            goal cannot be reached.
        """
        row = stack_footprints([goal])[0]
        away = compute_distance_many(self.points, row[None])
        inside = np.flatnonzero(self.standing & (away <= reach))
        close = np.flatnonzero(self.standing & (away > reach) & (away <= reach + self.span))
        last = dijkstra_kernels.find_last_moves(self.scene, self.points, close, self._moves, self.macro, row, reach)
        headings = np.arange(self.classes) if facing is None else np.flatnonzero(facing)
        layers = self.classes if facing is None else self.headings
        last = last[:, headings % self.classes]
        which, column = np.nonzero(last)
        states = (inside[:, None] * layers + headings).ravel()
        states = np.concatenate([states, close[which] * layers + headings[column]])
        costs = np.zeros(len(states), dtype=np.int64)
        costs[len(inside) * len(headings) :] = last[which, column]
        return self.make_field_from_states(states, costs, layers, allowed, clock)

    def make_field_from_states(self, states: NDArray[np.int64], costs: NDArray[np.int64], headings: int,
                               allowed: NDArray[np.bool_] | None = None, clock: Clock = NO_LIMIT
                               ) -> NDArray[np.int16]:
        """Compute a field from states (cell * headings + heading) with a known cost-to-go. Raises `OutOfTime`.

        Returns:
            Shape (cells * headings,), int16; -1 where none of the states can be reached. Cells in which
            the body does not fit take the least cost-to-go of their neighbours.
        """
        allowed = self.everywhere if allowed is None else allowed
        order = np.argsort(costs, kind="stable")
        seeds, seed_costs = states[order].astype(np.int64), costs[order].astype(np.int64)
        starts, sources, costs_of_links = self._links
        field = np.full(len(self.points) * headings, dijkstra_kernels.UNREACHED, dtype=np.int16)
        levels = max(2, int(costs_of_links.max(initial=0)) + 1)
        buckets, filled = np.empty((levels, 4096), dtype=np.int32), np.zeros(levels, dtype=np.int64)
        counts = np.array([0, 0, 0, int(np.diff(starts).max(initial=0))])
        while counts[0] >= 0:
            clock.check()
            buckets = dijkstra_kernels.run_dijkstra(starts, sources, costs_of_links, self.classes, headings, allowed,
                                                    seeds, seed_costs, field, buckets, filled, counts, SLICE)
        return dijkstra_kernels.fill_gaps(field, self.standing & allowed, headings, self.shape[1])

    def get_field(self, key: object, make: Callable[[], NDArray[np.int16]]) -> NDArray[np.int16]:
        """Field under a key, computed on first use; beyond 256 MB the least recently used are dropped."""
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
        """Cost-to-go of a pose by a field; -1 if the goal cannot be reached from there."""
        i, j = np.floor((np.array([state.x, state.y]) - self.low) / self.size).astype(int)
        if not (0 <= i < self.shape[0] and 0 <= j < self.shape[1]):
            return -1
        layers = len(field) // len(self.points)
        layer = (state.heading_steps + round(state.heading_offset / self._turn_step)) % layers
        return int(field[(i * self.shape[1] + j) * layers + layer])


def _make_scene(collision: CollisionMap, door: int, span: float) -> SweepScene:
    """Index a room's solids by floor cell, for the sweeps."""
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
    return SweepScene(
        collision.solids, door, collision.radius, collision.low, size, np.array(shape), starts.astype(np.int64),
        (np.concatenate(items) if items else np.zeros(0, dtype=np.int32))[order], collision.distance,
        collision.resolution, collision.slack,
    )
