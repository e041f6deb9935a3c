"""Conclusions of a factorial in sentences, each chosen and filled by rule from the tables of its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hrl_escape.experiments.inference import correct_by_holm
from hrl_escape.experiments.studies.contrasts import Analysis, Term
from hrl_escape.experiments.studies.factorial import RESPONSES, compute_response, get_factors, read_levels
from hrl_escape.experiments.studies.raw import RawRun
from hrl_escape.names import join_words

__all__ = ["HEALED", "SIGNIFICANT", "conclude", "correct_main_effects", "count_healed_rooms"]

SIGNIFICANT = 0.05
HEALED = 0.9
"""Mean final score in a room from which on a correction is said to heal there."""


def correct_main_effects(found: Mapping[tuple[str, str], Analysis]) -> dict[tuple[str, str, str], float]:
    """P-values of all main effects, (algorithm, response, factor), corrected as one family (Holm)."""
    keys = [(name, response, factor) for name, response in found for factor in get_factors(name)]
    terms = [found[name, response].get_term(factor) for name, response, factor in keys]
    return dict(zip(keys, correct_by_holm([term.p for term in terms]), strict=True))


def count_healed_rooms(algorithm: str, runs: Sequence[RawRun]) -> dict[str, tuple[int, int]]:
    """For each factor the rooms that it heals where it alone is corrected, and the rooms tried; none where not run."""
    counts: dict[str, tuple[int, int]] = {}
    names = get_factors(algorithm)
    for number, name in enumerate(names):
        levels = [1 if number == other else -1 for other in range(len(names))]
        rooms: dict[str, list[float]] = {}
        for run in runs:
            if read_levels(run.agent) == levels:
                rooms.setdefault(run.room, []).append(compute_response(run, RESPONSES[0]))
        if rooms:
            counts[name] = sum(float(np.mean(values)) >= HEALED for values in rooms.values()), len(rooms)
    return counts


def conclude(algorithm: str, found: Mapping[tuple[str, str], Analysis], runs: Sequence[RawRun]) -> list[str]:
    """Sentences on one algorithm: factors that move each response, and those that suffice alone."""
    corrected = correct_main_effects(found)
    sentences = [_tell_response(response, [found[algorithm, response].get_term(factor)
                                           for factor in get_factors(algorithm)],
                                {factor: corrected[algorithm, response, factor] for factor in get_factors(algorithm)})
                 for response in RESPONSES]
    return [*sentences, *_tell_sufficient(count_healed_rooms(algorithm, runs))]


def _tell_response(response: str, terms: Sequence[Term], p: Mapping[str, float]) -> str:
    shown = [term for term in terms if p[term.factors[0]] < SIGNIFICANT]
    raising = sorted((term for term in shown if term.effect > 0), key=lambda term: -term.effect)
    lowering = [term for term in shown if term.effect < 0]
    idle = [term.factors[0] for term in terms if term not in shown]
    if not shown:
        return f"No correction is shown to move the {response}."
    parts = [f"the {response} is raised by {_tell_raising(raising)}"] if raising else []
    if lowering:
        parts.append(f"{'it' if raising else f'the {response}'} is lowered by {join_words(map(_describe, lowering))}")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}" + (f". Nothing is shown of {join_words(idle)}." if idle else ".")


def _tell_raising(terms: Sequence[Term]) -> str:
    """Factors from the largest effect on, and whether that leads."""
    first, *rest = terms
    if not rest:
        return f"{_describe(first)} alone"
    if first.low > rest[0].high:
        return f"{_describe(first)} more than any other, and by {join_words(map(_describe, rest))}"
    return f"{join_words(map(_describe, terms))}, and the first is not shown to do more than the second"


def _tell_sufficient(counts: Mapping[str, tuple[int, int]]) -> list[str]:
    """Corrections that heal alone in more than half of the rooms."""
    if not counts:
        return []
    enough = [f"{name} (in {healed} of {rooms} rooms)" for name, (healed, rooms) in counts.items()
              if 2 * healed > rooms]
    if not enough:
        return ["No correction alone suffices in more than half of the rooms."]
    if len(enough) == 1:
        return [f"One correction suffices alone in more than half of the rooms: {enough[0]}."]
    return [f"Several corrections each suffice alone in more than half of the rooms, so that these runs name no single "
            f"cause: {join_words(enough)}."]


def _describe(term: Term) -> str:
    return f"{term.factors[0]} ({100 * term.effect:+.0f})"
