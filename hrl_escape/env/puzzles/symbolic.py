"""Symbolic models: a puzzle as planners see it, given by its author or derived by enumerating its states."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Iterable
from functools import cached_property
from typing import Any

from hrl_escape.errors import UnsupportedError

__all__ = ["CHANCES", "MOST_DERIVED", "SOLVED", "Effect", "Operator", "SymbolicModel", "derive_model", "name_state"]

MOST_DERIVED = 20_000
"""Most states of a puzzle whose symbolic model is derived."""
CHANCES = 64
"""Outcomes of a press of a random puzzle that are looked at, equally likely."""
SOLVED = "solved"
"""Proposition of a derived model that holds in the solved states."""


@dataclasses.dataclass(frozen=True)
class Effect:
    """A conditional effect of an operator: what it adds and deletes where a condition holds before it.

    Attributes:
        condition: propositions that must hold.
        forbidden: propositions that must not hold.
        add: propositions made true.
        delete: propositions made false.
    """

    condition: frozenset[str]
    forbidden: frozenset[str]
    add: frozenset[str]
    delete: frozenset[str]


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
    preconditions: frozenset[str]
    forbidden: frozenset[str]
    add: frozenset[str]
    delete: frozenset[str]
    destination: str | None = None
    when: tuple[Effect, ...] = ()
    cost: float = 1.0

    def is_applicable(self, facts: frozenset[str]) -> bool:
        """Say whether the operator may be applied where `facts` hold."""
        return self.preconditions <= facts and not self.forbidden & facts

    def apply(self, facts: frozenset[str]) -> frozenset[str]:
        """Return the facts after applying the operator; what is added and deleted at once holds."""
        tried = (effect for fact in (*facts, None) for effect in self._when_by_fact.get(fact, ()))
        met = [effect for effect in tried if effect.condition <= facts and not effect.forbidden & facts]
        return (facts - self.delete.union(*(e.delete for e in met))) | self.add.union(*(e.add for e in met))

    @cached_property
    def _when_by_fact(self) -> dict[str | None, list[Effect]]:
        """Conditional effects by one fact of their condition, None for those without: most are then never looked at."""
        table: dict[str | None, list[Effect]] = {}
        for effect in self.when:
            table.setdefault(min(effect.condition, default=None), []).append(effect)
        return table

    @property
    def may_add(self) -> frozenset[str]:
        """Propositions that it makes true under some condition."""
        return self.add.union(*(effect.add for effect in self.when))

    @property
    def may_change(self) -> frozenset[str]:
        """Propositions that it changes under some condition."""
        return self.may_add.union(self.delete, *(effect.delete for effect in self.when))

    @property
    def reads(self) -> frozenset[str]:
        """Propositions that decide if it is applicable and what it does."""
        return self.preconditions.union(self.forbidden, *(e.condition | e.forbidden for e in self.when))

    def relax(self, reached: frozenset[str]) -> frozenset[str]:
        """Propositions that it can add once all of `reached` have held, deletions left out of account."""
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
        came: dict[frozenset[str], tuple[frozenset[str], Operator] | None] = {facts: None}
        queue = [facts]
        for here in queue:
            if self.goal <= here:
                found: list[Operator] = []
                while (step := came[here]) is not None:
                    here, operator = step
                    found.append(operator)
                return tuple(reversed(found))
            for operator in self.operators:
                if operator.is_applicable(here) and (then := operator.apply(here)) not in came:
                    came[then] = here, operator
                    queue.append(then)
        return None


def name_state(number: int) -> str:
    """Proposition of a derived model that the puzzle is in the state of this number."""
    return f"state({number})"


def derive_model(kind: str, starts: Iterable[Hashable], targets: tuple[str, ...],
                 is_solved: Callable[[Any], bool], press: Callable[[Any, int, float], Hashable],
                 is_random: bool = False) -> tuple[SymbolicModel, dict[Hashable, int]]:
    """Derive the model of a puzzle from its rules, by visiting every state that presses lead to.

    There is one proposition a state, and one operator a target with a conditional effect a state. Effects are those of
    the most likely outcome; other outcomes, down to a probability of one in `CHANCES`, lead to states as well.

    Args:
        kind: name of the puzzle, for errors.
        starts: its first states.
        targets: names of its targets.
        is_solved: test of a state.
        press: (state, target, uniform number) -> the state after a press; 0 is its most likely outcome.
        is_random: a press has several outcomes.

    Returns:
        The model, and the number of each state.

    Raises:
        UnsupportedError: there are more than `MOST_DERIVED` states.
    """
    numbers: dict[Hashable, int] = {}
    for state in starts:
        numbers.setdefault(state, len(numbers))
    queue = list(numbers)
    chances = [(number + 0.5) / CHANCES for number in range(CHANCES)] if is_random else []
    changes: list[list[tuple[Hashable, Hashable]]] = [[] for _ in targets]
    for state in queue:
        for target, changed in enumerate(changes):
            likely = press(state, target, 0.0)
            if likely != state:
                changed.append((state, likely))
            for after in (likely, *(press(state, target, chance) for chance in chances)):
                if after not in numbers:
                    if len(numbers) == MOST_DERIVED:
                        raise UnsupportedError(f"puzzle {kind!r} has more than {MOST_DERIVED:,} states: give it "
                                               "make_symbolic_model and get_facts of its own")
                    numbers[after] = len(numbers)
                    queue.append(after)

    def list_facts(state: Hashable) -> frozenset[str]:
        return frozenset({name_state(numbers[state]), *([SOLVED] if is_solved(state) else [])})

    none: frozenset[str] = frozenset()
    facts = {state: list_facts(state) for state in numbers}
    operators = tuple(
        Operator(f"press-{name}", name, "press", none, none, none, none, when=tuple(
            Effect(frozenset({name_state(numbers[before])}), none, facts[after] - facts[before],
                   facts[before] - facts[after])
            for before, after in changed))
        for name, changed in zip(targets, changes, strict=True))
    propositions = (*(name_state(number) for number in range(len(numbers))), SOLVED)
    return SymbolicModel(propositions, operators, frozenset({SOLVED})), numbers
