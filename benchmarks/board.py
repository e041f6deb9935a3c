"""Write the page of a board from its records, which `hrl-escape ladder verify-submission --record` makes.

python -m benchmarks.board docs/board --out docs/board.md
"""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import jinja2
import tyro
from rich.console import Console

from hrl_escape.agents.spec import BAYES, REFERENCES
from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.references.registry import BY_LIGHTS
from hrl_escape.benchmark.submission import (
    Cell,
    Check,
    Record,
    Submission,
    find_rung,
    score_cells,
)
from hrl_escape.cli import run_script
from hrl_escape.errors import EscapeError, FileReadError, describe_damage
from hrl_escape.files import read_json, write_text
from hrl_escape.names import count_nouns, make_console_text
from hrl_escape.sets.rung import Rung
from hrl_escape.settings import read_record


@dataclasses.dataclass(frozen=True)
class Board:
    """Options of the page."""

    folder: Annotated[Path, tyro.conf.Positional] = Path("docs/board")
    """Folder of records."""
    out: Path = Path("docs/board.md")
    """Page to write."""


def run(args: Board) -> None:
    """Write the page; agents that were not tested in every room are named and left out."""
    console, records = Console(soft_wrap=True, highlight=False), read_records(args.folder)
    page, left_out = write_page(records)
    for name in left_out:
        console.print(f"left out, as it was not tested in every room: {make_console_text(name)}")
    write_text(args.out, page)
    console.print(f"wrote {make_console_text(str(args.out))}: {count_nouns(len(records) - len(left_out), 'agent')}")


class Row(NamedTuple):
    """Row of a rung's table."""

    name: str  # of the agent, as Markdown
    cells: tuple[str, ...]  # further columns, as Markdown
    score: Estimate  # efficiency in the test rooms
    agent: str  # name of the package's agent or reference; empty for a program


def read_records(folder: Path) -> list[Record]:
    """Records of a folder, in the order of their files' names; a damaged one is a `FileReadError`."""
    found = []
    for path in sorted(folder.glob("*.json")):
        value = read_json(path, "record of a board")
        try:
            found.append(Record(Submission.from_json(value["submission"]), read_record(Check, value["check"])))
        except (EscapeError, KeyError, TypeError) as error:
            raise FileReadError(f"{path}: this is no record of a board ({describe_damage(error)})") from error
    return found


def write_page(records: Sequence[Record]) -> tuple[str, list[str]]:
    """Markdown of a board's page, and names of agents left out because they were not tested in every room."""
    rungs: dict[str, list[Row]] = {}
    left_out = []
    for record in records:
        entry = record.submission.entry
        rung = find_rung(entry)
        if entry.rooms < rung.record.test.count:
            left_out.append(entry.card.name)
        else:
            rungs.setdefault(f"{entry.benchmark}/{entry.rung}", []).append(_make_row(record, rung))
    tables = {name: sorted(rows, key=lambda row: (-row.score.value, row.name)) for name, rows in sorted(rungs.items())}
    template = jinja2.Environment(loader=jinja2.FileSystemLoader(Path(__file__).parent), trim_blocks=True,
                                  keep_trailing_newline=True).get_template("board.md.j2")
    page = template.render(rungs=tables, findings={name: conclude(rows) for name, rows in tables.items()})
    return page, left_out


def conclude(rows: Sequence[Row]) -> str:
    """Sentence on a rung: whether its best agent is shown to be better than the best search baseline."""
    floors = [row for row in rows if row.agent in BY_LIGHTS]
    others = [row for row in rows if row.agent not in REFERENCES]
    if not floors or not others:
        return "No search baseline was run yet."
    floor, best = (max(some, key=lambda row: row.score.value) for some in (floors, others))
    ceiling = [row.score.value for row in rows if row.agent == BAYES]
    bar = f"{floor.score.value:.2f} of {floor.name}, which learns nothing"
    words = (f"{best.name} beats the {bar}: {best.score:.3f}" if best.score.low > floor.score.value else
             f"No agent is shown to beat the {bar}; the best, {best.name}, has {best.score:.3f}")
    return f"{words}{f'; {BAYES}, which knows how rooms are drawn, has {ceiling[0]:.2f}' if ceiling else ''}."


def _make_row(record: Record, rung: Rung) -> Row:
    submission, card = record.submission, record.submission.entry.card
    sets: dict[str, list[Cell]] = {"test": [], "hidden": []}
    for cell in submission.cells:
        sets[cell.set].append(cell)
    test, hidden = (score_cells(cells, rung.config.dynamics.is_random) if cells else None for cells in sets.values())
    assert test is not None  # a submission has a test room at least
    name = _escape(card.name)
    cost = "" if card.primitives is None else f"{card.primitives:,}"
    hours = "" if card.core_hours is None else f"{card.core_hours:.2g}"
    cells = (_escape(", ".join(card.authors)), f"{test:.3f}", "" if hidden is None else f"{hidden:.3f}",
             f"{sum(cell.escaped for cell in sets['test'])} of {len(sets['test'])}", cost, hours,
             _escape(str(card.view)), _escape(card.told), f"{record.check.cells} of {len(submission.cells)}",
             submission.agent_digest[:12])
    return Row(f"[{name}]({card.link})" if card.link else name, cells, test, submission.entry.agent)


def _escape(text: str) -> str:
    """Text of a stranger as Markdown that shows it letter by letter."""
    return re.sub(r"[^\w ,.()/+:;-]|_", lambda sign: f"&#{ord(sign[0])};", text)


if __name__ == "__main__":
    sys.exit(run_script(run))
