"""The table of published tapes, from recordings.

    python -m benchmarks.tapes data

Reads the tapes that come with the package and, of other names, those of a folder, and writes what each is, a line each:
the hash of its content, its size, and its scores. What the table holds already of other tapes is kept. A tape that
`hrl-escape data make` kept as `NAME.other.npz`, since it is not the published one, replaces it once it is renamed.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Annotated

import tyro

from hrl_escape.cli import run_script
from hrl_escape.data.catalogue import FOLDER, DataSpec, list_specs
from hrl_escape.data.published import PUBLISHED, PublishedTape, read_published
from hrl_escape.data.tape import load_tape
from hrl_escape.errors import VerificationError
from hrl_escape.files import write_text

SCORES = ("mean_return", "mean_length", "escapes", "chance", "best_known")


@dataclasses.dataclass(frozen=True)
class Args:
    """Options of the table of tapes."""

    folder: Annotated[Path, tyro.conf.Positional] = FOLDER
    """Folder of recordings."""


def describe_tape(spec: DataSpec, path: Path) -> PublishedTape:
    """What the tape of a data set is.

    Raises:
        VerificationError: it is a trial, or a tape of another name.
    """
    tape = load_tape(path)
    if tape.about["name"] != spec.name or len(tape.action) < spec.primitives:
        raise VerificationError(f"{path} holds {len(tape.action):,} primitives of {tape.about['name']}, and "
                                f"{spec.name} has {spec.primitives:,}; move it away and record it anew")
    scores = {name: round(tape.about["scores"][name], 3) for name in SCORES}
    return PublishedTape(tape.content, path.stat().st_size, len(tape.action), len(tape.option), len(tape.room), scores)


def write_line(name: str, tape: PublishedTape) -> str:
    """A line of TOML."""
    fields = dataclasses.asdict(tape)
    scores = ", ".join(f"{score} = {value}" for score, value in fields.pop("scores").items())
    return f"{name} = {{{', '.join(f'{key} = {json.dumps(value)}' for key, value in fields.items())}, " \
           f"scores = {{{scores}}}}}\n"


def read_tapes(folder: Path) -> dict[str, PublishedTape]:
    """What the tapes are that come with the package, and those of a folder whose names do not."""
    tapes: dict[str, PublishedTape] = {}
    for spec in list_specs():
        for path in (PUBLISHED.parent / f"{spec.name}.npz", folder / f"{spec.name}.npz"):
            if path.is_file():
                tapes[spec.name] = describe_tape(spec, path)
                break
    return tapes


def run(args: Args) -> int:
    """Write the table."""
    tapes = {**(read_published() if PUBLISHED.is_file() else {}), **read_tapes(args.folder)}
    write_text(PUBLISHED, "# Published tapes; written by python -m benchmarks.tapes\n" + "".join(
        write_line(spec.name, tapes[spec.name]) for spec in list_specs() if spec.name in tapes))
    print(f"wrote {PUBLISHED}: {len(tapes)} tapes")
    return 0


if __name__ == "__main__":
    sys.exit(run_script(run))
