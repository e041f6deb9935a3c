"""Measure how learning over options scales from 2 to 20 buttons, and how soon the button graph is recovered.

Writes docs/results/scaling.md with its figures and raw results. Killed, the same command goes on.

Examples:
    hrl-escape experiment scaling --workers 2
    hrl-escape experiment scaling --runs 5 --minutes 120 --out /tmp/runs --docs /tmp/page
    hrl-escape experiment scaling --from-raw             # the page anew from the raw results, nothing is trained
"""

from __future__ import annotations

import dataclasses

from rich.console import Console

from hrl_escape.errors import ConfigError, FileReadError
from hrl_escape.experiments.launcher import choose_workers
from hrl_escape.experiments.studies.running import StudyArgs
from hrl_escape.experiments.studies.scaling import TrialResult, load_results, run_trials, save_results
from hrl_escape.experiments.studies.scaling_page import write_scaling_page
from hrl_escape.files import claim_folder


@dataclasses.dataclass(frozen=True)
class ScalingArgs(StudyArgs):
    """Options of `hrl-escape experiment scaling`."""

    runs: int = 2
    """Trials of each agent in each kind of room, each in another room."""
    primitives: int = 20_000
    """Training budget of a trial."""
    minutes: float = 40.0
    """Begin no trial after so long; the page says what was run."""


def run(args: ScalingArgs) -> None:
    """Run, write the page, and say where it is."""
    console = Console(highlight=False, soft_wrap=True)

    def report(result: TrialResult, number: int, total: int) -> None:
        escape = "no escape" if result.first_escape is None else f"escaped at {result.first_escape:,}"
        near = "" if result.near_best is None else f", near the best at {result.near_best:,}"
        console.print(f"{number:3}/{total} {result.trial.name}: {escape}{near} ({result.seconds:.0f} s)")

    raw = args.docs / "raw" / "scaling.csv"
    if not args.from_raw:
        for name in ("runs", "primitives", "minutes"):
            if getattr(args, name) <= 0:
                raise ConfigError(name, getattr(args, name), "it must be above 0")
        claim_folder(raw.parent)
        out, workers = args.out / "scaling", choose_workers(args.workers)
        save_results(raw, run_trials(out, args.runs, args.primitives, workers, args.minutes, report))
    results = load_results(raw)
    if not results:
        raise FileReadError(f"{raw} holds no trial; without --from-raw trials are run")
    write_scaling_page(results, args.docs)
    console.print(f"Page: {args.docs / 'scaling.md'}")
