"""`hrl-escape demo`, which `make demo` runs: the comparison that `compare` makes where nothing is named."""

import re
from pathlib import Path

from tests.command_line import call


def test_demo_is_the_quickstart_comparison_and_make_runs_it(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, said, _ = call(capsys, "demo", "--dry-run")
    assert code == 0 and said == call(capsys, "compare", "quickstart", "--dry-run")[1] and "runs/quickstart" in said
    makefile = (Path(__file__).parents[2] / "Makefile").read_text()
    assert re.search(r"^DEMO +\?= (.*)$", makefile, re.MULTILINE)[1] == "hrl-escape demo"
