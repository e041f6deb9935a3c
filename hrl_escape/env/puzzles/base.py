"""Puzzles: the rules that open the exit (paper, section 5.1).

A puzzle reads contacts and updates its state. It declares its observation numbers, which targets are lit, and when it
is solved. It is independent of engines; its only geometry is the panels and pads that it asks the room to place.
`register_puzzle`, or an entry point in the group `hrl_escape.puzzles`, adds a puzzle of your own.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping
from functools import cached_property
from typing import Annotated, Any, ClassVar, NamedTuple, TypeAlias, TypeVar

import numpy as np
from typing_extensions import Self

from hrl_escape.env.puzzles.contacts import PUSH, USE, Contacts
from hrl_escape.env.puzzles.places import Pads, Panels, Place, Prop
from hrl_escape.env.puzzles.symbolic import Effect, Modelled, Operator, SymbolicModel
from hrl_escape.env.schema import HashedSettings
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.registry import Registry
from hrl_escape.settings import Range

__all__ = ["MOST_DERIVED", "PUSH", "SOLVED", "USE", "Contacts", "DerivedModel", "NoPuzzle", "Pads", "Panels", "Place",
           "Prop", "Puzzle", "PuzzleConfig", "PuzzleKind", "Success", "get_puzzle_kind", "list_puzzles",
           "register_puzzle"]

MOST_DERIVED = 20_000
"""Largest number of states of a derived symbolic model."""
SOLVED = "solved"
"""Proposition of a derived model that holds in the solved states."""
PuzzleState: TypeAlias = Any
"""A hashable value; each puzzle defines its own type."""
PlacesType = TypeVar("PlacesType", Panels, Pads)
Success = Annotated[float, Range(0, 1, open_low=True)]
"""Type of a field: probability in [0, 1] that a press has its effect."""


@dataclasses.dataclass(frozen=True)
class _OfKind(HashedSettings, ABC):
    """Settings of one registered kind of puzzle; the field `kind` names it in plain dicts."""

    kind: ClassVar[str]
    _section = "puzzle"
    _default_kind: ClassVar[str | None] = None
    _family: ClassVar[str]
    """Field of `PuzzleKind` that holds this family of classes."""

    def to_dict(self) -> dict[str, Any]:
        """Return the kind and the fields as plain values."""
        return {"kind": self.kind} | super().to_dict()

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build the settings of the kind that `data` names.

        Raises:
            UnknownNameError: no such kind of puzzle, or no such field.
            ConfigError: a value is not valid.
        """
        if not isinstance(data, Mapping):
            raise ConfigError(cls._section, data, "a table of fields")
        own = getattr(cls, "kind", None)
        kind = data.get("kind", own or cls._default_kind)
        member = cls if own is not None and kind == own else getattr(get_puzzle_kind(kind), cls._family)
        if not issubclass(member, cls):
            raise ConfigError("puzzle.kind", kind, repr(own))
        return super(_OfKind, member).from_dict({name: value for name, value in data.items() if name != "kind"})


@dataclasses.dataclass(frozen=True)
class PuzzleConfig(_OfKind):
    """Puzzle section of a room configuration; `make_puzzle` samples its random parts.

    A field of type `Panels` or `Pads` sets the sizes and places of the targets.
    """

    needs_physics: ClassVar[bool] = False
    _default_kind, _family = "buttons", "config_type"

    def check(self) -> None:
        """Check that every target has a place. Puzzles that relate several fields extend this."""
        for section, laid, other in (("panels", self.panels, self.pads), ("pads", self.pads, self.panels)):
            if laid is None or other is not None:
                continue
            count = self.count_targets()
            if laid.places == "paper" and count > 4:
                raise ConfigError("puzzle.count", count, "at most 4 with panels.places = 'paper'")
            if isinstance(laid.places, tuple) and len(laid.places) < count:
                raise ConfigError(f"{section}.places", len(laid.places), f"at least puzzle.count = {count} places")

    def count_targets(self) -> int:
        """Return the number of panels or pads: the field `count`, or the targets of a puzzle without random parts."""
        count: int | None = getattr(self, "count", None)
        return len(self.make_puzzle(np.random.default_rng(0)).target_names) if count is None else count

    def make_puzzle(self, rng: np.random.Generator) -> Puzzle:
        """Sample a concrete puzzle, such as a graph, from this configuration.

        By default nothing is random: the fields of the puzzle are the fields of the same names here.
        """
        puzzle = get_puzzle_kind(self.kind).puzzle_type
        names = {field.name for field in dataclasses.fields(self)}
        return puzzle(**{field.name: getattr(self, field.name) for field in dataclasses.fields(puzzle)
                         if field.name in names})

    @property
    def panels(self) -> Panels | None:
        """Sizes and places of the puzzle's panels, or None if it has none."""
        return self._find_field(Panels)

    @property
    def pads(self) -> Pads | None:
        """Sizes and places of the puzzle's pads, or None if it has none."""
        return self._find_field(Pads)

    def _find_field(self, kind: type[PlacesType]) -> PlacesType | None:
        values = (getattr(self, field.name) for field in dataclasses.fields(self))
        return next((value for value in values if isinstance(value, kind)), None)


@dataclasses.dataclass(frozen=True)
class Puzzle(_OfKind):
    """A concrete puzzle: the rules, as pure functions of its hashable state.

    A puzzle defines `kind`, `fixed_names` or `target_names`, `update` and `is_solved`. The other members have defaults.
    Mixins (`mixins.py`) add further abilities, such as a hand-written symbolic model (`Modelled`).

    Attributes:
        kind: registered name.
        fixed_names: names of the targets, if they are the same in every room.
        are_pads: true if all targets are pads on the floor.
        about: one sentence for players about the puzzle. It must be true in every room.
    """

    fixed_names: ClassVar[tuple[str, ...]]
    are_pads: ClassVar[bool] = False
    about: ClassVar[str] = "Its rule is hidden: try things, and see what changes."
    _family = "puzzle_type"

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build the rules of the kind that `data` names; errors as in settings of a kind."""
        if cls is Puzzle and isinstance(data, Mapping) and data.get("kind") == NoPuzzle.kind:
            return NoPuzzle.from_dict(data)  # type: ignore[return-value]  # a subclass
        return super().from_dict(data)

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the targets, by default `fixed_names`. The index of a target in this tuple is its number."""
        return self.fixed_names

    @property
    def pad_names(self) -> tuple[str, ...]:
        """Names of the targets that are pads on the floor; the others are panels on the walls."""
        return self.target_names if self.are_pads else ()

    @property
    def is_watching(self) -> bool:
        """True if `update` is called after every primitive; false if only after primitives that press or grip."""
        return False

    @property
    def chances(self) -> tuple[float, ...]:
        """Ascending thresholds at which the outcome of `contacts.uniform` changes: (0.9,) for success 9 times in 10.

        Rules compare by `contacts.uniform < chance`, and a threshold belongs to the outcome above it. The default is
        the field `success`, if the puzzle has one and it is less than 1.
        """
        success: float = getattr(self, "success", 1.0)
        return (success,) if success < 1.0 else ()

    @property
    def is_random(self) -> bool:
        """True if the outcome of a press or grip is random: `update` then reads `contacts.uniform`."""
        return bool(self.chances)

    def make_state(self) -> PuzzleState:
        """Return the initial state, by default 0."""
        return 0

    def list_starts(self) -> tuple[PuzzleState, ...]:
        """List the possible initial states, all equally likely. The first is `make_state()`."""
        return (self.make_state(),)

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a state; by default, whether its observation is within `bounds`."""
        try:
            numbers = self.observe(state)
            return type(state) is type(self.make_state()) and len(numbers) == len(self.bounds) and all(
                low <= number <= high for number, (low, high) in zip(numbers, self.bounds, strict=True))
        except Exception:  # rules may raise anything on a value that is not a state
            return False

    @abstractmethod
    def update(self, state: PuzzleState, contacts: Contacts) -> PuzzleState:
        """Return the state after the contacts of one primitive; presses count in index order."""

    @abstractmethod
    def is_solved(self, state: PuzzleState) -> bool:
        """Return whether the exit is open."""

    def is_failed(self, state: PuzzleState) -> bool:
        """Return whether the puzzle is failed, which ends the episode without success."""
        return False

    def compute_reward(self, before: PuzzleState, after: PuzzleState, contacts: Contacts) -> float:
        """Return the puzzle's reward for a primitive after which `update` was called; it is added to the room's."""
        return 0.0

    @property
    def has_reward(self) -> bool:
        """True if the puzzle adds rewards. The return then depends on more than the number of primitives."""
        return type(self).compute_reward is not Puzzle.compute_reward

    def compute_progress(self, state: PuzzleState) -> float:
        """Return the fraction, in [0, 1], of the required facts that hold; by default the facts of the goal.

        Puzzles with dependencies also count the facts that the goal depends on. Facts that must be off count as well.
        """
        goal = self._goal
        return len(goal & self.symbolic.get_facts(state)) / len(goal) if goal else float(self.is_solved(state))

    @cached_property
    def _goal(self) -> frozenset[str]:
        """Goal of the puzzle's hand-written model. Empty for a derived model: it is slow to make and adds no facts."""
        return self.make_symbolic_model().goal if isinstance(self, Modelled) else frozenset()

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Lowest and highest value of each of the N_p observation numbers; by default 0 and 1."""
        return ((0.0, 1.0),) * len(self.observe(self.make_state()))

    def observe(self, state: PuzzleState) -> tuple[float, ...]:
        """Return the N_p observation numbers, within `bounds`; by default one per target, 1 while it is on."""
        return tuple(map(float, self.get_lit(state)))

    @property
    def light_numbers(self) -> tuple[int, ...]:
        """Index of each target's light among the observation numbers; empty if the puzzle observes no lights.

        The default has one per target, if `observe` has its default too.
        """
        return tuple(range(len(self.target_names))) if type(self).observe is Puzzle.observe else ()

    def get_lit(self, state: PuzzleState) -> tuple[bool, ...]:
        """Return whether each target is on, shape (targets,); by default none is."""
        return (False,) * len(self.target_names)

    def describe(self, state: PuzzleState) -> tuple[str, ...]:
        """Return sentences about what `observe` shows in addition to the lights; by default its numbers.

        Sentences contain no positions, because the room describes those. Puzzles that observe positions override this.
        """
        numbers = self.observe(state)
        return () if numbers == self.get_lit(state) else (f"The display reads {' '.join(f'{n:g}' for n in numbers)}.",)

    @property
    def symbolic(self) -> Modelled:
        """Symbolic model for planners, hierarchies and PDDL export: the puzzle's own, or a derived one."""
        return self if isinstance(self, Modelled) else self._derived

    @cached_property
    def _derived(self) -> DerivedModel:
        return DerivedModel(self)


class DerivedModel(Modelled):
    """Symbolic model derived from a puzzle's rules, by visiting every reachable state on first use.

    It has one proposition per state, and one operator per target with a conditional effect per state. Effects are those
    of the most likely outcome. States that less likely outcomes lead to are visited as well.
    """

    def __init__(self, puzzle: Puzzle) -> None:
        self._puzzle = puzzle

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the puzzle's targets."""
        return self._puzzle.target_names

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model.

        Raises:
            UnsupportedError: there are more than `MOST_DERIVED` states.
        """
        return self._derived[0]

    def get_facts(self, state: Hashable) -> frozenset[str]:
        """Return the proposition of the state, and `SOLVED` in solved states."""
        facts = self._derived[1].get(state)
        if facts is None:
            raise ConfigError("puzzle.state", state, "a state that presses can reach from an initial state")
        return facts

    @cached_property
    def _derived(self) -> tuple[SymbolicModel, dict[Hashable, frozenset[str]]]:
        """The model, and the facts of each state."""
        puzzle, numbers = self._puzzle, dict[Hashable, int]()
        for state in puzzle.list_starts():
            numbers.setdefault(state, len(numbers))
        queue = list(numbers)
        changes: list[list[tuple[Hashable, Hashable]]] = [[] for _ in self.target_names]
        for state in queue:
            for target, changed in enumerate(changes):
                outcomes = [puzzle.update(state, Contacts((target,), uniform=chance))
                            for chance in (0.0, *puzzle.chances)]
                if outcomes[0] != state:
                    changed.append((state, outcomes[0]))
                for after in outcomes:
                    if after not in numbers:
                        if len(numbers) == MOST_DERIVED:
                            raise UnsupportedError(f"puzzle {puzzle.kind!r} has more than {MOST_DERIVED:,} states. "
                                                   "Make it Modelled, with make_symbolic_model and get_facts")
                        numbers[after] = len(numbers)
                        queue.append(after)
        facts = {state: frozenset([f"state({number})"] + [SOLVED] * bool(puzzle.is_solved(state)))
                 for state, number in numbers.items()}
        operators = tuple(
            Operator(f"press-{name}", name, "press", when=tuple(
                Effect(facts[before] - {SOLVED}, add=facts[after] - facts[before], delete=facts[before] - facts[after])
                for before, after in changed))
            for name, changed in zip(self.target_names, changes, strict=True))
        propositions = (*(f"state({number})" for number in range(len(numbers))), SOLVED)
        return SymbolicModel(propositions, operators, frozenset({SOLVED})), facts


@dataclasses.dataclass(frozen=True)
class NoPuzzle(Puzzle):
    """The puzzle of a `World`: there is none, and it is solved. It is not registered, as no room is sampled with it."""

    kind: ClassVar[str] = "nothing"
    fixed_names = ()

    def update(self, state: int, contacts: Contacts) -> int:
        """Nothing changes."""
        return state

    def is_solved(self, state: int) -> bool:
        """Always true."""
        return True


class PuzzleKind(NamedTuple):
    """A registered puzzle: its section of the room configuration, and its rules."""

    config_type: type[PuzzleConfig]
    puzzle_type: type[Puzzle]


def _is_kind(value: Any) -> bool:
    """True for a pair (config type, puzzle type); raises `ConfigError` if the two do not match."""
    if not (isinstance(value, tuple) and len(value) == 2 and all(isinstance(part, type) for part in value)
            and issubclass(value[0], PuzzleConfig) and issubclass(value[1], Puzzle)):
        return False
    kind, puzzle_type = value[0].kind, value[1]
    if puzzle_type.kind != kind:
        raise ConfigError("puzzle.kind", puzzle_type.kind, f"the same name as its config's, {kind!r}")
    if puzzle_type.target_names is Puzzle.target_names and not hasattr(puzzle_type, "fixed_names"):
        raise ConfigError(f"{puzzle_type.__name__}.fixed_names", None, "the targets' names, or a property target_names")
    return True


puzzles: Registry[PuzzleKind] = Registry("puzzle", "a pair (config type, puzzle type)", _is_kind)
"""All puzzles by name."""


def register_puzzle(config_type: type[PuzzleConfig], puzzle_type: type[Puzzle]) -> None:
    """Register a puzzle under its `kind`.

    Raises:
        ConfigError: the types differ in `kind`, the name is taken, or the targets have no names.
    """
    puzzles.register(config_type.kind, PuzzleKind(config_type, puzzle_type))


def get_puzzle_kind(kind: Any) -> PuzzleKind:
    """Return a puzzle by name.

    Raises:
        UnknownNameError: no puzzle of that name; the message lists the valid names.
    """
    return PuzzleKind(*puzzles.get(kind))


def list_puzzles() -> tuple[str, ...]:
    """Return the names of all puzzles in alphabetical order. Puzzles that fail to load are omitted with a warning."""
    return tuple(sorted(puzzles.load_all()))
