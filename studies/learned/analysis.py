"""Learned hierarchies: contrasts of controls, and learned options compared with planned ones that fail."""

from __future__ import annotations

from collections.abc import Sequence

from studies import controls
from studies.baseline import BaselineRun
from studies.learned.dial import DialLine, find_best_option, tabulate_dial
from studies.study import Findings, Study

__all__ = ["LINES", "analyse"]

LINES = (BaselineRun, DialLine)


def analyse(study: Study, lines: Sequence[BaselineRun | DialLine]) -> Findings:
    """Contrasts, and places on the dial."""
    found = controls.analyse(study, [line for line in lines if isinstance(line, BaselineRun)])
    placed = [line for line in lines if isinstance(line, DialLine)]
    found.numbers.best = find_best_option(placed)
    return found._replace(tables={**found.tables, "learned_dial": tabulate_dial(placed)})
