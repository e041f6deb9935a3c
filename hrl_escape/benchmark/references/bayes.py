"""The Bayes planner, given how graphs are drawn: fewest expected primitives until the exit, without learning.

It knows the room configuration, what marks mean included, the room and what every press showed, and nothing else of the
graph. Up to six buttons (one fewer where wrong presses do more than nothing, and where some marks deceive, unless the
graphs are few) its choices are optimal in expectation over the room configuration's graphs and rules, with the lengths
of ways from button to button as the planner finds them; a puzzle that is failed costs as much as the exit is worth.
With more it takes the button with the best odds per primitive, odds estimated by a sample of graphs.

Its mean is a lower bound, in expectation, for any agent that has to discover the graph within one episode, up to the
approximation of path lengths. An agent that keeps what it found in earlier episodes of the room can need fewer.

Every graph and rule that a room configuration can draw is listed with its exact probability by running the room
configuration's own generator once for each sequence of outcomes that its draws can have, so that a change to the
generator is a change here too. Which buttons are lit and which of them agree with all presses so far is the planner's
belief. A press divides it: the button lights and opens the exit, lights alone, or does not light, after which nothing
has changed, all is off, or the episode is over. Beliefs (Astrom 1965; Kaelbling, Littman and Cassandra 1998) form a
graph without cycles where presses are the only news, and one pass backwards gives the optimal expected cost. Graphs too
many to list are sampled by sequential Monte Carlo with moves (Chopin 2002; Gilks and Berzuini 2001): those that a press
contradicts are replaced, and Metropolis steps exchange the labels of two buttons, under which every graph is as likely
as before.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Sequence
from functools import cached_property, lru_cache
from typing import Any, TypeVar, cast

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.by_lights import SearchBaseline
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance, Target
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.presets import PRESETS
from hrl_escape.env.puzzles.buttons import VIOLATION_RULES, ButtonsConfig, ButtonsPuzzle, SectionsConfig
from hrl_escape.env.puzzles.graphs import (
    Edges,
    GraphConfig,
    compute_order,
    mask_parents,
    sample_graph,
    sample_relabelled,
)
from hrl_escape.env.puzzles.marks import MarksConfig, compute_depths
from hrl_escape.env.sampling.generation import sample_puzzle
from hrl_escape.errors import PlanningFailed, UnknownNameError, UnsupportedError
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.planner import RoomPlanner, get_planner
from hrl_escape.settings import Between

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

    def select(self, kept: NDArray[np.integer], weights: NDArray[np.float64]) -> GraphFamily:
        """Some of the graphs, with new probabilities."""
        return GraphFamily(self.parents[kept], self.goals[kept], weights, self.rules[kept])


def can_light(parents: NDArray[np.uint64], lit: int) -> NDArray[np.bool_]:
    """True where a press would light a button: its parents, bits in an array of any shape, are all among `lit`."""
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

    `UnsupportedError` for a family with other draws than those that `iterate_outcomes` follows.
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
    """List the labelled graphs that a configuration gives to rooms with so many buttons, under each of its rules.

    The room configuration's `count` and `graph.max_parents` may be ranges. `UnsupportedError` for more than
    `MOST_BUTTONS`.
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
    """The graphs of a room configuration's family that may be a room's before its first press, by its marks and places.

    `config` is the room configuration's puzzle, `odds` the probability of each motif of marks, (motifs,); all alike by
    default.
    """
    assert isinstance(room.puzzle, ButtonsPuzzle)
    return condition_on_places(condition_on_marks(family, config.marks, room.puzzle.marks, odds), config.sections,
                               room.targets)


def infer_motif(family: GraphFamily, rules: MarksConfig, marks: tuple[int, ...],
                odds: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Probability of each motif of marks, (motifs,), by the graphs that are still possible in a room.

    These are as likely as `condition_on_marks` and all presses since made them. `odds` are those before the room.
    """
    by_motif = rules.compute_motif_likelihood(marks, _classify(family, rules))
    by_motif *= 1.0 if odds is None else odds[:, None]
    return by_motif / by_motif.sum(axis=0) @ family.weights


def condition_on_marks(family: GraphFamily, rules: MarksConfig, marks: tuple[int, ...],
                       odds: NDArray[np.float64] | None = None) -> GraphFamily:
    """The graphs that the marks of a room allow, as likely as these make them; the same family where they say nothing.

    The code of the marks is known. `odds` are the probabilities of the motifs, (motifs,); all alike by default.
    """
    if not marks or rules.shuffled:
        return family
    return _reweigh(family, rules.compute_likelihood(marks, _classify(family, rules), odds))


def condition_on_places(family: GraphFamily, rules: SectionsConfig, targets: Sequence[Target]) -> GraphFamily:
    """The graphs that the places of a room's buttons allow by the configuration's sections, whose ranking is known."""
    if not rules.count:
        return family
    places = [(target.x, target.y) for target in targets]
    return _reweigh(family, rules.compute_likelihood(places, _measure_depths(family)))


def _reweigh(family: GraphFamily, likelihood: NDArray[np.float64]) -> GraphFamily:
    weights = family.weights * likelihood
    kept = np.flatnonzero(weights)
    return family.select(kept, weights[kept] / weights.sum())


def find_own_config(instance: RoomInstance) -> RoomConfig:
    """The room configuration that a room was drawn from: the preset or the rung of its name that draws its puzzle."""
    for config in _list_configs(instance.name):
        if instance.seed is not None and sample_puzzle(config, instance.seed)[1] == instance.puzzle:
            return config
    raise UnsupportedError(f"the configuration of room {instance.id} ({instance.name}) is not known: take a "
                           "preset, a rung of the ladder, or an InstanceSet, which holds its configuration")


def _list_configs(name: str) -> Iterator[RoomConfig]:
    from hrl_escape.env.presets import get_preset
    from hrl_escape.sets.benchmark import list_benchmarks, load_benchmark

    if name in PRESETS:
        yield get_preset(name)
    for benchmark in list_benchmarks():
        try:
            yield load_benchmark(benchmark)[name].config
        except UnknownNameError:
            continue


PARTICLES, SHAKES = 2048, 40
DOUBT = 4.0
"""Cost of a press that a graph does not explain, as a negative logarithm of its likelihood: finite, so that a sample
in which no graph is left can still find one."""


class GraphParticles:
    """Graphs of a room configuration, likely in the light of presses.

    Args:
        config: the room configuration's puzzle.
        count: number of buttons in the room.
        rng: draws and moves.
        marks: of the room's buttons; none without marks.

    Raises:
        UnsupportedError: marks of several motifs, wires, or sections.

    Attributes:
        parents: uint64 (particles, buttons), the bits of each button's parents.
        goals: int64 (particles,), the button that opens the exit.
    """

    def __init__(self, config: ButtonsConfig, count: int, rng: np.random.Generator, marks: tuple[int, ...] = ()
                 ) -> None:
        if marks and config.marks.motifs > 1:
            raise UnsupportedError(f"marks of {config.marks.motifs} motifs on {count} buttons: bayes lists the "
                                   "graphs of fewer, and its samples of more know one motif")
        if marks and config.marks.kind == "wires":
            raise UnsupportedError(f"wires between {count} buttons: bayes lists the graphs of fewer, and its "
                                   "samples of more do not know which button a wire comes from")
        if config.sections.count:
            raise UnsupportedError(f"sections with {count} buttons: bayes lists the graphs of fewer, and its "
                                   "samples of more do not know where buttons hang")
        self._rng, self._presses = rng, list[tuple[int, int, bool, bool]]()
        self.parents = np.zeros((PARTICLES, count), np.uint64)
        self.goals = np.zeros(PARTICLES, np.int64)
        self._classes = np.zeros((PARTICLES, count), np.int64)
        for number in range(PARTICLES):
            edges, self.goals[number] = _draw_graph(config, count, rng)
            self.parents[number] = mask_parents(edges, count)
            if marks:
                self._classes[number] = config.marks.classify(count, edges, int(self.goals[number]))
        single = [[config.marks.compute_likelihood((mark,), np.array([[own]]))[0] for own in
                   range(config.marks.classes)] for mark in marks] or [[1.0] * config.marks.classes] * count
        with np.errstate(divide="ignore"):
            self._surprise = -np.log(np.array(single))  # (buttons, classes), infinite where a mark cannot be
        self._doubts, self._surprises = self._measure(self.parents, self.goals, self._classes)
        if marks:
            self._resample()
            for _ in range(SHAKES):
                self._shake()

    def learn(self, press: tuple[int, int, bool, bool]) -> None:
        """Note a press: the unlit button, bits of those lit before, whether it lit, and whether the exit opened."""
        if press in self._presses:
            return
        self._presses.append(press)
        before = self._surprises
        self._doubts, self._surprises = self._measure(self.parents, self.goals, self._classes)
        self._resample(before)
        for _ in range(SHAKES):
            self._shake()

    def _resample(self, counted: NDArray[np.float64] | float = 0.0) -> None:
        """Draw graphs anew by how well they explain what is known; `counted` is what their number tells already."""
        energy = self._doubts + self._surprises - counted
        likelihood = np.exp(-(energy - energy.min()))
        chosen = self._rng.choice(PARTICLES, PARTICLES, p=likelihood / likelihood.sum())
        for name in ("parents", "goals", "_classes", "_doubts", "_surprises"):
            setattr(self, name, getattr(self, name)[chosen])

    def compute_odds(self, lit: int) -> NDArray[np.float64]:
        """Probability that each button would light if it were pressed, (buttons,), `lit` being the bits of those on."""
        weights = np.exp(-8.0 * self._doubts)
        weights = weights / weights.sum()
        return weights @ can_light(self.parents, lit)

    def _shake(self) -> None:
        """Exchange the labels of two buttons in every graph, where that explains the presses as well."""
        count = self.parents.shape[1]
        first = self._rng.integers(count, size=PARTICLES)
        second = (first + self._rng.integers(1, count, size=PARTICLES)) % count if count > 1 else first
        parents, goals = _exchange(self.parents, self.goals, first, second)
        classes, rows = self._classes.copy(), np.arange(PARTICLES)
        classes[rows, first], classes[rows, second] = self._classes[rows, second], self._classes[rows, first]
        doubts, surprises = self._measure(parents, goals, classes)
        gain = self._doubts + self._surprises - doubts - surprises
        taken = self._rng.random(PARTICLES) < np.exp(np.minimum(gain, 0.0))
        for name, moved in (("parents", parents), ("goals", goals), ("_classes", classes), ("_doubts", doubts),
                            ("_surprises", surprises)):
            getattr(self, name)[taken] = moved[taken]

    def _measure(self, parents: NDArray[np.uint64], goals: NDArray[np.int64], classes: NDArray[np.int64]
                 ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Doubts about every graph, `DOUBT` for each press or mark that cannot be, and the surprise at its marks."""
        surprise = self._surprise[np.arange(classes.shape[1]), classes]
        doubts = DOUBT * np.isinf(surprise).sum(axis=1)
        for button, lit, has_lit, has_opened in self._presses:
            allowed = can_light(parents[:, button], lit)
            doubts += DOUBT * (allowed != has_lit)
            if has_lit:
                doubts += DOUBT * ((goals == button) != has_opened)
        return doubts, np.where(np.isinf(surprise), 0.0, surprise).sum(axis=1)


def _draw_graph(config: ButtonsConfig, count: int, rng: np.random.Generator) -> tuple[Edges, int]:
    """A graph of the room configuration for a room with so many buttons."""
    most: Any = config.graph.max_parents
    if isinstance(most, Between):
        most = int(rng.integers(int(most.low), int(most.high), endpoint=True))
    return sample_relabelled(dataclasses.replace(config.graph, max_parents=most), count, rng, config.goal)


def _exchange(parents: NDArray[np.uint64], goals: NDArray[np.int64], first: NDArray[np.int64],
              second: NDArray[np.int64]) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Each graph with the labels of its two buttons exchanged, as rows of parents and as bits in all rows."""
    rows = np.arange(len(parents))
    moved = parents.copy()
    moved[rows, first], moved[rows, second] = parents[rows, second], parents[rows, first]
    low, high = first.astype(np.uint64)[:, None], second.astype(np.uint64)[:, None]
    differ = (moved >> low ^ moved >> high) & np.uint64(1)
    moved ^= differ << low | differ << high
    others = np.where(goals == first, second, np.where(goals == second, first, goals))
    return moved, others


# --- beliefs over graphs that can be listed ----------------------------------------------

MOST_BELIEFS = 3_000_000
"""Largest belief graph, about 1 kB a belief."""


@dataclasses.dataclass(frozen=True)
class Ways:
    """Lengths of ways between places, in primitives."""

    legs: NDArray[np.floating]  # float (places, buttons), from a place to the press of a button
    arrivals: NDArray[np.int64]  # int (places, buttons), the place of the robot after that
    leaving: NDArray[np.floating]  # float (places,), from a place to the open exit
    failure: float = 0.0  # cost of a failed puzzle


class BeliefGraph:
    """Every belief that presses can lead to in a family of graphs, children before parents.

    Raises:
        UnsupportedError: more than `MOST_BELIEFS` beliefs.

    Attributes:
        opens: float32 (beliefs, buttons), probability that a press opens the exit.
        lights: that it lights the button and does not open the exit.
        fails: that it fails the puzzle.
        resets: that it is seen to turn buttons off.
        lit: int32 (beliefs, buttons), the belief after a press that lights; -1 where it cannot be.
        reset: that after one which is seen to turn buttons off.
        dark: that after one which changes nothing.
    """

    def __init__(self, family: GraphFamily) -> None:
        self.family = family
        self._numbers: dict[tuple[int, int], int] = {}
        self._rows: list[tuple[list[Any], ...]] = []
        self._levels: list[int] = []
        self.root = self._add(0, np.arange(len(family.weights), dtype=np.int32))
        opens, lights, fails, resets, lit, reset, dark = zip(*self._rows, strict=True)
        self.opens, self.lights = np.array(opens, np.float32), np.array(lights, np.float32)
        self.fails, self.resets = np.array(fails, np.float32), np.array(resets, np.float32)
        self.lit, self.reset, self.dark = (np.array(after, np.int32) for after in (lit, reset, dark))
        del self._rows

    def __len__(self) -> int:
        return len(self.opens)

    def find(self, lit: int, graphs: NDArray[np.int32]) -> int | None:
        """Number of a belief; None for one that no choice between presses of unlit buttons leads to.

        `lit` are the bits of the buttons that are on, `graphs` the ascending numbers, int32, of those that all presses
        agree with.
        """
        return self._numbers.get((lit, hash(graphs.tobytes())))

    def _add(self, lit: int, graphs: NDArray[np.int32]) -> int:
        """Number of a belief, added with all that it can lead to if it is new."""
        key = lit, hash(graphs.tobytes())
        if key in self._numbers:
            return self._numbers[key]
        if len(self._numbers) >= MOST_BELIEFS:
            raise UnsupportedError(f"more than {MOST_BELIEFS:,} beliefs")
        family, count = self.family, self.family.count
        weights = family.weights[graphs]
        total, level = float(weights.sum()), -1
        opens, lights, fails, resets = ([0.0] * count for _ in range(4))
        after, reset, dark = ([-1] * count for _ in range(3))
        for button in range(count):
            if lit >> button & 1:
                continue
            allowed = can_light(family.parents[graphs, button], lit)
            if not allowed.any():
                continue  # known to be in vain
            is_goal = allowed & (family.goals[graphs] == button)
            lit_only = allowed & ~is_goal
            opens[button] = float(weights[is_goal].sum()) / total
            lights[button] = float(weights[lit_only].sum()) / total
            ended, undone, unchanged = split_mistakes(family.rules[graphs], ~allowed, lit)
            fails[button], resets[button] = (float(weights[part].sum()) / total for part in (ended, undone))
            for beliefs, part, bits in ((after, lit_only, lit | 1 << button), (reset, undone, 0),
                                        (dark, unchanged, lit)):
                if part.any():
                    beliefs[button] = self._add(bits, graphs[part])
                    level = max(level, self._levels[beliefs[button]])
        self._numbers[key] = len(self._rows)
        self._rows.append((opens, lights, fails, resets, after, reset, dark))
        self._levels.append(level + 1)
        return self._numbers[key]

    @cached_property
    def _by_level(self) -> list[NDArray[np.int64]]:
        """Numbers of beliefs by the longest way that is left from them; each leads to lower levels only."""
        levels = np.array(self._levels)
        order = np.argsort(levels, kind="stable")
        return np.split(order, np.cumsum(np.bincount(levels))[:-1])

    def solve(self, ways: Ways) -> NDArray[np.float32]:
        """Fewest expected primitives to the exit, by the optimal choices, float32 (beliefs, places).

        A puzzle that is failed counts as `ways.failure` primitives; infinite where no press opens the exit any more.
        """
        costs = np.full((len(self), len(ways.legs)), np.inf, np.float32)
        for beliefs in self._by_level:
            for button in range(self.family.count):
                here = self.compute_costs_after(costs, beliefs, button, ways)[:, ways.arrivals[:, button]]
                costs[beliefs] = np.minimum(here + ways.legs[:, button], costs[beliefs])
        return costs

    def compute_costs_after(self, costs: NDArray[np.float32], beliefs: NDArray[np.int64], button: int, ways: Ways
                            ) -> NDArray[np.float32]:
        """Expected primitives to the exit after a press, float32 (beliefs, places); infinite where it is in vain.

        `costs` are those from the beliefs that it leads to, `beliefs` the numbers of those before it.
        """
        opens, lights, fails, resets = (odds[beliefs, button, None] for odds in
                                        (self.opens, self.lights, self.fails, self.resets))
        after = opens * ways.leaving + fails * np.float32(ways.failure)
        for odds, then in ((lights, self.lit), (resets, self.reset), (1 - opens - lights - fails - resets, self.dark)):
            known = then[beliefs, button]
            after = after + odds * np.where(known[:, None] >= 0, costs[known], 0)
        return np.where(opens + lights > 0, after, np.float32(np.inf))


_make_belief_graph = lru_cache(maxsize=8)(BeliefGraph)
"""The belief graph of a family, kept for the next room."""


def split_mistakes(rules: NDArray[np.int64], mistaken: NDArray[np.bool_], lit: int) -> list[NDArray[np.bool_]]:
    """Split graphs under which a press is mistaken by what shows: it fails, buttons go off, or nothing changes.

    `rules` and `mistaken` are (graphs,). With no button on before it (bits `lit`) a reset shows nothing.
    """
    ignored, resets, fails = (mistaken & (rules == VIOLATION_RULES.index(rule)) for rule in ("ignore", "reset", "fail"))
    return [fails, resets & bool(lit), ignored | resets & (not lit)]


# --- the planner ------------------------------------------------------------------------

_NO_WAY = 1e4
"""Primitives of a way that the planner does not find."""


class BayesPlanner(SearchBaseline):
    """Fewest expected primitives, over the graphs that the room's configuration can draw.

    The first decision raises `UnsupportedError` where the puzzle is not of buttons that stay on, or the room
    configuration is not known.
    """

    RULE = "needs the fewest expected primitives over the graphs that the room configuration can draw"

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        self._mind: _Mind | None = None  # of the present room alone: a hundred megabytes with six buttons
        self._odds: NDArray[np.float64] | None = None

    def expect(self, odds: NDArray[np.float64] | None) -> None:
        """Set the odds of the motifs of marks for rooms to come, (motifs,); None for the room configuration's."""
        self._odds, self._mind = odds, None

    def infer_motif(self) -> NDArray[np.float64] | None:
        """Odds of the motifs after the presses in this room, (motifs,); None where marks have no motifs."""
        return None if self._mind is None else self._mind.infer_motif()

    def _begin(self, is_new: bool) -> None:
        if self._mind is None or self._mind.room.id != self._room.instance.id:
            rooms = getattr(self._room, "rooms", None)
            self._mind = _Mind(self._room.instance,
                               find_own_config(self._room.instance) if rooms is None else rooms.config, self._odds)
        if is_new:
            self._mind.forget()

    def _note(self, action: int, before: RoomState, after: RoomState) -> None:
        target, = self._options[action].targets
        touched = after.touching & ~before.touching
        lit = _get_bits(before) | _get_bits(after) & touched & ((1 << target) - 1)  # of two at once the lower is first
        if touched >> target & 1 and not lit >> target & 1:
            assert self._mind is not None
            self._mind.learn(target, lit, _get_bits(after), self._puzzle.is_solved(after.puzzle))

    def _describe(self, action: int, state: RoomState) -> str:
        assert self._mind is not None
        return f"lights with {self._mind.compute_odds(_get_bits(state))[self._options[action].targets[0]]:.0%}"

    def _choose(self, legal: Sequence[int], state: RoomState, rng: np.random.Generator) -> int:
        assert self._mind is not None
        actions = {self._options[action].targets[0]: action for action in legal}
        return actions[self._mind.choose(state, sorted(actions))]


class _Mind:
    """Knowledge of one room: its ways, and the graphs that agree with the presses."""

    def __init__(self, room: RoomInstance, room_config: RoomConfig, odds: NDArray[np.float64] | None) -> None:
        puzzle, config = room.puzzle, room_config.puzzle
        if not isinstance(puzzle, ButtonsPuzzle) or puzzle.allow_off or puzzle.locks:
            raise UnsupportedError(f"bayes knows rooms of buttons that stay on and do not lock each other; in "
                                   f"{room.name} take search-backtrack")
        self.room, self._puzzle, self._planner = room, puzzle, get_planner(room)
        assert isinstance(config, ButtonsConfig)
        self._config, self._odds = config, odds
        self._graph: BeliefGraph | None = None
        has_doubtful_marks = bool(puzzle.marks) and 0 < config.marks.truth < 1
        doubts = (config.on_violation != "ignore") + has_doubtful_marks
        if puzzle.count <= MOST_BUTTONS - min(doubts, 1 if config.graph.kind == "chain" else 2):  # chains are few
            family = make_family(self._config, puzzle.count)
            self._family = condition_on_room(family, config, room, odds)
            make = _make_belief_graph if self._family is family else BeliefGraph  # one for all rooms, or the room's own
            self._graph = make(self._family)
            self._ways = measure_ways(self._planner)
            self._costs = self._graph.solve(self._ways)

    def forget(self) -> None:
        """Return to the room configuration's odds."""
        self._last: int | None = None  # button pressed last
        if self._graph is not None:
            self._graphs = np.arange(len(self._family.weights), dtype=np.int32)
        else:
            rng = np.random.default_rng(self.room.seed)
            self._particles = GraphParticles(self._config, self._puzzle.count, rng, self._puzzle.marks)

    def learn(self, target: int, lit: int, after: int, has_opened: bool) -> None:
        """Take note of a press of an unlit button, `lit` being the bits before it and `after` those after it."""
        self._last, has_lit = target, bool(after >> target & 1)
        if self._graph is None:
            self._particles.learn((target, lit, has_lit, has_opened))
            return
        family, kept = self._family, self._graphs
        allowed = can_light(family.parents[kept, target], lit)
        agrees = allowed == has_lit
        if has_lit:
            agrees &= (family.goals[kept] == target) == has_opened
        else:
            _, undone, unchanged = split_mistakes(family.rules[kept], agrees, lit)
            agrees = undone if lit & ~after else unchanged
        self._graphs = kept[agrees]

    def choose(self, state: RoomState, targets: Sequence[int]) -> int:
        """The button to press next, among those whose options may be taken."""
        lit = _get_bits(state)
        legs = np.array([_go(self._planner, state, PressGoal(target))[1] for target in targets])
        belief = None if self._graph is None else self._graph.find(lit, self._graphs)
        if self._graph is not None and belief is not None:
            at, count = np.array([belief]), self._puzzle.count
            last = count if self._last is None else self._last
            after = [self._graph.compute_costs_after(self._costs, at, target, self._ways) for target in targets]
            costs = legs + [cost[0, last * count + target] for cost, target in zip(after, targets, strict=True)]
            if np.isfinite(costs).any():
                return targets[int(costs.argmin())]
        odds = self.compute_odds(lit)[list(targets)]
        unlit = np.array([not lit >> target & 1 for target in targets])
        return targets[int(np.argmax(unlit * (odds + 1e-9) / (legs + 1.0)))]

    def infer_motif(self) -> NDArray[np.float64] | None:
        """Odds of the motifs of marks by the graphs that are left, (motifs,); None without, or in a sample."""
        if self._graph is None or self._config.marks.motifs == 1:
            return None
        weights = self._family.weights[self._graphs]
        left = self._family.select(self._graphs, weights / weights.sum())
        return infer_motif(left, self._config.marks, self._puzzle.marks, self._odds)

    def compute_odds(self, lit: int) -> NDArray[np.float64]:
        """Probability that a press lights each button, shape (buttons,), `lit` being the bits now."""
        if self._graph is None:
            return self._particles.compute_odds(lit)
        family, kept = self._family, self._graphs
        return family.weights[kept] @ can_light(family.parents[kept], lit) / family.weights[kept].sum()


def measure_ways(planner: RoomPlanner) -> Ways:
    """Ways from button to button and to the exit, every inner door open, as the planner finds them.

    A place is where the robot presses a button when it comes from the start or from another button, for a way depends
    on the heading at its beginning: place `before * buttons + button`, where `before` is the number of buttons for the
    start.
    """
    room = planner.instance
    count = len(room.targets)
    legs = np.full(((count + 1) * count, count), _NO_WAY, np.float32)
    leaving = np.full((count + 1) * count, _NO_WAY, np.float32)
    start = planner.rules.make_state(room.starts[0])._replace(puzzle=(1 << count) - 1)
    states = [*(_go(planner, start, PressGoal(target))[0] for target in range(count)), start]
    for place, (before, button) in enumerate(itertools.product(states, range(count))):
        state = before and _go(planner, before, PressGoal(button))[0]
        if state is not None:
            legs[place] = [_go(planner, state, PressGoal(other))[1] for other in range(count)]
            leaving[place] = _go(planner, state, ExitGoal())[1]
    arrivals = np.tile(np.arange(count) * count, count + 1)[:, None] + np.arange(count)
    return Ways(legs, arrivals, leaving, failure=room.reward.exit / -room.reward.step if room.reward.step < 0 else 0.0)


def _get_bits(state: RoomState) -> int:
    """Bits of the buttons that are lit."""
    return cast(int, state.puzzle)


def _go(planner: RoomPlanner, state: RoomState, goal: Goal) -> tuple[RoomState | None, float]:
    """State at the end of a planned way, and its primitives; none, and `_NO_WAY`, where the planner finds no way."""
    try:
        plan = planner.plan(state, goal)
        return plan.states[-1], float(plan.cost)
    except PlanningFailed:
        return None, _NO_WAY
