"""Conclusions of a screening in sentences, each chosen and filled by rule from the tables of its page."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hrl_escape.benchmark.inference import compare_pairs, correct_by_holm
from hrl_escape.names import count_nouns, join_words
from studies.factorial.design import Factor
from studies.factorial.effects import (
    SIGNIFICANT,
    MainEffect,
    Screening,
    compute_effects,
    find_sufficient,
    measure_area,
    measure_change,
)
from studies.factorial.mediation import Path, compute_paths
from studies.statistics import choose_holm_levels

__all__ = ["FEWEST_ROOMS", "FEWEST_SEEDS", "Findings", "advise", "analyse_screening", "conclude",
           "tell_first_look", "tell_fresh_runs"]

FEWEST_SEEDS = 5
"""With fewer training seeds a cell nothing is concluded."""
FEWEST_ROOMS = 3


@dataclass(frozen=True)
class Findings:
    """Everything that is read off one algorithm's runs.

    Attributes:
        screening: the runs.
        effects: on the slope of the efficiency of training episodes, which is what the study asks about.
        levels: effects on the area under that curve, which stand beside them.
        sufficient: see `find_sufficient`.
        paths: of the factors whose effect is shown, through quantities of the logs.
    """

    screening: Screening
    effects: Sequence[MainEffect]
    levels: Sequence[MainEffect]
    sufficient: Mapping[str, bool | None]
    paths: Sequence[Path]

    @property
    def is_enough(self) -> bool:
        """Seeds and rooms are as many as a conclusion takes."""
        return len(self.screening.seeds) >= FEWEST_SEEDS and len(self.screening.rooms) >= FEWEST_ROOMS

    @property
    def shown(self) -> list[MainEffect]:
        """Effects that are shown, largest first."""
        shown = [effect for effect in self.effects if effect.is_shown]
        return sorted(shown, key=lambda effect: -effect.test.difference)


def analyse_screening(screening: Screening) -> Findings:
    """Compute effects, sufficient corrections and paths."""
    effects = compute_effects(screening, measure_change)
    shown = [effect.factor for effect in effects if effect.is_shown]
    return Findings(screening, effects, compute_effects(screening, measure_area),
                    find_sufficient(screening, effects, measure_change),
                    compute_paths(screening, shown, measure_change, np.random.default_rng(0)))


def conclude(findings: Findings) -> list[str]:
    """Sentences on one algorithm: what moves slope and level, whether one correction suffices, what carries it."""
    if not findings.is_enough:
        return [f"{len(findings.screening.seeds)} training seeds a cell in {len(findings.screening.rooms)} rooms: with "
                f"fewer than {FEWEST_SEEDS} seeds or {FEWEST_ROOMS} rooms nothing is concluded."]
    sentences = _tell_moving("slope", findings.effects)
    sentences += _tell_moving("level", findings.levels)
    sentences += _tell_sufficient(findings.sufficient)
    unshown = [effect for effect in findings.effects if not effect.is_shown]
    if unshown:
        middle = float(np.median([effect.visible for effect in unshown]))
        sentences.append(f"On the slope nothing is shown of {join_words(effect.factor for effect in unshown)}; a study "
                         f"of this size has 80 % power to detect an effect of {middle:.2f} of half of these.")
    return [*sentences, *(_tell_paths(effect, findings.paths) for effect in findings.shown)]


def advise(findings: Findings, factors: Sequence[Factor]) -> str:
    """Advice to a user: the corrections that are shown to raise the slope, and those that lower it."""
    words = {factor.name: factor.corrected for factor in factors}
    if not findings.is_enough:
        return "Run more rooms and seeds: too few to conclude from."
    better, worse = ([f"{effect.factor} ({words[effect.factor]})" for effect in findings.shown
                      if effect.test.difference * sign > 0] for sign in (1, -1))
    said = ("If an agent over options gets worse as it trains, look at the slope of its curve first, and take these "
            f"parts of the default settings: {join_words(better)}" if better else
            "Take the default settings as a whole: no part of them is shown to help alone")
    return f"{said}{f'; leave {join_words(worse)} as published' if worse else ''}."


def tell_first_look(findings: Findings, looked: int | None) -> str:
    """Sentence on rooms that were added after a look at the first ones; empty where none were.

    Args:
        findings: of all rooms.
        looked: rooms whose results had been looked at when runs in others were decided on; None for all.
    """
    screening = findings.screening
    rooms = screening.rooms[:looked]
    if rooms == screening.rooms:
        return ""
    first = {effect.factor: effect for effect in
             compute_effects(dataclasses.replace(screening, rooms=rooms), measure_change)}
    chosen = [first[effect.factor] for effect in findings.shown] or sorted(first.values(), key=lambda own: own.p)[:1]
    told = join_words(f"{effect.factor} had {_tell_p(effect.p)}" for effect in chosen)
    return (f"Rooms of {screening.algorithm} after the first {len(rooms)} were added once these had been looked at, "
            f"in which {told}. So p above is too small, by some unknown amount.")


def tell_fresh_runs(fresh: Screening, published: Findings) -> str:
    """Sentence on fresh rooms and seeds: do they show what the published runs show, or nothing where these do not?

    Only effects that the published runs show are tested, so that the correction is for these alone (Holm); where they
    show none, all factors are.
    """
    if not published.is_enough or len(fresh.rooms) < FEWEST_ROOMS:
        rooms, seeds = count_nouns(len(fresh.rooms), "room"), count_nouns(len(fresh.seeds), "training seed")
        return f"{rooms} and {seeds}: too few to conclude anything."
    effects = {effect.factor: effect for effect in compute_effects(fresh, measure_change)}
    if not published.shown:
        found = [effect for effect in effects.values() if effect.is_shown]
        return (f"Another conclusion: {join_words(map(_describe, found))} is shown." if found else
                "The same conclusion: no effect is shown.")
    chosen = [effects[effect.factor] for effect in published.shown]
    raw = [effect.test.p for effect in chosen]
    told = []
    for before, effect, level, p in zip(published.shown, chosen, choose_holm_levels(raw, SIGNIFICANT),
                                        correct_by_holm(raw), strict=True):
        now = dataclasses.replace(effect, test=compare_pairs([np.array(effect.rooms)], level))
        is_alike = before.test.difference * now.test.difference > 0
        verdict = ("the same conclusion" if is_alike else "the contrary") if p < SIGNIFICANT else "not shown again"
        told.append(f"{_describe(now)}, {verdict} ({_tell_p(p)})")
    return _capitalise(f"{'; '.join(told)}.")


def _tell_p(p: float) -> str:
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def _tell_moving(response: str, effects: Sequence[MainEffect]) -> list[str]:
    """Corrections that raise a response, and those that lower it, largest first."""
    shown = sorted((effect for effect in effects if effect.is_shown), key=lambda own: -abs(own.test.difference))
    raising, lowering = ([effect for effect in shown if effect.test.difference * sign > 0] for sign in (1, -1))
    if not raising:
        told = [f"No correction is shown to raise the {response}."]
    elif len(raising) == 1:
        told = [f"One correction is shown to raise the {response}: {_describe(raising[0])}."]
    else:
        told = [f"The {response} is raised by {join_words(map(_describe, raising))}."]
    return told + [f"The {response} is lowered by {join_words(map(_describe, lowering))}."] * bool(lowering)


def _tell_sufficient(sufficient: Mapping[str, bool | None]) -> list[str]:
    if not sufficient:
        return []
    enough = [factor for factor, verdict in sufficient.items() if verdict]
    short = [factor for factor, verdict in sufficient.items() if verdict is False]
    unclear = [factor for factor, verdict in sufficient.items() if verdict is None]
    of_all = f"what {join_words(sufficient)} bring together"
    sentences = []
    if len(enough) > 1:
        sentences.append(f"Each of {join_words(enough)} alone brings more than three quarters of {of_all}, so that "
                         "these runs name no single cause.")
    elif enough:
        sentences.append(f"{_capitalise(enough[0])} alone brings more than three quarters of {of_all}.")
    if len(short) == len(sufficient):
        none = f"Neither {' nor '.join(short)}" if len(short) == 2 else f"None of {join_words(short)}"
        sentences.append(f"{none} on its own brings three quarters of what they bring together.")
    elif short:
        sentences.append(f"{_capitalise(join_words(short))} alone {'brings' if len(short) == 1 else 'bring'} less than "
                         f"three quarters of {of_all}.")
    if unclear:
        sentences.append(f"These runs do not show whether {join_words(unclear, 'or')} alone would do.")
    return sentences


def _tell_paths(effect: MainEffect, paths: Sequence[Path]) -> str:
    own = sorted((path for path in paths if path.factor == effect.factor and path.is_shown
                  and path.carries * effect.test.difference > 0), key=lambda path: -abs(path.carries))
    if not own:
        return f"No quantity of the logs is shown to carry the effect of {effect.factor}."
    words = join_words(f"{path.mediator} ({path.carries:+.3f}, {path.low:+.3f} to {path.high:+.3f})" for path in own)
    return f"The effect of {effect.factor} goes, as far as the logs show, through {words}."


def _describe(effect: MainEffect) -> str:
    test = effect.test
    return f"{effect.factor} ({test.difference:+.3f}, {test.low:+.3f} to {test.high:+.3f})"


def _capitalise(text: str) -> str:
    return text[0].upper() + text[1:]
