"""Demands of the rungs of a benchmark: the efficiencies that learners are held against, measured once."""

from __future__ import annotations

import dataclasses
from importlib.resources import files

from hrl_escape.files import parse_json
from hrl_escape.settings import read_record


@dataclasses.dataclass(frozen=True)
class RungReferences:
    """Mean efficiencies in the test rooms of a rung.

    Attributes:
        chance: of random choices among the options.
        searcher: of the best searcher that learns nothing.
        by: its name.
        oracle: of the planner, which knows the graph; below 1 only where presses fail by chance.
        ceiling: of `smdp-bayes`, which knows how rooms are drawn; None where graphs cannot be listed.
        told: bits of the hidden graph that marks and places tell; None where graphs cannot be listed.
        hidden: bits of the hidden graph.
    """

    chance: float
    searcher: float
    by: str
    oracle: float
    ceiling: float | None = None
    told: float | None = None
    hidden: float | None = None


def load_references(benchmark: str) -> dict[str, RungReferences]:
    """References of a benchmark that comes with the package, by rung; empty where they were not measured."""
    entry = files("hrl_escape.ladder") / "data" / "references" / f"{benchmark}.json"
    if not entry.is_file():
        return {}
    table = parse_json(entry.read_text(encoding="utf-8"), str(entry), "references")
    return {rung: read_record(RungReferences, own, rung) for rung, own in table.items()}
