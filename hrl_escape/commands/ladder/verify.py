"""Generate a benchmark's rooms anew and check that they are those of the manifest, and that no set shares a room.

A rung takes a few seconds, those with many obstacles up to a minute.

Examples:
    hrl-escape ladder verify
    hrl-escape ladder verify doormat pair
"""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.ladder.benchmark import load_benchmark


@dataclasses.dataclass(frozen=True)
class VerifyArgs:
    """Options of `hrl-escape ladder verify`."""

    rungs: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Rungs to verify; all by default."""
    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""


def run(args: VerifyArgs) -> None:
    """Print one line a rung; the first that differs ends it with exit code 2."""
    console = Console(soft_wrap=True, highlight=False)
    load_benchmark(args.benchmark).verify(args.rungs, console.print)
