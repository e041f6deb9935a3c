"""Conclusions of a screening in sentences, each chosen and filled by rule from the tables of its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hrl_escape.experiments.studies.factorial_effects import (
    MainEffect,
    Screening,
    compute_effects,
    find_sufficient,
    measure_area,
    measure_change,
)
from hrl_escape.experiments.studies.mediation import Path, compute_paths
from hrl_escape.names import join_words

__all__ = ["FEWEST_ROOMS", "FEWEST_SEEDS", "Findings", "analyse", "conclude"]

FEWEST_SEEDS = 5
"""With fewer training seeds a cell nothing is concluded."""
FEWEST_ROOMS = 3


@dataclass(frozen=True)
class Findings:
    """Everything that is read off one algorithm's runs.

    Attributes:
        screening: the runs.
        effects: on the area under the efficiency curve of training.
        changes: effects on the slope of that curve, which nothing is concluded from.
        sufficient: see `find_sufficient`.
        paths: of the factors whose effect is shown, through quantities of the logs.
    """

    screening: Screening
    effects: Sequence[MainEffect]
    changes: Sequence[MainEffect]
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


def analyse(screening: Screening) -> Findings:
    """Compute effects, sufficient corrections and paths."""
    effects = compute_effects(screening, measure_area)
    shown = [effect.factor for effect in effects if effect.is_shown]
    return Findings(screening, effects, compute_effects(screening, measure_change),
                    find_sufficient(screening, effects, measure_area),
                    compute_paths(screening, shown, measure_area, np.random.default_rng(0)))


def conclude(findings: Findings) -> list[str]:
    """Sentences on one algorithm: what moves the area, whether one correction suffices, what carries it."""
    if not findings.is_enough:
        return [f"{len(findings.screening.seeds)} training seeds a cell in {len(findings.screening.rooms)} rooms: with "
                f"fewer than {FEWEST_SEEDS} seeds or {FEWEST_ROOMS} rooms nothing is concluded."]
    raising = [effect for effect in findings.shown if effect.test.difference > 0]
    lowering = [effect for effect in findings.shown if effect.test.difference < 0]
    sentences = [_tell_raising(raising)]
    if lowering:
        sentences.append(f"The area is lowered by {join_words(map(_describe, lowering))}.")
    sentences += _tell_sufficient(findings.sufficient)
    unshown = [effect for effect in findings.effects if not effect.is_shown]
    sentences += _tell_hints(unshown, len(findings.screening.rooms))
    if unshown and findings.shown:
        sentences.append(f"Nothing is shown of {join_words(effect.factor for effect in unshown)}.")
    return [*sentences, *(_tell_paths(effect, findings.paths) for effect in findings.shown)]


def _tell_raising(raising: Sequence[MainEffect]) -> str:
    if not raising:
        return "No correction is shown to raise the area."
    if len(raising) == 1:
        return f"One correction is shown to raise the area: {_describe(raising[0])}."
    return f"The area is raised by {join_words(map(_describe, raising))}."


def _tell_hints(effects: Sequence[MainEffect], rooms: int) -> list[str]:
    """Effects whose interval leaves 0 out, as long as it is not corrected."""
    hints = [effect for effect in effects if effect.test.low > 0 or effect.test.high < 0]
    if not hints:
        return []
    return [f"Before correction the interval of {join_words(map(_describe, hints))} leaves 0 out; a test over {rooms} "
            "rooms has little power."]


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
    if short:
        sentences.append(f"{_capitalise(join_words(short))} alone {'brings' if len(short) == 1 else 'bring'} less than "
                         f"three quarters of {of_all}.")
    if unclear:
        sentences.append(f"Whether {join_words(unclear, 'or')} alone would do is not shown.")
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
