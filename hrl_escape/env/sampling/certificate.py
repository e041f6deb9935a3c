"""Certificate of a room's geometry: the start, a touching place for each target, and the exit are connected.

It uses a conservative grid over the floor. A straight move that keeps the clearance and some slack joins two
neighbouring free cells. Cells connected in the grid are therefore connected in the room. Operations are counted against
a budget, which ends sampling after the same amount of work on every machine.

For a rectangular base the certificate covers the largest disc inside its outline. The search in `primitive_proof.py`
then proves the room for the rectangle itself.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import CONTACT_SKIN, PASSAGE_SLACK, compute_resolution
from hrl_escape.env.floor_grid import FloorGrid, label_parts
from hrl_escape.env.geometry import (
    Footprint,
    Neighbourhood,
    Solid,
    compute_distance,
    compute_distance_many,
    compute_first_contact,
    stack_footprints,
)
from hrl_escape.env.instance import Rectangle, RoomInstance, Start, Target, does_base_fit
from hrl_escape.env.robot import make_robot, sample_hand_positions
from hrl_escape.env.sampling.floorplan import Rejected

_ARM_THICKNESS = 0.1  # m, around the line through an arm's joints
_ENOUGH = 3  # number of neighbouring places that must touch a target


# --- free space ----------------------------------------------------------------------------


class OutOfWork(Exception):
    """The budget of work is spent."""


class Work:
    """Counter of work against a limit, in units of about a microsecond on one core. `done` is the spent work."""

    def __init__(self, limit: float) -> None:
        self.limit, self.done = limit, 0.0

    def spend(self, units: float) -> None:
        """Charge units of work to the budget.

        Raises:
            OutOfWork: the budget is spent.
        """
        self.done += units
        if self.done > self.limit:
            raise OutOfWork


class FreeSpace:
    """Free cells of a floor for a body of a given radius.

    Attributes:
        radius: body radius plus clearance, m.
        resolution: cell size, m.
        grid: grid over the floor.
        free: cells where the body fits, bool (columns, rows).
        work: budget for queries.
        labels: number of each cell's connected part, int32 (columns, rows); 0 for cells that are not free.
    """

    def __init__(self, reach_x: float, reach_y: float, body_radius: float, solids: Sequence[Solid],
                 work: Work | None = None) -> None:
        self.radius = body_radius + CONTACT_SKIN
        self.resolution = compute_resolution(reach_x, reach_y)
        self.grid = FloorGrid.cover(reach_x, reach_y, self.resolution)
        self._low = self.grid.low
        self.footprints: list[Footprint] = []
        self.work = work or Work(math.inf)
        self.free = np.ones(self.grid.shape, dtype=bool)
        self._add(solids)

    def extend(self, solids: Sequence[Solid]) -> FreeSpace:
        """Return the free space with more solids on the floor; this object does not change."""
        other = copy.copy(self)
        other.free, other.footprints = self.free.copy(), list(self.footprints)
        other._add(solids)
        return other

    def _add(self, solids: Sequence[Solid]) -> None:
        need = self.radius + PASSAGE_SLACK + self.resolution / 2
        for solid in solids:
            self.footprints.append(solid.footprint)
            window, away = self.grid.measure(solid.footprint, need)
            self.work.spend(away.size / 15)
            self.free[window] &= away >= need
        self._neighbourhood = Neighbourhood(self.footprints)
        self.work.spend(self.free.size / 100)
        self.labels = label_parts(self.free, corners=False)

    def find_cell(self, x: float, y: float) -> tuple[int, int]:
        """Return the cell of a point, or the nearest cell at the edge for a point outside the grid."""
        i, j = int((x - self._low[0]) / self.resolution), int((y - self._low[1]) / self.resolution)
        return min(max(i, 0), self.free.shape[0] - 1), min(max(j, 0), self.free.shape[1] - 1)

    def get_cells(self, label: int) -> NDArray[np.int_]:
        """Return the cells (n, 2) of a connected part."""
        self.work.spend(self.free.size / 50)
        return np.argwhere(self.labels == label)

    def get_cells_near(self, label: int, x: float, y: float, distance: float) -> NDArray[np.int_]:
        """Return the cells (n, 2) of a connected part in a square around a point, in the order of `get_cells`."""
        low = ((np.array([x, y]) - distance - self._low) / self.resolution).astype(int) - 1
        high = ((np.array([x, y]) + distance - self._low) / self.resolution).astype(int) + 2
        low = low.clip(0)
        part = self.labels[low[0] : max(high[0], 0), low[1] : max(high[1], 0)]
        self.work.spend(part.size / 30)
        return np.argwhere(part == label) + low

    def is_clear(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether the body fits exactly at each of the points (n, 2)."""
        if not len(points):
            return np.zeros(0, dtype=bool)
        (x, y), reach = points.mean(axis=0), np.ptp(points, axis=0)
        near = self._neighbourhood.find_near(x, y, self.radius + math.hypot(*reach))
        self.work.spend(20 + len(near) * (10 + len(points) / 20))
        return compute_distance_many(points, self._neighbourhood.shapes[near]) >= self.radius - 1e-9

    def find_labels(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return `find_label` of many points (n, 2); points in the middle of free cells are looked up at once."""
        cells = ((points - self._low) / self.resolution).astype(int).clip(0, np.array(self.free.shape) - 1)
        is_centre = (self.grid.get_centres(cells) == points).all(axis=1) & self.free[cells[:, 0], cells[:, 1]]
        labels = np.where(is_centre, self.labels[cells[:, 0], cells[:, 1]], 0).astype(np.int32)
        for number in np.flatnonzero(~is_centre):
            labels[number] = self.find_label(*points[number].tolist())
        return labels

    def find_label(self, x: float, y: float) -> int:
        """Return the connected part of a free position; 0 if it is not free or has no link.

        A position has a link if a straight move that keeps the clearance leads to a free cell.
        """
        cell = self.find_link(x, y)
        return 0 if cell is None else int(self.labels[cell])

    def find_link(self, x: float, y: float) -> tuple[int, int] | None:
        """Return the nearest free cell that a free position has a link to, or None if there is none."""
        self.work.spend(200)
        at = ((np.array([x, y]) - self._low) / self.resolution).astype(int)
        span = 3 + math.ceil((PASSAGE_SLACK + 0.3) / self.resolution)
        low, high = (at - span).clip(0), (at + span + 1).clip(0)
        cells = np.argwhere(self.free[low[0] : high[0], low[1] : high[1]]) + low
        moves = self.grid.get_centres(cells) - (x, y)
        lengths = np.hypot(*moves.T)
        near = self._neighbourhood.list_near(x, y, self.radius + lengths.max(initial=0.0))
        if not len(cells) or any(compute_distance(x, y, f) < self.radius - 1e-9 for f in near):
            return None
        order = np.argsort(lengths, kind="stable")
        for k, (dx, dy) in zip(order.tolist(), moves[order].tolist(), strict=True):
            if all(compute_first_contact(x, y, dx, dy, self.radius, f) > 1.0 for f in near):
                return tuple(cells[k].tolist())
        return None

    def keeps_link(self, x: float, y: float, cell: tuple[int, int], solids: Sequence[Solid]) -> bool:
        """Return whether an existing link stays free with more solids on the floor."""
        dx, dy = (self.grid.get_centres(np.array([cell]))[0] - (x, y)).tolist()
        return bool(self.free[cell]) and all(
            compute_distance(x, y, solid.footprint) >= self.radius - 1e-9
            and compute_first_contact(x, y, dx, dy, self.radius, solid.footprint) > 1.0 for solid in solids)


# --- the certificate -----------------------------------------------------------------------


class Approach(NamedTuple):
    """A place that touches a target, and the free cell that a straight move leads to."""

    x: float
    y: float
    cell: tuple[int, int]


class Floors(NamedTuple):
    """Free space with the exit door shut, and with it open (equal if there is no door)."""

    shut: FreeSpace  # with the door shut
    opened: FreeSpace  # with it open
    touches: dict[int, list[Approach]]
    """Known places that touch each target, without those that obstacles have blocked."""

    def extend(self, solids: Sequence[Solid]) -> Floors:
        """Return the same floors with more solids."""
        shut = self.shut.extend(solids)
        touches = {target: [link for link in links if shut.keeps_link(*link, solids)]
                   for target, links in self.touches.items()}
        return Floors(shut, shut if self.opened is self.shut else self.opened.extend(solids), touches)


def make_floors(instance: RoomInstance, work: Work | None = None) -> Floors:
    """Compute the free space of a room."""
    opened = FreeSpace(instance.reach_x, instance.reach_y, instance.robot.inner_radius, instance.solids, work)
    return Floors(opened.extend((instance.door,)) if instance.door else opened, opened, {})


def find_unmet(instance: RoomInstance, floors: Floors) -> str | None:
    """Return the part of the geometric certificate that a room fails, or None if it holds.

    Start, touching places and exit must be connected. Under physics the arm must also be clear of walls at the start.
    """
    shut, opened, touches = floors
    labels = set(shut.find_labels(np.array([(start.x, start.y) for start in instance.starts])).tolist())
    if 0 in labels or len(labels) != 1:
        return "every start must be free and on one connected floor"
    solids = [solid.footprint for solid in instance.all_solids]
    if not all(does_base_fit(instance.robot, start, solids) for start in instance.starts):
        return "the base must be clear of walls and obstacles at every start"
    if not all(has_arm_free(instance, start) for start in instance.starts):
        return "the arm must be clear of walls and obstacles at every start"
    label = labels.pop()
    for index, target in enumerate(instance.targets):
        if not (_can_touch_by_hand(instance, target, shut, label) if instance.dynamics.press_with == "hand" else
                _can_touch_by_body(instance, target, shut, label, touches.setdefault(index, []))):
            return f"{target.name} must be touchable from floor connected with the start"
    start = instance.starts[0]
    label = opened.find_label(start.x, start.y)
    if not any(opened.find_label(x, y) == label for x, y in _points_in(instance.exit)):
        return "the exit must be connected with the start"
    return None


def _points_in(area: Rectangle) -> list[tuple[float, float]]:
    x, y = area.centre
    shares = (0.0, -0.5, 0.5, -0.95, 0.95)
    half_x, half_y = (area.x_max - area.x_min) / 2, (area.y_max - area.y_min) / 2
    return [(x + a * half_x, y + b * half_y) for a in shares for b in shares]


def has_arm_free(instance: RoomInstance, start: Start) -> bool:
    """Return whether the arm at home is clear of all solids. Without physics, arms pass through solids."""
    if instance.dynamics.kind != "physics" or not instance.robot.joints:
        return True
    robot = make_robot(instance.robot)
    elbows, thick = robot.compute_elbows(robot.home), max(instance.robot.hand_radius, _ARM_THICKNESS)
    standing = [solid.footprint for solid in instance.all_solids if solid.height > elbows[:, 2].min() - thick]
    heading = start.heading_steps * math.radians(instance.robot.turn_step_deg) + start.heading_offset
    cos, sin = math.cos(heading), math.sin(heading)
    longest = np.linalg.norm(np.diff(elbows, axis=0), axis=1).max()
    along = np.linspace(0.0, 1.0, math.ceil(longest / thick) + 1)[:, None]
    points = np.concatenate([a + along * (b - a) for a, b in zip(elbows[:-1], elbows[1:], strict=True)])[:, :2]
    points = (start.x, start.y) + points @ np.array([[cos, sin], [-sin, cos]])
    return not standing or bool((compute_distance_many(points, stack_footprints(standing)) > thick).all())


# --- touching ------------------------------------------------------------------------------


def _can_touch_by_body(instance: RoomInstance, target: Target, space: FreeSpace, label: int,
                       known: list[Approach]) -> bool:
    """Search around the target for a few neighbouring places that all touch it, first among `known`."""
    if sum(int(space.labels[link.cell]) == label for link in known) >= _ENOUGH:
        return True
    reach = instance.compute_press_reach(target)
    if reach < 0.0:
        raise Rejected(f"{target.name} must hang low enough for the body to touch it")
    reach -= instance.robot.outer_radius - instance.robot.inner_radius if target.kind == "panel" else 0.0
    known.clear()
    for share in (0.999, 0.9, 0.5, 0.0):
        points = _outline(target, reach * share if share else 1e-6) if target.kind == "panel" else _fill(target, share)
        for x, y in points[space.is_clear(points)].tolist():
            cell = space.find_link(x, y)
            if cell is not None and space.labels[cell] == label:
                known.append(Approach(x, y, cell))
            if len(known) >= _ENOUGH:
                return True
    return False


def _outline(target: Target, distance: float) -> NDArray[np.float64]:
    """Points at a distance around a target's footprint, at most 0.1 m (or 1/200 of it) apart."""
    spacing = max(0.1, 4 * (target.half_x + target.half_y + distance) / 200)
    points = []
    for sign_x, sign_y, along_x in ((1, 1, True), (1, -1, True), (1, 1, False), (-1, 1, False)):
        half, away = (target.half_x, target.half_y) if along_x else (target.half_y, target.half_x)
        steps = np.linspace(-half, half, max(3, math.ceil(2 * half / spacing) + 1))
        side = np.full_like(steps, (sign_y if along_x else sign_x) * (away + distance))
        points.append(np.stack([steps, side] if along_x else [side, steps], axis=1))
    angles = np.linspace(0, math.tau, 32, endpoint=False)
    round_corner = distance * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points.append(round_corner + np.sign(round_corner) * (target.half_x, target.half_y))
    cos, sin = math.cos(target.yaw), math.sin(target.yaw)
    return np.concatenate(points) @ np.array([[cos, sin], [-sin, cos]]) + (target.x, target.y)


def _fill(target: Target, share: float) -> NDArray[np.float64]:
    """Points spread over a fraction of a pad's area."""
    sides = np.linspace(-share, share, 5)
    points = np.stack(np.meshgrid(sides * target.half_x, sides * target.half_y), axis=-1).reshape(-1, 2)
    cos, sin = math.cos(target.yaw), math.sin(target.yaw)
    return points @ np.array([[cos, sin], [-sin, cos]]) + (target.x, target.y)


def _can_touch_by_hand(instance: RoomInstance, target: Target, space: FreeSpace, label: int) -> bool:
    """Search for a free cell, a heading on the lattice and a joint configuration that touch the target."""
    robot = make_robot(instance.robot)
    hands = sample_hand_positions(robot, 4000)
    limit = 0.9 * (instance.robot.hand_radius + instance.dynamics.press_margin)
    hands = hands[np.abs(hands[:, 2] - target.z) <= target.half_z]
    if not len(hands):
        return False
    lengths, bearings = np.hypot(hands[:, 0], hands[:, 1]), np.arctan2(hands[:, 1], hands[:, 0])
    reach = float(lengths.max()) + limit
    cells = space.get_cells_near(label, target.x, target.y, reach + math.hypot(target.half_x, target.half_y))
    centres = space.grid.get_centres(cells)
    shape = stack_footprints([target.footprint])
    away = compute_distance_many(centres, shape)
    near = centres[away <= reach]
    turn = math.radians(instance.robot.turn_step_deg)
    for x, y in near[:: max(1, len(near) // 60)]:
        space.work.spend(60 + len(hands) / 10)
        aim = math.atan2(target.y - y, target.x - x)
        headings = np.round((aim - bearings) / turn) * turn
        points = np.stack([x + lengths * np.cos(headings + bearings), y + lengths * np.sin(headings + bearings)], 1)
        if (compute_distance_many(points, shape) <= limit).any():
            return True
    return False
