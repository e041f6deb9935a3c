"""Results of a study: a file that only grows, one line of JSON a run, small enough to come with the source.

The first line holds the version of the labels of agents; a file of version 0.3 has none and is refused. A run that was
made again gets a new line, which counts in place of the one before. Processes take turns, so that none loses the lines
of another.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Hashable, Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar

from hrl_escape.errors import EscapeError, FileReadError, describe_damage
from hrl_escape.files import read_text, write_text
from hrl_escape.processes import taking_turns
from hrl_escape.settings import read_record

__all__ = ["HEADER", "Line", "Store", "read_rows"]

HEADER = '{"format":2}'
"""First line of a file of results."""


@dataclasses.dataclass(frozen=True)
class Line:
    """Base of lines: frozen dataclasses of plain values."""

    PLACE: ClassVar[tuple[str, ...]] = ()
    """Attributes that are the subject of a line: a later one about the same counts in its place."""

    @property
    def place(self) -> tuple[Any, ...]:
        """Values of these attributes."""
        return tuple(getattr(self, name) for name in self.PLACE)


def read_rows(path: Path) -> list[str]:
    """Lines of a file of results, each a JSON value, without the header.

    Raises:
        FileReadError: it cannot be read, or is of version 0.3.
    """
    header, *rows = read_text(path, "file of results").splitlines() or [""]
    if header != HEADER:
        raise FileReadError(f"{path}: the first line is not {HEADER}, so its agents can be of version 0.3, where "
                            "smdp-dqn also chose primitives. Begin another file")
    return rows


class Store:
    """The file of a study's results.

    Args:
        path: of the file; it need not exist.
        kinds: classes of its lines, distinguished by their fields.
    """

    def __init__(self, path: Path, kinds: Sequence[type[Line]]) -> None:
        self.path = path
        self._kinds = tuple(kinds)

    def load(self) -> list[Any]:
        """Lines in the order of first appearance of their subjects; none without a file.

        Raises:
            FileReadError: a line is damaged; the message has its number.
        """
        return list(self._load().values())

    def add(self, lines: Iterable[Line]) -> None:
        """Append the lines that are not there yet.

        Raises:
            FileReadError: the file is damaged; it stays as it is.
            FileWriteError: it cannot be written.
        """
        with taking_turns(self.path.parent):
            there = self._load()
            new = [line for line in lines if there.get((type(line), line.place)) != line]
            if new:
                rows = [json.dumps(dataclasses.asdict(line), separators=(",", ":"), allow_nan=False) for line in new]
                text = read_text(self.path) if self.path.exists() else HEADER
                write_text(self.path, "\n".join([*text.splitlines(), *rows, ""]))

    def _load(self) -> dict[tuple[type[Line], Hashable], Line]:
        found: dict[tuple[type[Line], Hashable], Line] = {}
        rows = read_rows(self.path) if self.path.exists() else []
        for number, row in enumerate(rows, 2):
            try:
                line = self._read(json.loads(row))
            except (EscapeError, TypeError, ValueError) as error:
                raise FileReadError(f"{self.path}, line {number}: this is no result of the study "
                                    f"({describe_damage(error)})") from error
            found[type(line), line.place] = line
        return found

    def _read(self, fields: Any) -> Line:
        """A line of the kind whose fields these are."""
        for kind in self._kinds:
            every = dataclasses.fields(kind)
            required = {field.name for field in every if field.default is dataclasses.MISSING}
            if isinstance(fields, dict) and required <= fields.keys() <= {field.name for field in every}:
                return read_record(kind, fields)
        return read_record(self._kinds[0], fields)
