"""Pack a run's folder into one file that can be moved and handed on.

Example:
    hrl-escape run pack runs/smdp-dqn-paper-two-button-0-5a1d3f0c --out mine.zip
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.agents.training.archive import pack_run
from hrl_escape.names import make_console_text


@dataclasses.dataclass(frozen=True)
class PackArgs:
    """Options of `hrl-escape run pack`."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The folder of the run."""
    out: Path | None = None
    """Archive to write; by default the folder's name with .zip, in the current folder."""


def run(args: PackArgs) -> None:
    """Pack a run folder into one archive, and print its size and parts."""
    out = Path(f"{args.folder.absolute().name}.zip") if args.out is None else args.out
    summary = pack_run(args.folder, out)
    Console(soft_wrap=True).print(f"wrote {make_console_text(str(out))}: {len(summary.parts)} parts, "
                                  f"{sum(part.bytes for part in summary.parts):,} bytes, SHA-256 {summary.digest}")
