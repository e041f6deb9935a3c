"""Measure how learning over options scales from 2 to 20 buttons, and how soon the button graph is recovered.

Writes docs/results/scaling.md with its figures and raw results. Killed, the same command goes on.

Examples:
    hrl-escape experiment scaling --workers 2
    hrl-escape experiment scaling --runs 5 --minutes 120 --out /tmp/runs --docs /tmp/page
    hrl-escape experiment scaling --parts bar --first-seed 100
    hrl-escape experiment scaling --from-raw             # the page anew from the raw results, nothing is trained
"""

from __future__ import annotations

import dataclasses

from rich.console import Console

from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.experiments.studies.running import StudyArgs
from hrl_escape.experiments.studies.scaling.page import write_scaling_page
from hrl_escape.experiments.studies.scaling.scaling_runs import load_scaling_runs, save_scaling_runs
from hrl_escape.experiments.studies.scaling.study import AGENTS, STUDY_PARTS, TOLD, run_scaling
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
    parts: tuple[str, ...] = STUDY_PARTS
    """Parts to run: bar, told, agents. With another `--first-seed` the results go to a file of their own, and the page
    holds them against the published ones."""


def run(args: ScalingArgs) -> None:
    """Run, write the page, and say where it is."""
    raw, fresh = (args.docs / "raw" / f"{name}.csv" for name in ("scaling", "scaling-fresh"))
    if not args.from_raw:
        for part in args.parts:
            if part not in STUDY_PARTS:
                raise UnknownNameError("part of the scaling study", part, STUDY_PARTS)
        for name in ("runs", "primitives", "minutes"):
            if getattr(args, name) <= 0:
                raise ConfigError(name, getattr(args, name), "it must be above 0")
        claim_folder(raw.parent)
        runs = run_scaling(args.out / "scaling", args.runs, args.primitives, args.workers, args.minutes,
                           first_seed=args.first_seed, parts=args.parts)
        save_scaling_runs(fresh if args.first_seed else raw, runs)
    agents = (*AGENTS, *(spec.label for spec in TOLD))
    again = load_scaling_runs(fresh, agents) if fresh.exists() else []
    write_scaling_page(load_scaling_runs(raw, agents), args.docs, again)
    Console(highlight=False, soft_wrap=True).print(f"Page: {args.docs / 'scaling.md'}")
