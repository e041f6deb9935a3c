"""Keys of a room: content, layout, and task up to the numbers of buttons.

Two sets of rooms are disjoint in content if they share no room, in layout if no two rooms are alike, and in task if no
two rooms have the same puzzle.

A layout is a set of named points: corners of solids and of the exit, ends of panels, and start positions without
headings. Two layouts are alike if one of the eight symmetries of the square about the room's centre pairs all points of
the same name within `ALIKE_WITHIN`. Version 1 of layouts compares hashes of rounded positions instead, which differ
for positions on either side of a rounding border. The manifest of a benchmark holds its version (`layouts`).

Tasks are compared by the canonical form of a small coloured graph. Colour refinement distinguishes nodes by their
neighbours. If a cell of equal nodes remains, each of them is individualised in turn, and the smallest form is the
canonical one (McKay 1981, "Practical graph isomorphism"). Automorphisms prune equivalent branches.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle

ALIKE_WITHIN = 0.5
"""Largest distance between matching points of alike layouts, m."""
LATEST_LAYOUTS = 2
"""Version of layouts of new benchmarks; version 1 are hashes of rounded positions."""

LayoutKey: TypeAlias = "str | tuple[tuple[str, float, float], ...]"
"""Hash of rounded positions (version 1), or points sorted by name (version 2)."""


def list_points(room: RoomInstance) -> tuple[tuple[str, float, float], ...]:
    """Return the named points (name, x, y) of a room, m, sorted; the origin is the room's centre."""
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
    """Index of layouts that finds the first alike layout."""

    def __init__(self, layouts: Iterable[LayoutKey] = ()) -> None:
        self._count = 0
        self._hashes: dict[str, int] = {}
        self._groups: dict[tuple[str, ...], list[tuple[int, NDArray[np.float64], NDArray[np.float64]]]] = (
            defaultdict(list))  # by names: number, places, and the places sorted
        self._stacks: dict[tuple[str, ...], NDArray[np.float64]] = {}  # all sorted places of a group, once asked for
        self.update(layouts)

    def update(self, layouts: Iterable[LayoutKey]) -> None:
        """Add layouts, numbered in order."""
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
        """Return the number of the first alike layout, or None."""
        if isinstance(layout, str):
            return self._hashes.get(layout)
        names, places = _split(layout)
        group = self._groups.get(names)
        if group is None:
            return None
        near, parts, images = set(), _list_parts(names), list(_list_images(places))
        if names not in self._stacks:
            self._stacks[names] = np.array([each for _, _, each in group])
        for image in images:  # a cheap necessary condition: sorted coordinates of alike layouts are near each other
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
    from scipy.sparse import csr_array  # pyright: ignore[reportMissingTypeStubs]  # takes a third of a second to load
    from scipy.sparse.csgraph import maximum_bipartite_matching  # pyright: ignore[reportMissingTypeStubs]

    for part in parts:
        gaps = np.linalg.norm(first[part][:, None] - second[part][None], axis=2)
        if (maximum_bipartite_matching(csr_array(gaps <= ALIKE_WITHIN), perm_type="column") < 0).any():
            return False
    return True


Form = tuple[tuple[int, ...], tuple[tuple[int, int], ...]]


def compute_canonical_form(colours: Sequence[int], edges: Iterable[tuple[int, int]]) -> Form:
    """Compute the canonical form of a coloured directed graph: colours in order, and sorted (from, to) edges."""
    return _Search(colours, tuple(edges)).find()


class _Search:
    """Search over refined colourings for the smallest form."""

    def __init__(self, colours: Sequence[int], edges: tuple[tuple[int, int], ...]) -> None:
        self._colours, self._edges = tuple(colours), edges
        self._parents: list[list[int]] = [[] for _ in colours]
        self._children: list[list[int]] = [[] for _ in colours]
        for source, target in edges:
            self._parents[target].append(source)
            self._children[source].append(target)
        self._forms: dict[Form, list[int]] = {}  # the numbering that first gave each form
        self._automorphisms: list[list[int]] = []

    def find(self) -> Form:
        self._visit(self._refine(_rank(self._colours)), ())
        return min(self._forms)

    def _refine(self, ranks: list[int]) -> list[int]:
        """Split cells until all nodes of each have equally many neighbours in every cell."""
        while True:
            signs = [(ranks[node], *(tuple(sorted(ranks[i] for i in ends[node]))
                                     for ends in (self._parents, self._children))) for node in range(len(ranks))]
            finer = _rank(signs)
            if max(finer, default=0) == max(ranks, default=0):
                return finer
            ranks = finer

    def _visit(self, ranks: list[int], fixed: tuple[int, ...]) -> None:
        cells: dict[int, list[int]] = {}
        for node, rank in enumerate(ranks):
            cells.setdefault(rank, []).append(node)
        cell = next((cells[rank] for rank in sorted(cells) if len(cells[rank]) > 1), None)
        if cell is None:
            self._record(ranks)
            return
        tried: list[int] = []
        for node in cell:
            if not self._is_image_of(node, tried, fixed):
                self._visit(self._refine(_rank([(rank, i != node) for i, rank in enumerate(ranks)])), (*fixed, node))
                tried.append(node)

    def _record(self, numbers: list[int]) -> None:
        order = sorted(range(len(numbers)), key=numbers.__getitem__)
        form = (tuple(self._colours[node] for node in order),
                tuple(sorted((numbers[a], numbers[b]) for a, b in self._edges)))
        first = self._forms.setdefault(form, numbers)
        if first is not numbers:
            at = {number: node for node, number in enumerate(first)}
            self._automorphisms.append([at[number] for number in numbers])

    def _is_image_of(self, node: int, tried: list[int], fixed: tuple[int, ...]) -> bool:
        """Return whether an automorphism that fixes `fixed` maps the node to a tried one."""
        maps = [each for each in self._automorphisms if all(each[i] == i for i in fixed)]
        orbit, new = {node}, [node]
        while new:
            here = new.pop()
            for each in maps:
                for there in (each[here], each.index(here)):
                    if there not in orbit:
                        orbit.add(there)
                        new.append(there)
        return not orbit.isdisjoint(tried)


def _rank(signs: Sequence[Any]) -> list[int]:
    """Rank of each sign among the different ones."""
    places = {sign: rank for rank, sign in enumerate(sorted(set(signs)))}
    return [places[sign] for sign in signs]


# --- keys --------------------------------------------------------------------------------

GRAIN = 0.5
"""Grid of positions in layouts of version 1, m."""
TURN = math.radians(30)
"""Grid of directions in layouts of version 1."""


class RoomKeys(NamedTuple):
    """Keys of one room; hashes are 64 hexadecimal digits of SHA-256."""

    content: str  # hash of everything in the room
    layout: LayoutKey
    """Version 1: hash of positions rounded to 0.5 m and directions rounded to 30 degrees. Version 2: points, see
    `SeenLayouts`."""
    task: str  # hash of the puzzle up to the numbers of its buttons


def compute_keys(room: RoomInstance, layouts: int = 1) -> RoomKeys:
    """Compute the keys of a room, with the layout in the given version."""
    layout = compute_layout_key(room) if layouts == 1 else list_points(room)
    return RoomKeys(room.digest, layout, compute_task_key(room.puzzle))


def compute_layout_key(room: RoomInstance) -> str:
    """Hash the rounded positions of all objects, without names and order."""
    turn = math.radians(room.robot.turn_step_deg)
    things = [(solid.role, *_round(solid.x, solid.y, solid.yaw)) for solid in room.solids]
    things += [("target", *_round(target.x, target.y, target.yaw)) for target in room.targets]
    things += [(placed.prop.kind, *_round(placed.x, placed.y, placed.yaw)) for placed in room.props]
    things += [("start", *_round(start.x, start.y, start.heading_steps * turn + start.heading_offset))
               for start in room.starts]
    return _hash([*sorted(things), ("exit", *_round(*room.exit.centre, 0.0))])


def compute_task_key(puzzle: Puzzle) -> str:
    """Hash the rules of a puzzle, up to the numbers of its buttons."""
    rules = puzzle.to_dict()
    rules.pop("cues", None)  # cues do not change the rules
    if isinstance(puzzle, ButtonsPuzzle):
        colours = [int(button == puzzle.goal) for button in range(puzzle.count)] + [2] * len(puzzle.locks)
        colours += [3] * len(puzzle.doors)
        links = [link for node, (a, b) in enumerate(puzzle.locks, puzzle.count) for link in ((a, node), (node, b))]
        links += [(button, node) for node, button in enumerate(puzzle.doors, puzzle.count + len(puzzle.locks))]
        goals, edges = compute_canonical_form(colours, (*puzzle.edge_list, *links))
        rules |= {"goal": goals.index(1), "edge_list": edges}
        for name, colour in (("locks", 2), ("doors", 3)):  # nodes of colours of their own
            if name in rules:
                rules[name] = [node for node, own in enumerate(goals) if own == colour]
    return _hash(rules)


def _round(x: float, y: float, yaw: float) -> tuple[int, int, int]:
    return round(x / GRAIN), round(y / GRAIN), round(yaw / TURN) % round(math.tau / TURN)


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
