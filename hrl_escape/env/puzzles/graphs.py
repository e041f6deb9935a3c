"""Generators of button-dependency graphs: every DAG family of the room configuration.

All functions are pure given a random generator. A graph is a tuple of (parent, child) index pairs. The `larg-2019`
family reproduces the graphs of the published 2019 code, with Python 2's `random`.
"""

from __future__ import annotations

import dataclasses
import random
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np

from hrl_escape.env.schema import HashedSettings
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

Edges = tuple[tuple[int, int], ...]
EdgeSet = frozenset[tuple[int, int]]
"""Edges of a dependency graph, (parent, child)."""

GraphKind = Literal["chain", "tree", "layered", "random", "larg-2019", "edges"]
ButtonNumber = Annotated[int, Range(0, 63)]


@dataclasses.dataclass(frozen=True)
class GraphConfig(HashedSettings):
    """Directed acyclic graph of the dependencies between buttons."""

    _section = "graph"
    _takes_ranges = True
    kind: GraphKind = "chain"
    """Family of graphs; 'edges' uses the pairs in `edges`."""
    max_parents: Annotated[int, Range(1, 63)] = 1
    """Most parents of a button: the complexity of the paper (layered, random, larg-2019). More parents make a button
    wait for more others."""
    edge_probability: Annotated[float, Range(0, 1)] = 0.5
    """Probability of each possible edge (random)."""
    seed: Annotated[int, Range(0, 2**63 - 1)] | None = None
    """Seed of the graph alone (larg-2019). By default the seed of the instance."""
    edges: tuple[tuple[ButtonNumber, ButtonNumber], ...] = ()
    """Explicit (parent, child) pairs of button numbers from 0."""
    relabel: bool = True
    """If true, the buttons of a generated graph are numbered at random, and names do not reveal the order."""

    family: Annotated[int, Range(0, 64)] = 0
    """Number of graphs over the numbered buttons that all rooms share; each room uses one, which nothing shows. They
    can be learned in some rooms and used in others. 0 draws a new graph for each room."""
    code: Annotated[int, Range(0, 2**63 - 1)] = 0
    """Seed of the graphs of a family."""

    def check(self) -> None:
        """Check that only the family 'edges' has edges, and that it is no family of several."""
        if self.family and self.kind in ("edges", "larg-2019"):
            raise ConfigError("graph.family", self.family, f"0 with graph.kind = {self.kind!r}")
        if self.edges and self.kind != "edges":
            raise ConfigError("graph.edges", self.edges, "empty unless graph.kind is 'edges'")


def compute_order(count: int, edges: Edges) -> tuple[int, ...]:
    """Return a topological order of `count` nodes. Among free nodes, the smallest number comes first.

    Raises:
        ConfigError: an edge has an unknown node, or the edges form a cycle, which the message shows.
    """
    parents: list[set[int]] = [set() for _ in range(count)]
    for parent, child in edges:
        if not (0 <= parent < count and 0 <= child < count):
            raise ConfigError("graph.edges", (parent, child), f"pairs of button numbers from 0 to {count - 1}")
        parents[child].add(parent)
    order: list[int] = []
    left = set(range(count))
    while left:
        free = [node for node in sorted(left) if not parents[node] & left]
        if not free:
            raise ConfigError("graph.edges", sorted(left), "a graph without cycles; these buttons wait for each other")
        order.append(free[0])
        left.remove(free[0])
    return tuple(order)


def find_ancestors(edges: Iterable[tuple[int, int]], goals: Iterable[int]) -> set[int]:
    """Return the targets that must have been lit for the goals, goals included; edges are (parent, child) pairs."""
    every, ancestors, before = set(edges), set(goals), 0
    while len(ancestors) > before:
        before = len(ancestors)
        ancestors |= {parent for parent, child in every if child in ancestors}
    return ancestors


def mask_parents(edges: Iterable[tuple[int, int]], count: int) -> tuple[int, ...]:
    """Return the bits of the parents of each of `count` nodes; edges are (parent, child) pairs."""
    masks = [0] * count
    for parent, child in edges:
        masks[child] |= 1 << parent
    return tuple(masks)


def sample_graph(config: GraphConfig, count: int, rng: np.random.Generator) -> Edges:
    """Sample the edges of a DAG over `count` buttons. In generated graphs, parents have smaller numbers than children.

    `sample_relabelled` permutes these numbers afterwards.

    The families: `chain` 0 -> 1 -> ...; `tree` has one random earlier parent per button; `layered` has layers of random
    width, each button with 1 to max_parents parents in the layer before (the shape of the published generator);
    `random` makes every earlier button a parent with `edge_probability`, at most max_parents; `larg-2019` reproduces
    the published graphs; `edges` uses given pairs.
    """
    if config.kind == "edges":
        return config.edges
    if config.kind == "chain":
        return tuple((i, i + 1) for i in range(count - 1))
    if config.kind == "tree":
        return tuple((int(rng.integers(i)), i) for i in range(1, count))
    if config.kind == "larg-2019":
        seed = int(rng.integers(2**31)) if config.seed is None else config.seed
        return sample_larg_graph(count, seed, config.max_parents)
    if config.kind == "layered":
        return _draw_layers(count, config.max_parents, lambda most: int(rng.integers(1, most + 1)),
                            lambda above, number: sorted(rng.choice(above, number, replace=False).tolist()))
    edges: list[tuple[int, int]] = []
    for child in range(1, count):
        wanted = np.flatnonzero(rng.random(child) < config.edge_probability)
        if len(wanted) > config.max_parents:
            wanted = np.sort(rng.choice(wanted, config.max_parents, replace=False))
        edges.extend((int(parent), child) for parent in wanted)
    return tuple(edges)


def sample_relabelled(config: GraphConfig, count: int, rng: np.random.Generator, goal: int | None = None
                      ) -> tuple[Edges, int]:
    """Sample a graph and its goal, then permute its numbers if it is a generated graph with `relabel`.

    The default goal is the last node in topological order. A given goal is a number before the permutation. Returns
    edges and goal.
    """
    if config.family:
        return list_family(config, count, goal)[rng.integers(config.family)]
    edges = sample_graph(config, count, rng)
    last: int = compute_order(count, edges)[-1] if goal is None else goal
    if config.relabel and config.kind != "edges":
        label = rng.permutation(count).tolist()
        edges, last = tuple(sorted((label[parent], label[child]) for parent, child in edges)), label[last]
    return edges, last


@lru_cache(maxsize=64)
def list_family(config: GraphConfig, count: int, goal: int | None = None) -> tuple[tuple[Edges, int], ...]:
    """Return the different graphs of a family and their goals, which follow from `config.code`.

    Raises:
        ConfigError: there are fewer graphs of this kind.
    """
    rng, fresh = np.random.default_rng([config.code, 6]), dataclasses.replace(config, family=0)
    found: dict[tuple[Edges, int], None] = {}
    for _ in range(100 * config.family):
        found[sample_relabelled(fresh, count, rng, goal)] = None
        if len(found) == config.family:
            return tuple(found)
    raise ConfigError("graph.family", config.family, f"at most about {len(found)}, the number of such graphs of "
                      f"{count} buttons")


def sample_locks(count: int, edges: Edges, goal: int, most: int, rng: np.random.Generator) -> Edges:
    """Sample up to `most` pairs (a, b) of nodes where a locks b: dead ends that can be avoided.

    The goal needs b, and neither of the two needs the other. An order drawn first has every b before its a, and some
    order of presses therefore reaches the goal. Fewer pairs are sampled if the graph has fewer.
    """
    label = rng.permutation(count).tolist()
    order = compute_order(count, tuple((label[parent], label[child]) for parent, child in edges))
    place = [order.index(label[node]) for node in range(count)]
    needs = [find_ancestors(edges, (node,)) for node in range(count)]
    pairs = [(a, b) for b in sorted(needs[goal]) for a in range(count)
             if place[b] < place[a] and a not in needs[b] and b not in needs[a]]
    chosen = rng.choice(len(pairs), min(most, len(pairs)), replace=False).tolist() if pairs else []
    return tuple(sorted(pairs[number] for number in chosen))


def sample_larg_graph(count: int, seed: int, max_parents: int) -> Edges:
    """Reproduce the button graph that the published 2019 code draws for a seed.

    That code seeds Python 2's `random` and draws layers of `randint(1, min(4, left)//2 + 1)` nodes. Each node has
    `randint(1, min(|previous layer|, max_parents))` parents from `random.sample`. It repeats the draw until some button
    has at least `max_parents - 1` parents, as far as such layers allow. Python 2 computes both draws as
    `int(random() * n)`; Python 3 has the same Mersenne Twister behind `random()`.
    """
    uniform = random.Random(seed).random
    wanted = min(max_parents - 1, 3, count - 1)
    while True:
        edges = _draw_layers(count, max_parents, lambda most: 1 + int(uniform() * most),
                             lambda above, number: _sample_as_python2(above, number, uniform))
        degrees = Counter(child for _, child in edges)
        if max(degrees.values(), default=0) >= wanted:
            return edges


def _draw_layers(count: int, max_parents: int, draw: Callable[[int], int],
                 choose: Callable[[list[int], int], Iterable[int]]) -> Edges:
    """Draw layers of nodes whose parents are in the layer before.

    `draw(n)` draws a number from 1 to n; `choose(layer, n)` draws n nodes of the layer before.
    """
    edges: list[tuple[int, int]] = []
    above: list[int] = []
    while (first := above[-1] + 1 if above else 0) < count:
        layer = list(range(first, first + draw(min(4, count - first) // 2 + 1)))
        for child in layer if above else ():
            edges.extend((parent, child) for parent in choose(above, draw(min(len(above), max_parents))))
        above = layer
    return tuple(edges)


def _sample_as_python2(population: list[int], number: int, uniform: Callable[[], float]) -> list[int]:
    pool = list(population)
    size = len(pool)
    chosen = []
    for i in range(number):
        j = int(uniform() * (size - i))
        chosen.append(pool[j])
        pool[j] = pool[size - i - 1]
    return chosen


def find_target_edges(graph: EdgeSet, places: Sequence[int]) -> EdgeSet:
    """Translate a graph over components of the observation into one over targets.

    Args:
        graph: (parent, child) pairs of components; see `Agent.get_graph`.
        places: component of each target's light; see `Observer.light_places`.
    """
    targets = {place: target for target, place in enumerate(places)}
    return frozenset((targets[parent], targets[child]) for parent, child in graph
                     if parent in targets and child in targets)


def find_edges_that_matter(edges: Iterable[tuple[int, int]], goals: Iterable[int]) -> EdgeSet:
    """Return the edges of a graph that change which orders of presses reach the goals.

    These are the edges among the ancestors of the goals that no longer path implies. With a before b and b before c,
    an edge from a to c changes nothing. The graph may have cycles.
    """
    every = set(edges)
    ancestors = find_ancestors(every, goals)
    kept = {(parent, child) for parent, child in every if child in ancestors}
    return frozenset(edge for edge in kept if edge[0] not in find_ancestors(kept - {edge}, [edge[1]]))
