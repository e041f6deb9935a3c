"""Commands on the recordings of data sets."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from hrl_escape.commands.room_choice import refuse_rooms
from hrl_escape.data.catalogue import FOLDER, RECORDING_KINDS, RUNGS, find_recording, list_specs, parse_spec
from hrl_escape.data.published import compare_published, read_published, refuse_other
from hrl_escape.errors import ConfigError, FileReadError, UnknownNameError, VerificationError
from hrl_escape.names import make_file_name


@dataclasses.dataclass(frozen=True)
class ExportArgs:
    """Options of `hrl-escape data export`."""

    name: Annotated[str, tyro.conf.Positional]
    """Data set, or the path of a recording."""
    to: Literal["minari", "ogbench"] = "ogbench"
    """Format: Minari's two data sets, or OGBench's two files."""
    level: Literal["decisions", "primitives"] = "decisions"
    """Rows of OGBench's files; Minari gets both."""
    observation: str = "features"
    """Observation, by name."""
    out: Path | None = None
    """Folder; by default Minari's own, and `exported` for OGBench's files."""


def run_export(args: ExportArgs) -> None:
    """Export a data set to Minari (extra `data`) or OGBench.

    Examples:
        hrl-escape data export pair-play-v1 --to ogbench --out exported
        hrl-escape data export pair-play-v1 --to minari --out minari
    """
    from hrl_escape.data.export import MINARI_FOLDER, to_minari, to_ogbench  # these load torch
    from hrl_escape.data.materialise import load_data

    data = load_data(args.name, observation=args.observation, level=args.level)
    if args.to == "minari":
        made = to_minari(data, folder=args.out)
        written = [f"{each.spec.dataset_id} ({each.total_episodes:,} episodes)" for each in made]
        place = "" if args.out is None else f" into {args.out}; set {MINARI_FOLDER}={args.out.absolute()} to load them"
    else:
        written, place = [str(path) for path in to_ogbench(data, args.out or Path("exported"))], ""
    Console(soft_wrap=True, highlight=False).print("wrote " + " and ".join(written) + place, markup=False)


@dataclasses.dataclass(frozen=True)
class DataListArgs:
    """Options of `hrl-escape data list`."""

    rung: str | None = None
    """Show only this rung."""
    json: bool = False
    """Print JSON instead of a table."""


def run_list(args: DataListArgs) -> None:
    """List the data sets of the catalogue: behaviour, size, scores, and whether they are recorded here.

    The values of a data set that is not recorded here are the published ones.

    Examples:
        hrl-escape data list
        hrl-escape data list --rung lattice --json
    """
    from hrl_escape.data.recording import load_recording

    if args.rung not in (None, *RUNGS):
        raise UnknownNameError("rung with data sets", args.rung, RUNGS)
    published = read_published()
    rows: list[dict[str, Any]] = []
    for spec in list_specs():
        if args.rung not in (None, spec.rung):
            continue
        try:
            path = find_recording(spec.name)
        except FileReadError:
            if (known := published.get(spec.name)) is None:
                continue
            here, size, primitives, scores = False, known.bytes, known.primitives, known.scores
        else:
            recording = load_recording(path)
            here, size, primitives, scores = True, path.stat().st_size, len(recording.action), recording.about["scores"]
        rows.append({"name": spec.name, "primitives": primitives, "here": here, "bytes": size,
                     "mean_return": scores.get("mean_return"), "escapes": scores.get("escapes"),
                     "what": RECORDING_KINDS[spec.kind]})
    if args.json:
        print(json.dumps(rows, indent=2))
        return
    table = Table("data set", "primitives", "bytes", "here", "return", "escapes", box=None, pad_edge=False)
    for row in rows:
        reached = ("-", "-") if row["mean_return"] is None else (f"{row['mean_return']:.1f}", f"{row['escapes']:.2f}")
        table.add_row(row["name"], f"{row['primitives']:,}", f"{row['bytes']:,}", "yes" if row["here"] else "no",
                      *reached)
    console = Console(width=120, highlight=False)
    console.print(table)
    for kind, what in RECORDING_KINDS.items():
        console.print(f"{kind}: {what}", markup=False)
    console.print("Names with 1m or 10m before v1 hold ten or a hundred times as much; to record one: "
                  "hrl-escape data make NAME")


@dataclasses.dataclass(frozen=True)
class MakeArgs:
    """Options of `hrl-escape data make`."""

    names: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Data sets of the catalogue, see `hrl-escape data list`; with --played the name of the new one."""
    out: Path = FOLDER
    """Folder of the recordings; `train --data NAME` looks into `data`."""
    primitives: int | None = None
    """Number of primitives of a trial; by default the number of the name."""
    room: str | None = None
    """With --played: rooms of the episodes, such as paper-two-button or ladder-1/pair/train#0..4."""
    played: tuple[Path, ...] = ()
    """Episodes saved by `hrl-escape play`, for a data set of your own play."""
    quiet: bool = False
    """Show no progress line."""

    @classmethod
    def check_words(cls, command: Sequence[str], words: Sequence[str]) -> None:
        """Refuse --rooms, the name of --room in 0.3."""
        refuse_rooms(words)


def run_make(args: MakeArgs) -> None:
    """Record data sets of six kinds of behaviour in the training rooms of a rung, or make one from your own play.

    The kinds are play, noisy, expert, medium, stitch and explore. A recording of 10^5 primitives takes ten seconds to a
    minute and 20 to 120 kB, and replays exactly. A stopped recording resumes. A full-size recording is compared with
    the published one. If it differs, it is written as NAME.other.npz and the command fails, except for medium, whose
    network depends on processor and torch version.

    Examples:
        hrl-escape data make pair-play-1m-v1
        hrl-escape data make lattice-play-v1 lattice-expert-v1 --out data
        hrl-escape data make mine --room paper-two-button --played episodes/*.json
    """
    from hrl_escape.data.record import make_played_recording, record  # loads torch
    from hrl_escape.data.recording import load_recording, save_recording

    console = Console(soft_wrap=True, highlight=False)
    if args.played or args.room:
        if len(args.names) != 1 or not (args.played and args.room):
            raise ConfigError("names", args.names, "one name, with both --room and --played")
        name = make_file_name(args.names[0])
        recording = make_played_recording(name, args.room, args.played)
        save_recording(args.out / f"{name}.npz", recording)
        console.print(f"{recording}; wrote {args.out / f'{name}.npz'}", markup=False)
        return
    if not args.names:
        raise ConfigError("names", "none", "at least one data set of `hrl-escape data list`")
    if args.primitives is not None and args.primitives < 1:
        raise ConfigError("--primitives", args.primitives, "at least 1")
    refused: list[str] = []
    for spec in [parse_spec(name) for name in args.names]:
        path = args.out / f"{spec.name}.npz"
        try:
            recording = load_recording(path) if path.is_file() else record(
                spec, path, primitives=args.primitives, progress=False if args.quiet else None)
            found = compare_published(spec.name, recording)
            if not (args.primitives or found.fits):
                raise refuse_other(spec.name, found, path)
        except VerificationError as error:
            refused.append(str(error))
        else:
            told = "" if args.primitives else f"; {found.words}"
            console.print(f"{recording}; {path}, {path.stat().st_size:,} bytes{told}", markup=False)
    if refused:
        raise VerificationError("; ".join(refused))


@dataclasses.dataclass(frozen=True)
class DataShowArgs:
    """Options of `hrl-escape data show`."""

    name: Annotated[str, tyro.conf.Positional]
    """Data set, or the path of a recording."""
    draw: Path | None = None
    """Draw its first episodes and its durations into this file: png, svg or pdf."""
    json: bool = False
    """Print JSON."""


def run_show(args: DataShowArgs) -> None:
    """Show the card of a data set: origin, size, scores with references, and optionally a picture.

    Examples:
        hrl-escape data show pair-play-v1
        hrl-escape data show lattice-expert-v1 --draw card.png
    """
    from hrl_escape.data.card import describe, describe_unrecorded, save_card  # loads torch and matplotlib
    from hrl_escape.data.recording import load_recording

    try:
        path = find_recording(args.name)
    except FileReadError:
        known = read_published().get(args.name)
        if known is None or args.draw is not None:
            raise
        card = {**describe_unrecorded(parse_spec(args.name), known), "bytes": known.bytes,
                "recorded": f"not here: hrl-escape data make {args.name}"}
    else:
        recording = load_recording(path)
        card = {**describe(recording), "bytes": path.stat().st_size, "recorded": str(path)}
        if args.draw is not None:
            save_card(args.draw, recording)
    if args.json:
        print(json.dumps(card, indent=2))
        return
    console = Console(soft_wrap=True, highlight=False)
    for name, value in card.items():
        if value is not None:
            console.print(f"[bold]{name.replace('_', ' ')}[/bold]", end=": ")
            console.print(str(value), markup=False)
    if args.draw is not None:
        console.print(f"wrote {args.draw}", markup=False)
