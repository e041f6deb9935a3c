"""The gallery: findings by measurement, a page by rule from them, and the page in the docs from its own findings."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.sampling.generation import generate
from studies.__main__ import main
from studies.gallery.analysis import PlayedRun, SolvedRoom, count_fewest, list_entries
from studies.store import HEADER, Store
from studies.study import find_study
from tests.studies.pages import load, save, tell

GALLERY = find_study("gallery")
PLAYERS = GALLERY.data["players"]


def test_an_entry_has_three_sentences_a_level_and_a_room():
    entries = list_entries(GALLERY)
    assert len({entry.preset for entry in entries}) == len(entries)
    for entry in entries:
        assert entry.preset in PRESETS and entry.level in GALLERY.data["exactness"]
        assert entry.rules.count(". ") == 2 and entry.rules.endswith("."), entry.preset
        assert entry.optimum.format(fewest=1, expected="1")


@pytest.mark.parametrize(("preset", "fewest"), [("hanoi", 14), ("bit-flip", 4), ("light-box", 11), ("foraging", 4)])
def test_the_fewest_operators_are_those_known(preset, fewest):
    assert count_fewest(generate(get_preset(preset), 0)) == fewest


@pytest.mark.nightly
def test_what_was_measured_is_not_measured_again(tmp_path: Path):
    command = ["gallery", "--presets", "four-button-chain", "--runs", "1", "--primitives", "60", "--episodes", "1"]
    assert main([*command, "--docs", str(tmp_path)]) == 0
    found = load("gallery", tmp_path)
    assert [type(each) for each in found] == [SolvedRoom, *[PlayedRun] * 5]
    (raw,) = tmp_path.glob("raw/*.jsonl")
    whole, page = raw.read_text(), (tmp_path / "gallery.md").read_text()
    assert main([*command, "--docs", str(tmp_path)]) == 0 and raw.read_text() == whole
    raw.write_text("".join(whole.splitlines(keepends=True)[:-1]))
    assert main([*command, "--docs", str(tmp_path)]) == 0 and raw.read_text() == whole, "the same to the bit"
    assert (tmp_path / "gallery.md").read_text() == page


def make_findings(lengths: dict[str, tuple[int | None, ...]]) -> list[SolvedRoom | PlayedRun]:
    return [SolvedRoom("light-box", 9, 0.5, 70), *(PlayedRun("light-box", agent, 0, 100, each)
                                                  for agent, each in lengths.items())]


def test_sentences_follow_the_findings(tmp_path):
    random, order, searcher, learner = PLAYERS
    page = tell("gallery", make_findings({random: (10, 30), order: (None, 5), searcher: (4, 4), learner: (None, None)}),
                tmp_path)
    assert "**Searching without learning escapes in every episode in 1 of 1 puzzle, `smdp-r-max` in 0 of 1," in page
    assert "There is no puzzle in which `smdp-r-max` escapes in every episode" in page
    assert "None of these puzzles shows learning: whatever the learner solves, searching solves" in page
    assert "Random options escape in every episode of LightBox." in page
    assert "Options in the order of their numbers escape in every episode of no puzzle." in page
    assert f"`{learner}` escapes in no episode of LightBox." in page
    assert "| `light-box` | L2 | 9 | 70 | 100%, 20 | 50%, 5 | 100%, 4 | 0% |  |" in page
    assert "9 presses where all work, 18.0 on average" in page
    other = [SolvedRoom("hanoi", 14, 1.0, 70), *(PlayedRun("hanoi", agent, 0, 0, (9,)) for agent in (searcher, order))]
    page = tell("gallery", [*make_findings({random: (10,), order: (None,), searcher: (4,), learner: (4,)}), *other])
    assert "episode in 2 of 2 puzzles, `smdp-r-max` in 1 of 1, random options in 1 of 1, options in the order" in page
    assert "of their numbers in 1 of 2.**" in page, "a puzzle that an agent was not played in is none of its puzzles"
    page = tell("gallery", make_findings({random: (None, None), order: (5, 5), searcher: (None, 2),
                                          learner: (7, 8)}))
    assert f"In LightBox `{learner}` escapes in every episode and the searcher" in page
    assert "Choose a puzzle in which searching fails, such as these" in page
    assert "Random options escape in every episode of no puzzle." in page
    assert f"`{learner}` escapes in every episode of LightBox." in page and "in no episode" not in page


@pytest.mark.parametrize(("seeds", "told"), [(1, "These are few runs, 1 training seed of 100 primitives and 2 "),
                                             (9, "These are few runs, 9 training seeds of 100 "),
                                             (10, "These are 10 training seeds of 100 ")])
def test_runs_are_called_few_where_they_are(seeds, told):
    found = [PlayedRun("light-box", PLAYERS[-1], seed, 100, (7, None)) for seed in range(seeds)]
    assert told in tell("gallery", [SolvedRoom("light-box", 9, 0.5, 70), *found])


def test_every_entry_is_measured():
    found = Store(GALLERY.folder / "raw.jsonl", (SolvedRoom, PlayedRun)).load()
    measured = {each.preset for each in found if isinstance(each, SolvedRoom)}
    assert measured == {entry.preset for entry in list_entries(GALLERY)}


def test_a_damaged_line_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = save("gallery", make_findings({}), tmp_path)
    path.write_text(f'{HEADER}\n{{"preset": "hanoi", "fewest": 14}}\n')
    assert main(["gallery", "--from-raw", "--docs", str(tmp_path)]) == 2
    assert "gallery.jsonl, line 2" in capsys.readouterr().err
