"""Reference efficiencies of the benchmarks that come with the package."""

from __future__ import annotations

import dataclasses
from importlib.resources import files
from pathlib import Path

from hrl_escape.files import read_json
from hrl_escape.settings import read_record

_FOLDER = Path(str(files("hrl_escape.benchmark") / "data" / "references"))


@dataclasses.dataclass(frozen=True)
class RungReferences:
    """Mean efficiencies in the test rooms of a rung."""

    random: float  # of the random policy over options
    search: float  # of the best search baseline
    by: str  # its name
    oracle: float  # of the oracle; below 1 only if presses fail at random
    bayes: float | None = None  # of the Bayes planner where it is exact; of the oracle where nothing is hidden
    told: float | None = None  # bits of the graph that cues reveal, or None if graphs cannot be listed
    hidden: float | None = None  # bits of the graph
    headroom: tuple[float, float, float] | None = None
    """Bayes planner minus the best search baseline, with the ends of its interval for unseen rooms."""


def load_references(benchmark: str) -> dict[str, RungReferences]:
    """Return the references of a benchmark by rung; empty if they were not measured."""
    entry = _FOLDER / f"{benchmark}.json"
    table = read_json(entry, "references") if entry.is_file() else {}
    return {rung: read_record(RungReferences, own, rung) for rung, own in table.items()}
