"""Measure how learning over options scales from 2 to 20 buttons, and how soon the button graph is recovered.

Writes docs/results/scaling.md with its figures and raw results. Killed, the same command goes on. Results of a part
join those that are there, a run that was made again in place of its old line.

Examples:
    hrl-escape experiment scaling --workers 2
    hrl-escape experiment scaling --runs 5 --minutes 120 --out /tmp/runs --docs /tmp/page
    hrl-escape experiment scaling --parts bar --first-seed 100
    hrl-escape experiment scaling --parts told --runs 10
    hrl-escape experiment scaling --parts agents --agents smdp-dqn smdp-sarsa
    hrl-escape experiment scaling --from-raw             # the page anew from the raw results, nothing is trained
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from rich.console import Console

from hrl_escape.comparison.studies.running import StudyArgs
from hrl_escape.comparison.studies.scaling.page import write_scaling_page
from hrl_escape.comparison.studies.scaling.scaling_runs import (
    ScalingRun,
    join_scaling_runs,
    load_scaling_runs,
    save_scaling_runs,
)
from hrl_escape.comparison.studies.scaling.study import AGENTS, STUDY_PARTS, TOLD, run_scaling
from hrl_escape.errors import ComparisonError, ConfigError, UnknownNameError
from hrl_escape.files import claim_folder

_KNOWN = (*AGENTS, *(spec.label for spec in TOLD))


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
    agents: tuple[str, ...] = AGENTS
    """Agents of the part agents."""


def run(args: ScalingArgs) -> None:
    """Run, write the page, and say where it is."""
    raw, fresh = (args.docs / "raw" / f"{name}.csv" for name in ("scaling", "scaling-fresh"))
    if not args.from_raw:
        for what, names, known in (("part", args.parts, STUDY_PARTS), ("agent", args.agents, AGENTS)):
            for name in names:
                if name not in known:
                    raise UnknownNameError(f"{what} of the scaling study", name, known)
        for name in ("runs", "primitives", "minutes"):
            if getattr(args, name) <= 0:
                raise ConfigError(name, getattr(args, name), "it must be above 0")
        path = fresh if args.first_seed else raw
        claim_folder(path.parent)
        earlier = _load_earlier(path, args.primitives)
        runs = run_scaling(args.out / "scaling", args.runs, args.primitives, args.workers, args.minutes,
                           first_seed=args.first_seed, parts=args.parts, agents=args.agents)
        joined = join_scaling_runs(earlier, runs)
        if not joined:
            raise ComparisonError(f"no run is finished after {args.minutes:g} minutes: raise --minutes")
        save_scaling_runs(path, joined)
    again = load_scaling_runs(fresh, _KNOWN) if fresh.exists() else []
    write_scaling_page(load_scaling_runs(raw, _KNOWN), args.docs, again)
    Console(highlight=False, soft_wrap=True).print(f"Page: {args.docs / 'scaling.md'}")


def _load_earlier(path: Path, budget: int) -> list[ScalingRun]:
    """Runs that new ones are to join.

    Raises:
        ConfigError: they had another budget.
        FileReadError: the file is damaged.
    """
    earlier = load_scaling_runs(path, _KNOWN) if path.exists() else []
    for run in earlier:
        if run.budget != budget:
            raise ConfigError("primitives", budget, f"the runs in {path}, which new ones join, have {run.budget}. "
                              "Choose another --docs")
    return earlier
