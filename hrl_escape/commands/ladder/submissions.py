"""Commands on submissions: agents of one's own, tested in a rung's rooms."""

from __future__ import annotations

import dataclasses
import secrets
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from hrl_escape.agents.training.archive import making_folder
from hrl_escape.files import read_toml, write_bytes
from hrl_escape.names import count_nouns, make_console_text

if TYPE_CHECKING:
    from hrl_escape.benchmark.submission import Cell, CheckedCell


@dataclasses.dataclass(frozen=True)
class StartArgs:
    """Options of `hrl-escape ladder start`."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder to make."""


def run_start(args: StartArgs) -> None:
    """Write a folder with a program that plays rooms, and its card: a start for an agent of your own on a board.

    Example:
        hrl-escape ladder start my-agent
    """
    starter = files("hrl_escape.benchmark") / "starter"
    with making_folder(args.folder) as made:
        for name in ("agent.py", "card.toml"):
            source = starter / (name + ".txt" * name.endswith(".py"))
            write_bytes(made / name, source.read_bytes())
    print(f"wrote {args.folder}: agent.py and card.toml")


@dataclasses.dataclass(frozen=True)
class SubmitArgs:
    """Options of `hrl-escape ladder submit`."""

    source: Annotated[str, tyro.conf.Positional] = ""
    """Folder of a training run, or a reference; nothing for the program that the card names."""
    card: Path = Path("card.toml")
    """Card of the agent; the files of a program stand beside it."""
    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""
    rung: str = "chain-3"
    """Rung in whose test rooms it is tested."""
    rooms: int | None = None
    """Test rooms, from the first; all by default, which a board asks for."""
    beacon: str = ""
    """Round of drand's quicknet that the benchmark has announced, and its value: test in hidden rooms, too."""
    out: Path = Path("submission.zip")
    """File to write."""


def run_submit(args: SubmitArgs) -> None:
    """Test a frozen agent in every test room of a rung, and pack card, results and agent into one file for a board.

    The agent is a training run's, a reference such as search-nearest, or any program: the card then says which
    command starts it, in a process of its own that reads observations and masks and writes actions. `hrl-escape ladder
    start` writes a program and its card to begin with.

    Examples:
        hrl-escape ladder submit --card my-agent/card.toml --benchmark marks-1 --rung told --out mine.zip
        hrl-escape ladder submit runs/mine --card card.toml --rung chain-3 --out mine.zip
        hrl-escape ladder submit search-nearest --card card.toml --rung chain-3 --rooms 2 --out search.zip
    """
    from hrl_escape.benchmark.submission import (  # loads what plays
        Card,
        describe_command,
        describe_score,
        pack_submission,
    )
    from hrl_escape.sets.benchmark import load_benchmark

    console, card = Console(soft_wrap=True, highlight=False), Card.from_dict(read_toml(args.card, "card of an agent"))
    rung = load_benchmark(args.benchmark)[args.rung]
    if card.command:
        console.print(f"starts {make_console_text(describe_command(card), 600)}")
    made = pack_submission(args.out, rung, card, args.source, args.card.parent, args.rooms, args.beacon)
    console.print(f"{make_console_text(card.name)} on {rung.benchmark}/{rung.name}: {describe_score(made, rung)}")
    console.print(f"wrote {make_console_text(str(args.out))}; the agent's SHA-256 is {made.agent_digest}")


@dataclasses.dataclass(frozen=True)
class VerifySubmissionArgs:
    """Options of `hrl-escape ladder verify-submission`."""

    file: Annotated[Path, tyro.conf.Positional]
    """Archive that `hrl-escape ladder submit` wrote."""
    cells: int = 5
    """Rooms to play again."""
    seed: int | None = None
    """Seed of the draw; a new one by default."""
    trust: bool = False
    """Start the program of an agent that is not of this package; it may do anything on this machine."""
    benchmark: str = ""
    """Manifest file of a benchmark that does not come with the package."""
    record: Path | None = None
    """JSON file to write, for a board, if all rooms are equal."""


def run_verify_submission(args: VerifySubmissionArgs) -> int:
    """Play some rooms of a submission again, and say for each whether the result is equal, bit for bit.

    Agents of this package are loaded as data. Any other agent is a program: what would be started is said first, and
    only --trust starts it. The rooms are drawn from a seed that is printed, a new one each time, so that nobody who
    submits can know it; --seed draws the same rooms again. The exit code is 1 if a room differs.

    Examples:
        hrl-escape ladder verify-submission mine.zip
        hrl-escape ladder verify-submission mine.zip --cells 64 --trust --record docs/board/mine.json
    """
    from hrl_escape.benchmark.submission import (  # loads what plays
        Check,
        Record,
        describe_command,
        describe_package,
        describe_score,
        find_rung,
        read_submission,
        verify_cells,
    )

    console = Console(soft_wrap=True, highlight=False)
    submission = read_submission(args.file)
    rung, card = find_rung(submission.entry, args.benchmark), submission.entry.card
    console.print(f"{make_console_text(card.name)} on {rung.benchmark}/{rung.name}: {describe_score(submission, rung)}")
    package = describe_package()
    if submission.entry.package != package:
        console.print("made with another version of hrl-escape or of its libraries than this, so results may differ")
    if card.command:
        console.print(f"{'starts' if args.trust else 'would start'} {make_console_text(describe_command(card), 600)}")
    seed = secrets.randbelow(2**31) if args.seed is None else args.seed
    checked = verify_cells(args.file, rung, args.cells, seed, args.trust)
    for each in checked:
        console.print(f"{each.stated.set} room {each.stated.room}: {_describe(each)}")
    equal = sum(each.is_equal for each in checked)
    console.print(f"{equal} of {count_nouns(len(checked), 'room')} equal, drawn by --seed {seed}")
    if equal == len(checked) and args.record is not None:
        Record(submission, Check(len(checked), seed, package["version"])).save(args.record)
        console.print(f"wrote {make_console_text(str(args.record))}")
    return int(equal < len(checked))


def _describe(each: CheckedCell) -> str:
    return f"equal: {_tell(each.stated)}" if each.is_equal else (
        f"DIFFERS: stated {_tell(each.stated)}; found {_tell(each.found)}")


def _tell(cell: Cell) -> str:
    return (f"{'escaped' if cell.escaped else 'no escape'} in {cell.primitives} primitives, {cell.decisions} decisions,"
            f" return {cell.total:g}, fewest known {cell.fewest:g}")
