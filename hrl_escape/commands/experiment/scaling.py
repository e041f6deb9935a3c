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

from hrl_escape.errors import ConfigError
from hrl_escape.experiments.studies.running import StudyArgs
from hrl_escape.experiments.studies.scaling import AGENTS, run_scaling
from hrl_escape.experiments.studies.scaling_page import write_scaling_page
from hrl_escape.experiments.studies.scaling_raw import load_scaling_runs, save_scaling_runs
from hrl_escape.files import claim_folder


@dataclasses.dataclass(frozen=True)
class ScalingArgs(StudyArgs):
    """Options of `hrl-escape experiment scaling`."""

    runs: int = 2
    """Runs of each agent in each kind of room, each in a room of its own."""
    primitives: int = 20_000
    """Training budget of a run."""
    minutes: float = 40.0
    """Begin no run after so long; the page says what was run."""


def run(args: ScalingArgs) -> None:
    """Run, write the page, and say where it is."""
    raw = args.docs / "raw" / "scaling.csv"
    if not args.from_raw:
        for name in ("runs", "primitives", "minutes"):
            if getattr(args, name) <= 0:
                raise ConfigError(name, getattr(args, name), "it must be above 0")
        claim_folder(raw.parent)
        runs = run_scaling(args.out / "scaling", args.runs, args.primitives, args.workers, args.minutes)
        save_scaling_runs(raw, runs)
    write_scaling_page(load_scaling_runs(raw, AGENTS), args.docs)
    Console(highlight=False, soft_wrap=True).print(f"Page: {args.docs / 'scaling.md'}")
