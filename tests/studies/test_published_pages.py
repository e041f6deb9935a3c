"""The README and the list of result pages agree with the studies."""

from __future__ import annotations

import copy
from pathlib import Path
from types import SimpleNamespace

import pytest

from studies.pages.learning_structure import RULES
from studies.parts.reach import BASELINE, FULL, RULE, count_escapes
from studies.publishing import list_pages, load_findings
from studies.running import open_store
from studies.study import find_study

RESULTS = Path(__file__).parents[2] / "docs" / "results"
HEADLINE = ("When wrong presses reset all buttons, only agents with learned dependencies or memory across episodes "
            "escape beyond ten buttons.")
"""Finding of the README."""


def test_every_page_of_results_but_the_index_is_published_by_the_studies_or_the_leaderboard():
    assert {path.stem for path in RESULTS.glob("*.md")} - {"index"} == {*list_pages(), "leaderboard"}


@pytest.fixture
def parts() -> SimpleNamespace:
    """Numbers of the page on parts, to change."""
    return SimpleNamespace(parts=copy.deepcopy(load_findings("parts").numbers),
                           crossover=copy.deepcopy(load_findings("crossover").numbers))


def test_the_readme_s_finding_holds_in_the_first_rooms_and_again_in_fresh_ones(parts: SimpleNamespace):
    """Its headline, its control and its open problem."""
    study = find_study("parts")
    runs = open_store(study, None).load()
    assert RULES["only-structure-escapes-beyond-ten"](parts) and RULES["search-is-fastest-up-to-ten-buttons"](parts)
    assert RULES["fifteen-buttons"](parts) and RULES["search-with-memory-is-faster"](parts)
    readme = " ".join((RESULTS.parents[1] / "README.md").read_text().split())
    assert f"**{HEADLINE}**" in readme and len(HEADLINE.split()) <= 20
    assert "docs/results/figures/reach.svg" in readme and "docs/results/figures/reach-dark.svg" in readme
    assert "does not escape from any room with 15 buttons" in readme
    assert count_escapes(runs, "learned walks + structure")[15][0] == 0
    assert "Where a wrong press has no effect, it escapes with twenty buttons, too." in readme
    assert all(run.first_escape for run in runs if (run.cell, run.rule, run.buttons) == (BASELINE, "ignore", 20))
    assert f"within {study.data['budget']:,} primitives" in readme and "5 to 30 runs per point" in readme
    counts = [count_escapes(runs, cell) for cell in (FULL, "options + memory", "options", "flat", BASELINE)]
    sizes = [made for own in counts for _, made in own.values()]
    assert (min(sizes), max(sizes)) == (5, 30)
    assert "A line ends at the first number of buttons without an escape." in readme
    for own in counts[1:]:
        *before, last = (escaped for escaped, _ in own.values())
        assert last == 0 and all(before)


def test_a_ratio_above_1_refutes_that_search_with_memory_is_faster(parts: SimpleNamespace):
    own = parts.crossover.ratios["reset"]["all"]
    own[8] = own[8]._replace(high=1.01)
    assert not RULES["search-with-memory-is-faster"](parts) and not RULES["takeaway"](parts)


@pytest.mark.parametrize("change", [{"search": 29}, {"learner": 30}])
def test_with_fifteen_buttons_all_runs_of_search_escape_and_not_all_of_the_learner(change: dict[str, int],
                                                                                   parts: SimpleNamespace):
    own = parts.crossover.ratios["reset"]["all"]
    own[15] = own[15]._replace(**change)
    assert not RULES["fifteen-buttons"](parts)


@pytest.mark.parametrize("slice_", ["first", "fresh"])
def test_a_single_escape_without_structure_refutes_the_headline(slice_: str, parts: SimpleNamespace):
    getattr(parts.parts, slice_).escapes[BASELINE, RULE][15] = (1, 5)
    assert not RULES["only-structure-escapes-beyond-ten"](parts)
    assert RULES["fifteen-buttons"](parts) is (slice_ == "fresh")
    getattr(parts.parts, slice_).escapes[BASELINE, RULE].pop(15)
    assert RULES["only-structure-escapes-beyond-ten"](parts), "options with memory were run with 15, too"


def test_one_learner_that_is_faster_than_search_refutes_the_finding(parts: SimpleNamespace):
    parts.parts.first.medians[FULL, RULE][10] = 100.0
    assert not RULES["search-is-fastest-up-to-ten-buttons"](parts)
