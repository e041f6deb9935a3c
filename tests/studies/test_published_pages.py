"""The pages in docs/results say what the results of their studies say, in today's words."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from statistics import median

import pytest

from studies.page import render
from studies.parts.reach import BASELINE, FULL, HEADLINE, LIMIT, RULE, count_escapes, supports_headline
from studies.publishing import list_pages
from studies.running import analyse, open_store
from studies.study import find_study, list_studies

RESULTS = Path(__file__).parents[2] / "docs" / "results"


@pytest.mark.nightly_for(
    "parts", "ladder", "canon", "scaling", "paper", "learned", "hierarchies", "buttons", "intra-option", "profiles",
    "price", "budgets", "factorial")
@pytest.mark.parametrize("name", [name for name, study in list_studies().items()
                                  if (study.folder / "page.md.j2").is_file()])
def test_a_published_page_is_what_its_results_give(name: str):
    study = find_study(name)
    lines = open_store(study, None).load()
    assert render(study, analyse(study, lines)) == (RESULTS / f"{study.page}.md").read_text()


def test_every_page_of_results_but_the_index_is_published_by_the_studies():
    pages = {path.stem for path in RESULTS.glob("*.md")} - {"index"}
    assert pages == {*list_pages(), *(study.page for study in list_studies().values()
                                      if (study.folder / "page.md.j2").is_file())}


def test_the_readme_s_finding_holds_in_the_first_rooms_and_again_in_fresh_ones():
    """Its headline, its control and its open problem."""
    study = find_study("parts")
    runs = open_store(study, None).load()
    for own in study.data["slices"].values():
        seeds = range(own["first_seed"], own["first_seed"] + own["runs"])
        assert supports_headline([run for run in runs if run.seed in seeds])
    readme = " ".join((RESULTS.parents[1] / "README.md").read_text().split())
    assert f"**{HEADLINE}**" in readme and len(HEADLINE.split()) <= 20
    assert "docs/results/figures/reach.svg" in readme and "docs/results/figures/reach-dark.svg" in readme
    assert "does not escape from any room with 15 buttons" in readme
    assert count_escapes(runs, "learned walks + structure")[15][0] == 0
    assert "Where a wrong press does nothing, the search baseline escapes with twenty buttons, too." in readme
    assert all(run.first_escape for run in runs if (run.cell, run.rule, run.buttons) == (BASELINE, "ignore", 20))
    assert f"within {study.data['budget']:,} primitives" in readme and "5 to 30 runs a point" in readme
    counts = [count_escapes(runs, cell) for cell in (FULL, "options + memory", "options", "flat", BASELINE)]
    sizes = [made for own in counts for _, made in own.values()]
    assert (min(sizes), max(sizes)) == (5, 30)
    assert "A line ends at the first number of buttons without an escape." in readme
    for own in counts[1:]:
        *before, last = (escaped for escaped, _ in own.values())
        assert last == 0 and all(before)


def test_with_three_to_ten_buttons_the_search_baseline_is_faster_than_every_learner():
    """As the README says below its figure."""
    study = find_study("parts")
    cells = {cell["name"] for cell in study.data["cells"] if "reference" not in cell}
    waits: dict[tuple[str, int], list[float]] = {}
    for run in open_store(study, None).load():
        if run.rule == RULE and not run.failure and run.cell in {*cells, BASELINE}:
            waits.setdefault((run.cell, run.buttons), []).append(run.first_escape or math.inf)
    medians = {place: median(own) for place, own in waits.items()}
    sizes = [size for size in study.data["sizes"] if 3 <= size <= LIMIT]
    assert sizes == [3, 4, 6, 8, 10]
    assert all(medians[BASELINE, size] < middle for size in sizes for (cell, other), middle in medians.items()
               if other == size and cell != BASELINE)


def test_a_single_escape_without_structure_refutes_the_headline():
    runs = open_store(find_study("parts"), None).load()
    other = next(run for run in runs if run.cell == BASELINE and run.rule == RULE and run.buttons > LIMIT)
    changed = [dataclasses.replace(run, first_escape=500) if run is other else run for run in runs]
    assert supports_headline(runs) and not supports_headline(changed)
