"""References of the benchmarks that come with the package: mean efficiencies by which learners are judged."""

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
    oracle: float  # of the planner, which knows the graph; below 1 only where presses fail by chance
    bayes: float | None = None  # of the Bayes planner; None where graphs cannot be listed
    told: float | None = None  # bits of the hidden graph that marks and places tell; None where graphs cannot be listed
    hidden: float | None = None  # bits of the hidden graph


def load_references(benchmark: str) -> dict[str, RungReferences]:
    """References of a benchmark that comes with the package, by rung; empty where they were not measured."""
    entry = _FOLDER / f"{benchmark}.json"
    table = read_json(entry, "references") if entry.is_file() else {}
    return {rung: read_record(RungReferences, own, rung) for rung, own in table.items()}
