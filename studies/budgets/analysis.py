"""Learners at the budgets of the ladder's rungs, with the references of the ladder's own study."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from types import SimpleNamespace

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.protocols import get_budget
from hrl_escape.benchmark.statistics import LEAST_RUNS
from studies.baseline import BaselineRun, compute_run_efficiency
from studies.ladder.analysis import (
    compare_with_search,
    draw_rungs,
    group_runs,
    subtract,
    tabulate,
    tabulate_beyond,
    tabulate_labels,
)
from studies.ladder.calibration import KNOWN, Cells
from studies.running import open_store
from studies.statistics import Difference, compare_strata
from studies.study import Findings, Study, find_study

__all__ = ["analyse", "compare_budgets"]

PROTOCOL = "per-instance"


def analyse(study: Study, lines: Sequence[BaselineRun]) -> Findings:
    """Comparisons with the best search baseline and with smaller budgets; references are from the ladder study."""
    rungs = [rung for rung in study.data["rungs"] if any(line.rung == rung for line in lines)]
    known = [line for line in open_store(find_study("ladder"), None).load() if isinstance(line, BaselineRun)
             and line.protocol == PROTOCOL and line.rung in rungs and line.primitives < get_budget(line.rung)
             and (line.agent == KNOWN or AgentSpec.parse(line.agent).chooses_options)]
    lines = [line for line in lines if line.primitives == get_budget(line.rung)]
    cells = group_runs([*(line for line in known if not line.primitives), *lines])
    beyond = compare_with_search(cells, rungs)
    return Findings(SimpleNamespace(
        runs=len(lines), rungs=rungs, beyond=beyond, more=compare_budgets(cells, group_runs(known), rungs),
        means={agent: {rung: compute_run_efficiency(cells[rung, agent]) for rung in rungs if (rung, agent) in cells}
               for agent in study.data["agents"]},
        copies=study.data["copies"], episodes=study.data["episodes"]), {
            "budgets": tabulate(cells, rungs), "budgets_labels": tabulate_labels(cells),
            "budgets_beyond": tabulate_beyond(beyond)},
        {"budgets": partial(draw_rungs, cells, rungs, list(study.data["agents"]))})


def compare_budgets(cells: Cells, former: Cells, rungs: Sequence[str]) -> dict[str, Difference]:
    """Gain of learners over the same ones with fewer primitives, in the same rooms, with rungs as strata (Holm)."""
    gains = {agent: found for agent in dict.fromkeys(agent for _, agent in cells) if (found := [
        gain for rung in rungs if any(run.primitives for run in former.get((rung, agent), ()))
        and len(gain := subtract(cells.get((rung, agent), ()), former[rung, agent])) >= LEAST_RUNS])}
    return dict(zip(gains, compare_strata(list(gains.values())), strict=True))
