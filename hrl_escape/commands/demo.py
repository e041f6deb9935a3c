"""Compare five agents in a room with two buttons: the same as `hrl-escape compare quickstart`.

Examples:
    hrl-escape demo
    hrl-escape demo --open
"""

from __future__ import annotations

import dataclasses

from hrl_escape.commands.compare import DEFAULT, CompareArgs
from hrl_escape.commands.compare import run as run_comparison


@dataclasses.dataclass(frozen=True)
class DemoArgs:
    """Options of `hrl-escape demo`."""

    workers: int | None = None
    """Runs at a time; one a core by default."""
    open: bool = False
    """Open the report in a browser at the end."""
    dry_run: bool = False
    """Run nothing: print how many runs are to be made and about how long they take."""


def run(args: DemoArgs) -> int:
    """Run the comparison, report, and say what came out."""
    return run_comparison(CompareArgs(what=DEFAULT, **vars(args)))
