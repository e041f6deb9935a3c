"""The pages in docs/results say what the results of their studies say, in today's words."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from studies.page import render
from studies.running import analyse, open_store
from studies.study import find_study, list_studies

RESULTS = Path(__file__).parents[2] / "docs" / "results"


@pytest.mark.parametrize("name", list_studies())
def test_a_published_page_is_what_its_results_give(name: str):
    study = find_study(name)
    lines = open_store(study, None).load()
    assert render(study, analyse(study, lines)) == (RESULTS / f"{study.page}.md").read_text()


def test_every_page_of_results_but_the_index_and_the_quickstart_is_a_study_s():
    pages = {path.stem for path in RESULTS.glob("*.md")} - {"index", "quickstart"}
    assert pages == {study.page for study in list_studies().values()}


def test_numbers_to_quote_stand_on_their_pages():
    rows = [row.split(" | ") for row in (RESULTS / "index.md").read_text().splitlines() if "python -m studies" in row]
    assert len(rows) > 3
    for _, measured, source in rows:
        page = (RESULTS / re.search(r"\[page\]\((.+?)\)", source)[1]).read_text()
        for number in re.findall(r"\d[\d,.]*\d%?|\d", measured):
            assert re.search(rf"(?<![\d.]){re.escape(number)}(?![\d]|[.,]\d)", page), (number, source)


def test_the_readme_s_figure_is_told_in_the_words_of_its_study():
    headline = re.search(r"\*\*(.+?)\*\*", (RESULTS / "buttons.md").read_text())[1]
    readme = (RESULTS.parents[1] / "README.md").read_text()
    assert headline.removesuffix(".") in readme and "docs/results/figures/buttons.svg" in readme
