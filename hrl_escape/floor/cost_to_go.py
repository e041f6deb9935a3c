"""Cost-to-go fields: approximate fewest primitives to a goal from anywhere on the floor.

From a representative place in each cell of a grid, every move at every heading is swept exactly and its end rounded to
a cell. Dijkstra's search from the goal over the reversed links gives the cost-to-go of all cells and headings (Dial
1969). Goals share the links, and fields are cached by goal. They are estimates: `planning/search/primitive_search.py`
searches exact poses.
"""

from __future__ import annotations

import copy
import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.clock import NO_LIMIT, Clock
from hrl_escape.env.floor_grid import FloorGrid, compute_extent_radius
from hrl_escape.env.geometry import Footprint, compute_distance_many, make_footprint, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.floor import dijkstra
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.floor.sweeps import POINT, Presser, make_sweep_scene, turns_anywhere

MOST_STATES = 1_500_000
CACHE_BYTES = 64_000_000
"""Memory for the cached fields of one grid, bytes; a field of a room of 20 m takes 0.1 to 0.3 MB."""
EXPLORED = 8
"""Exploration of a closed area visits at most one in this many cells of the grid from either side."""
SLICE = 100_000
"""States that a kernel processes between two checks of a clock."""


def make_collision(instance: RoomInstance, door_shut: bool) -> CollisionMap:
    """Compute the clearances of a room that searches need."""
    return CollisionMap(instance, door_shut=door_shut, reach=2.0)


class Seeds(NamedTuple):
    """States whose cost-to-go is known before a search."""

    states: NDArray[np.int64]  # cell * headings + heading, shape (n,), int64
    costs: NDArray[np.int64]  # their cost-to-go, shape (n,), int64
    headings: int  # headings that the states distinguish: the grid's classes, or all


class _Landings(NamedTuple):
    """Landings of moves by cell, heading class and translation, shape (cells * classes * moves,)."""

    cells: NDArray[np.int32]  # the cell, or -1
    costs: NDArray[np.int16]  # primitives of the move

    @classmethod
    def make(cls, count: int) -> _Landings:
        """Landings of moves that lead nowhere yet."""
        return cls(np.full(count, -1, dtype=np.int32), np.zeros(count, dtype=np.int16))


class _Links(NamedTuple):
    """Reversed moves: those into state s, a (cell, class), are from `starts[s]` to before `starts[s + 1]`."""

    starts: NDArray[np.int32]  # shape (cells * classes + 1,), int32
    sources: NDArray[np.int32]  # first cell of each, shape (links,), int32
    costs: NDArray[np.int16]  # its primitives, shape (links,), int16


def count_classes(rules: Rules) -> int:
    """Number of heading classes: turn steps of a quarter or half a turn, or more if the steps do not divide it."""
    return rules.headings // math.gcd(rules.headings, rules.symmetry)


def lay_grid(instance: RoomInstance, rules: Rules, refinement: int = 0) -> FloorGrid:
    """Lay a grid over a room's floor as `FieldMaker` describes; each `refinement` halves its cells."""
    area = 4 * instance.reach_x * instance.reach_y
    step = rules.actions.stride
    size = max(min(step / 4, 0.25), math.sqrt(area * count_classes(rules) / MOST_STATES)) / 2**refinement
    return FloorGrid.cover(instance.reach_x, instance.reach_y, size)


class FieldMaker:
    """Grid of one room with the links between its cells, and the fields computed on it.

    A disc that strafes has the same moves at headings 90 degrees apart, one with a differential drive at opposite
    ones, where a rectangle covers the same floor. So links distinguish only `classes` headings: the turn steps of a
    quarter or half a turn, or more if the steps do not divide it. Cells are a quarter of a stride wide, at most 0.25 m,
    and wider where a room would have more than 1.5 million (cell, class) states. A link then represents several moves
    in a row, and a link of strides still spans about four cells.

    Attributes:
        collision: clearances of the room, with its exit door shut if `door_shut`.
        grid: its cells, with the corner `low`, (2,), m, the side `size`, m, and the `shape` (columns, rows).
        headings: turn steps of a full turn.
        macro: primitives of a link; the longest one spans `span`, m.
        bin_size: resolution of poses for a search, m.
        scene: the room for the compiled kernels.
        points: representative place of each cell, shape (cells, 2), m.
        standing: True where the body fits there at some heading, shape (cells,), bool.
        turns: cosine and sine of the heading classes, and of the next one after the last, shape (classes + 1, 2).
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
            collision: clearances of the room with the door in this state, or None to compute them.
            path: places (n, 2) of a path, m; the grid then holds only cells in a corridor round it.
            width: half width of the corridor, in moves.
            clock: time limit.
        """
        step = rules.actions.stride
        self.door_shut = door_shut and instance.door is not None
        self.headings = rules.headings
        self.classes, self.grid = count_classes(rules), lay_grid(instance, rules, refinement)
        self.low, self.size, self.shape = self.grid
        self.macro = max(1, round(4 * self.size / step))
        self.bin_size = min(self.size / 2, step / 4)
        self._turn_step = rules.turn_step
        self.span = self.macro * rules.actions.longest
        self.collision = collision or make_collision(instance, door_shut)
        door = len(instance.solids) if self.door_shut else -1
        self.scene = make_sweep_scene(self.collision, door, self.span)
        angles = np.arange(self.classes) * rules.turn_step
        self.turns = np.array([rules.get_rotation(n % rules.headings, 0.0) for n in range(self.classes + 1)])
        self._moves = rules.actions.compute_moves(np.cos(angles), np.sin(angles), self.macro)
        self._turn_steps = rules.actions.turn_steps
        self._within = self._find_corridor(path, width * max(step, 2 * self.size))
        columns, rows = self.shape
        self.points, self.standing = np.empty((columns * rows, 2)), np.zeros(columns * rows, dtype=np.bool_)
        self._choose_points(0, columns, clock)
        self._choose_headings(clock)
        self._keeps_landings = not refinement  # refined grids are large, and never adapted
        self._landings: _Landings | None = None
        self._known_links: _Links | None = None
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
        return compute_distance_many(self.grid.get_centres(), shapes) <= width

    def _choose_points(self, begin: int, end: int, clock: Clock) -> None:
        rows = self.shape[1]
        stride = max(1, SLICE // rows)
        for first in range(begin, end, stride):
            clock.check()
            dijkstra.choose_points(self.scene, self.low, self.size, rows, first, min(first + stride, end),
                                           self._within, self.points, self.standing)

    def _choose_headings(self, clock: Clock) -> None:
        """Find the headings that fit the base in each cell, and its free turns; for a disc, all of them."""
        self._fits, self._can_turn = None, np.zeros(0, dtype=np.bool_)
        if turns_anywhere(self.scene.outline):
            return
        self._fits, self._can_turn = (np.zeros(self.states, dtype=np.bool_) for _ in range(2))
        stride = max(1, SLICE // self.classes)
        for first in range(0, len(self.points), stride):
            clock.check()
            dijkstra.choose_headings(self.scene, self.points, self.standing, self.turns, self._turn_step, first,
                                             min(first + stride, len(self.points)), self._fits, self._can_turn)

    @property
    def fits(self) -> NDArray[np.bool_]:
        """True where the body fits: shape (cells,), or (cells * classes,) where that depends on its heading."""
        return self.standing if self._fits is None else self._fits

    def get_fits(self, cells: NDArray[np.int64], headings: int) -> NDArray[np.bool_]:
        """Return true where the body fits in some cells at the first headings, shape (cells, headings)."""
        layers = len(self.fits) // len(self.points)
        return self.fits.reshape(-1, layers)[cells][:, np.arange(headings) % layers]

    def _find_landings(self, landings: _Landings, begin: int, end: int, clock: Clock) -> None:
        """Fill in where the moves from some columns of cells land."""
        rows = self.shape[1]
        stride = max(1, SLICE // self.classes)
        for first in range(begin * rows, end * rows, stride):
            clock.check()
            dijkstra.find_landings(self.scene, self.points, self.fits, self.turns, rows, self.low, self.size,
                                           self._moves, self.macro, first, min(first + stride, end * rows), *landings)
        clock.check()

    def _get_links(self, clock: Clock = NO_LIMIT) -> _Links:
        """Links into each cell, found on first use: they take nearly all of a grid's time. Raises `OutOfTime`."""
        if self._known_links is None:
            landings = _Landings.make(self.states * self._moves.shape[1])
            self._find_landings(landings, 0, self.shape[0], clock)
            self._link_cells(landings)
        assert self._known_links is not None
        return self._known_links

    def _link_cells(self, landings: _Landings) -> None:
        """Invert the moves: for each cell, the origins of the moves that end there, and their costs."""
        self._landings = landings if self._keeps_landings else None
        self._known_links = _Links(*dijkstra.link_cells(*landings, self.classes, self._moves.shape[1]))

    # --- edited rooms ------------------------------------------------------------------

    def adapt(self, instance: RoomInstance, collision: CollisionMap, changed: Sequence[Footprint],
              keeps: Callable[[Any], bool]) -> FieldMaker:
        """Return the grid of a room that differs in some solids only, equal to a new grid; the base turns anywhere.

        `changed` are their footprints before and after. Columns of cells that none of them comes near are taken over,
        and fields where no cell has changed and `keeps` says of their key that the goal is still the same.
        """
        new = copy.copy(self)
        new.collision = collision
        new.scene = make_sweep_scene(collision, len(instance.solids) if self.door_shut else -1, self.span)
        new.points, new.standing = self.points.copy(), self.standing.copy()
        near = collision.radius + 3 * self.size + collision.slack
        for begin, end in self._find_columns(changed, near):
            new.standing[begin * self.shape[1] : end * self.shape[1]] = False
            new._choose_points(begin, end, NO_LIMIT)
        new._fields, new._known_links = OrderedDict(), None
        if self._landings is None:  # no field has needed links so far
            return new
        landings = _Landings(*(array.copy() for array in self._landings))
        wide = self.shape[1] * self.classes * self._moves.shape[1]
        for begin, end in self._find_columns(changed, near + self.span + 3 * self.size):
            landings.cells[begin * wide : end * wide], landings.costs[begin * wide : end * wide] = -1, 0
            new._find_landings(landings, begin, end, NO_LIMIT)
        new._link_cells(landings)
        moved = (new.standing != self.standing) | (new.points != self.points).any(axis=1)
        if not moved.any() and all(map(np.array_equal, landings, self._landings)):
            new._fields.update((key, field) for key, field in self._fields.items() if keeps(key))
        return new

    def _find_columns(self, shapes: Sequence[Footprint], around: float) -> list[tuple[int, int]]:
        """Columns of cells within a distance of footprints, as ranges [first, last) apart from each other."""
        spans = sorted(
            (max(0, math.floor((s.x - compute_extent_radius(s) - around - self.low[0]) / self.size)),
             min(self.shape[0], math.ceil((s.x + compute_extent_radius(s) + around - self.low[0]) / self.size)))
            for s in shapes)
        joined: list[tuple[int, int]] = []
        for begin, end in spans:
            if joined and begin <= joined[-1][1]:
                joined[-1] = joined[-1][0], max(end, joined[-1][1])
            elif begin < end:
                joined.append((begin, end))
        return joined

    def find_seeds(self, goal: Footprint, reach: float, facing: NDArray[np.bool_] | None = None,
                   presser: Presser = POINT) -> Seeds:
        """States in a goal, or one move away: the body's axis within `reach` of a footprint, m.

        At any heading, or at the headings `facing` (headings,). Where a rectangle must touch the goal, `reach` alone
        is only necessary.
        """
        row = stack_footprints([goal])[0]
        away = compute_distance_many(self.points, row[None])
        surely = reach - presser.outer + presser.inner  # touches at any heading
        inside = np.flatnonzero(self.standing & (away <= reach))
        close = np.flatnonzero(self.standing & (away > surely) & (away <= reach + self.span))
        here = self._find_touching(inside, row, reach, presser)
        last = dijkstra.find_last_moves(self.scene, self.points, self.fits, self.turns, close, self._moves,
                                                self.macro, row, reach, presser)
        if not turns_anywhere(presser.outline):
            last[self._find_touching(close, row, reach, presser)] = 0
        headings = np.arange(self.classes) if facing is None else np.flatnonzero(facing)
        layers = self.classes if facing is None else self.headings
        last = last[:, headings % self.classes]
        which, column = np.nonzero(last)
        begun, heading = np.nonzero(here[:, headings % self.classes])
        states = np.concatenate([inside[begun] * layers + headings[heading], close[which] * layers + headings[column]])
        costs = np.zeros(len(states), dtype=np.int64)
        costs[len(begun) :] = last[which, column]
        return Seeds(states, costs, layers)

    def _find_touching(self, cells: NDArray[np.int64], goal: NDArray[np.float64], reach: float,
                       presser: Presser) -> NDArray[np.bool_]:
        """Return true where the body fits and touches a goal that the axis is near, shape (cells, classes)."""
        touching = np.ones((len(cells), self.classes), dtype=np.bool_)
        if not turns_anywhere(presser.outline):
            touching = dijkstra.find_touching_cells(self.points, self.turns, cells, goal, reach, presser)
        return touching & self.get_fits(cells, self.classes)

    def make_field(self, seeds: Seeds, allowed: NDArray[np.bool_] | None = None, clock: Clock = NO_LIMIT
                   ) -> NDArray[np.int16]:
        """Field of states with a known cost-to-go, over the cells `allowed` (cells,). Raises `OutOfTime`.

        It has shape (cells * headings,), int16, with the headings of the seeds; -1 where none of them can be reached.
        Cells without room for the body take the least cost-to-go of their neighbours.
        """
        headings = seeds.headings
        allowed = np.ones(len(self.points), dtype=np.bool_) if allowed is None else allowed
        if not allowed[seeds.states // headings].any():
            return np.full(len(self.points) * headings, -1, dtype=np.int16)
        field = np.full(len(self.points) * headings, dijkstra.UNREACHED, dtype=np.int16)
        order = np.argsort(seeds.costs, kind="stable")
        states, costs = seeds.states[order].astype(np.int64), seeds.costs[order].astype(np.int64)
        starts, sources, costs_of_links = self._get_links(clock)
        levels = max(2, int(costs_of_links.max(initial=0)) + 1)
        buckets, filled = np.empty((levels, 4096), dtype=np.int32), np.zeros(levels, dtype=np.int64)
        counts = np.array([0, 0, 0, int(np.diff(starts).max(initial=0))])
        while counts[0] >= 0:
            clock.check()
            buckets = dijkstra.run_dijkstra(starts, sources, costs_of_links, self.classes, headings, self._turn_steps,
                                            self._can_turn, allowed, states, costs, field, buckets, filled,
                                            counts, SLICE)
        known = self.fits & np.repeat(allowed, len(self.fits) // len(allowed))
        return dijkstra.fill_gaps(field, known, headings, self.shape[1])

    def get_field(self, key: object, find_seeds: Callable[[FieldMaker], Seeds], clock: Clock = NO_LIMIT
                  ) -> NDArray[np.int16]:
        """Field under a key, which is all that its seeds depend on; the least recently used give way to new ones."""
        if key not in self._fields:
            self._fields[key] = self.make_field(find_seeds(self), clock=clock)
            while len(self._fields) > 1 and sum(field.nbytes for field in self._fields.values()) > CACHE_BYTES:
                self._fields.popitem(last=False)
        self._fields.move_to_end(key)
        return self._fields[key]

    def has_field(self, key: object) -> bool:
        """Return whether the field under a key is kept."""
        return key in self._fields

    def is_cut_off(self, state: RoomState, seeds: Seeds, allowed: NDArray[np.bool_] | None = None,
                   clock: Clock = NO_LIMIT) -> bool:
        """Return true only if a field of these seeds is -1 at a state, found sooner than the field and its links.

        The states that lead to the seeds, or else the states after this one, are explored up to an eighth of the
        cells. One kernel does each, without checks of the clock.

        Raises:
            OutOfTime: the clock is up before either.
        """
        allowed = np.ones(len(self.points), dtype=np.bool_) if allowed is None else allowed
        wanted, most = self._list_sources(state, seeds.headings, allowed), len(self.points) // EXPLORED
        if not len(wanted):
            return True
        grid = (self.scene, self.points, self.fits, self.turns, self.shape[1], self.low, self.size, self._moves,
                self._turn_steps, self._can_turn, seeds.headings, allowed, seeds.states.astype(np.int64), wanted)
        far = math.ceil(self.span / self.size) + 2  # cells: places are off the centres, and ends are moved to cells
        clock.check()
        if (result := dijkstra.grow_back(*grid, far, most)) == dijkstra.UNDECIDED:
            clock.check()
            result = dijkstra.grow_on(*grid, most)
        return bool(result == dijkstra.CUT_OFF)

    def _list_sources(self, state: RoomState, headings: int, allowed: NDArray[np.bool_]) -> NDArray[np.int64]:
        """States of the grid whose least value is the field at a pose: its own, or its neighbours' if it has none.

        Without any of them a field there is -1.
        """
        columns, rows = self.shape
        if (cell := self.grid.find_number(state.x, state.y)) < 0:
            return np.zeros(0, dtype=np.int64)
        heading, layers = self._find_layer(state, headings), len(self.fits) // len(self.points)
        i, j = divmod(cell, rows)
        cells = np.array([cell, *(at * rows + to for at in range(max(i - 1, 0), min(i + 2, columns))
                                  for to in range(max(j - 1, 0), min(j + 2, rows)))])
        known = self.fits[cells * layers + heading % layers] & allowed[cells]
        return (cells[:1] if known[0] else cells[known]) * headings + heading

    def _find_layer(self, state: RoomState, headings: int) -> int:
        """Heading of a state among the `headings` that a field distinguishes."""
        return (state.heading_steps + round(state.heading_offset / self._turn_step)) % headings

    @property
    def states(self) -> int:
        """Number of (cell, class) states."""
        return len(self.points) * self.classes

    def get_cost(self, field: NDArray[np.int16], state: RoomState) -> int:
        """Cost-to-go of a pose by a field; -1 if the goal cannot be reached from there."""
        cell = self.grid.find_number(state.x, state.y)
        if cell < 0:
            return -1
        layers = len(field) // len(self.points)
        return int(field[cell * layers + self._find_layer(state, layers)])
