"""Interface and registry of tensor forms: a puzzle's rules over 64-bit words, one word per room.

A puzzle with few states needs no form of its own: `TabulatedPuzzle` reads a table, made by applying the rules in every
reachable state. Puzzles with maps, with things on the floor, that watch every primitive or that have too many states
have no table.
"""

from __future__ import annotations

import dataclasses
import itertools
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Sequence
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, NoReturn

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.instance import SpaceLayout
from hrl_escape.env.puzzles.base import USE, Contacts, Puzzle
from hrl_escape.env.puzzles.mixins import Barring, Pushing, get_mixin
from hrl_escape.env.tensor_geometry import store
from hrl_escape.errors import StateError, UnsupportedError, show_value

GRIPS = (1, -1, USE)
"""Values of `Contacts.grip` in a table, in order."""
MOST_TABULATED = 200_000
"""Most states of a puzzle with a table."""
_MOST_TRIED = 500
"""Most pairs of targets touched at once that are checked against the table."""


@dataclasses.dataclass(frozen=True)
class PuzzleTable:
    """The rules of a puzzle with S states, in which a primitive has O outcomes, for E events.

    Events are a press of each target. If the puzzle uses grips, each of `GRIPS` adds an event that touches no target
    and one per touched target. Several presses in one primitive count in index order. If a grip touches several
    targets, the first with an effect counts.
    """

    states: tuple[Any, ...]  # all states, initial states first
    numbers: dict[Any, int]  # index of each state
    after: NDArray[np.int32]  # index of the state after an event, int32 (events, states, outcomes)
    rewards: NDArray[np.float64]  # reward of the event, float64 (events, states, outcomes)
    observed: NDArray[np.float32]  # observation numbers, float32 (numbers, states)
    lit: NDArray[np.int64]  # bits of the targets that are on, int64 (states,)
    shut: NDArray[np.int64]  # bits of the inner doors that are shut, int64 (states,)
    solved: NDArray[np.bool_]  # bool (states,)
    failed: NDArray[np.bool_]  # bool (states,)


class _UnseenError(Exception):
    """The rules read a value that a table does not contain."""


class _Unseen:
    """Placeholder for a value of `Contacts`: any use of it raises `_UnseenError`."""

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
def tabulate(puzzle: Puzzle, pairs: bool = True, most: int | None = None) -> PuzzleTable:
    """Make the table of a puzzle.

    Args:
        puzzle: the puzzle.
        pairs: whether to check that several targets touched at once have the effect in the table. If false, the table
            is only valid for single targets.
        most: largest number of states, or None for `MOST_TABULATED`.

    Raises:
        UnsupportedError: the puzzle cannot have a table. It watches every primitive, its rules read more than presses,
            grips and the random number, simultaneous targets do not count one after the other, or there are more than
            `most` states.
    """
    try:
        if puzzle.is_watching:
            raise _UnseenError("they watch every primitive")
        if isinstance(puzzle, Pushing):
            raise _UnseenError("moves push things")
        if puzzle.is_random and not puzzle.chances:
            raise _UnseenError("they read contacts.uniform and list no chances")
        return _tabulate(puzzle, pairs, MOST_TABULATED if most is None else most)
    except _UnseenError as why:
        raise UnsupportedError(
            f"puzzle {puzzle.kind!r} has no tensor form, and its rules have no table, because {why}. Use the Bullet "
            "engine (gymnasium.make, or make_vec with vectorization_mode='sync'), or register_tensor_puzzle") from None


def _tabulate(puzzle: Puzzle, pairs: bool, most: int) -> PuzzleTable:
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
                if len(numbers) == most:
                    raise _UnseenError(f"they have more than {most:,} states")
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
        np.array([get_mixin(puzzle, Barring).get_shut(state) for state in states], dtype=np.uint64).view(np.int64),
        np.array([puzzle.is_solved(state) for state in states]),
        np.array([puzzle.is_failed(state) for state in states]))
    if pairs:
        _check_pairs(puzzle, table, chances)
    return table


def _pack(flags: Sequence[bool]) -> int:
    return sum(1 << number for number, is_on in enumerate(flags) if is_on)


def _check_pairs(puzzle: Puzzle, table: PuzzleTable, chances: Sequence[float]) -> None:
    """Check in some states that two targets touched at once have the effect in the table."""
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
            raise _UnseenError(f"{names} at once have another effect in the state {table.states[before]} than one "
                               "after the other, or than the first with an effect")


PuzzleTables = dict[str, Tensor]


class TensorContacts(NamedTuple):
    """Contacts of one primitive in each room."""

    pressed: Tensor  # bits of the newly touched targets, int64 (rooms,)
    uniform: Tensor  # random numbers in (0, 1) for this primitive, float64 (rooms,); 0 if no puzzle is random
    touching: Tensor  # bits of all targets touched at the primitive's end, int64 (rooms,)
    grip: Tensor
    """1 if the primitive was `grip`, -1 if `release`, 2 if `use`, 3 if a move pushes, otherwise 0, int64 (rooms,)."""
    has_moved: Tensor  # whether the body's axis has moved, bool (rooms,)
    x: Tensor  # x of the bodies' axes, m, float64 (rooms,)
    y: Tensor  # y of the bodies' axes, m, float64 (rooms,)
    ahead: Tensor  # index of the inner door one move ahead, -1 for none, int64 (rooms,)
    beyond: Tensor  # index of the inner door two moves ahead, into which a thing is pushed, int64 (rooms,)


class TensorPuzzle(ABC):
    """A puzzle's rules over tensors. Its state is one int64 word per room.

    The methods that are not abstract suit puzzles whose state is an integer with bit i for target i.
    """

    whole: ClassVar[frozenset[str]] = frozenset()
    """Names of the tables that all instances share; every other table has one column per instance."""

    @abstractmethod
    def make_tables(self, puzzles: Sequence[Any], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Stack the tables that the rules read; the last axis is the instance, except in the tables of `whole`.

        `frame` has the targets of the instance with the most, and the bounds of its observation numbers. Targets that
        an instance lacks are never touched, and numbers that it lacks are 0.
        """

    @abstractmethod
    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Apply presses in index order to states (rooms,); tables have one column per room, (..., rooms or 1)."""

    @abstractmethod
    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return whether the exit is open, bool (rooms,)."""

    def is_failed(self, tables: PuzzleTables, state: Tensor) -> Tensor | None:
        """Return whether the puzzle has failed, bool (rooms,), or None for a puzzle that cannot fail."""
        return None

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts,
                       targets: int) -> Tensor | None:
        """Return the puzzle's reward in addition to the room's, float32 or float64 (rooms,), or None if it has none.

        It counts in rooms where something was pressed or gripped, and always for puzzles that watch every primitive.
        """
        return None

    def find_shut(self, tables: PuzzleTables, state: Tensor, doors: int) -> Tensor:
        """Return whether each inner door is shut, bool (doors, rooms)."""
        return torch.zeros((doors, state.shape[0]), dtype=torch.bool, device=state.device)

    def encode(self, puzzle: Any, state: Any) -> int:
        """Return the unsigned word of a state of the puzzle.

        Raises:
            StateError: the state has no word.
        """
        return state

    def decode(self, puzzle: Any, word: int) -> Any:
        """Return the puzzle's state of an unsigned word."""
        return word

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return the bits of the targets that are on, int64 (rooms,)."""
        return state

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """Return the observation numbers, each 0 or 1, float32 (numbers, rooms)."""
        return unpack_bits(state, targets, torch.float32)


def unpack_bits(words: Tensor, count: int, dtype: torch.dtype) -> Tensor:
    """Unpack the lowest bits of words (rooms,) along a new first axis: shape (count, rooms)."""
    places = torch.arange(count, device=words.device).unsqueeze(1)
    return ((words >> places) & 1).to(dtype)


def pack_bits(flags: Tensor) -> Tensor:
    """Pack truth values (count, rooms) into the lowest bits of words, int64 (rooms,)."""
    return (flags.to(torch.int64) << torch.arange(len(flags), device=flags.device).unsqueeze(1)).sum(0)


def as_signed(bits: int) -> int:
    """Return the signed 64-bit integer with the same bits."""
    return bits - 2**64 if bits >= 2**63 else bits


class TabulatedPuzzle(TensorPuzzle):
    """The form of all puzzles with few states: the word is the index of the state in the puzzle's table.

    Tables of different puzzles are concatenated and padded to a power of two of rows; `first` is the row of each
    instance's first state. The index of an outcome is the number of the instance's `chances` that do not exceed the
    random number.
    """

    whole = frozenset({"after", "rewards", "observed", "lit", "shut", "solved", "failed"})

    def make_tables(self, puzzles: Sequence[Puzzle], frame: SpaceLayout) -> dict[str, NDArray[Any]]:
        """Return `after` and `rewards` (events, rows x outcomes), `observed` (numbers, rows), and one value per row.

        Tables without content have no rows.
        """
        made = {puzzle: tabulate(puzzle) for puzzle in puzzles}
        tables, targets = list(made.values()), len(frame.target_names)
        firsts = dict(zip(made, np.cumsum([0, *(len(table.states) for table in tables)]).tolist(), strict=False))
        outcomes = max(table.after.shape[2] for table in tables)
        has_grips = any(len(table.after) > len(puzzle.target_names) for puzzle, table in made.items())
        events = targets + len(GRIPS) * (targets + 1) * has_grips
        rows = 1 << (sum(len(table.states) for table in tables) - 1).bit_length()
        after = np.tile(np.arange(rows, dtype=np.int32)[None, :, None], (events, 1, outcomes))
        rewards = np.zeros(after.shape)
        observed = np.zeros((len(frame.bounds), rows), dtype=np.float32)
        words, flags = np.zeros((2, rows), dtype=np.int64), np.zeros((2, rows), dtype=bool)
        for (puzzle, table), first in zip(made.items(), firsts.values(), strict=True):
            place, own = slice(first, first + len(table.states)), len(puzzle.target_names)
            kept = _list_rows(own, targets)[: len(table.after)]
            for number in range(outcomes):
                outcome = min(number, table.after.shape[2] - 1)
                after[kept, place, number] = table.after[..., outcome] + first
                rewards[kept, place, number] = table.rewards[..., outcome]
            observed[: len(table.observed), place] = table.observed
            words[:, place], flags[:, place] = (table.lit, table.shut), (table.solved, table.failed)
        chances = [(*puzzle.chances, *(2.0,) * (outcomes - 1 - len(puzzle.chances))) for puzzle in puzzles]
        return {"after": after.reshape(events, -1), "rewards": _drop_zeros(rewards.reshape(events, -1)),
                "observed": observed, "lit": words[0], "shut": _drop_zeros(words[1]), "solved": flags[0],
                "failed": _drop_zeros(flags[1]),
                "first": np.array([firsts[puzzle] for puzzle in puzzles], dtype=np.int64),
                "chances": np.array(chances, dtype=np.float64).reshape(len(puzzles), -1).T}

    def _walk(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int
              ) -> tuple[Tensor, Tensor]:
        """Rows after presses in index order and a grip, int64 (rooms,), and their rewards, float64 (rooms,)."""
        after, rewards = tables["after"], tables["rewards"]
        outcomes = tables["chances"].shape[0] + 1
        outcome = (contacts.uniform >= tables["chances"]).sum(0)
        row, reward = tables["first"] + state, torch.zeros_like(contacts.uniform)
        for target in range(targets):
            is_pressed, place = (contacts.pressed >> target & 1) != 0, row * outcomes + outcome
            if rewards.shape[-1]:
                reward = reward + torch.where(is_pressed, rewards[target][place], 0.0)
            row = torch.where(is_pressed, after[target][place].to(torch.int64), row)
        if after.shape[0] == targets:
            return row, reward
        is_grip, first = torch.zeros_like(row, dtype=torch.bool), torch.full_like(row, targets)
        for number, grip in enumerate(GRIPS):
            is_this = contacts.grip == grip
            is_grip, first = is_grip | is_this, torch.where(is_this, targets + number * (targets + 1), first)
        place, width = store(row * outcomes + outcome), after.shape[1]
        chosen, is_idle = torch.zeros_like(row), torch.ones_like(row, dtype=torch.bool)
        for target in range(targets):
            is_touched = (contacts.touching >> target & 1) != 0
            acts = store(after.view(-1)[(first + target + 1) * width + place] != row)
            chosen = torch.where(is_touched & ((chosen == 0) | (is_idle & acts)), target + 1, chosen)
            is_idle = is_idle & ~(is_touched & acts)
        place = store((first + chosen) * width + place)
        if rewards.shape[-1]:
            reward = reward + torch.where(is_grip, rewards.view(-1)[place], 0.0)
        return torch.where(is_grip, after.view(-1)[place].to(torch.int64), row), reward

    def update(self, tables: PuzzleTables, state: Tensor, contacts: TensorContacts, targets: int) -> Tensor:
        """Look up the presses one after the other, then the grip."""
        return self._walk(tables, state, contacts, targets)[0] - tables["first"]

    def compute_reward(self, tables: PuzzleTables, before: Tensor, after: Tensor, contacts: TensorContacts,
                       targets: int) -> Tensor | None:
        """Return the sum of the rewards of presses and grip, float64 (rooms,)."""
        return self._walk(tables, before, contacts, targets)[1] if tables["rewards"].shape[-1] else None

    def is_solved(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return the `solved` flag of each state's row, bool (rooms,)."""
        return tables["solved"][tables["first"] + state]

    def is_failed(self, tables: PuzzleTables, state: Tensor) -> Tensor | None:
        """Return the `failed` flag of each state's row, bool (rooms,), or None if no state is failed."""
        return tables["failed"][tables["first"] + state] if tables["failed"].shape[-1] else None

    def find_shut(self, tables: PuzzleTables, state: Tensor, doors: int) -> Tensor:
        """Return whether the state's row shuts each inner door, bool (doors, rooms)."""
        if not tables["shut"].shape[-1]:
            return super().find_shut(tables, state, doors)
        return unpack_bits(tables["shut"][tables["first"] + state], doors, torch.bool)

    def get_lit(self, tables: PuzzleTables, state: Tensor) -> Tensor:
        """Return the bits of the lit targets in each state's row, int64 (rooms,)."""
        return tables["lit"][tables["first"] + state]

    def observe(self, tables: PuzzleTables, state: Tensor, targets: int) -> Tensor:
        """Return the observation numbers in each state's row, float32 (numbers, rooms)."""
        return tables["observed"][:, tables["first"] + state]

    def encode(self, puzzle: Puzzle, state: Any) -> int:
        """Return the index of a state in the puzzle's table."""
        number = tabulate(puzzle).numbers.get(state)
        if number is None:
            raise StateError(f"the state {show_value(state)} of puzzle {puzzle.kind!r} is unreachable by presses and "
                             "grips, and a batch supports reachable states only")
        return number

    def decode(self, puzzle: Puzzle, word: int) -> Any:
        """Return the state at an index of the puzzle's table."""
        return tabulate(puzzle).states[word]


def _list_rows(own: int, targets: int) -> list[int]:
    """Indices of a puzzle's events among the events of a batch with more targets."""
    presses = list(range(own))
    return presses + [targets + grip * (targets + 1) + touched for grip in range(len(GRIPS))
                      for touched in range(own + 1)]


def _drop_zeros(table: NDArray[Any]) -> NDArray[Any]:
    return table if table.any() else table[..., :0]


_FORMS: dict[str, TensorPuzzle] = {}
_TABULATED = TabulatedPuzzle()


def register_tensor_puzzle(puzzle_type: type[Puzzle], form: TensorPuzzle) -> None:
    """Register the tensor form of a puzzle without a table, or one that is faster than the table."""
    _FORMS[puzzle_type.kind] = form


def get_tensor_puzzle(kind: str) -> TensorPuzzle:
    """Return the tensor form of a puzzle: the registered one, otherwise `TabulatedPuzzle`."""
    return _FORMS.get(kind, _TABULATED)
