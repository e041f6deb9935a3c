"""Progress lines: a bar in terminals and notebooks, a line a minute in logs, and nothing when asked."""

from __future__ import annotations

import io
import re

import nbformat
import pytest
from nbclient import NotebookClient
from rich.console import Console

from hrl_escape import progress
from hrl_escape.progress import describe_results, show_progress


def work(console: Console, show: bool | None = None) -> None:
    with show_progress("dqn seed 0", 1_000, 250, show, console=console) as report:
        for done in (500, 750):
            report(done, "return -3.0 success 50%")


def read(show: bool | None = None, terminal: bool = False) -> str:
    shown = io.StringIO()
    work(Console(file=shown, force_terminal=terminal, width=80, color_system=None), show)
    return shown.getvalue()


def test_a_terminal_keeps_one_line_that_fits_it_with_rate_time_left_and_results():
    lines = re.sub(r"\x1b\[[^A-Za-z]*[A-Za-z]", "", read(terminal=True)).splitlines()
    bare = [line for line in lines if line.strip()][-1]
    assert len(bare) <= 80
    assert re.fullmatch(r"━+ dqn seed 0 750/1,000 [\d,]+/s 0:00 left return -3.0 success 50%", bare)


def test_a_log_gets_a_line_a_minute_and_a_last_one(monkeypatch: pytest.MonkeyPatch):
    clock = iter([0.0, 59.0, 60.0, 66.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    lines = read().splitlines()
    assert lines == ["dqn seed 0 750/1,000 8/s 0:30 left return -3.0 success 50%",
                     "dqn seed 0 750/1,000 8/s 0:33 left return -3.0 success 50%"]


def test_short_work_leaves_nothing_in_a_log_unless_asked_and_false_is_silent_everywhere(monkeypatch):
    assert read() == "" == read(False) == read(False, terminal=True)
    assert len(read(True).splitlines()) == 1
    monkeypatch.setenv(progress.SWITCH, "off")
    assert read(True) == "" == read(terminal=True)


def test_results_are_means_of_what_is_known():
    assert describe_results([-2.0, -4.0], [True, None, False]) == "return -3.0 success 50%"
    assert describe_results([1.0], [None]) == "return 1.0" and describe_results([]) == ""


@pytest.mark.nightly
def test_a_notebook_shows_one_bar_with_a_plain_text_for_pages_without_html():
    cells = ["from hrl_escape.progress import show_progress\n"
             "with show_progress('dqn <1>', 1_000) as report:\n    report(400, 'return 1.0')"]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    NotebookClient(notebook, timeout=120).execute()
    (output,) = notebook.cells[0].outputs
    assert output.data["text/plain"].startswith("dqn <1> 400/1,000")
    assert '<progress value="0.4000"' in output.data["text/html"] and "dqn &lt;1&gt;" in output.data["text/html"]
