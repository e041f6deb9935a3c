"""Aims of the options of a batch where robots grip: which target, what to do there, and when that is possible.

A press is done as it begins, and leaving in the exit; `stepping.py` knows both without a table. Gripping and releasing
change what the puzzle's symbolic model says, so both are tried out once in every state of the puzzle, by the rules and
by the model, as `planning/goals.py` does it in one state.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.env.batched.poses import TensorState
from hrl_escape.env.batched.puzzles.base import GRIPS, as_signed, get_tensor_puzzle, tabulate
from hrl_escape.env.batched.tables import Layout, pick_column
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.base import Puzzle
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.meta_actions import list_goals
from hrl_escape.planning.goals import ExitGoal, GripGoal, PressGoal, name_goal

MOST_TRIED = 20_000
"""Largest number of puzzle states to try acts in, some seconds."""
NO_STATE = -(1 << 63)
"""Placeholder for the state after an act that does not reach its goal: no puzzle has this word."""
_SIGNS = {"grip": 1, "release": -1}
BatchGoal: TypeAlias = PressGoal | GripGoal | ExitGoal


class Aims(NamedTuple):
    """Aims of the options of a batch; empty where they press and leave only, in the order of the targets."""

    targets: Tensor  # the target to go to, or the number of targets for the exit, int64 (options, instances)
    acts: Tensor  # the primitive to take while touching it, -1 for a press and the exit, int64 (options, instances)
    kinds: Tensor  # kind of an instance's puzzle: instances of one kind behave alike, int64 (instances,)
    words: Tensor  # states of all puzzles, ascending, int64 (states,)
    can: Tensor  # whether an act is possible; true for presses and the exit, bool (options, kinds, states)
    after: Tensor  # states that reach the goal of an act, or `NO_STATE`, int64 (outcomes, options, kinds, states)


def check_goals(instance: RoomInstance) -> tuple[BatchGoal, ...]:
    """Goals of a room's options, in the order of their numbers. Raises `UnsupportedError` for one that no batch has."""
    goals = list[BatchGoal]()
    for goal in (*list_goals(instance), ExitGoal()):
        if not (isinstance(goal, (PressGoal, ExitGoal)) or (isinstance(goal, GripGoal) and goal.action in _SIGNS)):
            raise UnsupportedError("batched options press, grip, release and leave, and push nothing: use OptionsEnv "
                                   "over one room")
        goals.append(goal)
    return tuple(goals)


def make_aims(instances: Sequence[RoomInstance], device: torch.device) -> Aims:
    """Put what the options of several instances go for on a device.

    Raises:
        UnsupportedError: the instances differ in their options, or a puzzle's states cannot be tried.
    """
    every = [check_goals(instance) for instance in instances]
    if not any(isinstance(goal, GripGoal) for goals in every for goal in goals):
        none = torch.zeros((0, 0), dtype=torch.int64, device=device)
        return Aims(none, none, none.flatten(), none.flatten(), none.unsqueeze(0).bool(), none.view(0, 0, 0, 0))
    if len({tuple(name_goal(goal, room) for goal in goals) for room, goals in zip(instances, every, strict=True)}) > 1:
        raise UnsupportedError("batched options have one list of actions: these rooms differ in what can be gripped")
    exit_ = len(instances[0].frame.target_names)
    targets = [[exit_ if isinstance(goal, ExitGoal) else goal.target for goal in goals] for goals in every]
    primitives = [[room.robot.actions.find(goal.action) if isinstance(goal, GripGoal) else -1 for goal in goals]
                  for room, goals in zip(instances, every, strict=True)]
    tried = [_try_acts(room.puzzle, goals) for room, goals in zip(instances, every, strict=True)]
    kinds = {acts.content: acts for acts in tried}  # puzzles that do the same, such as towers of as many blocks
    numbers = {content: number for number, content in enumerate(kinds)}
    words = np.unique(np.concatenate([acts.words for acts in kinds.values()]))
    can = np.ones((len(every[0]), len(kinds), len(words)), dtype=np.bool_)
    after = np.full((max(len(acts.after) for acts in kinds.values()), *can.shape), NO_STATE, dtype=np.int64)
    for number, acts in enumerate(kinds.values()):
        places = np.searchsorted(words, acts.words)
        can[:, number, places], after[: len(acts.after), :, number, places] = acts.can, acts.after
    tables = (np.array(targets).T, np.array(primitives).T, np.array([numbers[acts.content] for acts in tried]), words,
              can, after)
    return Aims(*(torch.from_numpy(np.ascontiguousarray(table)).to(device) for table in tables))


@dataclasses.dataclass(frozen=True, eq=False)
class _Acts:
    """`words`, `can` and `after` of `Aims` for puzzles of one kind."""

    words: NDArray[np.int64]  # ascending, int64 (states,)
    can: NDArray[np.bool_]  # bool (options, states)
    after: NDArray[np.int64]  # int64 (outcomes, options, states)

    @cached_property
    def content(self) -> tuple[bytes, ...]:
        """Equal where all three are."""
        return self.words.tobytes(), self.can.tobytes(), self.after.tobytes()


@lru_cache(maxsize=1024)
def _try_acts(puzzle: Puzzle, goals: tuple[BatchGoal, ...]) -> _Acts:
    """Try all acts in all states of a puzzle, 10 ms for four blocks."""
    try:
        table = tabulate(puzzle, pairs=False, most=MOST_TRIED)
    except UnsupportedError as why:
        raise UnsupportedError(f"batched options grip and release where a puzzle has at most {MOST_TRIED:,} states and "
                               f"its rules watch no primitive: use OptionsEnv over one room ({why})") from None
    form, model, count = get_tensor_puzzle(puzzle.kind), puzzle.symbolic.make_symbolic_model(), len(puzzle.target_names)
    held = [puzzle.symbolic.get_facts(state) for state in table.states]
    names = {name: number for number, name in enumerate(sorted(frozenset(model.propositions).union(*held)))}
    facts = np.zeros((len(table.states), len(names)), dtype=np.bool_)
    for row, holds in enumerate(held):
        facts[row, [names[fact] for fact in holds]] = True
    words = np.array([as_signed(form.encode(puzzle, state)) for state in table.states], dtype=np.int64)
    can = np.ones((len(goals), len(words)), dtype=np.bool_)
    after = np.full((table.after.shape[2], len(goals), len(words)), NO_STATE, dtype=np.int64)

    def count_held(which: Iterable[str], rows: Any = slice(None)) -> NDArray[np.int64]:
        return facts[rows][:, [names[fact] for fact in which]].sum(axis=1)

    for number, goal in enumerate(goals):
        if not isinstance(goal, GripGoal):
            continue
        can[number] = False
        if goal.target >= count:  # a target of other rooms
            continue
        grip = GRIPS.index(_SIGNS[goal.action])
        place = count + grip * (count + 1) + 1 + goal.target
        event = table.after[place] if place < len(table.after) else None  # (states, outcomes), or None if nothing comes
        for op in model.operators:
            if (op.action, op.target) != (goal.action, puzzle.target_names[goal.target]):
                continue
            fits = (count_held(op.preconditions) == len(op.preconditions)) & (count_held(op.forbidden) == 0)
            can[number] |= fits
            if event is None:
                continue
            for outcome, then in enumerate(event.T):
                is_reached = count_held(op.add, then) == len(op.add)
                if puzzle.is_random and op.delete:
                    is_reached |= count_held(op.delete, then) == 0
                after[outcome, number] = np.where(fits & is_reached, words[then], after[outcome, number])
    order = np.argsort(words)
    return _Acts(words[order], can[:, order], after[..., order])


# --- in a batch of rooms -------------------------------------------------------------------


def read_targets(layout: Layout, aims: Aims, instance: Tensor, goal: Tensor) -> Tensor:
    """Targets to go to for the goals of rooms, int64 (rooms,); the number of targets for the exit."""
    return aims.targets[goal, pick_column(layout, instance)] if len(aims.targets) else goal


def read_acts(layout: Layout, aims: Aims, instance: Tensor, goal: Tensor) -> Tensor:
    """Primitives that the goals of rooms end with, int64 (rooms,); -1 for a press and the exit."""
    return aims.acts[goal, pick_column(layout, instance)]


def find_possible(layout: Layout, aims: Aims, state: TensorState) -> Tensor:
    """Return true where an act of an option is possible in a room's puzzle, or it has none, bool (rooms, options).

    In a state that no presses or grips lead to, no act is.
    """
    kind, place = _find_place(layout, aims, state)
    is_known, acts = aims.words[place] == state.puzzle, aims.acts[:, pick_column(layout, state.instance)]
    return (aims.can[:, kind, place] & (is_known | (acts < 0))).T


def has_acted(layout: Layout, aims: Aims, goal: Tensor, before: TensorState, after: TensorState) -> Tensor:
    """Return true where the puzzles of rooms have changed as the acts of their goals change them, bool (rooms,)."""
    kind, place = _find_place(layout, aims, before)
    return (aims.after[:, goal, kind, place] == after.puzzle).any(0)


def _find_place(layout: Layout, aims: Aims, state: TensorState) -> tuple[Tensor, Tensor]:
    """Kind of the rooms' puzzles and number of their states, int64 (rooms,) each."""
    place = torch.searchsorted(aims.words, state.puzzle)
    return aims.kinds[pick_column(layout, state.instance)], place.clamp(max=len(aims.words) - 1)

