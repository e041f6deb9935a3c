"""Regions of a room's floor at several resolutions, and what a search in one of them is for: feudal learning's tree.

A manager sees its cell and the facts that hold. An order leads to the next cell, or is to search: to make one of the
open landmarks true, or to escape.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from hrl_escape.agents.hierarchy.regions import DIRECTIONS, Quadtree
from hrl_escape.planning.goals import RegionGoal
from hrl_escape.synthesis.landmarks import OpenLandmarks
from hrl_escape.synthesis.situation import Situations

__all__ = ["compute_depth", "make_region_tree"]

MOST_LEVELS = 3
KEPT = 50_000
"""Answers of the planner that are kept: every manager asks before every primitive which orders can be obeyed."""
BORDER_MARGIN = 1e-3
"""Distance that a region to be walked to keeps from its borders, as a share of its size: a border has one owner."""


def compute_depth(rooms: Situations, planned: bool) -> int:
    """Finest level: its cells are at least two moves wide; with planned leaves they are quarters.

    A planner crosses a quarter as well as a small cell, and every finer level is one more manager that must learn which
    of its orders serve the one above.
    """
    if planned:
        return 1
    widths = 2 * rooms.instance.reach_x, 2 * rooms.instance.reach_y
    levels = int(math.log2(max(1.0, min(widths) / (2 * rooms.instance.robot.actions.stride))))
    return min(max(levels, 1), MOST_LEVELS)


def make_region_tree(rooms: Situations, planned: bool) -> Quadtree:
    """The floor, cut into four at every level, once for planned leaves; north is +y.

    With planned leaves the planner obeys: it walks into the next cell, or to the nearest thing that a search in this
    cell is for, provided that its way ends here.

    Args:
        rooms: the room.
        planned: the planner walks; else walking is learned over primitives.
    """
    half_width, half_depth = rooms.instance.reach_x, rooms.instance.reach_y
    landmarks, depth = OpenLandmarks(rooms), compute_depth(rooms, planned)
    most = math.nextafter(1.0, 0.0)

    def locate(x: float, y: float) -> tuple[float, float]:
        row, column = (half_depth - y) / (2 * half_depth), (half_width + x) / (2 * half_width)
        return min(max(row, 0.0), most), min(max(column, 0.0), most)

    def find_place(observation: Any) -> tuple[float, float]:
        here = rooms.read(observation).state
        return locate(here.x, here.y)

    def list_facts(observation: Any) -> tuple[int, ...]:
        facts = rooms.read(observation).facts
        return tuple(int(fact in facts) for fact in landmarks.names[:-1])

    def has_found(before: Any, after: Any) -> bool:
        return bool(landmarks.list_open(rooms.read(before).facts) & rooms.read(after).facts)

    @lru_cache(KEPT)
    def find_obedience(packed: bytes, cell: tuple[int, int], order: int) -> int | None:
        here = rooms.read(np.frombuffer(packed))
        if order < len(DIRECTIONS):
            (down, right), size = DIRECTIONS[order], 2**depth
            row, column = cell[0] + down, cell[1] + right
            goal = RegionGoal(
                *(half_width * (2 * (column + side) / size - 1) for side in (BORDER_MARGIN, 1 - BORDER_MARGIN)),
                *(half_depth * (1 - 2 * (row + side) / size) for side in (1 - BORDER_MARGIN, BORDER_MARGIN)))
            return rooms.plan_first(here, goal)
        ways = []
        for landmark in sorted(landmarks.list_open(here.facts)):
            target = landmarks.find_goal(here.facts, landmark)
            way, end = ((), (0.0, 0.0)) if target is None else rooms.plan_to_end(here, target)
            if way and tuple(int(each * 2**depth) for each in locate(*end)) == cell:
                ways.append((len(way), way[0]))
        return min(ways)[1] if ways else None

    def obey(observation: Any, cell: tuple[int, int], order: int) -> int | None:
        return find_obedience(np.asarray(observation, np.float64).tobytes(), cell, order)

    return Quadtree(depth, find_place, list_facts, has_found, obey if planned else None)
