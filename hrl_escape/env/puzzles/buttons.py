"""The button puzzle (paper, section 5.2): binary buttons that depend on each other along a DAG.

A press turns a button on if all its parents are on; otherwise the violation rule decides what happens. One button is
the goal: while it is on, the exit is open. The state is an integer whose bit i is button i. A lock (a, b) makes dead
ends possible: once a is on, b can no longer be turned on. A button can open a door between two rooms, and can carry a
cue (`cues.py`).
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
from hrl_escape.env.puzzles.cues import COLOURS, Cue, CuesConfig
from hrl_escape.env.puzzles.graphs import (
    ButtonNumber,
    GraphConfig,
    compute_order,
    find_ancestors,
    mask_parents,
    sample_locks,
    sample_relabelled,
)
from hrl_escape.env.puzzles.mixins import Cued, Doored
from hrl_escape.env.puzzles.symbolic import SymbolicModel
from hrl_escape.env.schema import HashedSettings
from hrl_escape.errors import ConfigError
from hrl_escape.settings import Range

ViolationRule = Literal["ignore", "reset", "fail"]
"""Effect of a press with unmet parents: none, all buttons go off, or the puzzle fails and the episode ends."""
VIOLATION_RULES: tuple[ViolationRule, ...] = get_args(ViolationRule)
FAILED = 1 << 63
"""State bit of a failed puzzle."""
_FAILED_FACT = "failed"
MOST_TO_FAIL = 63
"""Most buttons of a puzzle that can fail: one bit of the word marks the failure."""
_TRIES = 200
"""Most graphs drawn to find one with enough dead ends."""


@dataclasses.dataclass(frozen=True)
class PositionalCuesConfig(HashedSettings):
    """Ranked directions from the middle of the room. Positions of buttons then carry information about the graph.

    The floor is cut into equal sections around the middle. Buttons with more buttons before them hang in sections of
    higher rank, and further counter-clockwise within a section. The ranking is random but the same in all rooms, which
    allows agents to learn it in some rooms and use it in others. The set of positions is that of a room without
    sections.
    """
    _section = "positional_cues"
    sections: Annotated[int, Range(0, 64)] = 0
    """Equal sections around the middle, counter-clockwise from the right. 0 makes positions independent of the
    graph."""
    code: Annotated[int, Range(0, 2**63 - 1)] = 0
    """Seed of the ranking."""

    @cached_property
    def ranks(self) -> NDArray[np.int64]:
        """Rank of each section, shape (sections,)."""
        return np.random.default_rng([self.code, 5]).permutation(self.sections)

    def sort_places(self, places: ArrayLike) -> NDArray[np.int64]:
        """Sort indices of places (n, 2), m from the middle of the room, by the order of the buttons there."""
        x, y = np.asarray(places, dtype=np.float64).T
        turns = np.arctan2(y, x) % math.tau / math.tau * self.sections
        return np.lexsort((turns, self.ranks[np.minimum(turns.astype(np.int64), self.sections - 1)]))

    def deal(self, places: ArrayLike, depths: Sequence[int], rng: np.random.Generator) -> NDArray[np.int64]:
        """Return the index of the place of each button; buttons of equal depth are placed at random."""
        dealt = np.empty(len(depths), dtype=np.int64)
        dealt[np.lexsort((rng.random(len(depths)), np.array(depths)))] = self.sort_places(places)
        return dealt

    def compute_likelihood(self, places: ArrayLike, depths: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the probability of the buttons' places under each of several graphs.

        Args:
            places: positions of the buttons, (buttons, 2).
            depths: depth of each button under each graph, (graphs, buttons).

        Returns:
            float64 (graphs,); all 1 without sections.
        """
        if not self.sections:
            return np.ones(len(depths))
        ways = np.array([math.prod(map(math.factorial, np.bincount(own).tolist())) for own in depths])
        return (np.diff(depths[:, self.sort_places(places)], axis=1) >= 0).all(axis=1) / ways


@dataclasses.dataclass(frozen=True)
class ButtonsConfig(PuzzleConfig):
    """Configuration of the button puzzle."""

    kind = "buttons"
    _takes_ranges = True
    count: Annotated[int, Range(1, 64)] = 2
    """Number of buttons, each a panel on a wall. More buttons make the order harder to discover."""
    graph: GraphConfig = GraphConfig()
    """Dependencies between buttons: a button turns on only once its parents are on."""
    on_violation: Literal["ignore", "reset", "fail", "drawn"] = "ignore"
    """Effect of a press with unmet parents: ignored, turns all buttons off, or fails the puzzle and ends the episode.
    `drawn`: each room samples one of the three, and only a wrong press reveals which."""
    allow_off: bool = False
    """If true, pressing a button that is on turns it off."""
    goal: ButtonNumber | None = None
    """Number of the goal button from 0, before `graph.relabel`. By default the last in topological order."""
    buttons: Panels = Panels()
    """Sizes and places of the buttons' panels."""
    dead_ends: Annotated[int, Range(0, 64)] = 0
    """Number of locks, pairs of buttons. Once the first is on, the second, which the goal needs, can no longer be
    turned on. More locks make more orders of presses fail."""
    doors: Annotated[int, Range(0, 15)] = 0
    """Number of doorways with a door. Each door opens once a button of its own is on."""
    cues: CuesConfig = CuesConfig()
    """Symbols on the buttons that carry information about the graph."""
    positional_cues: PositionalCuesConfig = PositionalCuesConfig()
    """Ranked directions from the middle of the room that carry information about the graph."""

    def check(self) -> None:
        """Check the limits that relate several fields."""
        if self.goal is not None and self.goal >= self.count:
            raise ConfigError("puzzle.goal", self.goal, f"a button from 0 to {self.count - 1}")
        if self.graph.kind == "edges":
            compute_order(self.count, self.graph.edges)
        may_go_off = self.allow_off or self.on_violation in ("reset", "drawn")
        if self.on_violation in ("fail", "drawn") and self.count > MOST_TO_FAIL:
            raise ConfigError("puzzle.count", self.count, f"at most {MOST_TO_FAIL} if a press can fail the puzzle")
        if self.dead_ends and may_go_off:
            raise ConfigError("puzzle.dead_ends", self.dead_ends, "0 if buttons can be turned off again")
        if self.doors > self.count:
            raise ConfigError("puzzle.doors", self.doors, f"at most puzzle.count = {self.count}, one button per door")
        if self.doors and (may_go_off or self.dead_ends):
            raise ConfigError("puzzle.doors", self.doors,
                              "0 if buttons can be turned off again or locked, because a door might never open again")
        if self.cues.kind == "dependencies" and self.count > len(COLOURS):
            raise ConfigError("puzzle.count", self.count, f"at most {len(COLOURS)} with dependency cues, one colour "
                              "per button")
        if self.positional_cues.sections and (self.doors or self.buttons.places != "random"):
            raise ConfigError("puzzle.positional_cues.sections", self.positional_cues.sections,
                              "0 if doors or fixed places decide where buttons hang")
        super().check()

    def make_puzzle(self, rng: np.random.Generator) -> ButtonsPuzzle:
        """Sample the dependency graph, relabel the buttons if configured, and choose the buttons that open doors.

        Raises:
            ConfigError: graphs of this kind have too few places for that many dead ends.
        """
        for _ in range(_TRIES):
            edges, goal = sample_relabelled(self.graph, self.count, rng, self.goal)
            locks = sample_locks(self.count, edges, goal, self.dead_ends, rng) if self.dead_ends else ()
            if len(locks) == self.dead_ends:
                doors = tuple(rng.choice(self.count, self.doors, replace=False).tolist()) if self.doors else ()
                shown = (edges, goal)
                if self.cues.shuffled:
                    shown = sample_relabelled(self.graph, self.count, rng, self.goal)
                cues = () if self.cues.kind == "none" else self.cues.draw(self.count, *shown, rng)
                rule = self.on_violation
                if rule == "drawn":  # drawn last, which leaves all other draws unchanged
                    rule = VIOLATION_RULES[rng.integers(len(VIOLATION_RULES))]
                return ButtonsPuzzle(self.count, edges, goal, rule, self.allow_off, locks, doors, cues)
        raise ConfigError("puzzle.dead_ends", self.dead_ends,
                          "at most the number of pairs of buttons in such graphs where neither needs the other")


@dataclasses.dataclass(frozen=True)
class ButtonsPuzzle(Doored, Cued, GraphPuzzle):
    """A concrete button puzzle. The name of button i is `button-<i+1>`."""

    kind, word = "buttons", "button"
    about = "Every button has a lamp. Some lamps come on only after others; which is hidden. One opens the exit."
    on_violation: ViolationRule = "ignore"
    """Effect of a press with unmet parents, or of pressing a locked button."""
    allow_off: bool = False
    """If true, pressing a button that is on turns it off."""
    locks: tuple[tuple[ButtonNumber, ButtonNumber], ...] = ()
    """Pairs (a, b): while button a is on, b cannot be turned on."""
    doors: tuple[ButtonNumber, ...] = ()
    """Index of the button that opens each inner door."""
    cues: tuple[Cue, ...] = ()
    """Number of the symbol on each button; empty if buttons have no cues."""

    def check(self) -> None:
        """Check the limits that relate several fields."""
        super().check()
        if self.locks:
            if self.allow_off or self.on_violation == "reset":
                raise ConfigError("puzzle.locks", self.locks, "empty if buttons can be turned off again")
            needed = find_ancestors(self.edge_list, (self.goal,))
            # raises unless some order turns on every needed button before it is locked
            compute_order(self.count, (*self.edge_list, *((b, a) for a, b in self.locks if b in needed)))
        if len(self.cues) not in (0, self.count):
            raise ConfigError("puzzle.cues", self.cues, f"empty, or one for each of {self.count} buttons")
        if any(button >= self.count for button in self.doors):
            raise ConfigError("puzzle.doors", self.doors, f"numbers from 0 to {self.count - 1}")
        if self.doors and (self.allow_off or self.on_violation == "reset"):
            raise ConfigError("puzzle.doors", self.doors, "empty if buttons can be turned off again")
        if self.on_violation == "fail" and self.count > MOST_TO_FAIL:
            raise ConfigError("puzzle.count", self.count, f"at most {MOST_TO_FAIL} if a press can fail the puzzle")

    @cached_property
    def lock_masks(self) -> tuple[int, ...]:
        """Bits of the buttons that lock each button."""
        return mask_parents(self.locks, self.count)

    @cached_property
    def failure(self) -> int:
        """State bit of a failed puzzle; 0 if the puzzle cannot fail."""
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
        """Return the bits of the doors whose button is off."""
        return sum(1 << door for door, button in enumerate(self.doors) if not state >> button & 1)

    @property
    def has_dead_ends(self) -> bool:
        """True if turning on a button too early can make the goal unreachable, or a wrong press fails the puzzle."""
        return bool(self.locks or self.failure)

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is an integer with one bit per button, and the failure bit if possible."""
        return super().is_state(state & ~self.failure if type(state) is int else state)

    def is_solved(self, state: int) -> bool:
        """Return whether the goal button is on and the puzzle has not failed."""
        return super().is_solved(state) and not state & self.failure

    def is_failed(self, state: int) -> bool:
        """Return whether a press with unmet parents has failed the puzzle."""
        return bool(state & self.failure)

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `on(<name>)` for every button that is on, and `failed` if the puzzle has failed."""
        facts = super().get_facts(state)
        return facts | {_FAILED_FACT} if state & self.failure else facts

    def update(self, state: int, contacts: Contacts) -> int:
        """Apply presses in index order, up to the first that fails the puzzle."""
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
        """Return the model: one operator per button, applicable while its parents are on and it is off and unlocked.

        If the puzzle can fail, no operator is applicable after a failure.
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
