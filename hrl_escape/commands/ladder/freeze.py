"""Fill in a manifest's roots: generate the rooms of every rung, skip those that look alike, and write the file.

A manifest needs a name and, for each rung, a name and a schematic; counts have defaults. Whoever changes a
frozen benchmark gives it another name.

Examples:
    hrl-escape ladder freeze my-ladder.json
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.ladder.certificate import freeze_manifest
from hrl_escape.ladder.manifest import load_manifest
from hrl_escape.version import __version__


@dataclasses.dataclass(frozen=True)
class FreezeArgs:
    """Options of `hrl-escape ladder freeze`."""

    manifest: Annotated[Path, tyro.conf.Positional]
    """Manifest file; it is written anew."""


def run(args: FreezeArgs) -> None:
    """Write the manifest with roots, skipped indices and task overlaps."""
    frozen = freeze_manifest(load_manifest(args.manifest), __version__)
    frozen.save(args.manifest)
    Console(soft_wrap=True, highlight=False).print(f"{frozen.name}: {len(frozen.rungs)} rungs; wrote {args.manifest}")
