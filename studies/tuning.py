"""Record of how default settings came about: which were chosen by trying them, where, and whether that is reported in.

The record is `tuning.toml`. It holds what the project's history documents, and omits the number of trials where it was
not written down. A default that was chosen where results are reported flatters them there.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from hrl_escape.files import read_toml
from hrl_escape.settings import read_record

__all__ = ["Tuning", "load_tuning"]

_FILE = Path(__file__).with_name("tuning.toml")


@dataclasses.dataclass(frozen=True)
class Tuning:
    """Defaults that were chosen together.

    Attributes:
        agents: names; each also over options, with `smdp-` in front.
        settings: their defaults today.
        tried_in: rooms and environments where they were chosen.
        before: defaults that they replaced, as far as there were any.
        reported_in: members of `tried_in` whose results this project reports.
        source: place in the project's history.
        trials: number of settings that were tried, or None if it was not written down.
        seeds: training seeds of these trials, in words; empty where they were not written down.
        note: anything else.
    """

    agents: tuple[str, ...]
    settings: dict[str, Any]
    tried_in: tuple[str, ...]
    before: dict[str, Any]
    reported_in: tuple[str, ...]
    source: str
    trials: int | None = None
    seeds: str = ""
    note: str = ""


def load_tuning() -> list[Tuning]:
    """Read the whole record."""
    return [read_record(Tuning, entry) for entry in read_toml(_FILE, "record of tuning")["tuned"]]
