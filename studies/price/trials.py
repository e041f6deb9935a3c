"""Settings that were tried for the price of flatness, all of them, in rooms and with seeds that are not reported.

The record is `trials.toml`, in the order in which they were tried.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from hrl_escape.files import read_toml
from hrl_escape.settings import read_record
from studies.page import make_table
from studies.price.contestants import CONTESTANTS

__all__ = ["SettingsTrial", "describe_trials", "load_trials", "tell_exploration"]

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


def tell_exploration(trials: Sequence[SettingsTrial] | None = None) -> str:
    """A sentence on what longer exploration alone did for `dqn` in the trials; nothing without two that tell it.

    Args:
        trials: by default all.
    """
    alone = {"epsilon_steps", "epsilon_end"}
    single = [trial for trial in trials or load_trials() if trial.agent == "dqn" and not trial.streams]
    for trial in single:
        before = [other for other in single if not other.settings
                  and (other.buttons, other.room, other.primitives) == (trial.buttons, trial.room, trial.primitives)]
        if trial.settings and trial.settings.keys() <= alone and before:
            return (f"In the trials longer exploration alone ({_list_settings(trial.settings)}) took the share of late "
                    f"training episodes that escape from {before[0].escapes:.0%} to {trial.escapes:.0%} (one run each, "
                    f"{trial.primitives:,} primitives).")
    return ""


def _list_settings(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"`{name} = {json.dumps(value)}`" for name, value in settings.items())


def describe_trials() -> dict[str, Any]:
    """Values of the section on how settings were chosen, and those that are used."""
    trials = load_trials()
    counts = Counter(trial.agent for trial in trials)
    used = {contestant.label: contestant.settings for contestant in CONTESTANTS}
    return {
        "count": len(trials), "counts": [f"{count} of {agent}" for agent, count in counts.items()],
        "rooms": sorted({str(trial.room) for trial in trials}),
        "table": make_table(["learner", "settings"], [[label, _list_settings(settings)]
                                                      for label, settings in used.items() if settings]),
    }
