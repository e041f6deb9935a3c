"""Find out why SARSA and DDPG get worse with meta-actions: a factorial between the two recipes.

Writes docs/results/why-it-worsens.md with its figures and raw results.

Examples:
    hrl-escape experiment factorial --workers 2
    hrl-escape experiment factorial --algorithms sarsa --no-corners --out /tmp/runs --docs /tmp/page
    hrl-escape experiment factorial --from-raw           # the page anew from the raw results, nothing is trained
"""

from __future__ import annotations

import dataclasses

from rich.console import Console

from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.experiments.studies.factorial import ALGORITHMS, get_factors, make_factorial_grid
from hrl_escape.experiments.studies.factorial_page import write_factorial_page
from hrl_escape.experiments.studies.running import StudyArgs, run_study


@dataclasses.dataclass(frozen=True)
class FactorialArgs(StudyArgs):
    """Options of `hrl-escape experiment factorial`."""

    algorithms: tuple[str, ...] = ALGORITHMS
    """Algorithms whose recipes are compared: sarsa, ddpg."""
    no_corners: bool = False
    """Only the half fraction that is analysed, not the agents that differ from a recipe in one factor."""
    runs: int = 1
    """Training seeds of each agent in each room."""
    primitives: int = 20_000
    """Training budget of a run."""


def run(args: FactorialArgs) -> None:
    """Run, write the page, and print the main effects."""
    if not args.algorithms:
        raise ConfigError("algorithms", "", f"name one or more of {', '.join(ALGORITHMS)}")
    for name in args.algorithms:
        if name not in ALGORITHMS:
            raise UnknownNameError("algorithm of this factorial", name, ALGORITHMS)
    grids = {name: make_factorial_grid(name, not args.no_corners, args.runs, args.primitives)
             for name in args.algorithms}
    runs = run_study(list(grids.values()), args)
    analyses = write_factorial_page({name: runs[grid.name] for name, grid in grids.items()}, args.docs)
    console = Console(highlight=False, soft_wrap=True)
    for (name, response), analysis in analyses.items():
        effects = [analysis.get_term(factor) for factor in get_factors(name)]
        console.print(f"[bold]{name}, {response}[/bold]: " + ", ".join(
            f"{term.factors[0]} {100 * term.effect:+.1f}" for term in effects))
    console.print(f"Page: {args.docs / 'why-it-worsens.md'}")
