"""Learned options at scale: makes missing runs in the registered order, and answers as registered."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import multiprocessing
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from statistics import median
from types import SimpleNamespace
from typing import Any

import torch
from rich.console import Console

from hrl_escape.errors import ComparisonError, UnknownNameError
from studies.learned_options.answers import compare_times, compare_to_flat, find_crossover, gather_cells
from studies.learned_options.report import (
    draw_curves,
    draw_escapes,
    tabulate_cells,
    tabulate_gains,
    tabulate_missing,
    tabulate_rates,
    tabulate_reuse,
    tabulate_trials,
)
from studies.learned_options.runs import (
    OPEN,
    TRIAL,
    UNSEEN,
    ScaleRun,
    choose_settings,
    list_jobs,
    list_learners,
    make_run,
)
from studies.running import StudyArgs
from studies.store import Store
from studies.study import Findings, Study

__all__ = ["LINES", "Args", "analyse", "answer", "check_design", "compute_design", "measure"]

LINES = (ScaleRun,)
REGISTERED = ("study.toml", "questions.md")
"""Files of the design."""
ONE_ROOM = "one room"


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    minutes: float | None = None
    """Begin no run after so long; the same command continues."""
    device: str = "cpu"
    """Device of rooms and networks."""
    workers: int = 1
    """Runs at a time, each in a process of its own with one thread."""
    agents: tuple[str, ...] = ()
    """Labels of the learners to run; all by default."""
    buttons: tuple[int, ...] = ()
    """Numbers of buttons to run; all by default."""
    budget: int | None = None
    """Budget of the runs to make, as registered; every one by default."""
    rooms: int | None = None
    """First so many rooms of each cell; all by default."""


def compute_design(study: Study) -> str:
    """Hash of the registered files."""
    return hashlib.sha256(b"\0".join((study.folder / name).read_bytes() for name in REGISTERED)).hexdigest()[:16]


def measure(study: Study, args: Args, store: Store) -> None:
    """Make the runs that are missing, until the time is up, and say how many are left.

    Raises:
        UnknownNameError: the study has no such learner.
        ComparisonError: the results are of another design.
    """
    data, design = study.data, compute_design(study)
    learners = list_learners(data)
    for label in args.agents:
        if label not in learners:
            raise UnknownNameError(f"agent of {study.name}", label, learners)
    check_design(lines := store.load(), design)
    jobs = [job for job in list_jobs(data, design) if _is_wanted(job, args, data)]
    known = {line.place for line in lines}
    missing = [job for job in jobs if job.place not in known]
    console, made = Console(stderr=True, highlight=False, soft_wrap=True), 0
    for line in _make(data, missing, store, args):
        made += 1
        console.print(f"{line.part}, {line.agent}, {line.buttons} buttons, room {line.seed}, "
                      f"{line.budget:,} primitives: first escape {line.first_escape}, efficiency {line.late:.2f}, "
                      f"{line.seconds:.0f} s; {len(missing) - made} of {len(jobs)} runs are missing", markup=False)
    if made < len(missing):
        console.print(f"time is up: {len(missing) - made} of {len(jobs)} runs are missing, the same command continues")


def _is_wanted(job: ScaleRun, args: Args, data: Mapping[str, Any]) -> bool:
    """True for a job that the options ask for; trials are made for the learners asked for."""
    if args.agents and job.agent not in args.agents and not (
            job.agent == data["reuse"]["agent"] and job.part == TRIAL
            and any(list_learners(data)[label].acts == "reused" for label in args.agents)):
        return False
    if job.part == TRIAL:
        return True
    first = [own for own in data["slices"].values() if own <= job.seed]
    return ((not args.buttons or job.buttons in args.buttons)
            and args.budget in (None, job.budget)
            and (args.rooms is None or job.seed - max(first) < args.rooms))


def _make(data: Mapping[str, Any], jobs: Sequence[ScaleRun], store: Store, args: Args) -> Iterator[ScaleRun]:
    """Make runs, some at a time, and keep and yield each as it ends.

    A run whose settings are still open waits for the trials of its learner.
    """
    end = math.inf if args.minutes is None else time.monotonic() + 60 * args.minutes
    context, left = multiprocessing.get_context("spawn"), list(jobs)
    running: dict[Future[ScaleRun], ScaleRun] = {}
    with ProcessPoolExecutor(args.workers, context, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        while True:
            choices = choose_settings(line for line in store.load() if line.part == TRIAL)
            waits = {job.agent for job in (*running.values(), *left) if job.part == TRIAL}
            ready = [job for job in left if job.part == TRIAL or not waits.intersection(
                (job.agent, *([data["reuse"]["agent"]] if job.part == UNSEEN else [])))]
            for job in ready[: args.workers - len(running)] if time.monotonic() < end else ():
                left.remove(job)
                asked = dataclasses.replace(job, choice=choices[job.agent]) if job.choice == OPEN else job
                running[pool.submit(make_run, data, asked, choices, args.device)] = job
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job = running.pop(future)
                try:
                    line = future.result()
                except BrokenProcessPool:
                    raise ComparisonError(f"the process of a run was killed ({job.agent}, {job.buttons} buttons, room "
                                          f"{job.seed}): the same command continues, perhaps with fewer --workers"
                                          ) from None
                store.add([line])
                yield line


def check_design(lines: Sequence[ScaleRun], design: str) -> None:
    """Refuse counted lines of another design.

    Raises:
        ComparisonError: there are some.
    """
    if other := [line for line in lines if line.part != TRIAL and line.design != design]:
        raise ComparisonError(f"{len(other)} lines are of the design {other[0].design}, and {' and '.join(REGISTERED)} "
                              f"now give {design}: a new design begins with results of its own (--docs)")


def analyse(study: Study, lines: Sequence[ScaleRun]) -> Findings:
    """Registered answers of both stages, and the runs that are missing.

    Raises:
        ComparisonError: lines are of another design.
    """
    data, design = study.data, compute_design(study)
    check_design(lines, design)
    learners, known = list_learners(data), {line.place for line in lines}
    counted = [job for job in list_jobs(data, design) if job.part != TRIAL]
    made, least = sum(job.place in known for job in counted), data["least"]
    choices = choose_settings(line for line in lines if line.part == TRIAL)
    first, second = (answer(data, lines, budget) for budget in data["budgets"])
    tried = next((line.fewest for line in lines if line.part == TRIAL), math.nan)
    fewest = {line.seed: line.fewest for line in lines
              if line.part != TRIAL and line.buttons == data["trials"]["buttons"]}
    numbers = SimpleNamespace(
        data=data, design=design, runs=len(counted), made=made, first=first, second=second, choices=choices,
        trial_fewest=tried, fewest=median(fewest.values()) if fewest else math.nan)
    return Findings(numbers, {
        "learned_options_first": tabulate_cells(first.sizes, learners, least),
        "learned_options_second": tabulate_cells(second.sizes, learners, least),
        "learned_options_unseen": tabulate_cells(first.unseen, learners, least),
        "learned_options_reuse": tabulate_reuse(first.reuse),
        "learned_options_reset": tabulate_cells(first.reset, learners, least),
        "learned_options_fresh": tabulate_cells(first.fresh, learners, least),
        "learned_options_gains": tabulate_gains(first.gains, learners),
        "learned_options_fresh_gains": tabulate_gains(first.fresh_gains, learners),
        "learned_options_second_gains": tabulate_gains(second.gains, learners),
        "learned_options_missing": tabulate_missing(data, counted, known),
        "learned_options_rates": tabulate_rates(learners, lines, data["left_out"]),
        "learned_options_trials": tabulate_trials(lines, data, learners, choices)},
        {"learned-options": partial(draw_curves, first.sizes, learners, least),
         "learned-options-escapes": partial(draw_escapes, first.sizes, learners, least)})


def answer(data: Mapping[str, Any], lines: Sequence[ScaleRun], budget: int) -> SimpleNamespace:
    """Answers of a stage.

    Args:
        data: of `study.toml`.
        lines: all runs.
        budget: of the stage.

    Returns:
        `sizes`, `fresh`, `reset` and `unseen`: cells by number of buttons, in the first rooms, in fresh ones, with
        wrong presses that reset the buttons, and of the part about unseen rooms. `gains` and `fresh_gains`:
        comparisons with the best flat learner. `reuse`: number of buttons -> times of reused options over those of
        options learned anew, with enough rooms. `crossover`: number of buttons, or None.
    """
    learners = list_learners(data)
    budgets = {label: min(budget, learner.most or budget) for label, learner in learners.items()}
    flat, own = ([label for label, learner in learners.items() if learner.family == family
                  and learner.sees == "features"] for family in ("flat", "learned options"))
    rooms = {name: range(first, first + data["rooms"]) for name, first in data["slices"].items()}
    counts = {part: sorted({block["buttons"] for block in data["blocks"] if block["part"] == part})
              for part in (ONE_ROOM, UNSEEN)}
    sizes = {name: {buttons: gather_cells(lines, ONE_ROOM, buttons, seeds, budgets) for buttons in counts[ONE_ROOM]}
             for name, seeds in rooms.items()}
    planned = {label for label, learner in learners.items() if learner.acts == "planned"}
    unseen = {buttons: {**gather_cells(lines, UNSEEN, buttons, rooms["first"], budgets),
                        **{label: runs for label, runs in sizes["first"][buttons].items() if label in planned}}
              for buttons in counts[UNSEEN]}
    gains = {name: compare_to_flat(cells, flat, own, data["least"]) for name, cells in sizes.items()}
    reset = {buttons: gather_cells(lines, ONE_ROOM, buttons, rooms["first"], budgets, "reset")
             for buttons in counts[ONE_ROOM]}
    reused = next(label for label, learner in learners.items() if learner.acts == "reused")
    pairs = {buttons: [(run, cells[data["reuse"]["agent"]][room]) for room, run in cells.get(reused, {}).items()
                       if room in cells.get(data["reuse"]["agent"], {})] for buttons, cells in unseen.items()}
    reuse = {buttons: compare_times(own) for buttons, own in pairs.items() if len(own) >= data["least"]}
    return SimpleNamespace(budget=budget, sizes=sizes["first"], fresh=sizes["confirmation"], unseen=unseen,
                           reset=reset, gains=gains["first"], fresh_gains=gains["confirmation"], reuse=reuse,
                           crossover=find_crossover(gains["first"]))
