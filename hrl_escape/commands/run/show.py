"""Show what a run's folder or archive holds, and which code it would run, without running any.

Example:
    hrl-escape run show mine.zip
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.agents.training.archive import read_summary
from hrl_escape.agents.training.env_description import list_foreign
from hrl_escape.names import make_console_text


@dataclasses.dataclass(frozen=True)
class ShowRunArgs:
    """Options of `hrl-escape run show`."""

    path: Annotated[Path, tyro.conf.Positional]
    """The folder or the archive."""
    json: bool = False
    """Print JSON instead of text."""


def run(args: ShowRunArgs) -> None:
    """Print what a run folder or archive holds, as text or JSON; no code of it is run."""
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
