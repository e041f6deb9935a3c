"""The button puzzle (paper, section 5.2): binary buttons that depend on each other along a DAG.

A press turns a button on only if all its parents are on; what else it does is the rule of violations. One button is the
goal: while it is on, the exit is open. The state is an integer whose bit i is button i. A lock (a, b) is a dead end:
once a is on, b cannot be turned on any more. A button may open a door between two rooms, and bear a mark
(`marks.py`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.env.puzzles.base import Contacts, Panels, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.bits import GraphPuzzle
from hrl_escape.env.puzzles.graphs import (
    ButtonNumber,
    GraphConfig,
    compute_order,
    find_ancestors,
    mask_parents,
    sample_locks,
    sample_relabelled,
)
from hrl_escape.env.puzzles.marks import COLOURS, Mark, MarksConfig
from hrl_escape.env.puzzles.mixins import Doored, Marked
from hrl_escape.env.puzzles.symbolic import SymbolicModel
from hrl_escape.env.schema import HashedSettings
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

ViolationRule = Literal["ignore", "reset", "fail"]
"""Effect of a press with unmet parents: none, all buttons go off, or the puzzle is failed and the episode ends."""
VIOLATION_RULES: tuple[ViolationRule, ...] = get_args(ViolationRule)
FAILED = 1 << 63
"""Bit of a state in which the puzzle is failed."""
_FAILED_FACT = "failed"
MOST_TO_FAIL = 63
"""Buttons of a puzzle that can be failed: one bit of the word is kept for that."""
_TRIES = 200
"""Most graphs drawn in search of one with enough dead ends."""


@dataclasses.dataclass(frozen=True)
class SectionsConfig(HashedSettings):
    """Ranking of the directions from a room's middle by which its buttons are hung, so that places tell of the graph.

    The floor is cut into equal sections around the middle. Buttons that must wait for more others hang in sections of
    higher rank, and within one section further counter-clockwise. The ranking follows no rule, so it can be learned in
    some rooms and used in others. The places themselves are those of a room without sections.
    """

    _section = "sections"
    count: Annotated[int, Range(0, 64)] = 0
    """Equal sections around the middle, counter-clockwise from the right (0: places tell nothing of the graph)."""
    code: Annotated[int, Range(0, 2**63 - 1)] = 0
    """Seed of the ranking."""

    @cached_property
    def ranks(self) -> NDArray[np.int64]:
        """Rank of each section, (sections,)."""
        return np.random.default_rng([self.code, 5]).permutation(self.count)

    def sort_places(self, places: ArrayLike) -> NDArray[np.int64]:
        """Numbers of places (n, 2), m from the room's middle, in the order in which the buttons there come."""
        x, y = np.asarray(places, dtype=np.float64).T
        turns = np.arctan2(y, x) % math.tau / math.tau * self.count
        return np.lexsort((turns, self.ranks[np.minimum(turns.astype(np.int64), self.count - 1)]))

    def deal(self, places: ArrayLike, depths: Sequence[int], rng: np.random.Generator) -> NDArray[np.int64]:
        """Number of the place of each button; buttons that are equally deep are dealt at random."""
        dealt = np.empty(len(depths), dtype=np.int64)
        dealt[np.lexsort((rng.random(len(depths)), np.array(depths)))] = self.sort_places(places)
        return dealt

    def compute_likelihood(self, places: ArrayLike, depths: NDArray[np.int64]) -> NDArray[np.float64]:
        """Probability that buttons were dealt to the places where they hang, under each of several graphs.

        Args:
            places: of the buttons, (buttons, 2).
            depths: of each button under each graph, (graphs, buttons).

        Returns:
            float64 (graphs,); all 1 without sections.
        """
        if not self.count:
            return np.ones(len(depths))
        ways = np.array([math.prod(map(math.factorial, np.bincount(own).tolist())) for own in depths])
        return (np.diff(depths[:, self.sort_places(places)], axis=1) >= 0).all(axis=1) / ways


@dataclasses.dataclass(frozen=True)
class ButtonsConfig(PuzzleConfig):
    """Room configuration of the button puzzle."""

    kind = "buttons"
    _takes_ranges = True
    count: Annotated[int, Range(1, 64)] = 2
    """Number of buttons, each a panel on a wall."""
    graph: GraphConfig = GraphConfig()
    """Dependencies between buttons: a button turns on only once its parents are on."""
    on_violation: Literal["ignore", "reset", "fail", "drawn"] = "ignore"
    """A press with unmet parents is ignored, turns all buttons off, or fails the puzzle, which ends the episode.
    `drawn`: each room draws one of the three, and nothing shows which before the first mistake."""
    allow_off: bool = False
    """Pressing a button that is on turns it off."""
    goal: ButtonNumber | None = None
    """Number of the goal button from 0, before `graph.relabel` (None: last in topological order)."""
    buttons: Panels = Panels()
    """Sizes and places of the buttons' panels."""
    dead_ends: Annotated[int, Range(0, 64)] = 0
    """Locks: pairs of buttons. Once the first is on, the second, which the goal needs, cannot be turned on any more."""
    doors: Annotated[int, Range(0, 15)] = 0
    """Number of doorways with a door; each opens once a button of its own is on."""
    marks: MarksConfig = MarksConfig()
    """Symbols on the buttons that say something of the graph."""
    sections: SectionsConfig = SectionsConfig()
    """Directions from the room's middle whose ranking says something of the graph."""

    def check(self) -> None:
        """Check what spans several fields."""
        if self.goal is not None and self.goal >= self.count:
            raise ConfigError("puzzle.goal", self.goal, f"a button from 0 to {self.count - 1}")
        if self.graph.kind == "edges":
            compute_order(self.count, self.graph.edges)
        may_go_off = self.allow_off or self.on_violation in ("reset", "drawn")
        if self.on_violation in ("fail", "drawn") and self.count > MOST_TO_FAIL:
            raise ConfigError("puzzle.count", self.count, f"at most {MOST_TO_FAIL} where a press may fail the puzzle")
        if self.dead_ends and may_go_off:
            raise ConfigError("puzzle.dead_ends", self.dead_ends, "0 where buttons can be turned off again")
        if self.doors > self.count:
            raise ConfigError("puzzle.doors", self.doors, f"at most puzzle.count = {self.count}, a button for each")
        if self.doors and (may_go_off or self.dead_ends):
            raise ConfigError("puzzle.doors", self.doors,
                              "0 where buttons can be turned off again or locked, for a door might never open again")
        if self.marks.kind == "wires" and self.count > len(COLOURS):
            raise ConfigError("puzzle.count", self.count, f"at most {len(COLOURS)} with wires, a colour for each")
        if self.sections.count and (self.doors or self.buttons.places != "random"):
            raise ConfigError("puzzle.sections.count", self.sections.count, "0 where doors or fixed places decide "
                              "where buttons hang")
        super().check()

    def make_puzzle(self, rng: np.random.Generator) -> ButtonsPuzzle:
        """Sample the dependency graph, shuffle the buttons' numbers if it is to be relabelled, and choose openers.

        Raises:
            ConfigError: graphs like that have no place for so many dead ends.
        """
        for _ in range(_TRIES):
            edges, goal = sample_relabelled(self.graph, self.count, rng, self.goal)
            locks = sample_locks(self.count, edges, goal, self.dead_ends, rng) if self.dead_ends else ()
            if len(locks) == self.dead_ends:
                doors = tuple(rng.choice(self.count, self.doors, replace=False).tolist()) if self.doors else ()
                shown = (edges, goal)
                if self.marks.shuffled:
                    shown = sample_relabelled(self.graph, self.count, rng, self.goal)
                marks = () if self.marks.kind == "none" else self.marks.draw(self.count, *shown, rng)
                rule = self.on_violation
                if rule == "drawn":  # last of all, so that nothing else depends on it
                    rule = VIOLATION_RULES[rng.integers(len(VIOLATION_RULES))]
                return ButtonsPuzzle(self.count, edges, goal, rule, self.allow_off, locks, doors, marks)
        raise ConfigError("puzzle.dead_ends", self.dead_ends,
                          "as many as such graphs have pairs of buttons of which neither needs the other")


@dataclasses.dataclass(frozen=True)
class ButtonsPuzzle(Doored, Marked, GraphPuzzle):
    """A concrete button puzzle. Button i is called `button-<i+1>`."""

    kind, word = "buttons", "button"
    about = "Every button has a lamp. Some lamps come on only after others; which is hidden. One opens the exit."
    on_violation: ViolationRule = "ignore"
    """Effect of a press with unmet parents, or of a locked button."""
    allow_off: bool = False
    """Pressing a button that is on turns it off."""
    locks: tuple[tuple[ButtonNumber, ButtonNumber], ...] = ()
    """Pairs (a, b): while button a is on, b cannot be turned on."""
    doors: tuple[ButtonNumber, ...] = ()
    """Button that opens each inner door."""
    marks: tuple[Mark, ...] = ()
    """Number of the symbol on each button; none where buttons bear no marks."""

    def check(self) -> None:
        """Check what spans several fields."""
        super().check()
        if self.locks:
            if self.allow_off or self.on_violation == "reset":
                raise ConfigError("puzzle.locks", self.locks, "none where buttons can be turned off again")
            needed = find_ancestors(self.edge_list, (self.goal,))
            # in some order nothing that is needed is locked before it is on
            compute_order(self.count, (*self.edge_list, *((b, a) for a, b in self.locks if b in needed)))
        if len(self.marks) not in (0, self.count):
            raise ConfigError("puzzle.marks", self.marks, f"none, or one for each of {self.count} buttons")
        if any(button >= self.count for button in self.doors):
            raise ConfigError("puzzle.doors", self.doors, f"numbers from 0 to {self.count - 1}")
        if self.doors and (self.allow_off or self.on_violation == "reset"):
            raise ConfigError("puzzle.doors", self.doors, "none where buttons can be turned off again")
        if self.on_violation == "fail" and self.count > MOST_TO_FAIL:
            raise ConfigError("puzzle.count", self.count, f"at most {MOST_TO_FAIL} where a press may fail the puzzle")

    @cached_property
    def lock_masks(self) -> tuple[int, ...]:
        """For each button, the bits of the buttons that lock it."""
        return mask_parents(self.locks, self.count)

    @cached_property
    def failure(self) -> int:
        """Bit of the states in which the puzzle is failed; 0 where it cannot be."""
        return FAILED if self.on_violation == "fail" else 0

    @property
    def locks_between(self) -> tuple[tuple[int, int], ...]:
        """Pairs (a, b) of button numbers: once a is on, b cannot be turned on."""
        return self.locks

    @property
    def door_facts(self) -> tuple[str, ...]:
        """Fact that opens each door: its button is on."""
        return tuple(f"on({self.target_names[button]})" for button in self.doors)

    def get_shut(self, state: int) -> int:
        """Bits of the doors whose button is off."""
        return sum(1 << door for door, button in enumerate(self.doors) if not state >> button & 1)

    @property
    def has_dead_ends(self) -> bool:
        """True if a button turned on too early may bar the goal, or a wrong press fails the puzzle."""
        return bool(self.locks or self.failure)

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a word of this many bits, of a failed puzzle or not."""
        return super().is_state(state & ~self.failure if type(state) is int else state)

    def is_solved(self, state: int) -> bool:
        """Return whether the goal button is on, and no press has failed the puzzle."""
        return super().is_solved(state) and not state & self.failure

    def is_failed(self, state: int) -> bool:
        """Return whether a press with unmet parents has failed the puzzle."""
        return bool(state & self.failure)

    def get_facts(self, state: int) -> frozenset[str]:
        """`on(<name>)` for every button that is on, and `failed` where a press has failed the puzzle."""
        facts = super().get_facts(state)
        return facts | {_FAILED_FACT} if state & self.failure else facts

    def update(self, state: int, contacts: Contacts) -> int:
        """Apply presses in index order, up to one that fails the puzzle."""
        for button in contacts.pressed:
            if state & self.failure:
                break
            bit = 1 << button
            if state & bit:
                if self.allow_off:
                    state &= ~bit
            elif self.parent_masks[button] & ~state == 0 and not self.lock_masks[button] & state:
                state |= bit
            elif self.on_violation == "reset":
                state = 0
            else:
                state |= self.failure
        return state

    def make_symbolic_model(self) -> SymbolicModel:
        """One operator a button, applicable when its parents are on, and neither it nor any that locks it is.

        Where the puzzle can be failed, none is applicable after that.
        """
        model = super().make_symbolic_model()
        fact, failed = model.propositions, (_FAILED_FACT,) if self.failure else ()
        locks = [frozenset([*failed, *(fact[locking] for locking, locked in self.locks if locked == i)])
                 for i in range(self.count)]
        if not any(locks):
            return model
        operators = (dataclasses.replace(operator, forbidden=operator.forbidden | locking)
                     for operator, locking in zip(model.operators, locks, strict=True))
        return dataclasses.replace(model, propositions=(*fact, *failed), operators=tuple(operators))


register_puzzle(ButtonsConfig, ButtonsPuzzle)
