"""Recommended agents: their labels run, and what is said of them is what the pages of results say."""

import re
import statistics
from pathlib import Path

import pytest

from hrl_escape.agents.recommended import RECOMMENDED, format_answer
from hrl_escape.agents.spec import AgentSpec
from studies.across.analysis import AcrossRun
from studies.running import open_store
from studies.study import find_study

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
ROOM, UNSEEN, REMEMBERING, FORGETTING = RECOMMENDED
BACKTRACK = "search baseline, with backtracking"
SEARCH_BASELINES = ("search baseline, random order", "search baseline, nearest first", BACKTRACK)


def read_row(page: str, start: str) -> list[float]:
    """Numbers of the first row of a table that begins so."""
    row = next(line for line in (RESULTS / page).read_text().splitlines() if line.startswith(start))
    return [float(number) for number in re.findall(r"(?<=\| )\d\.\d+(?= )", row)]


def tell_range(numbers: list[float]) -> str:
    return f"{min(numbers):.2f} to {max(numbers):.2f}"


@pytest.mark.parametrize("choice", RECOMMENDED, ids=lambda choice: choice.use)
def test_each_recommended_label_names_an_agent(choice):
    spec = AgentSpec.parse(choice.label)
    spec.resolve_settings()
    assert spec.is_reference == (choice in (REMEMBERING, FORGETTING))


def test_what_is_said_of_one_room_is_what_was_measured():
    rows = {name: read_row("all-algorithms.md", f"| {name} |")[:7]
            for name in ("R-MAX over options", *SEARCH_BASELINES)}
    assert all(len(row) == 7 for row in rows.values())
    assert f"Efficiency {tell_range(rows['R-MAX over options'])} after 20,000 primitives" in ROOM.reason
    assert f"has {tell_range(rows[BACKTRACK])}." in ROOM.reason
    best = [max(found) for found in zip(*(rows[name] for name in SEARCH_BASELINES), strict=True)]
    assert rows[BACKTRACK] == best


def test_what_is_said_of_unseen_rooms_is_what_was_measured():
    study = find_study("across")
    runs: dict[str, list[float]] = {}
    for run in open_store(study, None).load():
        if isinstance(run, AcrossRun) and (run.agent, run.rooms, run.benchmark) == (UNSEEN.label, 64, "cues-1"):
            runs.setdefault(run.rung, []).append(statistics.fmean(run.efficiencies))
    means = [statistics.fmean(own) for rung, own in runs.items() if not rung.endswith("-control")]
    assert len(means) == 7
    low, high = map(float, re.findall(r"Efficiency (0\.\d\d) to (0\.\d\d) in unseen rooms", UNSEEN.reason)[0])
    assert abs(min(means) - low) < 0.03 and abs(max(means) - high) < 0.03


def test_search_with_memory_is_as_fast_as_is_said():
    text = (RESULTS / "learning-structure.md").read_text()
    assert "**With four to twenty buttons, search that remembers earlier episodes is faster than the learner" in text
    assert "With four to twenty buttons it escapes sooner" in REMEMBERING.reason


@pytest.mark.parametrize("page", ["README.md", "docs/index.md", "docs/faq.md", "docs/agents/index.md"])
def test_every_page_that_says_which_agent_quotes_the_one_answer(page):
    text = " ".join((ROOT / page).read_text().split())
    assert format_answer() in text or "```{recommended}" in text
