"""Families of dependency graphs: every graph that a room configuration can draw, with its exact probability.

Graphs are listed by running the configuration's own generator once for each sequence of random outcomes, so the list
follows any change to the generator. Cues and positions of buttons in a room condition the probabilities.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.instance import RoomInstance, Target
from hrl_escape.env.puzzles.buttons import VIOLATION_RULES, ButtonsConfig, ButtonsPuzzle, PositionalCuesConfig
from hrl_escape.env.puzzles.cues import CuesConfig, compute_depths
from hrl_escape.env.puzzles.graphs import (
    Edges,
    GraphConfig,
    compute_order,
    list_family,
    mask_parents,
    sample_graph,
)
from hrl_escape.errors import UnsupportedError
from hrl_escape.settings import Between

MOST_BUTTONS = 6
"""Largest number of buttons of a family that lists every graph."""

T = TypeVar("T", bound=Hashable)


@dataclasses.dataclass(frozen=True, eq=False)
class GraphFamily:
    """Labelled dependency graphs of buttons with the effect of a wrong press, and their probabilities."""

    parents: NDArray[np.uint64]  # uint64 (graphs, buttons), the bits of each button's parents
    goals: NDArray[np.int64]  # int64 (graphs,), the button that opens the exit
    weights: NDArray[np.float64]  # float64 (graphs,), probabilities; they sum to 1
    rules: NDArray[np.int64]  # int64 (graphs,), index into `VIOLATION_RULES` of the effect of a wrong press

    @property
    def count(self) -> int:
        """Number of buttons."""
        return self.parents.shape[1]

    def select(self, kept: NDArray[np.integer], weights: NDArray[np.float64]) -> GraphFamily:
        """Return some of the graphs with new probabilities."""
        return GraphFamily(self.parents[kept], self.goals[kept], weights, self.rules[kept])


def can_light(parents: NDArray[np.uint64], lit: int) -> NDArray[np.bool_]:
    """Return whether a press turns a button on.

    Args:
        parents: bits of the button's parents, uint64 of any shape.
        lit: bits of the buttons that are on.
    """
    return (parents & ~np.uint64(lit)) == 0


class _Draws:
    """Generator with a given sequence of outcomes, which records the probability of that sequence."""

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

    def permutation(self, count: int) -> NDArray[Any]:
        picked = self._pick(math.factorial(count))
        return np.array(next(itertools.islice(itertools.permutations(range(count)), picked, None)))


def iterate_outcomes(draw: Callable[[Any], T]) -> Iterator[tuple[T, float]]:
    """Yield every result of a random function with its probability.

    Args:
        draw: takes a generator and draws by `integers`, `permutation`, and `choice` without replacement. Its result
            must not depend on the order of chosen items.
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
    """Compute the probability of every graph of a family, before buttons are relabelled.

    Args:
        config: family of graphs; `max_parents` can be a range.
        count: number of buttons.

    Raises:
        UnsupportedError: the family draws in other ways than `iterate_outcomes` supports.
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
    """List the labelled graphs of a puzzle configuration, under each rule for wrong presses.

    Args:
        config: the puzzle; its `count` and `graph.max_parents` can be ranges.
        count: number of buttons.

    Raises:
        UnsupportedError: there are more than `MOST_BUTTONS` buttons, and each room draws a new graph.
    """
    if config.graph.family:
        found = {(mask_parents(edges, count), goal): 1.0 / config.graph.family
                 for edges, goal in list_family(config.graph, count, config.goal)}
        return _make_family(config, count, found)
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
    return _make_family(config, count, found)


def _make_family(config: ButtonsConfig, count: int, found: Mapping[tuple[tuple[int, ...], int], float]) -> GraphFamily:
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
def _classify(family: GraphFamily, rules: CuesConfig) -> NDArray[np.int64]:
    """Return the class of each button under each graph, (graphs, buttons)."""
    return np.array([rules.classify(family.count, edges, goal)
                     for edges, goal in zip(_list_edges(family), family.goals.tolist(), strict=True)])


@lru_cache(maxsize=16)
def _measure_depths(family: GraphFamily) -> NDArray[np.int64]:
    """Return the depth of each button under each graph, (graphs, buttons)."""
    return np.array([compute_depths(family.count, edges) for edges in _list_edges(family)])


def condition_on_room(family: GraphFamily, config: ButtonsConfig, room: RoomInstance,
                      odds: NDArray[np.float64] | None = None) -> GraphFamily:
    """Condition a family of graphs on the cues and the button positions of a room.

    Args:
        family: graphs of the room configuration.
        config: puzzle of the room configuration.
        room: the room.
        odds: probability of each latent code of the cues, (codes,); uniform by default.
    """
    assert isinstance(room.puzzle, ButtonsPuzzle)
    by_cues = condition_on_cues(family, config.cues, room.puzzle.cues, odds)
    return condition_on_positions(by_cues, config.positional_cues, room.targets)


def infer_code(family: GraphFamily, rules: CuesConfig, cues: tuple[int, ...],
               odds: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Compute the posterior over the latent codes of cues, (codes,).

    Args:
        family: graphs that are still possible, with their posterior probabilities.
        rules: rules of the cues.
        cues: cue of each button of the room.
        odds: prior over the codes, (codes,); uniform by default.
    """
    by_code = rules.compute_code_likelihood(cues, _classify(family, rules))
    by_code *= 1.0 if odds is None else odds[:, None]
    return by_code / by_code.sum(axis=0) @ family.weights


def condition_on_cues(family: GraphFamily, rules: CuesConfig, cues: tuple[int, ...],
                      odds: NDArray[np.float64] | None = None) -> GraphFamily:
    """Condition a family of graphs on the cues of a room; returns the same family if cues carry no information.

    Args:
        family: the graphs.
        rules: rules of the cues.
        cues: cue of each button of the room.
        odds: prior over latent codes, (codes,); uniform by default.
    """
    if not cues or rules.shuffled:
        return family
    return _reweigh(family, rules.compute_likelihood(cues, _classify(family, rules), odds))


def condition_on_positions(family: GraphFamily, rules: PositionalCuesConfig, targets: Sequence[Target]) -> GraphFamily:
    """Condition a family of graphs on the positions of a room's buttons, by the ranking of sections."""
    if not rules.sections:
        return family
    positions = [(target.x, target.y) for target in targets]
    return _reweigh(family, rules.compute_likelihood(positions, _measure_depths(family)))


def _reweigh(family: GraphFamily, likelihood: NDArray[np.float64]) -> GraphFamily:
    weights = family.weights * likelihood
    kept = np.flatnonzero(weights)
    return family.select(kept, weights[kept] / weights.sum())
