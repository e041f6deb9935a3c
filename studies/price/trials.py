"""Settings that were tried for the price of flatness, all of them, in rooms and with seeds that are not reported.

The record is `trials.toml`, in the order of the trials.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from hrl_escape.files import read_toml
from hrl_escape.settings import read_record
from studies.price.contestants import CONTESTANTS
from studies.tables import make_table
from studies.titles import find_title

__all__ = ["SettingsTrial", "load_trials", "tabulate_settings"]

_FILE = Path(__file__).with_name("trials.toml")


@dataclass(frozen=True)
class SettingsTrial:
    """One run with settings that were tried.

    Attributes:
        agent: name.
        settings: that differ from the defaults.
        streams: copies of the room at once; 0 for one ordinary environment.
        buttons: of the room.
        room: instance seed, which is the training seed too.
        primitives: budget.
        best: fewest primitives of an evaluation's escape; 0 where none escaped.
        escapes: share of training episodes that escaped in the last third of those that ended.
    """

    agent: str
    settings: dict[str, Any]
    streams: int
    buttons: int
    room: int
    primitives: int
    best: int
    escapes: float


@lru_cache(maxsize=1)
def load_trials() -> tuple[SettingsTrial, ...]:
    """Read the whole record."""
    return tuple(read_record(SettingsTrial, entry) for entry in read_toml(_FILE, "record of trials")["trials"])


def tabulate_settings() -> str:
    """Settings of the learners that differ from the defaults."""
    used = {contestant.label: contestant.settings for contestant in CONTESTANTS}
    return make_table(["learner", "settings"], [
        [find_title(label), ", ".join(f"`{name} = {json.dumps(value)}`" for name, value in settings.items())]
        for label, settings in used.items() if settings])
