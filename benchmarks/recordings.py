"""The table of published recordings, from their files.

    python -m benchmarks.recordings data

Reads the recordings that come with the package and, under other names, the recordings of a folder. Writes a line for
each: the hash of its content, its size, and its scores. Lines of other recordings in the table are kept. A
recording that `hrl-escape data make` kept as `NAME.other.npz`, since it is not the published one, replaces it once it
is renamed.
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
from hrl_escape.data.published import PUBLISHED, PublishedRecording, read_published
from hrl_escape.data.recording import load_recording
from hrl_escape.errors import VerificationError
from hrl_escape.files import write_text

SCORES = ("mean_return", "mean_length", "escapes", "chance", "best_known")


@dataclasses.dataclass(frozen=True)
class Args:
    """Options of the table of recordings."""

    folder: Annotated[Path, tyro.conf.Positional] = FOLDER
    """Folder of recordings."""


def describe_recording(spec: DataSpec, path: Path) -> PublishedRecording:
    """Describe the recording of a data set.

    Raises:
        VerificationError: it is a trial, or a recording of another name.
    """
    recording = load_recording(path)
    if recording.about["name"] != spec.name or len(recording.action) < spec.primitives:
        raise VerificationError(f"{path} holds {len(recording.action):,} primitives of {recording.about['name']}, and "
                                f"{spec.name} has {spec.primitives:,}; move it away and record it again")
    scores = {name: round(recording.about["scores"][name], 3) for name in SCORES}
    counts = (len(recording.action), len(recording.option), len(recording.room))
    return PublishedRecording(recording.content, path.stat().st_size, *counts, scores)


def write_line(name: str, recording: PublishedRecording) -> str:
    """A line of TOML."""
    fields = dataclasses.asdict(recording)
    scores = ", ".join(f"{score} = {value}" for score, value in fields.pop("scores").items())
    return f"{name} = {{{', '.join(f'{key} = {json.dumps(value)}' for key, value in fields.items())}, " \
           f"scores = {{{scores}}}}}\n"


def read_recordings(folder: Path) -> dict[str, PublishedRecording]:
    """Describe the recordings that come with the package, and recordings of a folder with other names."""
    recordings: dict[str, PublishedRecording] = {}
    for spec in list_specs():
        for path in (PUBLISHED.parent / f"{spec.name}.npz", folder / f"{spec.name}.npz"):
            if path.is_file():
                recordings[spec.name] = describe_recording(spec, path)
                break
    return recordings


def run(args: Args) -> int:
    """Write the table."""
    recordings = {**(read_published() if PUBLISHED.is_file() else {}), **read_recordings(args.folder)}
    write_text(PUBLISHED, "# Published recordings; written by python -m benchmarks.recordings\n" + "".join(
        write_line(spec.name, recordings[spec.name]) for spec in list_specs() if spec.name in recordings))
    print(f"wrote {PUBLISHED}: {len(recordings)} recordings")
    return 0


if __name__ == "__main__":
    sys.exit(run_script(run))
