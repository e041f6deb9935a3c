"""Runs of a study: makes missing runs, keeps a line of each, and analyses all lines."""

from __future__ import annotations

import dataclasses
import math
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console

from hrl_escape.benchmark.comparison import Comparison, run_grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.errors import ComparisonError, ConfigError, FileWriteError, UnknownNameError
from hrl_escape.files import TEMPORARY_PREFIX, describe_write_failure, make_folder
from hrl_escape.processes import taking_turns
from studies.baseline import BaselineRun, collect_baselines
from studies.store import Line, Store
from studies.study import Findings, Study

__all__ = ["NO_TRAINING", "GridArgs", "StudyArgs", "claim_folder", "get_args", "make_missing", "open_store",
           "refuse_failures", "run_study"]

Job = TypeVar("Job", bound=Line)

NO_TRAINING = 100
"""Training budget of references: only their evaluations count."""
COUNTS = ("runs", "primitives", "minutes", "rooms", "replicates", "episodes", "workers", "budget")


@dataclasses.dataclass(frozen=True)
class StudyArgs:
    """Options that all studies share."""

    docs: Path | None = None
    """Folder of the results, in its subfolder `raw`; by default the study's own folder."""
    from_raw: bool = False
    """Train nothing: analyse the results."""


@dataclasses.dataclass(frozen=True)
class GridArgs(StudyArgs):
    """Options of studies that run grids."""

    out: Path = Path("runs")
    """Folder of the runs, one of its own for each grid; finished runs in it are kept."""
    workers: int | None = None
    """Runs at a time; one a core by default."""
    first_seed: int = 0
    """Lowest training seed; those from 100 on are fresh. Give `--docs` too, to keep them apart."""
    runs: int | None = None
    """Training seeds of each agent in each room; the grid's by default."""
    primitives: int | None = None
    """Training budget of a run; the grid's by default."""
    agents: tuple[str, ...] = ()
    """Agents to run, by label; all of the grid by default."""


def get_args(study: Study) -> type[Any]:
    """Class of a study's options: `Args` of its analysis, or the options of grids where grids can be run."""
    return getattr(study.analysis, "Args", StudyArgs if "made_with" in study.data else GridArgs)


def open_store(study: Study, docs: Path | None) -> Store:
    """Results of a study: committed ones, or those in a folder."""
    path = study.folder / "raw.jsonl" if docs is None else docs / "raw" / f"{study.name}.jsonl"
    return Store(path, getattr(study.analysis, "LINES", (BaselineRun,)))


def make_missing(jobs: Iterable[Job], run: Callable[[Job], Line], store: Store, minutes: float | None) -> None:
    """Run the jobs whose lines a store lacks, in order, and begin none after so many minutes."""
    known, end = {line.place for line in store.load()}, time.monotonic() + 60 * (minutes or math.inf)
    for job in jobs:
        if job.place in known:
            continue
        if time.monotonic() > end:
            Console(stderr=True, highlight=False).print("time is up: the same command resumes")
            return
        store.add([run(job)])


def run_study(study: Study, args: Any) -> Findings:
    """Make missing runs, unless `from_raw` is set or an earlier version made them, and analyse all lines.

    Processes are started, so a script that calls this needs `if __name__ == "__main__":` around it.

    Raises:
        ComparisonError: a run failed, or there are no runs.
        FileReadError: the results are damaged.
        FileWriteError: results cannot be written.
        EscapeError: see `run_grid`.
    """
    for name in COUNTS:
        value = getattr(args, name, None)
        if value is not None and value <= 0:
            raise ConfigError(name, value, "it must be above 0")
    store = open_store(study, args.docs)
    if not args.from_raw and "made_with" not in study.data:
        claim_folder(store.path.parent)
        getattr(study.analysis, "measure", measure_grids)(study, args, store)
    with taking_turns(store.path.parent):
        lines = store.load()
        if not lines:
            raise ComparisonError(f"{store.path} holds no run" + (": leave out --from-raw" if args.from_raw else ""))
        return study.analysis.analyse(study, lines)


def measure_grids(study: Study, args: GridArgs, store: Store) -> None:
    """Run the grids of a study one after another, and keep the lines of each.

    References, where only evaluations count, are run apart and train for `NO_TRAINING`.
    """
    changes: dict[str, Any] = {name: value for name in ("runs", "primitives")
                               if (value := getattr(args, name)) is not None}
    for grid in study.grids:
        known = {agent.label: agent for agent in grid.agents}
        if unknown := [label for label in args.agents if label not in known]:
            raise UnknownNameError(f"agent of {grid.name}", unknown[0], known)
        chosen = [agent for label, agent in known.items() if not args.agents or label in args.agents]
        for part, agents, budget in (("learners", [agent for agent in chosen if not agent.is_reference], {}),
                                     ("references", [agent for agent in chosen if agent.is_reference],
                                      {"primitives": NO_TRAINING, "eval_every": NO_TRAINING})):
            if agents:
                changed = dataclasses.replace(grid, agents=tuple(agents), first_seed=args.first_seed,
                                              **changes | budget)
                comparison = run_grid(changed, args.out / grid.name / part, LocalLauncher(args.workers))
                refuse_failures(comparison)
                store.add(getattr(study.analysis, "collect", _collect)(comparison))


def _collect(comparison: Comparison) -> list[Line]:
    return [*collect_baselines(comparison, "per-instance", comparison.grid.name)]


def refuse_failures(*comparisons: Comparison) -> None:
    """Refuse comparisons with failed runs, because a study reports all runs.

    Raises:
        ComparisonError: runs failed; names the first and its error.
    """
    failures = [(failure, comparison.grid.name) for comparison in comparisons for failure in comparison.failures]
    if failures:
        first, name = failures[0]
        raise ComparisonError(f"{len(failures)} runs of {name} failed; {first.run.name}: {first.message}. The same "
                              "command tries them again")


def claim_folder(path: Path) -> None:
    """Make a folder and check that files can be written there, before work begins whose results belong there.

    Raises:
        FileWriteError: they cannot.
    """
    make_folder(path)
    try:
        with tempfile.TemporaryFile(prefix=TEMPORARY_PREFIX, dir=path):
            pass
    except OSError as error:
        raise FileWriteError(describe_write_failure(path, error)) from error
