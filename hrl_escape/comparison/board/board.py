"""Boards: records of submissions that were verified, and the page that they make."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, PackageLoader

from hrl_escape.comparison.board.submission import Cell, Submission, find_rung, score_cells
from hrl_escape.comparison.inference import Estimate
from hrl_escape.comparison.references.registry import BAYES, FLOORS, REFERENCES
from hrl_escape.errors import EscapeError, FileReadError, describe_damage
from hrl_escape.files import read_json, write_json
from hrl_escape.ladder.rung import Rung
from hrl_escape.settings import read_record


class Row(NamedTuple):
    """Row of a rung's table."""

    name: str  # of the agent, as Markdown
    cells: tuple[str, ...]  # further columns, as Markdown
    score: Estimate  # efficiency in the test rooms
    agent: str  # name of the package's agent or reference; empty for a program


@dataclasses.dataclass(frozen=True)
class Check:
    """Verification of a submission: rooms played again, the seed that drew them, and the package's version."""

    cells: int
    seed: int
    version: str


@dataclasses.dataclass(frozen=True)
class Record:
    """A submission without its agent's files, and how it was verified."""

    submission: Submission
    check: Check

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        value = {"submission": self.submission.to_json(), "check": dataclasses.asdict(self.check)}
        write_json(path, value, indent=None)


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


def describe_score(submission: Submission, rung: Rung) -> str:
    """Words on a submission's efficiency and escapes."""
    words = []
    for role in ("test", "hidden"):
        cells = [cell for cell in submission.cells if cell.set == role]
        if cells:
            score = score_cells(cells, rung.config.dynamics.is_random)
            words.append(f"efficiency {_format(score)} in {len(cells)} {role} rooms, "
                         f"{sum(cell.escaped for cell in cells)} escapes")
    return "; ".join(words)


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
    template = Environment(loader=PackageLoader("hrl_escape.comparison.board", "."), trim_blocks=True,
                           keep_trailing_newline=True).get_template("board.md.j2")
    page = template.render(rungs=tables, findings={name: conclude(rows) for name, rows in tables.items()})
    return page, left_out


def conclude(rows: Sequence[Row]) -> str:
    """Sentence on a rung: whether its best agent is shown to be better than the best searcher that learns nothing."""
    floors = [row for row in rows if row.agent in FLOORS]
    others = [row for row in rows if row.agent not in REFERENCES]
    if not floors or not others:
        return "No agent stands beside a searcher that learns nothing yet."
    floor, best = (max(some, key=lambda row: row.score.value) for some in (floors, others))
    ceiling = [row.score.value for row in rows if row.agent == BAYES]
    bar = f"{floor.score.value:.2f} of {floor.name}, which learns nothing"
    words = (f"{best.name} beats the {bar}: {_format(best.score)}" if best.score.low > floor.score.value else
             f"No agent is shown to beat the {bar}; the best, {best.name}, has {_format(best.score)}")
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
    cells = (_escape(", ".join(card.authors)), _format(test), "" if hidden is None else _format(hidden),
             f"{sum(cell.escaped for cell in sets['test'])} of {len(sets['test'])}", cost, hours,
             _escape(str(card.view)), _escape(card.told), f"{record.check.cells} of {len(submission.cells)}",
             submission.agent_digest[:12])
    return Row(f"[{name}]({card.link})" if card.link else name, cells, test, submission.entry.agent)


def _format(score: Estimate) -> str:
    return f"{score.value:.3f} ({score.low:.3f} to {score.high:.3f})"


def _escape(text: str) -> str:
    """Text of a stranger as Markdown that shows it letter by letter."""
    return re.sub(r"[^\w ,.()/+:;-]|_", lambda sign: f"&#{ord(sign[0])};", text)
