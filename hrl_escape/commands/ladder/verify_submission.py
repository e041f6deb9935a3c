"""Play some rooms of a submission again, and say for each whether the result is equal, bit for bit.

Agents of this package are loaded as data. Any other agent is a program: what would be started is said first, and only
--trust starts it. The rooms are drawn from a seed that is printed, a new one each time, so that whoever submits cannot
know it; --seed draws the same rooms again. The exit code is 1 if a room differs.

Examples:
    hrl-escape ladder verify-submission mine.zip
    hrl-escape ladder verify-submission mine.zip --cells 64 --trust --record docs/board/mine.json
"""

from __future__ import annotations

import dataclasses
import secrets
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.comparison.submission import (
    Cell,
    Check,
    CheckedCell,
    Record,
    describe_command,
    describe_package,
    describe_score,
    find_rung,
    read_submission,
    verify_cells,
)
from hrl_escape.names import count_nouns, make_console_text


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


def run(args: VerifySubmissionArgs) -> int:
    """Print a line a room; the exit code is 1 if one differs."""
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
