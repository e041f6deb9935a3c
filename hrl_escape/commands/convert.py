"""Convert a file of version 0.3 to this version.

    hrl-escape convert runs/smdp-dqn-paper-two-button-0-5a1d3f0c
    hrl-escape convert grid.toml --out new.toml

PATH is the folder or archive of a training run, the archive of a trained agent, a grid (.toml, .json), a recording
(.npz), recorded games (.jsonl), a recorded episode or a saved room (.json). `smdp-dqn` of version 0.3 becomes
`smdp-dqn+primitives`, and `smdp-dqn+no-primitives` becomes `smdp-dqn`. Search baselines, named settings and hierarchies
get their new names. A converted run can be loaded, watched, recorded and packed, but not resumed. Results of
comparisons belong to the version that made them: convert the grid and run it again.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.benchmark.conversion import convert_file
from hrl_escape.data.convert import convert_data
from hrl_escape.errors import UnsupportedError
from hrl_escape.names import make_console_text


@dataclasses.dataclass(frozen=True)
class ConvertArgs:
    """Options of `hrl-escape convert`."""

    path: Annotated[Path, tyro.conf.Positional]
    """A run (folder or archive), trained agent, grid, recording, recorded games, a recorded episode or a room."""
    out: Path | None = None
    """File or folder to write; by default next to PATH, with -converted behind its name."""


def run(args: ConvertArgs) -> None:
    """Convert one file or folder; the original stays."""
    path = args.path.absolute()
    suffix = "" if path.is_dir() else path.suffix
    out = args.out or path.with_name(f"{path.name.removesuffix(suffix)}-converted{suffix}")
    if out.exists():
        raise UnsupportedError(f"{out} is there already: give another --out")
    said = (path.is_file() and convert_data(path, out)) or convert_file(path, out)
    console = Console(soft_wrap=True, highlight=False)
    console.print(f"converted {make_console_text(said)}: {make_console_text(str(out))}")
