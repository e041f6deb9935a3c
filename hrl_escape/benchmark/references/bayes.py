"""Bayes planner: minimises expected primitives to the exit, given how graphs are drawn, without learning.

It is given the room configuration, including the meaning of cues, and the room without its graph. Up to six buttons its
choices are optimal in expectation, with path lengths between buttons as the planner finds them (five buttons if wrong
presses have effects or cues are noisy, and any number in a family of few graphs). They are also optimal in code locks
and light boxes whose variants can be listed. A failed puzzle costs as much as the exit is worth. With more buttons it
takes the button with the best odds per primitive, with odds estimated by a sample of graphs.

Its mean is a lower bound, in expectation, for any agent that has to discover the graph within one episode, up to the
approximation of path lengths. An agent that remembers earlier episodes in the room can need fewer primitives.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, cast

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.belief_graph import BeliefGraph, split_mistakes
from hrl_escape.benchmark.references.graph_family import (
    MOST_BUTTONS,
    can_light,
    condition_on_room,
    infer_code,
    make_family,
)
from hrl_escape.benchmark.references.graph_particles import GraphParticles
from hrl_escape.benchmark.references.path_lengths import measure_paths, walk_path
from hrl_escape.benchmark.references.puzzle_beliefs import PuzzleBeliefs, find_solved, list_drawn
from hrl_escape.benchmark.references.search import SearchBaseline
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.base import PuzzleConfig
from hrl_escape.env.puzzles.blocks_world import BlocksWorldConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from hrl_escape.env.puzzles.codes import CodeLockConfig
from hrl_escape.env.puzzles.light_box import LightBoxConfig
from hrl_escape.env.puzzles.lights_out import LightsOutConfig
from hrl_escape.errors import UnsupportedError
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.planner import get_planner
from hrl_escape.sets.own_config import find_own_config

LISTED = (CodeLockConfig, LightBoxConfig)
"""Puzzles with few variants, which are listed."""
SHOWN = (BlocksWorldConfig, LightsOutConfig)
"""Puzzles whose rules follow from what is shown, so that the Bayes planner is the oracle."""
_make_belief_graph = lru_cache(maxsize=8)(BeliefGraph)
"""Cache of the belief graphs of families without cues, which rooms share."""


@lru_cache(maxsize=8)
def _make_puzzle_beliefs(config: PuzzleConfig) -> PuzzleBeliefs:
    return PuzzleBeliefs(list_drawn(config))


class BayesPlanner(SearchBaseline):
    """Planner that minimises expected primitives over the graphs that the room configuration can draw.

    The first decision raises `UnsupportedError` if the puzzle is none of buttons that stay on, a code lock and a light
    box, or if the room configuration is unknown.
    """

    RULE = "needs the fewest expected primitives over the puzzles that the room configuration can draw"

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        self._posterior: Posterior | PuzzlePosterior | None = None  # of the current room only: 100 MB with six buttons
        self._odds: NDArray[np.float64] | None = None

    def expect(self, odds: NDArray[np.float64] | None) -> None:
        """Set the prior over latent codes of cues for the next rooms, (codes,), or the default for None."""
        self._odds, self._posterior = odds, None

    def infer_code(self) -> NDArray[np.float64] | None:
        """Return the posterior over latent codes after the presses in this room, (codes,), or None without codes."""
        return self._posterior.infer_code() if isinstance(self._posterior, Posterior) else None

    def _begin(self, is_new: bool) -> None:
        if self._posterior is None or self._posterior.room.id != self._room.instance.id:
            rooms = getattr(self._room, "rooms", None)
            room = self._room.instance
            config = find_own_config(room) if rooms is None else rooms.config
            self._posterior = (PuzzlePosterior(room, config) if isinstance(config.puzzle, LISTED) else
                               Posterior(room, config, self._odds))
        if is_new:
            self._posterior.forget()

    def _note(self, action: int, before: RoomState, after: RoomState) -> None:
        target, = self._options[action].targets
        touched = after.touching & ~before.touching
        if isinstance(self._posterior, PuzzlePosterior):
            if touched >> target & 1:
                self._posterior.learn(target, after.puzzle)
            return
        lit = get_bits(before) | get_bits(after) & touched & ((1 << target) - 1)  # of two at once the lower is first
        if touched >> target & 1 and not lit >> target & 1:
            assert self._posterior is not None
            has_opened = self._puzzle.is_solved(after.puzzle) and not self._puzzle.is_solved(before.puzzle)
            self._posterior.learn(target, lit, get_bits(after), has_opened)  # an inner door can still bar the open exit

    def _describe(self, action: int, state: RoomState) -> str:
        assert self._posterior is not None
        return f"lights with {self._posterior.compute_odds(state)[self._options[action].targets[0]]:.0%}"

    def _choose(self, legal: Sequence[int], state: RoomState, rng: np.random.Generator) -> int:
        assert self._posterior is not None
        actions = {self._options[action].targets[0]: action for action in legal}
        return actions[self._posterior.choose(state, sorted(actions))]


class Posterior:
    """Posterior over the graphs of one room, with path lengths.

    Args:
        room: the room, whose graph is not read.
        room_config: configuration that the room was sampled from.
        odds: prior over latent codes of cues, (codes,), or None for the default.

    Attributes:
        graph: beliefs and their transitions, or None with too many graphs to list.
        family: graphs with their probabilities before the first press, where `graph` is given.
        ways: path lengths, where `graph` is given.
        costs: fewest expected primitives, float32 (beliefs, places), where `graph` is given.

    Raises:
        UnsupportedError: the puzzle has other parts than buttons that stay on and do not lock each other.
    """

    def __init__(self, room: RoomInstance, room_config: RoomConfig, odds: NDArray[np.float64] | None) -> None:
        puzzle, config = room.puzzle, room_config.puzzle
        if isinstance(config, SHOWN):
            raise UnsupportedError(f"nothing is hidden in {puzzle.kind}: use oracle")
        if not isinstance(puzzle, ButtonsPuzzle) or puzzle.allow_off or puzzle.locks:
            raise UnsupportedError(f"bayes supports buttons that stay on and do not lock each other, code locks and "
                                   f"light boxes; for {room.name} use search-backtrack")
        self.room, self._puzzle, self._planner = room, puzzle, get_planner(room)
        assert isinstance(config, ButtonsConfig)
        self._config, self._odds = config, odds
        self.graph: BeliefGraph | None = None
        has_doubtful_cues = bool(puzzle.cues) and 0 < config.cues.truth < 1
        doubts = (config.on_violation != "ignore") + has_doubtful_cues
        most = MOST_BUTTONS - min(doubts, 1 if config.graph.kind == "chain" else 2)  # chains are few
        if config.graph.family or puzzle.count <= most:
            family = make_family(self._config, puzzle.count)
            self.family = condition_on_room(family, config, room, odds)
            make = _make_belief_graph if self.family is family else BeliefGraph  # one for all rooms, or the room's own
            self.graph = make(self.family)
            self.ways = measure_paths(self._planner)
            self.costs = self.graph.solve(self.ways)

    def forget(self) -> None:
        """Return to the prior."""
        self._last: int | None = None  # button pressed last
        if self.graph is not None:
            self._graphs = np.arange(len(self.family.weights), dtype=np.int32)
        else:
            rng = np.random.default_rng(self.room.seed)
            self._particles = GraphParticles(self._config, self._puzzle.count, rng, self._puzzle.cues)

    def learn(self, target: int, lit: int, after: int, has_opened: bool) -> None:
        """Condition on a press of a button that was off; `lit` and `after` are the bits before and after it."""
        self._last, has_lit = target, bool(after >> target & 1)
        if self.graph is None:
            self._particles.learn((target, lit, has_lit, has_opened))
            return
        family, kept = self.family, self._graphs
        allowed = can_light(family.parents[kept, target], lit)
        agrees = allowed == has_lit
        if has_lit:
            agrees &= (family.goals[kept] == target) == has_opened
        else:
            _, undone, unchanged = split_mistakes(family.rules[kept], agrees, lit)
            agrees = undone if lit & ~after else unchanged
        self._graphs = kept[agrees]

    def choose(self, state: RoomState, targets: Sequence[int]) -> int:
        """Return the next button to press, among those with legal options."""
        lit = get_bits(state)
        legs = np.array([walk_path(self._planner, state, PressGoal(target))[1] for target in targets])
        belief = None if self.graph is None else self.graph.find(lit, self._graphs)
        if self.graph is not None and belief is not None:
            at, count = np.array([belief]), self._puzzle.count
            last = count if self._last is None else self._last
            after = [self.graph.compute_costs_after(self.costs, at, target, self.ways) for target in targets]
            costs = legs + [cost[0, last * count + target] for cost, target in zip(after, targets, strict=True)]
            if np.isfinite(costs).any():
                return targets[int(costs.argmin())]
        odds = self.compute_odds(state)[list(targets)]
        unlit = np.array([not lit >> target & 1 for target in targets])
        return targets[int(np.argmax(unlit * (odds + 1e-9) / (legs + 1.0)))]

    def infer_code(self) -> NDArray[np.float64] | None:
        """Return the posterior over latent codes, (codes,), or None without codes, or with sampled graphs."""
        if self.graph is None or self._config.cues.latent_codes == 1:
            return None
        weights = self.family.weights[self._graphs]
        left = self.family.select(self._graphs, weights / weights.sum())
        return infer_code(left, self._config.cues, self._puzzle.cues, self._odds)

    def compute_odds(self, state: RoomState) -> NDArray[np.float64]:
        """Compute the probability that a press turns each button on, (buttons,)."""
        lit = get_bits(state)
        if self.graph is None:
            return self._particles.compute_odds(lit)
        family, kept = self.family, self._graphs
        return family.weights[kept] @ can_light(family.parents[kept], lit) / family.weights[kept].sum()


class PuzzlePosterior:
    """Posterior over the puzzles of one room whose configuration draws few, with path lengths.

    Args:
        room: the room, whose puzzle is not read.
        room_config: configuration that the room was sampled from.

    Attributes:
        beliefs: beliefs that presses can lead to.
        ways: path lengths.
        costs: fewest expected primitives, float32 (beliefs + 1, places).
    """

    def __init__(self, room: RoomInstance, room_config: RoomConfig) -> None:
        self.room, self._puzzle, self._planner = room, room.puzzle, get_planner(room)
        self.beliefs = _make_puzzle_beliefs(room_config.puzzle)
        self.ways = measure_paths(self._planner, find_solved(room.puzzle))
        self.costs = self.beliefs.solve(self.ways)

    def forget(self) -> None:
        """Return to the prior."""
        self._last = len(self.room.targets)  # target pressed last; their number at the start
        self._belief = self.beliefs.root

    def learn(self, target: int, after: Any) -> None:
        """Condition on a press of a target by what shows of `after`, the state of the puzzle after it."""
        seen = self._puzzle.is_solved(after), self._puzzle.observe(after)
        _, self._belief = self.beliefs.press(self._belief, target)[seen]
        self._last = target

    def choose(self, state: RoomState, targets: Sequence[int]) -> int:
        """Return the next target to press, among those with legal options."""
        at = np.array([self.beliefs.find(self._belief)])
        count = len(self.room.targets)
        costs = [walk_path(self._planner, state, PressGoal(target))[1]
                 + self.beliefs.compute_costs_after(self.costs, at, target)[0, self._last * count + target]
                 for target in targets]
        return targets[int(np.argmin(costs))]

    def compute_odds(self, state: RoomState) -> NDArray[np.float64]:
        """Compute the probability that a press shows more progress, (targets,)."""
        shown = sum(self._puzzle.observe(state.puzzle))
        return np.array([sum(chance for (_, seen), (chance, _) in self.beliefs.press(self._belief, target).items()
                             if sum(seen) > shown) for target in range(len(self.room.targets))])


def get_bits(state: RoomState) -> int:
    """Return the bits of the buttons that are on."""
    return cast(int, state.puzzle)
