"""Counting baseline across rooms: the bar for learners that are tested in unseen rooms.

In training rooms it searches until it escapes, and counts which cues the next button had, out of the buttons that were
off. Cues of a button are its symbol, the direction of its place, its symbol together with that of the button turned on
before, its plug together with that button's colour, and its number together with that button's number, each by the
place in the order where that helps. In an unseen room it searches with backtracking and tries buttons by their odds
and their distance. A kind of cue counts only if it predicts the training rooms that are left out, one at a time.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.spec import COUNT_CUES
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.trained_search import TrainedSearch
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.cues import split_cue

CUE_KINDS = ("symbol", "direction", "symbols", "plug", "number")
"""Kinds of cues that are counted."""
CUE_SECTORS = 16
"""Directions from the middle of the floor that are distinguished."""
PRIOR = 1.0
"""Weight of the odds without cues, in buttons."""
MOST_ROOMS = 1_000
"""Training rooms that are counted."""

OrderStep = list[tuple[tuple[str, ...], bool]]
"""Buttons that were off at a step of an order: their cues, one of each kind, and whether the button was next."""


class RoomOrder(NamedTuple):
    """Cues of a room and the order of its buttons."""

    cues: tuple[int, ...]  # symbol of each button; empty without symbols
    sectors: tuple[int, ...]  # direction of each button from the middle of the floor, from 0 to `CUE_SECTORS` - 1
    order: tuple[int, ...]  # buttons in the order in which they were turned on


@dataclasses.dataclass
class _Count:
    """Times that buttons with a cue were off, and were next."""

    off: float = 0.0
    next: float = 0.0


class CountCues(TrainedSearch):
    """Counting baseline: learns in training rooms which cues the next button has.

    `act` searches and learns; `act_greedy` acts by the counts.
    """

    SPEC = COUNT_CUES
    RULE = "tries the buttons whose cues were next most often in training rooms, by odds and distance"
    STATE = ("counted", "_rng")

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        self._orders: dict[str, RoomOrder] = {}  # of each training room that it has escaped from
        self._losses: list[float] = []  # primitives lost by each wrong press
        self._memories: dict[str, tuple[dict[Any, Any], dict[Any, Any]]] = {}  # of rooms without an escape yet
        self._lit: list[int] = []  # targets that are on, in order
        self._table: CountTable | None = None

    @property
    def counted(self) -> Mapping[str, Any]:
        """Results of training, as plain values."""
        return {"orders": {room: [list(each) for each in own] for room, own in self._orders.items()},
                "losses": list(self._losses)}

    @counted.setter
    def counted(self, value: Mapping[str, Any]) -> None:
        self._orders = {room: RoomOrder(*map(tuple, own)) for room, own in value["orders"].items()}
        self._losses, self._table, self._memories = list(value["losses"]), None, {}

    @property
    def rooms(self) -> int:
        """Number of training rooms that it has escaped from."""
        return len(self._orders)

    def _learn(self, transition: SMDPTransition, has_escaped: bool) -> None:
        """Count the order of a training room at its first escape."""
        room = self._room.instance.id
        if has_escaped:
            if room not in self._orders and len(self._orders) < MOST_ROOMS:
                self._orders[room], self._table = self._look(), None
            self._memories.pop(room, None)
        else:
            if transition.terminated:
                self._losses.append(float(self._room.instance.horizon))
            self._memories[room] = self._known, self._states

    def _begin(self, is_new: bool) -> None:
        super()._begin(is_new)
        room = self._room.instance.id
        if self._is_learning and room in self._memories:
            self._known, self._states = self._memories[room]
        self._lit = []
        if self._table is None:
            self._table = CountTable(list(self._orders.values()))

    def _note(self, action: int, before: RoomState, after: RoomState) -> None:
        super()._note(action, before, after)
        was, now = (self._puzzle.get_lit(state.puzzle) for state in (before, after))
        target, *_ = self._options[action].targets
        if any(old and not new for old, new in zip(was, now, strict=True)):
            if self._is_learning:
                self._losses.append(float(len(self._recorder.states)))
            self._lit = []
        elif now[target] and not was[target]:
            self._lit.append(target)
        elif not now[target] and self._is_learning:
            self._losses.append(0.0)

    def _look(self) -> RoomOrder:
        """Return what the room shows so far."""
        room = self._room.instance
        turns = (math.atan2(target.y, target.x) % math.tau / math.tau for target in room.targets)
        sectors = tuple(min(int(turn * CUE_SECTORS), CUE_SECTORS - 1) for turn in turns)
        return RoomOrder(tuple(room.puzzle.cues), sectors, tuple(self._lit))

    def _weigh(self, room: RoomOrder, off: Sequence[int]) -> Sequence[float] | None:
        """Return the probability that each of the buttons that are off is next, or None if nothing is known."""
        return None if self._table is None else self._table.weigh(room, off)

    def _pick(self, untried: Sequence[int], state: RoomState) -> int:
        off = [target for target in range(self._puzzle.count) if target not in self._lit]
        odds = self._weigh(self._look(), off)
        if odds is None:
            return super()._pick(untried, state)
        open_ = {action: odds[off.index(self._options[action].targets[0])]
                 for action in untried if self._options[action].targets[0] in off}
        if not open_:
            return super()._pick(untried, state)
        total = sum(open_.values())
        loss = float(np.mean(self._losses)) if self._losses else 0.0
        step = self._room.instance.robot.move_step

        def expect(action: int) -> float:
            """Primitives for each light: the way, and what a wrong press loses."""
            share = open_[action] / total
            return (self._measure(action, state) / step + 1.0 + (1.0 - share) * loss) / share

        return min(open_, key=expect)


class CountTable:
    """Counts of the cues of next buttons in training rooms.

    Attributes:
        kinds: numbers of the kinds of cues that count, in `CUE_KINDS`.
    """

    def __init__(self, rooms: Sequence[RoomOrder]) -> None:
        steps = [list_steps(room) for room in rooms]
        self.kinds = _choose_kinds(steps)
        self._counts = _count(steps, self.kinds)

    def weigh(self, room: RoomOrder, off: Sequence[int]) -> Sequence[float] | None:
        """Return the probability that each of the buttons that are off is next, or None if no cue predicts it."""
        if not self.kinds:
            return None
        return _compute_odds([read_cues(room, target, len(room.order)) for target in off], self._counts, self.kinds)


def list_steps(room: RoomOrder) -> list[OrderStep]:
    """Return the buttons that were off at each step of an order, with their cues."""
    return [[(read_cues(room, target, place), target == room.order[place])
             for target in range(len(room.sectors)) if target not in room.order[:place]]
            for place in range(len(room.order))]


def read_cues(room: RoomOrder, target: int, place: int) -> tuple[str, ...]:
    """Return the cue of each of `CUE_KINDS` of a button after the first `place` buttons of the order were turned on."""
    last, plug, colour, previous, symbol = room.order[place - 1] if place else None, "", "", "", ""
    if room.cues:
        _, shape, size = split_cue(room.cues[target])
        plug, symbol = f"{shape},{size}", str(room.cues[target])
        if last is not None:
            colour, previous = str(split_cue(room.cues[last])[0]), str(room.cues[last])
    parts = (f"{place} {symbol}", f"{place} {room.sectors[target]}", f"{previous}>{symbol}", f"{colour}>{plug}",
             f"{'' if last is None else last}>{target}")
    return tuple(f"{kind}:{part}" for kind, part in zip(CUE_KINDS, parts, strict=True))


def _count(rooms: Iterable[Sequence[OrderStep]], kinds: Sequence[int]) -> dict[str, _Count]:
    """Count how often buttons with each cue were off, and were next."""
    found: dict[str, _Count] = {}
    for step in itertools.chain.from_iterable(rooms):
        for cues, is_next in step:
            for kind in kinds:
                count = found.setdefault(cues[kind], _Count())
                count.off += 1.0
                count.next += float(is_next)
    return found


def _compute_odds(off: Sequence[Sequence[str]], counts: Mapping[str, _Count], kinds: Sequence[int],
                  left_out: Mapping[str, _Count] | None = None) -> list[float]:
    """Return the probability that each button is next, by counts without those of a room that is left out."""
    base, weights, none = 1.0 / len(off), [], _Count()
    for cues in off:
        weight = 1.0
        for kind in kinds:
            count, without = counts.get(cues[kind], none), (left_out or {}).get(cues[kind], none)
            weight *= (count.next - without.next + PRIOR * base) / (count.off - without.off + PRIOR) / base
        weights.append(weight)
    total = sum(weights)
    return [weight / total for weight in weights]


def _choose_kinds(rooms: Sequence[Sequence[OrderStep]]) -> tuple[int, ...]:
    """Return the kinds of cues that predict the next button best in rooms that are left out, one at a time."""
    best, most = (), sum(math.log(1.0 / len(step)) for room in rooms for step in room)
    for size in (1, 2):
        for kinds in itertools.combinations(range(len(CUE_KINDS)), size):
            counts, total = _count(rooms, kinds), 0.0
            for room in rooms:
                own = _count([room], kinds)
                for step in room:
                    odds = _compute_odds([cues for cues, _ in step], counts, kinds, own)
                    total += math.log(next(each for each, (_, is_next) in zip(odds, step, strict=True) if is_next))
            if total > most:
                best, most = kinds, total
    return best
