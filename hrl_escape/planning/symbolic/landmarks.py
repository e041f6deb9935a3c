"""Landmarks of a symbolic model: facts that every plan makes true on its way to the goal, and their forced order.

Exact for the delete relaxation, in which a true fact stays true (Keyder, Richter and Helmert 2010, by the
propagation of Zhu and Givan 2003). A forbidden fact is a fact of its own, which deletes make true.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping
from typing import TypeAlias

from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel

__all__ = ["find_landmarks"]

Literal: TypeAlias = tuple[str, bool]


def find_landmarks(model: SymbolicModel, facts: frozenset[str], goal: Iterable[str] | None = None
                   ) -> Mapping[str, frozenset[str]] | None:
    """Find the facts that do not hold and that every plan from here makes true.

    Args:
        model: operators and propositions.
        facts: those that hold here.
        goal: facts to make true; None for the model's own goal.

    Returns:
        Landmark -> the landmarks that every plan makes true before it; None if no plan leads to the goal, even without
        deletes.
    """
    before: dict[Literal, frozenset[Literal]] = {
        (fact, fact in facts): frozenset() for fact in model.propositions}
    grew = True
    while grew:
        grew = False
        for operator in itertools.chain(*map(_split, model.operators)):
            needs = [(fact, True) for fact in operator.preconditions] + [(fact, False) for fact in operator.forbidden]
            if any(need not in before for need in needs):
                continue
            led = frozenset().union(*(before[need] | {need} for need in needs))
            made = [(fact, True) for fact in operator.add] + [(fact, False) for fact in operator.delete - operator.add]
            for literal in made:
                least = led if literal not in before else before[literal] & led
                if before.get(literal) != least:
                    before[literal], grew = least, True
    wanted = [(fact, True) for fact in (model.goal if goal is None else goal)]
    if any(literal not in before for literal in wanted):
        return None
    found = {fact for literal in wanted for fact, holds in before[literal] | {literal} if holds and fact not in facts}
    return {fact: frozenset(each for each, holds in before[fact, True] if holds and each not in facts) - {fact}
            for fact in sorted(found)}


def _split(operator: Operator) -> list[Operator]:
    """Split an operator into one without conditional effects and one for each conditional effect."""
    parts = [dataclasses.replace(operator, preconditions=operator.preconditions | effect.condition,
                                 forbidden=operator.forbidden | effect.forbidden, add=effect.add, delete=effect.delete,
                                 when=()) for effect in operator.when]
    return [dataclasses.replace(operator, when=()), *parts]
