"""Every dependency graph that a schematic of buttons can draw, with its probability, computed exactly.

The schematic's own generator is run once for each sequence of outcomes that its draws can have, so that a change to the
generator is a change here too.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Sequence
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import PRESETS
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import Edges, GraphConfig, compute_order, mask_parents, sample_graph
from hrl_escape.env.puzzles.marks import MarksConfig
from hrl_escape.env.sampling.ranges import sample_puzzle
from hrl_escape.errors import UnknownNameError, UnsupportedError
from hrl_escape.ranges import Between

MOST_BUTTONS = 6
"""Buttons up to which every graph of a family is listed."""

T = TypeVar("T", bound=Hashable)


@dataclasses.dataclass(frozen=True, eq=False)
class GraphFamily:
    """Labelled graphs of buttons and how likely each is.

    Attributes:
        parents: uint64 (graphs, buttons), the bits of each button's parents.
        goals: int64 (graphs,), the button that opens the exit.
        weights: float64 (graphs,), probabilities; they sum to 1.
    """

    parents: NDArray[np.uint64]
    goals: NDArray[np.int64]
    weights: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of buttons."""
        return self.parents.shape[1]


def can_light(parents: NDArray[np.uint64], lit: int) -> NDArray[np.bool_]:
    """True where a press would light a button: all its parents are lit.

    Args:
        parents: bits of parents, any shape.
        lit: bits of the buttons that are lit.
    """
    return (parents & ~np.uint64(lit)) == 0


class _Draws:
    """A stand-in for a random generator that gives one sequence of outcomes, and knows how likely it is."""

    def __init__(self, outcomes: Sequence[int]) -> None:
        self._outcomes, self.sizes, self.probability = outcomes, list[int](), 1.0

    def _pick(self, count: int) -> int:
        number = len(self.sizes)
        self.sizes.append(count)
        self.probability /= count
        return self._outcomes[number] if number < len(self._outcomes) else 0

    def integers(self, low: int, high: int | None = None) -> int:
        low, high = (0, low) if high is None else (low, high)
        return low + self._pick(high - low)

    def choice(self, items: Sequence[Any], count: int, replace: bool = True) -> NDArray[Any]:
        assert not replace
        picked = self._pick(math.comb(len(items), count))
        return np.array(next(itertools.islice(itertools.combinations(items, count), picked, None)))


def iterate_outcomes(draw: Callable[[Any], T]) -> Iterator[tuple[T, float]]:
    """Yield what a function can draw by `integers` and by `choice` without replacement, with probabilities.

    Args:
        draw: takes a generator. What it returns must not depend on the order of what it chose.
    """
    outcomes: list[int] | None = []
    while outcomes is not None:
        draws = _Draws(outcomes)
        yield draw(draws), draws.probability
        outcomes = [*outcomes, *[0] * (len(draws.sizes) - len(outcomes))]
        while outcomes and outcomes[-1] + 1 == draws.sizes[len(outcomes) - 1]:
            outcomes.pop()
        outcomes = [*outcomes[:-1], outcomes[-1] + 1] if outcomes else None


def list_graphs(config: GraphConfig, count: int) -> dict[Edges, float]:
    """Probability of every graph of a family before its buttons are relabelled.

    Args:
        config: the family; `max_parents` may be a range.
        count: number of buttons.

    Raises:
        UnsupportedError: a family with other draws than those that `iterate_outcomes` follows.
    """
    if config.kind in ("random", "larg-2019"):
        raise UnsupportedError(f"graphs of kind {config.kind} cannot be listed; take chain, tree, layered or edges")
    found: dict[Edges, float] = defaultdict(float)
    ranged: Any = config.max_parents
    values = range(int(ranged.low), int(ranged.high) + 1) if isinstance(ranged, Between) else (ranged,)
    for most in values:
        fixed = dataclasses.replace(config, max_parents=most)
        for edges, probability in iterate_outcomes(lambda rng, fixed=fixed: sample_graph(fixed, count, rng)):
            found[edges] += probability / len(values)
    return found


@lru_cache(maxsize=16)
def make_family(config: ButtonsConfig, count: int) -> GraphFamily:
    """Every labelled graph that a schematic can give to a room with so many buttons.

    Args:
        config: of the puzzle; `count` and `graph.max_parents` may be ranges.
        count: number of buttons in the room.

    Raises:
        UnsupportedError: more buttons than `MOST_BUTTONS`, or a family that cannot be listed.
    """
    if count > MOST_BUTTONS:
        raise UnsupportedError(f"the graphs of {count} buttons are too many to list; {MOST_BUTTONS} are the most")
    relabels = config.graph.relabel and config.graph.kind != "edges"
    labels = list(itertools.permutations(range(count))) if relabels else [tuple(range(count))]
    found: dict[tuple[tuple[int, ...], int], float] = defaultdict(float)
    for edges, probability in list_graphs(config.graph, count).items():
        last = compute_order(count, edges)[-1] if config.goal is None else config.goal
        for label in labels:
            relabelled = ((label[parent], label[child]) for parent, child in edges)
            found[mask_parents(relabelled, count), label[last]] += probability / len(labels)
    graphs = sorted(found)
    return GraphFamily(np.array([masks for masks, _ in graphs], dtype=np.uint64).reshape(len(graphs), count),
                       np.array([goal for _, goal in graphs], dtype=np.int64),
                       np.array([found[graph] for graph in graphs]))


@lru_cache(maxsize=16)
def _classify(family: GraphFamily, rules: MarksConfig) -> NDArray[np.int64]:
    """Class of each button under each graph, (graphs, buttons)."""
    pairs = list(itertools.product(range(family.count), repeat=2))
    return np.array([rules.classify(family.count, tuple((a, b) for a, b in pairs if masks[b] >> a & 1), goal)
                     for masks, goal in zip(family.parents.tolist(), family.goals.tolist(), strict=True)])


def condition_on_marks(family: GraphFamily, rules: MarksConfig, marks: tuple[int, ...]) -> GraphFamily:
    """The graphs that the marks of a room allow, as likely as these make them; the same family where they say nothing.

    Args:
        family: every graph of the schematic.
        rules: the schematic's marks, whose code is known.
        marks: of the room's buttons; none without marks.
    """
    if not marks or rules.shuffled:
        return family
    weights = family.weights * rules.compute_likelihood(marks, _classify(family, rules))
    kept = np.flatnonzero(weights)
    return GraphFamily(family.parents[kept], family.goals[kept], weights[kept] / weights.sum())


def find_schematic(instance: RoomInstance) -> RoomConfig:
    """The schematic that a room was drawn from: the preset or the rung of its name that draws its puzzle.

    Raises:
        UnsupportedError: none does.
    """
    for config in _list_schematics(instance.name):
        if instance.seed is not None and sample_puzzle(config, instance.seed)[1] == instance.puzzle:
            return config
    raise UnsupportedError(f"which schematic room {instance.id} ({instance.name}) was drawn from is not known: take a "
                           "preset or a rung of the ladder")


def _list_schematics(name: str) -> Iterator[RoomConfig]:
    from hrl_escape.env.presets import get_preset
    from hrl_escape.ladder.benchmark import list_benchmarks, load_benchmark

    if name in PRESETS:
        yield get_preset(name)
    for benchmark in list_benchmarks():
        try:
            yield load_benchmark(benchmark)[name].config
        except UnknownNameError:
            continue
