"""Learned hierarchies: contrasts of controls, and learned options compared with planned ones that fail."""

from __future__ import annotations

from collections.abc import Sequence

from hrl_escape.settings import read_record
from studies import controls
from studies.baseline import BaselineRun
from studies.learned.dial import DialLine, DialSettings, find_best_option, measure_dial, tabulate_dial
from studies.running import GridArgs, measure_grids
from studies.store import Store
from studies.study import Findings, Study

__all__ = ["LINES", "analyse", "measure"]

LINES = (BaselineRun, DialLine)


def measure(study: Study, args: GridArgs, store: Store) -> None:
    """Run the grid, then place what its agents learn on the dial."""
    measure_grids(study, args, store)
    (grid,) = study.grids
    seeds = range(args.first_seed, args.first_seed + (args.runs or grid.runs))
    measure_dial(read_record(DialSettings, study.data["dial"]), grid, store, seeds, args.primitives or grid.primitives)


def analyse(study: Study, lines: Sequence[BaselineRun | DialLine]) -> Findings:
    """Contrasts, and places on the dial."""
    found = controls.analyse(study, [line for line in lines if isinstance(line, BaselineRun)])
    placed = [line for line in lines if isinstance(line, DialLine)]
    found.numbers.best, found.numbers.worse = find_best_option(placed)
    return found._replace(tables={**found.tables, "learned_dial": tabulate_dial(placed)})
