"""Canonical form of a small coloured graph: equal for two graphs exactly if relabelling turns one into the other.

Colour refinement tells nodes apart by their neighbours; where it cannot, each node of a cell is singled out in turn
and the smallest form wins (McKay 1981, "Practical graph isomorphism"). Automorphisms found on the way spare branches
that would repeat others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Form = tuple[tuple[int, ...], tuple[tuple[int, int], ...]]


def compute_canonical_form(colours: Sequence[int], edges: Iterable[tuple[int, int]]) -> Form:
    """Colours and edges of a directed graph under its canonical numbering.

    Args:
        colours: a whole number a node, which relabelling keeps.
        edges: (from, to) pairs of node numbers.

    Returns:
        Colours in canonical order, and the sorted edges.
    """
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
            signs = [(ranks[node], sorted(ranks[i] for i in self._parents[node]),
                      sorted(ranks[i] for i in self._children[node])) for node in range(len(ranks))]
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
        """Return whether automorphisms that keep `fixed` carry the node to one already tried."""
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


def _rank(signs: Sequence[object]) -> list[int]:
    """Rank of each sign among the different ones."""
    places = {sign: rank for rank, sign in enumerate(sorted(set(map(_freeze, signs))))}  # type: ignore[type-var]
    return [places[_freeze(sign)] for sign in signs]


def _freeze(sign: object) -> object:
    return tuple(map(_freeze, sign)) if isinstance(sign, (list, tuple)) else sign
