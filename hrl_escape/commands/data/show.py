"""Show the card of a data set: what it is, how it was made, its scores and their references, and a picture if asked.

Examples:
    hrl-escape data show pair-play-v1
    hrl-escape data show lattice-expert-v1 --draw card.png
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.data.card import describe, save_card
from hrl_escape.data.catalogue import find_tape
from hrl_escape.data.tape import load_tape


@dataclasses.dataclass(frozen=True)
class DataShowArgs:
    """Options of `hrl-escape data show`."""

    name: Annotated[str, tyro.conf.Positional]
    """Data set, or the path of a tape."""
    draw: Path | None = None
    """Draw its first episodes and its durations into this file: png, svg or pdf."""
    json: bool = False
    """Print JSON."""


def run(args: DataShowArgs) -> None:
    """Print the card."""
    tape = load_tape(find_tape(args.name))
    if args.draw is not None:
        save_card(args.draw, tape)
    card = describe(tape)
    if args.json:
        print(json.dumps(card, indent=2))
        return
    console = Console(soft_wrap=True, highlight=False)
    for name, value in card.items():
        console.print(f"[bold]{name.replace('_', ' ')}[/bold]", end=": ")
        console.print(str(value), markup=False)
    if args.draw is not None:
        console.print(f"wrote {args.draw}", markup=False)
