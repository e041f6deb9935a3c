"""Every dependency graph and rule that a schematic of buttons can draw, with its probability, computed exactly.

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
from hrl_escape.env.instance import RoomInstance, Target
from hrl_escape.env.presets import PRESETS
from hrl_escape.env.puzzles.buttons import VIOLATION_RULES, ButtonsConfig, ButtonsPuzzle
from hrl_escape.env.puzzles.graphs import Edges, GraphConfig, compute_order, mask_parents, sample_graph
from hrl_escape.env.puzzles.marks import MarksConfig, compute_depths
from hrl_escape.env.puzzles.sections import SectionsConfig
from hrl_escape.env.sampling.ranges import sample_puzzle
from hrl_escape.errors import UnknownNameError, UnsupportedError
from hrl_escape.ranges import Between

MOST_BUTTONS = 6
"""Buttons up to which every graph of a family is listed."""

T = TypeVar("T", bound=Hashable)


@dataclasses.dataclass(frozen=True, eq=False)
class GraphFamily:
    """Labelled graphs of buttons, each with what a mistake does, and how likely each is."""

    parents: NDArray[np.uint64]  # uint64 (graphs, buttons), the bits of each button's parents
    goals: NDArray[np.int64]  # int64 (graphs,), the button that opens the exit
    weights: NDArray[np.float64]  # float64 (graphs,), probabilities; they sum to 1
    rules: NDArray[np.int64]  # int64 (graphs,), number in `VIOLATION_RULES` of what a press with unmet parents does

    @property
    def count(self) -> int:
        """Number of buttons."""
        return self.parents.shape[1]

    @property
    def entropy(self) -> float:
        """Uncertainty about the graph and the rule, bits."""
        return float(-(self.weights * np.log2(self.weights)).sum())

    def select(self, kept: NDArray[np.integer], weights: NDArray[np.float64]) -> GraphFamily:
        """Some of the graphs, with new probabilities."""
        return GraphFamily(self.parents[kept], self.goals[kept], weights, self.rules[kept])


def can_light(parents: NDArray[np.uint64], lit: int) -> NDArray[np.bool_]:
    """True where a press would light a button: all its parents, bits of any shape, are among the bits `lit`."""
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
    """Yield what a function draws from a generator by `integers` and by `choice` without replacement, with probability.

    What it returns must not depend on the order of what it chose.
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
    """Probability of every graph of a family, whose `max_parents` may be a range, before its buttons are relabelled.

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
    """Every labelled graph that a schematic can give to a room with so many buttons, under each rule that it can draw.

    The schematic's `count` and `graph.max_parents` may be ranges.

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
    rules = [number for number, rule in enumerate(VIOLATION_RULES) if config.on_violation in (rule, "drawn")]
    return GraphFamily(
        np.tile(np.array([masks for masks, _ in graphs], dtype=np.uint64).reshape(len(graphs), count), (len(rules), 1)),
        np.tile(np.array([goal for _, goal in graphs], dtype=np.int64), len(rules)),
        np.tile([found[graph] / len(rules) for graph in graphs], len(rules)), np.repeat(rules, len(graphs)))


def _list_edges(family: GraphFamily) -> list[Edges]:
    pairs = list(itertools.product(range(family.count), repeat=2))
    return [tuple((a, b) for a, b in pairs if masks[b] >> a & 1) for masks in family.parents.tolist()]


@lru_cache(maxsize=16)
def _classify(family: GraphFamily, rules: MarksConfig) -> NDArray[np.int64]:
    """Class of each button under each graph, (graphs, buttons)."""
    return np.array([rules.classify(family.count, edges, goal)
                     for edges, goal in zip(_list_edges(family), family.goals.tolist(), strict=True)])


@lru_cache(maxsize=16)
def _measure_depths(family: GraphFamily) -> NDArray[np.int64]:
    """Depth of each button under each graph, (graphs, buttons)."""
    return np.array([compute_depths(family.count, edges) for edges in _list_edges(family)])


def condition_on_room(family: GraphFamily, config: ButtonsConfig, room: RoomInstance,
                      odds: NDArray[np.float64] | None = None) -> GraphFamily:
    """The graphs of a schematic that may be a room's before its first press, by its marks and where its buttons hang.

    `odds` are those of each motif of marks, (motifs,); all alike by default.
    """
    assert isinstance(room.puzzle, ButtonsPuzzle)
    return condition_on_places(condition_on_marks(family, config.marks, room.puzzle.marks, odds), config.sections,
                               room.targets)


def measure_information(config: ButtonsConfig, rooms: Sequence[RoomInstance]) -> tuple[float, float]:
    """Bits that marks and places of rooms tell of the hidden graph, and bits that there are to tell of graph and rule.

    Means over rooms.

    Raises:
        UnsupportedError: the graphs cannot be listed, see `make_family`.
    """
    families = [make_family(config, len(room.targets)) for room in rooms]
    told = [family.entropy - condition_on_room(family, config, room).entropy
            for family, room in zip(families, rooms, strict=True)]
    return float(np.mean(told)), float(np.mean([family.entropy for family in families]))


def infer_motif(family: GraphFamily, rules: MarksConfig, marks: tuple[int, ...],
                odds: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Probability of each motif of marks, (motifs,), by the graphs that are still possible in a room.

    Args:
        family: these graphs, as likely as `condition_on_marks` and all presses since made them.
        rules: the schematic's marks.
        marks: of the room's buttons.
        odds: those before the room; all alike by default.
    """
    by_motif = rules.compute_motif_likelihood(marks, _classify(family, rules))
    by_motif *= 1.0 if odds is None else odds[:, None]
    return by_motif / by_motif.sum(axis=0) @ family.weights


def condition_on_marks(family: GraphFamily, rules: MarksConfig, marks: tuple[int, ...],
                       odds: NDArray[np.float64] | None = None) -> GraphFamily:
    """The graphs that the marks of a room allow, as likely as these make them; the same family where they say nothing.

    The schematic's marks are known with their code; `odds` are those of each motif, (motifs,), all alike by default.
    """
    if not marks or rules.shuffled:
        return family
    return _reweigh(family, rules.compute_likelihood(marks, _classify(family, rules), odds))


def condition_on_places(family: GraphFamily, rules: SectionsConfig, targets: Sequence[Target]) -> GraphFamily:
    """The graphs that the places of a room's buttons allow by the schematic's sections, whose ranking is known."""
    if not rules.count:
        return family
    places = [(target.x, target.y) for target in targets]
    return _reweigh(family, rules.compute_likelihood(places, _measure_depths(family)))


def _reweigh(family: GraphFamily, likelihood: NDArray[np.float64]) -> GraphFamily:
    weights = family.weights * likelihood
    kept = np.flatnonzero(weights)
    return family.select(kept, weights[kept] / weights.sum())


def find_schematic(instance: RoomInstance) -> RoomConfig:
    """The schematic that a room was drawn from: the preset or the rung of its name that draws its puzzle.

    Raises:
        UnsupportedError: none does.
    """
    for config in _list_schematics(instance.name):
        if instance.seed is not None and sample_puzzle(config, instance.seed)[1] == instance.puzzle:
            return config
    raise UnsupportedError(f"which schematic room {instance.id} ({instance.name}) was drawn from is not known: take a "
                           "preset, a rung of the ladder, or an InstanceSet, which holds its schematic")


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
