"""Unpack a run's archive into a folder; every part is checked against its hash, and no code is run.

Example:
    hrl-escape run unpack mine.zip --out runs/mine
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.agents.training.archive import unpack_run
from hrl_escape.names import make_console_text


@dataclasses.dataclass(frozen=True)
class UnpackArgs:
    """Options of `hrl-escape run unpack`."""

    archive: Annotated[Path, tyro.conf.Positional]
    """The archive, as `hrl-escape run pack` wrote it."""
    out: Path | None = None
    """Folder to make; by default the archive's name without its ending, in the current folder."""


def run(args: UnpackArgs) -> None:
    """Unpack an archive into a run folder, and print its size and parts."""
    out = Path(args.archive.stem) if args.out is None else args.out
    summary = unpack_run(args.archive, out)
    Console(soft_wrap=True).print(f"wrote {make_console_text(str(out))}: {len(summary.parts)} parts, "
                                  f"SHA-256 {summary.digest}")
