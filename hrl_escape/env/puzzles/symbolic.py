"""Symbolic models of puzzles for planners. Puzzles without their own model get a `DerivedModel` (`base.py`)."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hrl_escape.env.puzzles.contacts import Contacts
from hrl_escape.search import find_cheapest_steps


@dataclasses.dataclass(frozen=True)
class Effect:
    """A conditional effect of an operator: facts to add and delete if a condition holds before it."""

    condition: frozenset[str]  # propositions that must hold
    forbidden: frozenset[str] = frozenset()  # propositions that must not hold
    add: frozenset[str] = frozenset()  # propositions made true
    delete: frozenset[str] = frozenset()  # propositions made false


@dataclasses.dataclass(frozen=True)
class Operator:
    """A symbolic action: a STRIPS operator over propositions, with optional conditional effects.

    For a random puzzle, the effects belong to the most likely outcome.

    Attributes:
        name: verb phrase, such as `press-button-2`.
        target: name of the target or prop it acts on.
        action: what to do with the target: `press` it; `grip` or `release` while touching it; `push` a prop to
            `destination`. On a map, `grip`, `release` and `use` act from the cell before the target, and `push-east`
            and so on push it by one cell.
        preconditions: propositions that must hold.
        forbidden: propositions that must not hold.
        add: propositions made true.
        delete: propositions made false.
        destination: name of the prop that `target` is pushed onto, if `action` is `push`.
        when: conditional effects, in addition to `add` and `delete`.
        cost: cost of the operator in planners that do not count primitives, such as PDDL planners.
    """

    name: str
    target: str
    action: str
    preconditions: frozenset[str] = frozenset()
    forbidden: frozenset[str] = frozenset()
    add: frozenset[str] = frozenset()
    delete: frozenset[str] = frozenset()
    destination: str | None = None
    when: tuple[Effect, ...] = ()
    cost: float = 1.0

    def is_applicable(self, facts: frozenset[str]) -> bool:
        """Return whether the operator is applicable in a state with the given facts."""
        return self.preconditions <= facts and not self.forbidden & facts

    def apply(self, facts: frozenset[str]) -> frozenset[str]:
        """Return the facts after applying the operator; a proposition both added and deleted holds."""
        tried = (effect for fact in (*facts, None) for effect in self._when_by_fact.get(fact, ()))
        met = [effect for effect in tried if effect.condition <= facts and not effect.forbidden & facts]
        return (facts - self.delete.union(*(e.delete for e in met))) | self.add.union(*(e.add for e in met))

    @cached_property
    def _when_by_fact(self) -> dict[str | None, list[Effect]]:
        """Conditional effects by one fact of their condition (None: no condition), which reduces the checks."""
        table: dict[str | None, list[Effect]] = {}
        for effect in self.when:
            table.setdefault(min(effect.condition, default=None), []).append(effect)
        return table

    @property
    def may_add(self) -> frozenset[str]:
        """Propositions that the operator can make true."""
        return self.add.union(*(effect.add for effect in self.when))

    @property
    def may_change(self) -> frozenset[str]:
        """Propositions that the operator can change."""
        return self.may_add.union(self.delete, *(effect.delete for effect in self.when))

    @property
    def reads(self) -> frozenset[str]:
        """Propositions that decide whether the operator is applicable and what its effects are."""
        return self.preconditions.union(self.forbidden, *(e.condition | e.forbidden for e in self.when))

    def relax(self, reached: frozenset[str]) -> frozenset[str]:
        """Return the propositions that the operator can add once all of `reached` have held, ignoring deletions."""
        if not self.preconditions <= reached:
            return frozenset()
        return self.add.union(*(effect.add for effect in self.when if effect.condition <= reached))


@dataclasses.dataclass(frozen=True)
class SymbolicModel:
    """Symbolic model of a puzzle: propositions, operators, and the facts that solve it."""

    propositions: tuple[str, ...]
    operators: tuple[Operator, ...]
    goal: frozenset[str]

    def find_fewest(self, facts: frozenset[str]) -> tuple[Operator, ...] | None:
        """Return the fewest operators that make the goal true, by breadth-first search, or None if there are none."""
        return find_cheapest_steps(
            facts, lambda here: self.goal <= here,
            lambda here: ((op, 1, op.apply(here)) for op in self.operators if op.is_applicable(here)), lambda here: 0)


class Modelled(ABC):
    """Base class of puzzles with their own symbolic model."""

    if TYPE_CHECKING:  # defined by the puzzle
        @property
        def target_names(self) -> tuple[str, ...]:
            """Names of the targets."""
            ...

    @property
    def has_dead_ends(self) -> bool:
        """True if presses can make the puzzle unsolvable."""
        return False

    @abstractmethod
    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model, which is the same in every call."""

    def find_model(self, state: Any) -> SymbolicModel | None:
        """Return the model of a state where things have moved and have other ways, or None.

        Operators keep their names and effects. Operators whose target is unreachable are omitted.
        """
        return None

    @abstractmethod
    def get_facts(self, state: Any) -> frozenset[str]:
        """Return the propositions of the model that hold in a state.

        Raises:
            ConfigError: the state is not part of the model.
        """

    def make_contacts(self, operator: Operator) -> Contacts:
        """Return the contacts of the primitive that executes an operator, for the most likely outcome."""
        target = self.target_names.index(operator.target)
        if operator.action == "press":
            return Contacts((target,), touching=(target,))
        return Contacts((), touching=(target,), grip=1 if operator.action == "grip" else -1)

    def plan(self, state: Any, place: int = -1) -> tuple[Operator, ...] | None:
        """Return operators that solve the puzzle from a state, or None to leave this to a search.

        On a map, `place` is the index of the inner door at the robot's cell; -1 if there is none.
        """
        return None
