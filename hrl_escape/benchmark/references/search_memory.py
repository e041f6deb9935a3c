"""Search baseline that remembers the earlier episodes in a room: the bar for learners within one room.

Until its first escape it searches with backtracking and keeps the results of all presses. Afterwards it repeats the
presses that turned buttons on, with one of them dropped or moved in each training episode, and keeps the change if the
episode was not longer. It is local search over orders of presses (Lin 1965). It reads lights, positions and whether the
exit is open, as learners over options do.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import gymnasium
import numpy as np

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.spec import SEARCH_MEMORY
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.trained_search import TrainedSearch
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.base import PuzzleState

_Press: TypeAlias = tuple[PuzzleState, int, PuzzleState]

_UNKNOWN = 10**9
"""Length of an escape that has not ended yet, longer than any."""


@dataclasses.dataclass
class _Memory:
    """Knowledge of one room."""

    room: str = ""  # content hash of the room
    results: list[_Press] = dataclasses.field(default_factory=list[_Press])
    """Puzzle state, action and puzzle state after it, in the order of their discovery."""
    presses: tuple[int, ...] = ()  # actions that turned buttons on in the shortest escape, in order; empty before one
    length: int = _UNKNOWN  # primitives of this escape
    waiting: list[tuple[int, ...]] = dataclasses.field(default_factory=list[tuple[int, ...]])
    """Changes of `presses` that are still to be tried, the last one first."""


class SearchMemory(TrainedSearch):
    """Search baseline that remembers earlier episodes in the room.

    `act` explores and learns. `act_greedy` repeats the shortest escape known, and searches before the first. Trials in
    one room share what they find out.
    """

    SPEC = SEARCH_MEMORY
    RULE = ("repeats the presses that turned buttons on in its shortest escape from the room, with one of them dropped "
            "or moved in each training episode")
    STATE = ("kept", "_rng")

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        self._learned = self._memory = _Memory()
        self._plan: list[int] = []  # presses still to make in this episode
        self._lit: list[int] = []  # actions that turned on the buttons that are on
        self._seen: set[tuple[PuzzleState, int]] = set()  # states and actions of `_memory.results`

    @property
    def kept(self) -> Mapping[str, Any]:
        """Results of training, as plain values."""
        return dataclasses.asdict(self._learned)

    @kept.setter
    def kept(self, value: Mapping[str, Any]) -> None:
        self._learned = self._memory = _Memory(
            value["room"], [(before, action, after) for before, action, after in value["results"]],
            tuple(value["presses"]), value["length"], [tuple(each) for each in value["waiting"]])

    def note_outcome(self, transition: SMDPTransition, rng: np.random.Generator) -> None:
        """Read the presses of an evaluation, for later trials in the room."""
        self.observe(transition)

    def _learn(self, transition: SMDPTransition, has_escaped: bool) -> None:
        """Keep the order of presses if the escape was not longer."""
        length, memory = len(self._recorder.states) - 1, self._memory
        if has_escaped and length <= memory.length:
            is_change = memory.length == _UNKNOWN or (length < memory.length and tuple(self._lit) != memory.presses)
            memory.presses, memory.length = tuple(self._lit), length
            if is_change:
                memory.waiting = self._list_changes(memory.presses)

    def _begin(self, is_new: bool) -> None:
        super()._begin(is_new=True)
        room = self._room.instance.id
        if self._is_learning:
            if self._learned.room != room:
                self._learned = _Memory(room)
            self._memory = self._learned
        elif is_new or self._memory.room != room:
            self._memory = copy.deepcopy(self._learned) if self._learned.room == room else _Memory(room)
        memory = self._memory
        self._seen = set()
        for before, action, after in memory.results:
            self._keep(before, action, after)
        self._lit = []
        self._plan = list(self._take_change() if self._is_learning else memory.presses)

    def _take_change(self) -> tuple[int, ...]:
        """Return the next change that is not known to fail, or the best presses without one."""
        memory = self._memory
        while memory.waiting:
            change = memory.waiting.pop()
            if self._may_work(change):
                return change
        return memory.presses

    def _may_work(self, presses: Sequence[int]) -> bool:
        """Return whether no press of an order is known to have no effect, or to undo others, where it would be made."""
        here: tuple[float, ...] = self._puzzle.observe(self._puzzle.make_state())
        for action in presses:
            there = self._known.get(here, {}).get(action)
            if there is None:
                return True
            if sum(there) <= sum(here):  # buttons that are on
                return False
            here = there
        return True

    def _list_changes(self, presses: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Return the presses with one dropped or moved, the longest tour by straight lines first.

        The last press stays, because it opens the exit. Moves that lengthen the tour are left out.
        """
        inner, last = presses[:-1], presses[-1:]
        drops = {inner[:at] + inner[at + 1:] for at in range(len(inner))}
        moves = {rest[:to] + inner[at:at + 1] + rest[to:] for at in range(len(inner))
                 for rest in (inner[:at] + inner[at + 1:],) for to in range(len(inner))} - {inner}
        now = self._measure_tour(presses)
        tours = sorted(((self._measure_tour(order + last), order + last) for order in drops | moves), reverse=True)
        return [order for length, order in tours if length < now]

    def _measure_tour(self, presses: Sequence[int]) -> float:
        """Return the length of straight lines from the start over the targets of presses to the exit, m."""
        room, start = self._room.instance, self._recorder.states[0]
        targets = [room.targets[self._options[action].targets[0]] for action in presses]
        places = [(start.x, start.y), *((target.x, target.y) for target in targets), room.exit.centre]
        return sum(math.dist(one, other) for one, other in zip(places, places[1:], strict=False))

    def _keep(self, before: PuzzleState, action: int, after: PuzzleState) -> None:
        self._seen.add((before, action))
        was, now = self._puzzle.observe(before), self._puzzle.observe(after)
        self._known.setdefault(was, {})[action] = now
        self._states.setdefault(was, before)
        self._states.setdefault(now, after)

    def _note(self, action: int, before: RoomState, after: RoomState) -> None:
        was, now, (target, *_) = before.puzzle, after.puzzle, self._options[action].targets
        if (was, action) not in self._seen or (was != now and (was, action, now) not in self._memory.results):
            self._memory.results.append((was, action, now))
            self._keep(was, action, now)
        lit_before, lit_after = self._puzzle.get_lit(was), self._puzzle.get_lit(now)
        if any(old and not new for old, new in zip(lit_before, lit_after, strict=True)):
            self._lit, self._plan = [], []  # a reset has undone them
        if lit_after[target] and not lit_before[target]:
            self._lit.append(action)
        if not self._memory.presses and self._puzzle.is_solved(now):
            self._memory.presses = tuple(self._lit)

    def _choose(self, legal: Sequence[int], state: RoomState, rng: np.random.Generator) -> int:
        while self._plan:
            action = self._plan.pop(0)
            if action in legal and self._is_dark(action, state.puzzle):
                return action
        return super()._choose(legal, state, rng)
