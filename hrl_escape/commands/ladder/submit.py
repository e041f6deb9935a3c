"""Test a frozen agent in every test room of a rung, and pack card, results and agent into one file for a board.

The agent is a training run's, a reference such as smdp-untried-nearest, or any program: the card then says which
command starts it, in a process of its own that reads observations and masks and writes actions. `hrl-escape ladder
start` writes a program and its card to begin with.

Examples:
    hrl-escape ladder submit --card my-agent/card.toml --benchmark marks-1 --rung told --out mine.zip
    hrl-escape ladder submit runs/mine --card card.toml --rung chain-3 --out mine.zip
    hrl-escape ladder submit smdp-untried-nearest --card card.toml --rung chain-3 --rooms 2 --out searcher.zip
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.comparison.submission import Card, describe_command, describe_score, pack_submission
from hrl_escape.files import read_toml
from hrl_escape.ladder.benchmark import load_benchmark
from hrl_escape.names import make_console_text


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


def run(args: SubmitArgs) -> None:
    """Test, pack, and print the score and the hash of the frozen agent."""
    console, card = Console(soft_wrap=True, highlight=False), Card.from_dict(read_toml(args.card, "card of an agent"))
    rung = load_benchmark(args.benchmark)[args.rung]
    if card.command:
        console.print(f"starts {make_console_text(describe_command(card), 600)}")
    made = pack_submission(args.out, rung, card, args.source, args.card.parent, args.rooms, args.beacon)
    console.print(f"{make_console_text(card.name)} on {rung.benchmark}/{rung.name}: {describe_score(made, rung)}")
    console.print(f"wrote {make_console_text(str(args.out))}; the agent's SHA-256 is {made.agent_digest}")
