"""Runs of the study `price`, and learners that it compares.

A run ended with two efficient evaluations in a row, or with its budget. Times are processor seconds of the process, so
that other work on the machine does not count.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hrl_escape.files import read_toml
from studies.store import Line

__all__ = ["BUTTON_COUNTS", "CONTESTANTS", "PAIRS", "PriceRun"]

_DATA = read_toml(Path(__file__).with_name("study.toml"))
BUTTON_COUNTS: tuple[int, ...] = tuple(_DATA["sizes"])
CONTESTANTS: list[dict[str, Any]] = _DATA["learners"]
PAIRS: dict[str, str] = _DATA["pairs"]


@dataclass(frozen=True)
class PriceRun(Line):
    """Result of one contestant in one room.

    Attributes:
        agent: label of the contestant.
        buttons: of the room.
        replicate: number; it is the training seed, and chooses the room.
        fewest: primitives of the best known escape.
        budget: primitives.
        primitives: trained for.
        first_escape: primitives at the end of the first training episode that escaped, in many streams at the end of
            its segment; None if none did.
        efficient_at: primitives at the first of two efficient evaluations in a row; None without such a pair.
        efficiency: in the last evaluation.
        episodes: training episodes that ended.
        escapes: how many of them escaped.
        seconds: of processor time, of training and evaluations; planning included.
        key: hash of everything that decides the numbers.
        curve: (primitives, efficiency) of each evaluation; empty of runs made before curves were kept.
    """

    agent: str
    buttons: int
    replicate: int
    fewest: int
    budget: int
    primitives: int
    first_escape: int | None
    efficient_at: int | None
    efficiency: float
    episodes: int
    escapes: int
    seconds: float
    key: str
    curve: tuple[tuple[int, float], ...] = ()

    PLACE = ("agent", "buttons", "replicate")
