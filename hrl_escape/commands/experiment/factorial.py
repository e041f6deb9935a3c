"""Find out why SARSA and DDPG get worse with meta-actions: a screening design between the two recipes.

Writes docs/results/why-it-worsens.md with its figures and raw results. Killed, the same command goes on.

Examples:
    hrl-escape experiment factorial --workers 2
    hrl-escape experiment factorial --algorithms sarsa ddpg --rooms 8 --out /tmp/runs --docs /tmp/page
    hrl-escape experiment factorial --first-seed 100     # beside the published runs, with other rooms and seeds
    hrl-escape experiment factorial --from-raw           # the page anew from the raw results, nothing is trained
"""

from __future__ import annotations

import dataclasses

from rich.console import Console

from hrl_escape.comparison.studies.factorial import ALGORITHMS, ROOMS, make_factorial_grid, name_factorial
from hrl_escape.comparison.studies.factorial_cause import conclude
from hrl_escape.comparison.studies.factorial_page import write_factorial_page
from hrl_escape.comparison.studies.raw import load_runs
from hrl_escape.comparison.studies.running import StudyArgs, get_raw_file, run_study
from hrl_escape.errors import ConfigError, UnknownNameError


@dataclasses.dataclass(frozen=True)
class FactorialArgs(StudyArgs):
    """Options of `hrl-escape experiment factorial`."""

    algorithms: tuple[str, ...] = ("sarsa",)
    """Algorithms to run: sarsa, ddpg. The page tells of all whose raw results are there."""
    rooms: int = ROOMS
    """Number of rooms, drawn from one schematic."""
    runs: int = 5
    """Training seeds of each agent in each room; fewer than five conclude nothing."""
    primitives: int = 4_000
    """Training budget of a run."""
    first_seed: int = 0
    """Lowest training seed and lowest instance of the rooms. Above 0 the results go to a file of their own, and the
    page holds them against the published ones."""


def run(args: FactorialArgs) -> None:
    """Run, write the page, and print its conclusions."""
    if not args.algorithms:
        raise ConfigError("algorithms", "", f"name one or more of {', '.join(ALGORITHMS)}")
    for name in args.algorithms:
        if name not in ALGORITHMS:
            raise UnknownNameError("algorithm of this factorial", name, ALGORITHMS)
    run_study([make_factorial_grid(name, args.rooms, args.runs, args.primitives, args.first_seed)
               for name in args.algorithms], args)
    published, fresh = ({name: get_raw_file(args.docs, name_factorial(name, is_fresh)) for name in ALGORITHMS}
                        for is_fresh in (False, True))
    results = {name: load_runs(path) for name, path in published.items() if path.exists() or name in args.algorithms}
    again = {name: load_runs(fresh[name]) for name in results if fresh[name].exists()}
    found = write_factorial_page(results, args.docs, again)
    console = Console(highlight=False, soft_wrap=True)
    for name, findings in found.items():
        console.print(f"[bold]{name}[/bold]: {' '.join(conclude(findings))}")
    console.print(f"Page: {args.docs / 'why-it-worsens.md'}")
