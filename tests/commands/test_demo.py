"""`hrl-escape demo`, which `make demo` runs: the comparison `demo`."""

import re
from pathlib import Path

from hrl_escape.benchmark.presets import get_grid
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin
from tests.command_line import call


def test_demo_is_the_comparison_of_that_name_and_make_runs_it(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, said, _ = call(capsys, "demo", "--dry-run")
    assert code == 0 and said == call(capsys, "compare", "demo", "--dry-run")[1] and "runs/demo" in said
    makefile = (Path(__file__).parents[2] / "Makefile").read_text()
    assert re.search(r"^DEMO +\?= (.*)$", makefile, re.MULTILINE)[1] == "hrl-escape demo"


def test_the_demo_compares_six_agents_where_numbers_do_not_give_the_order_away():
    grid = get_grid("demo")
    (place,) = grid.make_places()
    assert len(grid.agents) == 6 and grid.runs >= 10, "ten runs are the fewest with a verdict"
    puzzle = place.instance.puzzle
    edges = get_mixin(puzzle, Graphed).edges
    assert puzzle.on_violation == "reset" and any(before > after for before, after in edges)
