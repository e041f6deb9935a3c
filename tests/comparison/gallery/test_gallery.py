"""The gallery: findings by measurement, a page by rule from them, and the page in the docs from its own findings."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_escape.comparison.gallery.entries import EXACTNESS, load_entries
from hrl_escape.comparison.gallery.measure import (
    PLAYERS,
    GallerySettings,
    PlayedRun,
    SolvedRoom,
    count_fewest,
    load_gallery,
    measure_gallery,
    save_gallery,
)
from hrl_escape.comparison.gallery.page import GALLERY_PAGE, write_gallery
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import FileReadError

RESULTS = Path(__file__).parents[3] / "docs" / "results"


def test_an_entry_has_three_sentences_a_level_and_a_room():
    entries = load_entries()
    assert len({entry.preset for entry in entries}) == len(entries)
    for entry in entries:
        assert entry.preset in PRESETS and entry.level in EXACTNESS
        assert entry.rules.count(". ") == 2 and entry.rules.endswith("."), entry.preset
        assert entry.optimum.format(fewest=1, expected="1")


@pytest.mark.parametrize(("preset", "fewest"), [("hanoi", 14), ("bit-flip", 4), ("light-box", 11), ("foraging", 4)])
def test_the_fewest_operators_are_those_known(preset, fewest):
    assert count_fewest(generate(get_preset(preset), 0)) == fewest


def test_what_was_measured_is_not_measured_again(tmp_path):
    settings = GallerySettings(runs=1, primitives=60, episodes=1)
    found = list(measure_gallery(["four-button-chain"], settings))
    assert [type(each) for each in found] == [SolvedRoom, *[PlayedRun] * 3]
    save_gallery(tmp_path / "gallery.jsonl", found)
    assert load_gallery(tmp_path / "gallery.jsonl") == found
    assert list(measure_gallery(["four-button-chain"], settings, found)) == []
    assert list(measure_gallery(["four-button-chain"], settings, found[:-1])) == found[-1:], "the same to the bit"


def make_findings(lengths: dict[str, tuple[int | None, ...]]) -> list[SolvedRoom | PlayedRun]:
    return [SolvedRoom("light-box", 9, 0.5, 70), *(PlayedRun("light-box", agent, 0, 100, each)
                                                  for agent, each in lengths.items())]


def test_sentences_follow_the_findings(tmp_path):
    random, order, learner = PLAYERS
    write_gallery(make_findings({random: (10, 30), order: (None, 5), learner: (None, None)}), tmp_path)
    page = (tmp_path / GALLERY_PAGE).read_text()
    assert "Random options escape in every episode of LightBox." in page
    assert "Options in the order of their numbers escape in every episode of no puzzle." in page
    assert f"`{learner}` escapes in no episode of LightBox." in page
    assert "| `light-box` | L2 | 9 | 70 | 100%, 20 | 50%, 5 | 0% |" in page
    assert "9 presses where all work, 18.0 on average" in page
    write_gallery(make_findings({random: (None, None), order: (5, 5), learner: (7, 8)}), tmp_path)
    page = (tmp_path / GALLERY_PAGE).read_text()
    assert "Random options escape in every episode of no puzzle." in page
    assert f"`{learner}` escapes in every episode of LightBox." in page and "in no episode" not in page


@pytest.mark.parametrize(("seeds", "told"), [(1, "These are few runs, 1 training seed of 100 primitives and 2 "),
                                             (9, "These are few runs, 9 training seeds of 100 "),
                                             (10, "These are 10 training seeds of 100 ")])
def test_runs_are_called_few_where_they_are(tmp_path, seeds, told):
    found = [PlayedRun("light-box", PLAYERS[-1], seed, 100, (7, None)) for seed in range(seeds)]
    write_gallery([SolvedRoom("light-box", 9, 0.5, 70), *found], tmp_path)
    assert told in (tmp_path / GALLERY_PAGE).read_text()


def test_the_page_in_the_docs_is_the_one_of_its_findings(tmp_path):
    found = load_gallery(RESULTS / "raw" / "gallery.jsonl")
    write_gallery(found, tmp_path)
    assert (tmp_path / GALLERY_PAGE).read_text() == (RESULTS / GALLERY_PAGE).read_text()
    measured = {each.preset for each in found if isinstance(each, SolvedRoom)}
    assert measured == {entry.preset for entry in load_entries()}


def test_a_damaged_line_is_named(tmp_path):
    (tmp_path / "gallery.jsonl").write_text('{"preset": "hanoi", "fewest": 14}\n')
    with pytest.raises(FileReadError, match="line 1"):
        load_gallery(tmp_path / "gallery.jsonl")
