"""Rules of the page on 2 to 20 buttons."""

from __future__ import annotations

from typing import Any

from studies.publishing import Rules
from studies.scaling.rounds import HOLDS

STUDIES = ("scaling",)
FACTORED, MONTE_CARLO = "smdp-factored-r-max", "smdp-monte-carlo-model"


def is_the_bar_passed(numbers: Any) -> bool:
    """All runs in both rooms of the bar, and all fresh ones, come near the best with the whole graph."""
    return all(own.runs >= 10 and own.near_best == own.whole == own.escaped == own.runs for own in numbers.scaling.bar)


def do_too_few_parents_fail(numbers: Any) -> bool:
    """Given one parent it finds the whole graph in 3 of 10 runs at most, given two or more in 9 or more."""
    given = numbers.scaling.given
    few = [whole / made for (_, label), (whole, made) in given.items() if label.endswith(", 1")]
    enough = [whole / made for (_, label), (whole, made) in given.items() if not label.endswith(", 1")]
    return bool(few) and max(few) <= 0.3 and min(enough) >= 0.9


def does_more_cost(numbers: Any) -> bool:
    """No replacement of the true condition or number of parents saves primitives, and some cost primitives."""
    signs = {cost.sign for (_, label), cost in numbers.scaling.costs.items() if label != HOLDS}
    return -1 not in signs and 1 in signs


def _escape(numbers: Any, rule: str, agent: str, size: int) -> bool:
    return all(numbers.scaling.escapes[rule, agent, size].observed)


def do_models_go_furthest(numbers: Any) -> bool:
    """Only these two escape in all runs with 20 buttons under `ignore`, and with 15 under `reset` only one does."""
    agents = numbers.scaling.data["agents"]
    return [agent for agent in agents if ("ignore", agent, 20) in numbers.scaling.escapes
            and _escape(numbers, "ignore", agent, 20)] == [FACTORED, MONTE_CARLO] and [
        agent for agent in agents if ("reset", agent, 15) in numbers.scaling.escapes
        and _escape(numbers, "reset", agent, 15)] == [MONTE_CARLO]


RULES: Rules = {
    "the-bar-is-passed": is_the_bar_passed,
    "give-enough-parents": do_too_few_parents_fail,
    "more-costs": does_more_cost,
    "models-go-furthest": do_models_go_furthest,
}
