"""Find out why SARSA and DDPG get worse with meta-actions: a screening design between the two recipes.

Writes docs/results/why-it-worsens.md with its figures and raw results.

Examples:
    hrl-escape experiment factorial --workers 2
    hrl-escape experiment factorial --algorithms sarsa ddpg --rooms 8 --out /tmp/runs --docs /tmp/page
    hrl-escape experiment factorial --from-raw           # the page anew from the raw results, nothing is trained
"""

from __future__ import annotations

import dataclasses

from rich.console import Console

from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.experiments.studies.factorial import ALGORITHMS, ROOMS, make_factorial_grid
from hrl_escape.experiments.studies.factorial_cause import conclude
from hrl_escape.experiments.studies.factorial_page import write_factorial_page
from hrl_escape.experiments.studies.running import StudyArgs, run_study


@dataclasses.dataclass(frozen=True)
class FactorialArgs(StudyArgs):
    """Options of `hrl-escape experiment factorial`."""

    algorithms: tuple[str, ...] = ("sarsa",)
    """Algorithms whose recipes are compared: sarsa, ddpg."""
    rooms: int = ROOMS
    """Number of rooms, drawn from one schematic."""
    runs: int = 5
    """Training seeds of each agent in each room; fewer than five conclude nothing."""
    primitives: int = 4_000
    """Training budget of a run."""


def run(args: FactorialArgs) -> None:
    """Run, write the page, and print its conclusions."""
    if not args.algorithms:
        raise ConfigError("algorithms", "", f"name one or more of {', '.join(ALGORITHMS)}")
    for name in args.algorithms:
        if name not in ALGORITHMS:
            raise UnknownNameError("algorithm of this factorial", name, ALGORITHMS)
    grids = {name: make_factorial_grid(name, args.rooms, args.runs, args.primitives) for name in args.algorithms}
    runs = run_study(list(grids.values()), args)
    found = write_factorial_page({name: runs[grid.name] for name, grid in grids.items()}, args.docs)
    console = Console(highlight=False, soft_wrap=True)
    for name, findings in found.items():
        console.print(f"[bold]{name}[/bold]: {' '.join(conclude(findings))}")
    console.print(f"Page: {args.docs / 'why-it-worsens.md'}")
