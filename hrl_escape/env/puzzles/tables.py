"""Tables of puzzles with few states: the rules, tried once in every state that can be reached.

A table lists the effect of each press, grip, release and use in each state. It is made from the puzzle's rules, so the
batched engine runs such a puzzle without a second form of it. Puzzles with maps, with things on the floor, that watch
every primitive or that have too many states have no table.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Hashable, Iterator, Sequence
from functools import lru_cache
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.puzzles.base import USE, Contacts, Puzzle
from hrl_escape.env.puzzles.traits import Barring, Pushing, get_trait
from hrl_escape.errors import UnsupportedError

GRIPS = (1, -1, USE)
"""Values of `Contacts.grip` in a table, in order."""
MOST_TABULATED = 200_000
"""Most states of a puzzle with a table."""
_MOST_TRIED = 500
"""Most pairs of targets touched at once that are compared with the table."""


@dataclasses.dataclass(frozen=True)
class PuzzleTable:
    """The rules of a puzzle with S states, in which a primitive has O outcomes, for E events.

    Events are a press of each target, and where the puzzle has use for them, for each of `GRIPS` one that touches
    nothing and one for each target touched. Several presses of one primitive count in index order; of several targets
    touched by a grip, the first at which it does anything counts.
    """

    states: tuple[Any, ...]  # the states, those in which episodes may begin first
    numbers: dict[Any, int]  # their numbers
    after: NDArray[np.int32]  # number of the state after an event, int32 (events, states, outcomes)
    rewards: NDArray[np.float64]  # reward of the event, float64 (events, states, outcomes)
    observed: NDArray[np.float32]  # observation numbers, float32 (numbers, states)
    lit: NDArray[np.int64]  # bits of the targets that are on, int64 (states,)
    shut: NDArray[np.int64]  # bits of the inner doors that are shut, int64 (states,)
    solved: NDArray[np.bool_]  # bool (states,)
    failed: NDArray[np.bool_]  # bool (states,)


class _UnseenError(Exception):
    """The rules have read a value that a table does not hold."""


class _Unseen:
    """Stand-in for a value of `Contacts`: any use of it raises `_UnseenError`."""

    def __init__(self, name: str) -> None:
        self._name = name

    def _refuse(self, *_: Any) -> NoReturn:
        raise _UnseenError(f"they read contacts.{self._name}")

    __bool__ = __int__ = __float__ = __index__ = __len__ = __iter__ = __contains__ = __getitem__ = _refuse
    __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = __neg__ = __abs__ = __round__ = _refuse
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _refuse
    __floordiv__ = __rfloordiv__ = __mod__ = __rmod__ = __pow__ = __rpow__ = __and__ = __rand__ = __rshift__ = _refuse
    __hash__ = _refuse  # type: ignore[assignment]


_UNSEEN: dict[str, Any] = {name: _Unseen(name) for name in ("touching", "prop_poses", "has_moved", "x", "y", "ahead",
                                                           "beyond")}


def _touch(targets: Sequence[int], grip: int, chance: float) -> Contacts:
    """Contacts of presses (grip 0), or of a grip that touches targets, with a given random number."""
    if not grip:
        return Contacts(tuple(targets), uniform=chance, **_UNSEEN)
    unseen: dict[str, Any] = _UNSEEN | {"touching": tuple(targets)}
    return Contacts((), uniform=chance, grip=grip, **unseen)


def _list_events(targets: int) -> Iterator[tuple[int, tuple[int, ...]]]:
    """List grips, 0 for presses, and touched targets of all events."""
    yield from ((0, (target,)) for target in range(targets))
    yield from ((grip, touched) for grip in GRIPS for touched in ((), *((target,) for target in range(targets))))


@lru_cache(maxsize=1024)
def tabulate(puzzle: Puzzle) -> PuzzleTable:
    """Make the table of a puzzle.

    Raises:
        UnsupportedError: it has none: it watches every primitive, its rules read more than what is pressed, gripped
            and drawn, several targets at once are not one after the other, or there are more than `MOST_TABULATED`
            states.
    """
    try:
        if puzzle.is_watching:
            raise _UnseenError("they watch every primitive")
        if isinstance(puzzle, Pushing):
            raise _UnseenError("moves push things")
        if puzzle.is_random and not puzzle.chances:
            raise _UnseenError("they read contacts.uniform and list no chances")
        return _tabulate(puzzle)
    except _UnseenError as why:
        raise UnsupportedError(
            f"puzzle {puzzle.kind!r} has no tensor form, and none can be made of its rules, for {why}: use the Bullet "
            "engine (gymnasium.make, or make_vec with vectorization_mode='sync'), or register_tensor_puzzle") from None


def _tabulate(puzzle: Puzzle) -> PuzzleTable:
    targets, chances = len(puzzle.target_names), (0.0, *puzzle.chances)
    numbers: dict[Hashable, int] = {}
    for state in puzzle.list_starts():
        numbers.setdefault(state, len(numbers))
    states = list(numbers)
    trials = [(event, outcome, _touch(touched, grip, chance))
              for event, (grip, touched) in enumerate(_list_events(targets)) for outcome, chance in enumerate(chances)]
    after, rewards = list[int](), list[float]()
    for before in states:
        for _, _, contacts in trials:
            state = puzzle.update(before, contacts)
            if state not in numbers:
                if len(numbers) == MOST_TABULATED:
                    raise _UnseenError(f"they have more than {MOST_TABULATED:,} states")
                numbers[state] = len(numbers)
                states.append(state)
            after.append(numbers[state])
            rewards.append(puzzle.compute_reward(before, state, contacts))
    shape = (len(states), len(trials) // len(chances), len(chances))
    then = np.array(after, dtype=np.int32).reshape(shape).transpose(1, 0, 2)
    earned = np.array(rewards, dtype=np.float64).reshape(shape).transpose(1, 0, 2)
    here = np.arange(len(states), dtype=np.int32)[:, None]
    if (then[targets:] == here).all() and not earned[targets:].any():
        then, earned = then[:targets], earned[:targets]
    table = PuzzleTable(
        tuple(states), numbers, np.ascontiguousarray(then), np.ascontiguousarray(earned),
        np.array([puzzle.observe(state) for state in states], dtype=np.float32).reshape(
            len(states), len(puzzle.bounds)).T,
        np.array([_pack(puzzle.get_lit(state)) for state in states], dtype=np.uint64).view(np.int64),
        np.array([get_trait(puzzle, Barring).get_shut(state) for state in states], dtype=np.uint64).view(np.int64),
        np.array([puzzle.is_solved(state) for state in states]),
        np.array([puzzle.is_failed(state) for state in states]))
    _check_pairs(puzzle, table, chances)
    return table


def _pack(flags: Sequence[bool]) -> int:
    return sum(1 << number for number, is_on in enumerate(flags) if is_on)


def _check_pairs(puzzle: Puzzle, table: PuzzleTable, chances: Sequence[float]) -> None:
    """Check in some of the states that two targets touched at once have the effect in the table."""
    targets = len(puzzle.target_names)
    pairs = list(itertools.combinations(range(targets), 2))
    grips = (0, *GRIPS) if len(table.after) > targets else (0,)
    trials = [(grip, pair, outcome) for grip in grips for pair in pairs for outcome in range(len(chances))]
    every = itertools.product(range(len(table.states)), trials)
    step = max(1, len(table.states) * len(trials) // _MOST_TRIED) | 1
    for before, (grip, pair, outcome) in itertools.islice(every, 0, None, step):
        if grip:
            first = targets + GRIPS.index(grip) * (targets + 1) + 1
            events = [first + target for target in pair]
            after = table.after[:, before, outcome]
            events = [next((event for event in events if after[event] != before), events[0])]
        else:
            events = list(pair)
        state, reward = before, 0.0
        for event in events:
            state, reward = int(table.after[event, state, outcome]), reward + table.rewards[event, state, outcome]
        contacts = _touch(pair, grip, (chances[outcome] + (*chances, 1.0)[outcome + 1]) / 2)
        really = puzzle.update(table.states[before], contacts)
        earned = puzzle.compute_reward(table.states[before], really, contacts)
        if really != table.states[state] or abs(earned - reward) > 1e-6:
            names = " and ".join(puzzle.target_names[target] for target in pair)
            raise _UnseenError(f"{names} at once do something else in the state {table.states[before]} than "
                               "one after the other, or than the first that does anything")
