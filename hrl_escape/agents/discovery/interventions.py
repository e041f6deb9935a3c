"""Interventions on subgoals whose causes are unknown: rules for choosing the next, and what each costs in expectation.

Khorasani et al. (2025), Hierarchical reinforcement learning with targeted causal interventions. A subgoal can be
reached once its parents (all of an AND, any of an OR) have been intervened on. Each intervention makes more of them
reachable, until the goal is among them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cache
from typing import Literal, NamedTuple

__all__ = ["ExpectedCost", "InterventionRule", "compute_expected_cost", "compute_intervention_probabilities",
           "find_causes"]

InterventionRule = Literal["uniform", "targeted", "ancestors"]
"""`uniform`: any reachable subgoal; `targeted`: with n interventions made, an ancestor of the goal with probability
n / (n + 1), else another one; `ancestors`: an ancestor, as long as there is one."""


class ExpectedCost(NamedTuple):
    """Expectation over a rule's choices.

    Attributes:
        cost: sum over subgoals made reachable of 1 and the interventions made by then.
        interventions: how many.
    """

    cost: float
    interventions: float


def find_causes(parents: Mapping[int, Collection[int]], goal: int) -> frozenset[int]:
    """Everything that a goal depends on, directly or not, itself left out."""
    found: set[int] = set()
    waiting = list(parents.get(goal, ()))
    while waiting:
        node = waiting.pop()
        if node not in found:
            found.add(node)
            waiting += parents.get(node, ())
    return frozenset(found)


def compute_intervention_probabilities(
    candidates: Sequence[int], ancestors: Collection[int], made: int, rule: InterventionRule
) -> list[float]:
    """Probability of each candidate to be the next.

    Args:
        candidates: subgoals that can be reached and were not intervened on, at least one.
        ancestors: subgoals taken for ancestors of the goal.
        made: interventions so far.
        rule: see `InterventionRule`.
    """
    wanted = [candidate in ancestors for candidate in candidates]
    count, others = sum(wanted), len(candidates) - sum(wanted)
    if rule == "uniform" or not count or not others:
        return [1 / len(candidates)] * len(candidates)
    share = 1.0 if rule == "ancestors" else made / (made + 1)
    return [share / count if is_wanted else (1 - share) / others for is_wanted in wanted]


def compute_expected_cost(
    parents: Mapping[int, Collection[int]], goal: int, rule: InterventionRule, gate: Literal["and", "or"] = "and"
) -> ExpectedCost:
    """Exact cost of finding the goal when ancestors are known to the rule: an expectation over sets of interventions.

    Args:
        parents: of each subgoal, roots with none; every subgoal is a key.
        goal: the search ends when it can be reached.
        rule: see `InterventionRule`.
        gate: parents that must be on, all or any.
    """
    ancestors = find_causes(parents, goal)
    test = all if gate == "and" else any

    def list_reachable(made: frozenset[int]) -> list[int]:
        return [node for node, needs in parents.items() if not needs or test(need in made for need in needs)]

    @cache
    def expect(made: frozenset[int]) -> tuple[float, float]:
        before = list_reachable(made)
        if goal in before:
            return 0.0, 0.0
        candidates = [node for node in before if node not in made]
        cost = count = 0.0
        shares = compute_intervention_probabilities(candidates, ancestors, len(made), rule)
        for node, probability in zip(candidates, shares, strict=True):
            if probability:
                after = made | {node}
                joined = len(list_reachable(after)) - len(before)
                later, more = expect(after)
                cost += probability * (joined * (len(after) + 1) + later)
                count += probability * (1 + more)
        return cost, count

    return ExpectedCost(*expect(frozenset()))
