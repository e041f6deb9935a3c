"""Boards: the page is what its records say, of any truth, and shows the words of strangers letter by letter."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from benchmarks.board import Row, conclude, read_records, write_page
from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.submission import Check, Record, find_rung, read_submission, verify_cells
from hrl_escape.errors import FileReadError
from tests.command_line import call_script

ROOT = Path(__file__).parents[2]
BOARD = ROOT / "docs/board"


def make_row(name: str, value: float, agent: str = "", reach: float = 0.05) -> Row:
    return Row(name, (), Estimate(value, value - reach, value + reach), agent)


def test_the_page_is_what_the_command_makes(tmp_path, capsys):
    code, out, _ = call_script(capsys, "benchmarks.board", BOARD, "--out", tmp_path / "board.md")
    assert code == 0 and (tmp_path / "board.md").read_text() == (ROOT / "docs/board.md").read_text()
    assert "left out" not in out


def test_the_sentence_of_a_rung_follows_its_rows():
    floor, ceiling = make_row("nearest", 0.7, "search-nearest"), make_row("bayes", 0.98, "bayes")
    lower = make_row("dark", 0.5, "search-random")
    rows = [floor, lower, ceiling]
    assert conclude([*rows, make_row("mine", 0.9)]) == (
        "mine beats the 0.70 of nearest, which learns nothing: 0.900 (0.850 to 0.950); bayes, which knows how "
        "rooms are drawn, has 0.98.")
    assert conclude([*rows, make_row("mine", 0.72)]).startswith("No agent is shown to beat the 0.70 of nearest")
    assert conclude([*rows, make_row("mine", 0.3)]).startswith("No agent is shown to beat the 0.70 of nearest")
    assert "the best, yours, has 0.600" in conclude([lower, floor, make_row("mine", 0.3), make_row("yours", 0.6)])
    assert conclude(rows) == conclude([make_row("mine", 0.9)]) == (
        "No search baseline was run yet.")


def test_words_of_strangers_are_no_markup_and_hidden_rooms_have_a_column():
    record = read_records(BOARD)[0]
    entry, cells = record.submission.entry, record.submission.cells
    card = dataclasses.replace(entry.card, name="<b>|x|</b> [a](b)*", authors=("`me`",), told="{{ 7 * 7 }} $x$",
                               link="https://example.org/a")
    hidden = [dataclasses.replace(cells[0], set="hidden", room=room, escaped=False) for room in range(100)]
    stated = dataclasses.replace(entry, card=card, beacon="quicknet 7 " + "a" * 64)
    odd = dataclasses.replace(record.submission, entry=stated, cells=(*cells, *hidden))
    page, _ = write_page([Record(odd, record.check)])
    line = next(line for line in page.splitlines() if "example.org" in line)
    assert line.count("|") == 12 and not set("<>`{}*$") & set(line) and "](https://example.org/a)" in line
    assert "| 0.000 (0.000 to 0.0" in line
    partial = dataclasses.replace(record.submission, entry=dataclasses.replace(entry, rooms=1), cells=cells[:1])
    page, left_out = write_page([Record(partial, record.check)])
    assert left_out == [entry.card.name] and "|---|" not in page


def test_a_record_survives_its_file_and_a_damaged_one_is_named(tmp_path):
    record = read_records(BOARD)[0]
    record.save(tmp_path / "a.json")
    assert read_records(tmp_path) == [record] and record.check == Check(record.check.cells, record.check.seed, "0.3.0")
    value = json.loads((tmp_path / "a.json").read_text())
    value["submission"]["cells"][0]["primitives"] = 0
    (tmp_path / "a.json").write_text(json.dumps(value))
    with pytest.raises(FileReadError, match="a.json: this is no record"):
        read_records(tmp_path)


KEPT = sorted(BOARD.glob("*.zip"))


@pytest.mark.parametrize("path", KEPT, ids=lambda path: path.stem)
def test_a_submission_kept_beside_its_record_is_the_record_s_and_plays_to_its_results(path):
    (record,) = [record for record in read_records(BOARD) if record.submission == read_submission(path)]
    assert record.submission.entry.rooms == len(record.submission.cells)
    checked = verify_cells(path, find_rung(record.submission.entry), 2, seed=0, trust=True)  # ours, read and known
    assert all(each.is_equal for each in checked)
