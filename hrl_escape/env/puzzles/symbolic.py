"""Symbolic models of puzzles for planners; a puzzle without one of its own gets a `DerivedModel` (`base.py`)."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hrl_escape.env.puzzles.contacts import Contacts
from hrl_escape.search import find_cheapest_steps


@dataclasses.dataclass(frozen=True)
class Effect:
    """A conditional effect of an operator: what it adds and deletes where a condition holds before it."""

    condition: frozenset[str]  # propositions that must hold
    forbidden: frozenset[str] = frozenset()  # propositions that must not hold
    add: frozenset[str] = frozenset()  # propositions made true
    delete: frozenset[str] = frozenset()  # propositions made false


@dataclasses.dataclass(frozen=True)
class Operator:
    """One symbolic action: a STRIPS operator over propositions, with conditional effects where it has some.

    Of a random puzzle, the effects are those of the most likely outcome.

    Attributes:
        name: verb phrase, such as `press-button-2`.
        target: name of the target or prop it acts on.
        action: what to do with it: `press` a target, `grip` or `release` while touching it (in a puzzle with a map,
            from the cell before it, and `use`, or `push-east` and so on for one cell), or `push` a prop to
            `destination`.
        preconditions: propositions that must hold.
        forbidden: propositions that must not hold.
        add: propositions made true.
        delete: propositions made false.
        destination: name of the prop that `target` is pushed onto, if `action` is `push`.
        when: conditional effects, on top of `add` and `delete`.
        cost: price of the operator for planners that count no primitives, such as PDDL's.
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
        """Return whether the operator is applicable where `facts` hold."""
        return self.preconditions <= facts and not self.forbidden & facts

    def apply(self, facts: frozenset[str]) -> frozenset[str]:
        """Return the facts after applying the operator; a proposition both added and deleted holds."""
        tried = (effect for fact in (*facts, None) for effect in self._when_by_fact.get(fact, ()))
        met = [effect for effect in tried if effect.condition <= facts and not effect.forbidden & facts]
        return (facts - self.delete.union(*(e.delete for e in met))) | self.add.union(*(e.add for e in met))

    @cached_property
    def _when_by_fact(self) -> dict[str | None, list[Effect]]:
        """Conditional effects by one fact of their condition (None: no condition), so that few are examined."""
        table: dict[str | None, list[Effect]] = {}
        for effect in self.when:
            table.setdefault(min(effect.condition, default=None), []).append(effect)
        return table

    @property
    def may_add(self) -> frozenset[str]:
        """Propositions that the operator makes true under some condition."""
        return self.add.union(*(effect.add for effect in self.when))

    @property
    def may_change(self) -> frozenset[str]:
        """Propositions that the operator changes under some condition."""
        return self.may_add.union(self.delete, *(effect.delete for effect in self.when))

    @property
    def reads(self) -> frozenset[str]:
        """Propositions that decide whether the operator is applicable and what it does."""
        return self.preconditions.union(self.forbidden, *(e.condition | e.forbidden for e in self.when))

    def relax(self, reached: frozenset[str]) -> frozenset[str]:
        """Propositions that the operator can add once all of `reached` have held, with deletions ignored."""
        if not self.preconditions <= reached:
            return frozenset()
        return self.add.union(*(effect.add for effect in self.when if effect.condition <= reached))


@dataclasses.dataclass(frozen=True)
class SymbolicModel:
    """A puzzle as planners see it: propositions, operators, and the facts that solve it."""

    propositions: tuple[str, ...]
    operators: tuple[Operator, ...]
    goal: frozenset[str]

    def find_fewest(self, facts: frozenset[str]) -> tuple[Operator, ...] | None:
        """Find the fewest operators that make the goal true from here, breadth first; None if there are none."""
        return find_cheapest_steps(
            facts, lambda here: self.goal <= here,
            lambda here: ((op, 1, op.apply(here)) for op in self.operators if op.is_applicable(here)), lambda here: 0)


class Modelled(ABC):
    """Base of puzzles with a symbolic model of their own."""

    if TYPE_CHECKING:  # the puzzle's own
        @property
        def target_names(self) -> tuple[str, ...]:
            """Names of the targets."""
            ...

    @property
    def has_dead_ends(self) -> bool:
        """True if some presses lead to states from which the puzzle can no longer be solved."""
        return False

    @abstractmethod
    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model; it is the same at every call."""

    def find_model(self, state: Any) -> SymbolicModel | None:
        """Return the model of a state in which things lie elsewhere than at first and have other ways, else None.

        Operators keep their names and effects there; those that no way leads to are left out.
        """
        return None

    @abstractmethod
    def get_facts(self, state: Any) -> frozenset[str]:
        """Propositions of the model that hold.

        Raises:
            ConfigError: the model knows no such state.
        """

    def make_contacts(self, operator: Operator) -> Contacts:
        """Contacts of the primitive that carries out an operator at a target, by the most likely outcome."""
        target = self.target_names.index(operator.target)
        if operator.action == "press":
            return Contacts((target,), touching=(target,))
        return Contacts((), touching=(target,), grip=1 if operator.action == "grip" else -1)

    def plan(self, state: Any, place: int = -1) -> tuple[Operator, ...] | None:
        """Return the operators that solve the puzzle from here; None leaves this to a search.

        `place` is the number of the inner door in whose cell the robot stands, on a map; -1 where there is none.
        """
        return None
