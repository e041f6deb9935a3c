"""Code blocks of Markdown pages, and how tests run them.

A comment right above a block says where tests do something else than run it as it stands:
`<!-- tests: parse only -->`, or `<!-- tests: 20_000 -> 500 -->` for a replacement. Pages of results are written by
studies that run for hours; their commands are parsed only.
"""

from __future__ import annotations

import re
import shlex
import typing
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import tyro

from hrl_escape.cli import find_commands

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "examples/README.md", *ROOT.glob("docs/**/*.md")])
BLOCK = re.compile(r"^(?:<!-- tests: (?P<note>.+?) -->\n)?```(?P<language>\w+)\n(?P<text>.*?)^```$", re.M | re.S)


class Block(NamedTuple):
    """A block that tests run."""

    page: Path
    language: str
    text: str
    is_parsed_only: bool


def read_blocks(page: Path) -> list[Block]:
    """The blocks of a page, in order, with replacements made."""
    found = []
    for match in BLOCK.finditer(page.read_text(encoding="utf-8")):
        note, text = match["note"] or "", match["text"]
        if note and note != "parse only":
            for change in note.split(", "):
                old, new = change.split(" -> ")
                assert old in text, f"{page}: {old!r} is not in the block that it is to be replaced in"
                text = text.replace(old, new)
        is_parsed_only = note == "parse only" or page.parent == ROOT / "docs/results"
        found.append(Block(page, match["language"], text, is_parsed_only))
    return found


def read_commands(block: Block) -> list[list[str]]:
    """The command lines of a console block, without comments; `a && b` are two."""
    lines = block.text.replace("\\\n", " ").replace(" && ", "\n").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def parse(arguments: Sequence[str]) -> None:
    """Parse `hrl-escape ARGUMENTS` as the command line would, without running it. Raises SystemExit if wrong."""
    if "--help" in arguments:
        return
    place, function, words = ROOT / "hrl_escape/commands", "", list(arguments)
    while not function:
        place, function = find_commands(place)[words.pop(0)]
    parse_options(".".join(place.relative_to(ROOT).with_suffix("").parts), words, function)


def parse_options(module: str, words: Sequence[str], function: str = "run") -> None:
    """Parse the options of a module's function, without running it. Raises SystemExit if wrong."""
    if hasattr(found := import_module(module), "__path__"):  # a package that runs by its `__main__`
        found = import_module(f"{module}.__main__")
    options = typing.get_type_hints(getattr(found, function))["args"]
    tyro.cli(options, args=words, config=(tyro.conf.FlagCreatePairsOff,))
