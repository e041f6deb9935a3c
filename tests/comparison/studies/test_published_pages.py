"""The pages in docs/results say what their raw results say, in today's words."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from hrl_escape.cli import main

RESULTS = Path(__file__).parents[3] / "docs" / "results"


@pytest.mark.parametrize(("study", "page"), [
    ("paper", "paper.md"), ("factorial", "why-it-worsens.md"), ("price", "price.md"), ("scaling", "scaling.md"),
    ("hierarchies", "hierarchies.md"), ("learned", "learned.md"), ("intra-option", "intra-option.md"),
    ("ladder", "ladder.md"),
    ("generalisation", "generalisation.md"),
])
def test_a_published_page_is_what_its_raw_results_give(tmp_path: Path, study: str, page: str):
    shutil.copytree(RESULTS / "raw", tmp_path / "raw")
    assert main(["experiment", study, "--from-raw", "--docs", str(tmp_path)]) == 0
    assert (tmp_path / page).read_text() == (RESULTS / page).read_text()
