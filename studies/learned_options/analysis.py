"""Learned options at scale: makes missing runs in the registered order, and answers as registered."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import multiprocessing
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from rich.console import Console

from hrl_escape.errors import ComparisonError, UnknownNameError
from studies.learned_options.answers import compare_to_flat, find_crossover, gather_cells
from studies.learned_options.runs import (
    OPEN,
    TRIAL,
    UNSEEN,
    Learner,
    ScaleRun,
    choose_settings,
    list_jobs,
    list_learners,
    make_run,
)
from studies.running import StudyArgs
from studies.store import Store
from studies.study import Findings, Study
from studies.tables import make_table

__all__ = ["LINES", "Args", "analyse", "check_design", "compute_design", "measure"]

LINES = (ScaleRun,)
REGISTERED = ("study.toml", "questions.md")
"""Files of the design."""
ONE_ROOM = "one room"



@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    minutes: float | None = None
    """Begin no run after so long; the same command goes on."""
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
            raise UnknownNameError(f"learner of {study.name}", label, learners)
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
        console.print(f"time is up: {len(missing) - made} of {len(jobs)} runs are missing, the same command goes on")


def _is_wanted(job: ScaleRun, args: Args, data: Mapping[str, Any]) -> bool:
    """Whether options ask for a job; trials are made for the learners asked for."""
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
                del running[future]
                store.add([future.result()])
                yield future.result()


def check_design(lines: Sequence[ScaleRun], design: str) -> None:
    """Refuse counted lines of another design.

    Raises:
        ComparisonError: there are some.
    """
    if other := [line for line in lines if line.part != TRIAL and line.design != design]:
        raise ComparisonError(f"{len(other)} lines are of the design {other[0].design}, and {' and '.join(REGISTERED)} "
                              f"now give {design}: a new design begins with results of its own (--docs)")


def analyse(study: Study, lines: Sequence[ScaleRun]) -> Findings:
    """Registered answers of both stages, and how many runs of each are missing.

    Raises:
        ComparisonError: lines are of another design.
    """
    data, design = study.data, compute_design(study)
    check_design(lines, design)
    learners, known = list_learners(data), {line.place for line in lines}
    counted = [job for job in list_jobs(data, design) if job.part != TRIAL]
    stages = {budget: _answer(data, lines, learners, budget) for budget in data["budgets"]}
    made = [job for job in counted if job.place in known]
    numbers = SimpleNamespace(
        data=data, design=design, runs=len(counted), made=len(made), missing=len(counted) - len(made), stages=stages,
        first=stages[data["budgets"][0]], second=stages[data["budgets"][1]],
        choices=choose_settings(line for line in lines if line.part == TRIAL))
    return Findings(numbers, {
        "learned_options_missing": _tabulate_missing(data, counted, known),
        "learned_options_rates": _tabulate_rates(learners, lines)})


def _answer(data: Mapping[str, Any], lines: Sequence[ScaleRun], learners: Mapping[str, Learner], budget: int
            ) -> SimpleNamespace:
    """Answers of a stage."""
    budgets = {label: min(budget, learner.most or budget) for label, learner in learners.items()}
    flat, own = ([label for label, learner in learners.items() if learner.family == family
                  and learner.sees == "features"] for family in ("flat", "learned options"))
    counts = sorted({block["buttons"] for block in data["blocks"]})
    sizes = {name: {buttons: gather_cells(lines, ONE_ROOM, buttons, range(first, first + data["rooms"]), budgets)
                    for buttons in counts} for name, first in data["slices"].items()}
    gains = {name: compare_to_flat(cells, flat, own, data["least"]) for name, cells in sizes.items()}
    return SimpleNamespace(budget=budget, sizes=sizes["first"], fresh=sizes["confirmation"], gains=gains["first"],
                           fresh_gains=gains["confirmation"], crossover=find_crossover(gains["first"]))


def _tabulate_missing(data: Mapping[str, Any], jobs: Sequence[ScaleRun], known: set[tuple[Any, ...]]) -> str:
    """Runs that are there, of those registered, by cell."""
    counts: dict[tuple[Any, ...], list[int]] = {}
    titles = {label: learner.title for label, learner in list_learners(data).items()}
    for job in jobs:
        is_fresh = job.seed >= data["slices"]["confirmation"]
        cell = (titles[job.agent], job.part, job.buttons, job.rule, "confirmation" if is_fresh else "first")
        own = counts.setdefault(cell, [0] * 4)
        second = 2 * (job.budget == data["budgets"][1])
        own[second] += job.place in known
        own[second + 1] += 1
    return make_table(["learner", "part", "buttons", "wrong press", "rooms", *(
        f"{budget:,} primitives" for budget in data["budgets"])], [
        [*cell, f"{first} of {all_first}", f"{second} of {all_second}" if all_second else "as before"]
        for cell, (first, all_first, second, all_second) in counts.items()])


def _tabulate_rates(learners: Mapping[str, Learner], lines: Sequence[ScaleRun]) -> str:
    """Primitives a second of processor time, median over runs."""
    rows = []
    for label, learner in learners.items():
        rates = [line.primitives / line.seconds for line in lines if line.agent == label and line.seconds]
        rows.append([learner.title, f"`{label}`", learner.copies if learner.agent != "archive" else 1, len(rates),
                     f"{np.median(rates):,.0f}" if rates else ""])
    return make_table(["learner", "label", "copies of a room", "runs", "primitives a second"], rows)
