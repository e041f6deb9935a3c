"""Record data sets: play, noisy, expert, medium, stitch or explore in the training rooms of a rung, or your own play.

A tape of 10^5 primitives takes some ten seconds to a minute, 20 to 120 kB on disk, and replays to the bit. A
recording that was killed goes on where it was.

Examples:
    hrl-escape data make pair-play-1m-v1
    hrl-escape data make lattice-play-v1 lattice-expert-v1 --out data
    hrl-escape data make mine --rooms paper-two-button#0 --played episodes/*.json
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.data.catalogue import FOLDER, parse_spec
from hrl_escape.data.record import make_played_tape, record
from hrl_escape.data.tape import load_tape, save_tape
from hrl_escape.errors import ConfigError
from hrl_escape.names import make_file_name


@dataclasses.dataclass(frozen=True)
class MakeArgs:
    """Options of `hrl-escape data make`."""

    names: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Data sets of the catalogue, see `hrl-escape data list`; with --played the name of yours."""
    out: Path = FOLDER
    """Folder of the tapes; `train --data NAME` looks into `data`."""
    primitives: int | None = None
    """Another number of primitives than the name says, for a trial."""
    rooms: str | None = None
    """With --played: the rooms, such as paper-two-button#0 or ladder-1/pair/train[:4]."""
    played: tuple[Path, ...] = ()
    """Episodes saved by `hrl-escape play`, to make a data set of."""


def run(args: MakeArgs) -> None:
    """Record what is missing, one line a tape."""
    console = Console(soft_wrap=True, highlight=False)
    if args.played or args.rooms:
        if len(args.names) != 1 or not (args.played and args.rooms):
            raise ConfigError("names", args.names, "one name, with both --rooms and --played")
        name = make_file_name(args.names[0])
        tape = make_played_tape(name, args.rooms, args.played)
        save_tape(args.out / f"{name}.npz", tape)
        console.print(f"{tape}; wrote {args.out / f'{name}.npz'}", markup=False)
        return
    if not args.names:
        raise ConfigError("names", "none", "at least one data set of `hrl-escape data list`")
    if args.primitives is not None and args.primitives < 1:
        raise ConfigError("--primitives", args.primitives, "at least 1")
    for spec in [parse_spec(name) for name in args.names]:
        path = args.out / f"{spec.name}.npz"
        tape = load_tape(path) if path.is_file() else record(spec, path, primitives=args.primitives)
        console.print(f"{tape}; {path}, {path.stat().st_size:,} bytes", markup=False)
