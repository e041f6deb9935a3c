"""Write a data set in the form of another library: Minari's (extra `data`) or OGBench's.

Examples:
    hrl-escape data export pair-play-v1 --to ogbench --out exported
    hrl-escape data export pair-play-v1 --to minari --observation features
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from hrl_escape.data.export import to_minari, to_ogbench
from hrl_escape.data.materialise import load_data


@dataclasses.dataclass(frozen=True)
class ExportArgs:
    """Options of `hrl-escape data export`."""

    name: Annotated[str, tyro.conf.Positional]
    """Data set, or the path of a tape."""
    to: Literal["minari", "ogbench"] = "ogbench"
    """Form: Minari's two sets in its own folder, or OGBench's two files."""
    level: Literal["decisions", "primitives"] = "decisions"
    """Rows of OGBench's files; Minari gets both."""
    observation: str = "features"
    """Observation, by name."""
    out: Path = Path("exported")
    """Folder of OGBench's files."""


def run(args: ExportArgs) -> None:
    """Write it, and say where."""
    data = load_data(args.name, observation=args.observation, level=args.level)
    if args.to == "minari":
        written = [f"{made.spec.dataset_id} ({made.total_episodes:,} episodes)" for made in to_minari(data)]
    else:
        written = [str(path) for path in to_ogbench(data, args.out)]
    Console(soft_wrap=True, highlight=False).print("wrote " + " and ".join(written), markup=False)
