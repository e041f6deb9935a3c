"""The gallery's words on each puzzle: its rules, how exact it is, and which published numbers carry over."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from hrl_escape.files import read_toml

__all__ = ["EXACTNESS", "Entry", "load_entries"]

EXACTNESS = {
    "L1": "an action of the domain is a primitive: states, rewards and ends are equal after each",
    "L2": "an action of the domain is an option: the puzzle is in the domain's state after each, from any pose",
    "L3": "the structure is that of the domain, and no number is",
    "own": "the paper's puzzle, or one of this project",
}
"""Meaning of each level, by its name: how exactly a puzzle is a published domain."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """A puzzle of the gallery.

    Attributes:
        preset: name of its room.
        title: heading.
        rules: three sentences.
        level: how exactly it is the published domain, of `EXACTNESS`.
        carries: published numbers that hold in the room.
        carries_not: those that do not, and why.
        optimum: the best that can be done; `{fewest}` stands for the fewest operators, which are measured, and
            `{expected}` for their mean number where a press may do nothing.
    """

    preset: str
    title: str
    rules: str
    level: str
    carries: str
    carries_not: str
    optimum: str

    @property
    def name(self) -> str:
        """The title without its source."""
        return self.title.split(" (")[0].split(", after")[0]


def load_entries() -> tuple[Entry, ...]:
    """Read `entries.toml`, in the order of the page."""
    return tuple(Entry(**fields) for fields in read_toml(Path(__file__).with_name("entries.toml"))["puzzle"])
