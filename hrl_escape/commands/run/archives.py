"""Commands on the folders and archives of training runs."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.agents.training.archive import pack_run, read_summary, unpack_run
from hrl_escape.agents.training.env_description import list_foreign
from hrl_escape.names import make_console_text


@dataclasses.dataclass(frozen=True)
class PackArgs:
    """Options of `hrl-escape run pack`."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The folder of the run."""
    out: Path | None = None
    """Archive to write; by default the folder's name with .zip, in the current folder."""


def run_pack(args: PackArgs) -> None:
    """Pack a run's folder into one archive.

    Example:
        hrl-escape run pack runs/smdp-dqn-paper-two-button-0-5a1d3f0c --out mine.zip
    """
    out = Path(f"{args.folder.absolute().name}.zip") if args.out is None else args.out
    summary = pack_run(args.folder, out)
    Console(soft_wrap=True).print(f"wrote {make_console_text(str(out))}: {len(summary.parts)} parts, "
                                  f"{sum(part.bytes for part in summary.parts):,} bytes, SHA-256 {summary.digest}")


@dataclasses.dataclass(frozen=True)
class ShowRunArgs:
    """Options of `hrl-escape run show`."""

    path: Annotated[Path, tyro.conf.Positional]
    """The folder or the archive."""
    json: bool = False
    """Print JSON instead of text."""


def run_show(args: ShowRunArgs) -> None:
    """Show the contents of a run's folder or archive and the code that it would import, without importing it.

    Example:
        hrl-escape run show mine.zip
    """
    summary = read_summary(args.path)
    described = summary.described
    report = {
        **{name: described.get(name) for name in ("name", "seed", "primitives", "version")},
        "key": summary.key, "finished": summary.is_finished, "sha256": summary.digest,
        "needs_trust": list_foreign(described.get("environment")),
        "parts": [dataclasses.asdict(part) for part in summary.parts],
    }
    if args.json:
        print(json.dumps(report, indent=2))
        return
    console = Console(soft_wrap=True, highlight=False)
    for name in ("name", "seed", "primitives", "version", "key", "finished", "sha256"):
        console.print(f"{name:<12}{make_console_text(str(report[name]))}")
    foreign = ", ".join(map(str, report["needs_trust"])) or "nothing: it runs only known code"
    console.print(f"{'needs trust':<12}{make_console_text(foreign)}")
    for part in summary.parts:
        console.print(f"  {part.name:<16}{part.bytes:>14,} bytes  {part.sha256[:16]}")


@dataclasses.dataclass(frozen=True)
class UnpackArgs:
    """Options of `hrl-escape run unpack`."""

    archive: Annotated[Path, tyro.conf.Positional]
    """The archive, as `hrl-escape run pack` wrote it."""
    out: Path | None = None
    """Folder to make; by default the archive's name without its ending, in the current folder."""


def run_unpack(args: UnpackArgs) -> None:
    """Unpack a run's archive into a folder; checks every hash and runs no code.

    Example:
        hrl-escape run unpack mine.zip --out runs/mine
    """
    out = Path(args.archive.stem) if args.out is None else args.out
    summary = unpack_run(args.archive, out)
    Console(soft_wrap=True).print(f"wrote {make_console_text(str(out))}: {len(summary.parts)} parts, "
                                  f"SHA-256 {summary.digest}")
