"""Runs of a study: makes those that are missing, keeps a line of each, and writes the page of all lines."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

from hrl_escape.benchmark.comparison import Comparison, run_grid
from hrl_escape.benchmark.launching.local import LocalLauncher
from hrl_escape.errors import ComparisonError, ConfigError, FileWriteError, UnknownNameError
from hrl_escape.files import TEMPORARY_PREFIX, describe_write_failure, make_folder
from hrl_escape.processes import taking_turns
from studies.baseline import BaselineRun, collect_baselines
from studies.page import write_page
from studies.store import Line, Store
from studies.study import Page, Study

__all__ = ["NO_TRAINING", "GridArgs", "StudyArgs", "analyse", "claim_folder", "get_args", "open_store",
           "refuse_failures", "run_study"]

PAGES = Path("docs/results")
NO_TRAINING = 100
"""Training budget of references: only their evaluations count."""
COUNTS = ("runs", "primitives", "minutes", "rooms", "replicates", "episodes")


@dataclasses.dataclass(frozen=True)
class StudyArgs:
    """Options that all studies share."""

    docs: Path | None = None
    """Folder that takes page, figures and results; by default docs/results, with the results in the study's own
    folder, where they join those that are there."""
    from_raw: bool = False
    """Skip training: write the page again from the results."""


@dataclasses.dataclass(frozen=True)
class GridArgs(StudyArgs):
    """Options of studies that run grids."""

    out: Path = Path("runs")
    """Folder of the runs, one of its own for each grid; finished runs in it are kept."""
    workers: int | None = None
    """Runs at a time; one a core by default."""
    first_seed: int = 0
    """Lowest training seed; seeds from 100 on are fresh. Give another `--docs` too, or the page reports both."""
    runs: int | None = None
    """Training seeds of each agent in each room; the grid's by default."""
    primitives: int | None = None
    """Training budget of a run; the grid's by default."""
    agents: tuple[str, ...] = ()
    """Agents to run, by label; all of the grid by default."""


def get_args(study: Study) -> type[Any]:
    """Class of a study's options: `Args` of its analysis, or the options of grids."""
    return getattr(study.analysis, "Args", GridArgs)


def open_store(study: Study, docs: Path | None) -> Store:
    """Results of a study: published ones, or the results in a folder of pages."""
    path = study.folder / "raw.jsonl" if docs is None else docs / "raw" / f"{study.name}.jsonl"
    return Store(path, getattr(study.analysis, "LINES", (BaselineRun,)))


def run_study(study: Study, args: Any) -> Page:
    """Make what is missing, unless only the page is asked for, and write the page.

    Processes are started, so a script that calls this needs `if __name__ == "__main__":` around it.

    Raises:
        ComparisonError: a run failed, or it has no runs.
        FileReadError: the results are damaged.
        FileWriteError: results or page cannot be written.
        EscapeError: see `run_grid`.
    """
    for name in COUNTS:
        value = getattr(args, name, None)
        if value is not None and value <= 0:
            raise ConfigError(name, value, "it must be above 0")
    docs, store = args.docs or PAGES, open_store(study, args.docs)
    if not args.from_raw:
        claim_folder(docs)
        claim_folder(store.path.parent)
        getattr(study.analysis, "measure", measure_grids)(study, args, store)
    with taking_turns(store.path.parent):
        lines = store.load()
        if not lines:
            raise ComparisonError(f"{store.path} holds no run" + (": leave out --from-raw" if args.from_raw else ""))
        return write_page(study, analyse(study, lines), docs)


def analyse(study: Study, lines: list[Any]) -> Page:
    """Findings of a study in these lines.

    Raises:
        ComparisonError: runs are missing without which it says nothing.
    """
    return study.analysis.analyse(study, lines)


def measure_grids(study: Study, args: GridArgs, store: Store) -> None:
    """Run the grids of a study one after another, and keep the lines of each.

    References, which only have evaluations, are run apart and train for `NO_TRAINING`.
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
    """Refuse comparisons with failed runs, because a study reports all of them.

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
