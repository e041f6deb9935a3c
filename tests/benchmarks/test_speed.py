"""The history of speeds, and the page that quotes its last run."""

from __future__ import annotations

import re
from pathlib import Path

from benchmarks.speed import FIGURE, PARTS, make_table, read_history

PAGE = Path(__file__).parents[2] / "docs/speed.md"


def test_every_run_names_its_machine_and_its_rows_have_ratios_to_something():
    runs = read_history()
    assert runs and [run["date"] for run in runs] == sorted(run["date"] for run in runs)
    for run in runs:
        assert all(run[name] for name in ("date", "machine", "processor", "instructions")) and run["load"] >= 0.0
        assert all(row["value"] > 0.0 and row["unit"] and (row["ratio"] is None or row["to"]) for row in run["rows"])
        assert len({row["name"] for row in run["rows"]}) == len(run["rows"]) >= len(PARTS)


def test_the_page_shows_the_last_run_and_states_no_number_of_its_own():
    text, run = PAGE.read_text("utf-8"), read_history()[-1]
    assert "```{speed-table}" in text and FIGURE.is_file() and f"images/{FIGURE.name}" in text
    prose = re.sub(r"```.*?```|`[^`]*`|\([^)]*\)", "", text, flags=re.DOTALL)
    assert re.findall(r"\b\d[\d,.]*", prose) == []
    head, *rows = make_table(run).splitlines()
    assert all(str(word) in head for word in (run["date"], run["machine"]["hrl-escape"], run["processor"],
                                              run["instructions"]))
    assert [row.split(" | ")[0].removeprefix("| ") for row in rows[3:]] == [row["name"] for row in run["rows"]]
