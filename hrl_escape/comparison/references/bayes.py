"""The searcher that knows how graphs are drawn: fewest expected primitives until the exit, without learning.

It knows the schematic, what marks mean included, the room and what every press showed, and nothing else of the graph.
Up to six buttons (one fewer where wrong presses reset, and where some marks deceive) its choices are optimal in
expectation over the schematic's graphs, with the lengths of ways from button to button as the planner finds them. With
more it takes the button with the best odds per primitive, odds estimated by a sample of graphs. Nobody who must
discover the graph can need fewer primitives in the mean, but for what these lengths leave out.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import cast

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.comparison.episodes import StateRecorder
from hrl_escape.comparison.references.belief_graph import BeliefGraph, Ways, make_belief_graph
from hrl_escape.comparison.references.by_lights import Searcher
from hrl_escape.comparison.references.graph_family import (
    MOST_BUTTONS,
    GraphFamily,
    can_light,
    condition_on_room,
    find_schematic,
    infer_motif,
    make_family,
)
from hrl_escape.comparison.references.graph_particles import GraphParticles
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from hrl_escape.errors import PlanningFailed, UnsupportedError
from hrl_escape.planning.goals import ExitGoal, Goal, PressGoal
from hrl_escape.planning.planner import RoomPlanner, get_planner

_NO_WAY = 1e4
"""Primitives of a way that the planner does not find."""


class BayesSearcher(Searcher):
    """Fewest expected primitives, over the graphs that the room's schematic can draw.

    Raises:
        UnsupportedError: with the first decision, in rooms whose puzzle is not of buttons that stay on, or whose
            schematic is not known.
    """

    RULE = "needs the fewest expected primitives over the graphs that the schematic can draw"

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        self._mind: _Mind | None = None  # of the present room alone: a hundred megabytes with six buttons
        self._odds: NDArray[np.float64] | None = None

    def expect(self, odds: NDArray[np.float64] | None) -> None:
        """Set the odds of the motifs of marks for rooms to come, (motifs,); None for the schematic's."""
        self._odds, self._mind = odds, None

    def infer_motif(self) -> NDArray[np.float64] | None:
        """Odds of the motifs after the presses in this room, (motifs,); None where marks have no motifs."""
        return None if self._mind is None else self._mind.infer_motif()

    def _begin(self, is_new: bool) -> None:
        if self._mind is None or self._mind.room.id != self._room.instance.id:
            rooms = getattr(self._room, "rooms", None)
            self._mind = _Mind(self._room.instance,
                               find_schematic(self._room.instance) if rooms is None else rooms.config, self._odds)
        if is_new:
            self._mind.forget()

    def _note(self, action: int, before: RoomState, after: RoomState) -> None:
        target, = self._options[action].targets
        touched = after.touching & ~before.touching
        lit = _get_bits(before) | _get_bits(after) & touched & ((1 << target) - 1)  # of two at once the lower is first
        if touched >> target & 1 and not lit >> target & 1:
            assert self._mind is not None
            self._mind.learn(target, lit, bool(_get_bits(after) >> target & 1), self._puzzle.is_solved(after.puzzle))

    def _describe(self, action: int, state: RoomState) -> str:
        assert self._mind is not None
        return f"lights with {self._mind.compute_odds(_get_bits(state))[self._options[action].targets[0]]:.0%}"

    def _choose(self, legal: Sequence[int], state: RoomState, rng: np.random.Generator) -> int:
        assert self._mind is not None
        actions = {self._options[action].targets[0]: action for action in legal}
        return actions[self._mind.choose(state, sorted(actions))]


class _Mind:
    """Knowledge of one room: its ways, and the graphs that agree with the presses."""

    def __init__(self, room: RoomInstance, schematic: RoomConfig, odds: NDArray[np.float64] | None) -> None:
        puzzle, config = room.puzzle, schematic.puzzle
        if not isinstance(puzzle, ButtonsPuzzle) or puzzle.allow_off or puzzle.locks:
            raise UnsupportedError(f"smdp-bayes knows rooms of buttons that stay on and do not lock each other; in "
                                   f"{room.name} take smdp-retrace")
        self.room, self._puzzle, self._planner = room, puzzle, get_planner(room)
        assert isinstance(config, ButtonsConfig)
        self._config, self._odds = config, odds
        self._graph: BeliefGraph | None = None
        has_doubtful_marks = bool(puzzle.marks) and 0 < config.marks.truth < 1
        if puzzle.count <= MOST_BUTTONS - (puzzle.on_violation == "reset") - has_doubtful_marks:
            family = make_family(self._config, puzzle.count)
            self._family = condition_on_room(family, config, room, odds)
            make = make_belief_graph if self._family is family else BeliefGraph  # one for all rooms, or the room's own
            self._graph = make(self._family, puzzle.on_violation)
            self._ways = measure_ways(self._planner)
            self._costs = self._graph.solve(self._ways)

    def forget(self) -> None:
        """Return to the schematic's odds."""
        self._last: int | None = None  # button pressed last
        if self._graph is not None:
            self._graphs = np.arange(len(self._family.weights), dtype=np.int32)
        else:
            rng = np.random.default_rng(self.room.seed)
            self._particles = GraphParticles(self._config, self._puzzle.count, rng, self._puzzle.marks)

    def learn(self, target: int, lit: int, has_lit: bool, has_opened: bool) -> None:
        """Take note of a press of an unlit button, `lit` being the bits before it."""
        self._last = target
        if self._graph is None:
            self._particles.learn((target, lit, has_lit, has_opened))
            return
        family, kept = self._family, self._graphs
        allowed = can_light(family.parents[kept, target], lit)
        agrees = allowed == has_lit
        if has_lit:
            agrees &= (family.goals[kept] == target) == has_opened
        self._graphs = kept[agrees]

    def choose(self, state: RoomState, targets: Sequence[int]) -> int:
        """The button to press next, among those whose options may be taken."""
        lit = _get_bits(state)
        legs = np.array([_count_primitives(self._planner, state, PressGoal(target)) for target in targets])
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
        left = GraphFamily(self._family.parents[self._graphs], self._family.goals[self._graphs],
                           weights / weights.sum())
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
    states = [*(_find_end(planner, start, PressGoal(target)) for target in range(count)), start]
    for before, button in itertools.product(range(count + 1), range(count)):
        state = states[before] and _find_end(planner, states[before], PressGoal(button))
        if state is not None:
            place = before * count + button
            legs[place] = [_count_primitives(planner, state, PressGoal(other)) for other in range(count)]
            leaving[place] = _count_primitives(planner, state, ExitGoal())
    arrivals = np.tile(np.arange(count) * count, count + 1)[:, None] + np.arange(count)
    return Ways(legs, arrivals, leaving)


def _get_bits(state: RoomState) -> int:
    """Bits of the buttons that are lit."""
    return cast(int, state.puzzle)


def _find_end(planner: RoomPlanner, state: RoomState, goal: Goal) -> RoomState | None:
    try:
        return planner.plan(state, goal).states[-1]
    except PlanningFailed:
        return None


def _count_primitives(planner: RoomPlanner, state: RoomState, goal: Goal) -> float:
    try:
        return float(planner.plan(state, goal).cost)
    except PlanningFailed:
        return _NO_WAY
