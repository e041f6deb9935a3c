"""Layouts of rooms that look alike: turned or mirrored, and with every thing within half a metre of its counterpart.

A layout is a set of named points: corners of solids and of the exit, ends of panels, and where episodes begin, whatever
the heading there. Two are alike if one of the eight symmetries of the square about the room's middle pairs all points
of the same name within `ALIKE_WITHIN`. Unlike hashes of rounded places it has no borders at which a hair makes a
difference.
Benchmarks say in their manifest which of the two they were frozen with (`layouts`).
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array  # pyright: ignore[reportMissingTypeStubs]
from scipy.sparse.csgraph import maximum_bipartite_matching  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.env.instance import RoomInstance

ALIKE_WITHIN = 0.5
"""Distance within which a point is in the same place, m."""
LATEST_LAYOUTS = 2
"""Version of layouts that new benchmarks are frozen with; 1 are hashes of rounded places."""

LayoutKey: TypeAlias = "str | tuple[tuple[str, float, float], ...]"
"""Hash of rounded places (version 1), or points in order of their names (version 2)."""


def list_points(room: RoomInstance) -> tuple[tuple[str, float, float], ...]:
    """Named points (name, x, y) of a room, m, in its frame, whose origin is its middle; sorted."""
    points: list[tuple[str, float, float]] = []

    def add(name: str, x: float, y: float, yaw: float, *ends: tuple[float, float]) -> None:
        cos, sin = math.cos(yaw), math.sin(yaw)
        points.extend((name, x + along * cos - across * sin, y + along * sin + across * cos) for along, across in ends)

    for solid in room.solids:
        wide, deep = (solid.half_x, solid.half_y) if solid.shape == "box" else (0.0, 0.0)
        add(f"{solid.role} {solid.shape}", solid.x, solid.y, solid.yaw,
            *((a * wide, b * deep) for a, b in itertools.product((-1, 1), repeat=2)))
    for target in room.targets:
        add(target.kind, target.x, target.y, target.yaw, (-target.half_x, 0.0), (target.half_x, 0.0))
    for placed in room.props:
        add(f"prop {placed.prop.kind}", placed.x, placed.y, 0.0, (0.0, 0.0))
    points.extend(("start", start.x, start.y) for start in room.starts)
    exit_ = room.exit
    points.extend(("exit", x, y) for x in (exit_.x_min, exit_.x_max) for y in (exit_.y_min, exit_.y_max))
    return tuple(sorted(points))


class SeenLayouts:
    """Layouts that were seen, in order, among which one that looks alike is found."""

    def __init__(self, layouts: Iterable[LayoutKey] = ()) -> None:
        self._count = 0
        self._hashes: dict[str, int] = {}
        self._groups: dict[tuple[str, ...], list[tuple[int, NDArray[np.float64], NDArray[np.float64]]]] = (
            defaultdict(list))  # by names: number, places, and the places sorted
        self._stacks: dict[tuple[str, ...], NDArray[np.float64]] = {}  # all sorted places of a group, once asked for
        self.update(layouts)

    def update(self, layouts: Iterable[LayoutKey]) -> None:
        """Add layouts; their numbers go on from those before."""
        for layout in layouts:
            if isinstance(layout, str):
                self._hashes.setdefault(layout, self._count)
            else:
                names, places = _split(layout)
                self._stacks.pop(names, None)
                self._groups[names].append((self._count, places, _sort_parts(places, _list_parts(names))))
            self._count += 1

    def __contains__(self, layout: LayoutKey) -> bool:
        return self.find(layout) is not None

    def find(self, layout: LayoutKey) -> int | None:
        """Number of the first layout seen that looks like this one; None where there is none."""
        if isinstance(layout, str):
            return self._hashes.get(layout)
        names, places = _split(layout)
        group = self._groups.get(names)
        if group is None:
            return None
        near, parts, images = set(), _list_parts(names), list(_list_images(places))
        if names not in self._stacks:
            self._stacks[names] = np.array([each for _, _, each in group])
        for image in images:  # pairs sorted coordinate by coordinate are nearest in each, so that few are left
            gaps = np.abs(self._stacks[names] - _sort_parts(image, parts))
            near.update(np.flatnonzero((gaps <= ALIKE_WITHIN).all(axis=(1, 2))).tolist())
        for number in sorted(near):
            if any(_is_paired(group[number][1], image, parts) for image in images):
                return group[number][0]
        return None


def _split(layout: tuple[tuple[str, float, float], ...]) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    return tuple(name for name, _, _ in layout), np.array([place for _, *place in layout])


def _list_parts(names: tuple[str, ...]) -> list[NDArray[np.intp]]:
    """Indices of the points of each name."""
    return [np.flatnonzero(np.array(names) == name) for name in dict.fromkeys(names)]


def _list_images(places: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Points (n, 2) under the eight symmetries of the square."""
    for turned in (places, places[:, ::-1]):
        for signs in itertools.product((1.0, -1.0), repeat=2):
            yield turned * signs


def _sort_parts(places: NDArray[np.float64], parts: list[NDArray[np.intp]]) -> NDArray[np.float64]:
    """Points (n, 2), each coordinate sorted within the points of a name."""
    return np.concatenate([np.sort(places[part], axis=0) for part in parts])


def _is_paired(first: NDArray[np.float64], second: NDArray[np.float64], parts: list[NDArray[np.intp]]) -> bool:
    """Return whether points of each name can be paired one to one within the margin."""
    for part in parts:
        gaps = np.linalg.norm(first[part][:, None] - second[part][None], axis=2)
        if (maximum_bipartite_matching(csr_array(gaps <= ALIKE_WITHIN), perm_type="column") < 0).any():
            return False
    return True
