"""Write a folder with a program that plays rooms, and its card: a start for an agent of your own on a board.

Example:
    hrl-escape ladder start my-agent
"""

from __future__ import annotations

import dataclasses
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import tyro

from hrl_escape.agents.training.archive import making_folder
from hrl_escape.files import write_bytes


@dataclasses.dataclass(frozen=True)
class StartArgs:
    """Options of `hrl-escape ladder start`."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder to make."""


def run(args: StartArgs) -> None:
    """Write the folder; nothing that is there is written over."""
    starter = files("hrl_escape.comparison") / "starter"
    with making_folder(args.folder) as made:
        for name in ("agent.py", "card.toml"):
            source = starter / (name + ".txt" * name.endswith(".py"))
            write_bytes(made / name, source.read_bytes())
    print(f"wrote {args.folder}: agent.py and card.toml")
