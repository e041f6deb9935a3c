"""Leaderboard: make a result file, check one by replay, write the page.

    python -m benchmarks.leaderboard run search-nearest --card card.toml --rung colours --out new.json
    python -m benchmarks.leaderboard check new.json
    python -m benchmarks.leaderboard page

A card is a TOML file such as `benchmarks/leaderboard/starter/card.toml`. `run` takes a reference, the folder of a
program, or the folder of a training run, which it also archives. `check` exits with 1 if a room differs.
"""

from __future__ import annotations

import dataclasses
import secrets
import shutil
import sys
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from benchmarks.leaderboard.page import RESULTS, make_page, read_rows, summarise
from benchmarks.leaderboard.results import Result, check, load, make, pack
from hrl_escape.benchmark.agent_archive import RoomResult, describe_score, find_rung
from hrl_escape.cli import run_script
from hrl_escape.files import read_toml
from hrl_escape.names import count_nouns, make_console_text
from hrl_escape.sets.benchmark import load_benchmark
from studies.publishing import publish


@dataclasses.dataclass(frozen=True)
class Run:
    """Options of `run`."""

    source: Annotated[str, tyro.conf.Positional]
    """Name of a reference, folder of a program, or folder of a training run."""
    card: Path = Path("card.toml")
    """Card of the agent."""
    benchmark: str = "cues-1@0"
    """Benchmark that comes with the package, or a manifest file."""
    rung: str = "colours"
    """Rung whose test rooms the agent plays."""
    rooms: int | None = None
    """Test rooms, from the first; all by default, as the page requires."""
    out: Path = RESULTS / "mine.json"
    """Result file to write."""


@dataclasses.dataclass(frozen=True)
class Check:
    """Options of `check`."""

    file: Annotated[Path, tyro.conf.Positional]
    """Result file."""
    rooms: int = 5
    """Rooms to replay."""
    seed: int | None = None
    """Seed of the draw of rooms; a new one by default."""
    agent: Path | None = None
    """Archive of the agent, if neither the package nor the folder of the file has it."""
    trust: bool = False
    """Start the program of the result; read it before."""
    benchmark: str = ""
    """Manifest file of a benchmark that does not come with the package."""


@dataclasses.dataclass(frozen=True)
class Page:
    """Options of `page`."""

    docs: Path = Path("docs/results")
    """Folder that takes the page and its figure."""


def run(args: Run | Check | Page) -> int:
    """Make or check a result file, or write the page."""
    console = Console(soft_wrap=True, highlight=False)
    if isinstance(args, Page):
        page = make_page()
        publish(page, args.docs, {"leaderboard": summarise(read_rows(RESULTS))})
        console.print(f"wrote {make_console_text(str(args.docs / page.name))}.md")
        return 0
    return _make(args, console) if isinstance(args, Run) else _check(args, console)


def _make(args: Run, console: Console) -> int:
    rung, card = load_benchmark(args.benchmark)[args.rung], read_toml(args.card, "card of an agent")
    if (Path(args.source) / "run.json").exists():
        packed = pack(args.out.with_suffix(".zip"), rung, card, Path(args.source), args.rooms)
        made = Result(packed.card, packed.results)
    else:
        made = make(rung, card, args.source, args.rooms)
        if made.command and Path(args.source).absolute() != args.out.with_suffix("").absolute():
            shutil.copytree(args.source, args.out.with_suffix(""), dirs_exist_ok=True)
    made.save(args.out)
    console.print(f"{make_console_text(made.card.name)} on {rung.benchmark}/{rung.name}: "
                  f"{describe_score(made.results, rung)}")
    console.print(f"wrote {make_console_text(str(args.out))}")
    return 0


def _check(args: Check, console: Console) -> int:
    found = load(args.file)
    rung = find_rung(found.card, args.benchmark)
    console.print(f"{make_console_text(found.card.name)} on {rung.benchmark}/{rung.name}: "
                  f"{describe_score(found.results, rung)}")
    seed = secrets.randbelow(2**31) if args.seed is None else args.seed
    checked = check(args.file, args.rooms, seed, args.agent, args.trust, args.benchmark)
    for each in checked:
        words = f"equal, {_describe(each.stated)}" if each.is_equal else (
            f"DIFFERS, stated {_describe(each.stated)}, found {_describe(each.found)}")
        console.print(f"room {each.stated.room}: {words}")
    equal = sum(each.is_equal for each in checked)
    console.print(f"{equal} of {count_nouns(len(checked), 'room')} equal, drawn by --seed {seed}")
    return int(equal < len(checked))


def _describe(result: RoomResult) -> str:
    return (f"{'success' if result.escaped else 'no success'} in {result.primitives} primitives, {result.decisions} "
            f"decisions, return {result.total:g}, fewest known {result.fewest:g}")


if __name__ == "__main__":
    sys.exit(run_script(run))
