"""Write the page of a board from its records, which `hrl-escape ladder verify-submission --record` makes.

Example:
    hrl-escape ladder board docs/board --out docs/board.md
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from hrl_escape.comparison.board.board import read_records, write_page
from hrl_escape.files import write_text
from hrl_escape.names import count_nouns, make_console_text


@dataclasses.dataclass(frozen=True)
class BoardArgs:
    """Options of `hrl-escape ladder board`."""

    folder: Annotated[Path, tyro.conf.Positional] = Path("docs/board")
    """Folder of records."""
    out: Path = Path("docs/board.md")
    """Page to write."""


def run(args: BoardArgs) -> None:
    """Write the page; agents that were not tested in every room are named and left out."""
    console, records = Console(soft_wrap=True, highlight=False), read_records(args.folder)
    page, left_out = write_page(records)
    for name in left_out:
        console.print(f"left out, as it was not tested in every room: {make_console_text(name)}")
    write_text(args.out, page)
    console.print(f"wrote {make_console_text(str(args.out))}: {count_nouns(len(records) - len(left_out), 'agent')}")
