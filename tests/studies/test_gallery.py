"""Rooms of all puzzles: what is measured, once, and the scores of agents."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.sampling.generation import generate
from studies.__main__ import main
from studies.gallery.analysis import PlayedRun, SolvedRoom, analyse, count_fewest
from studies.store import HEADER, Store
from studies.study import find_study
from tests.studies.lines import load, save

GALLERY = find_study("gallery")
PLAYERS, PUZZLES = GALLERY.data["players"], GALLERY.data["puzzles"]


def test_every_puzzle_is_a_preset():
    assert len(set(PUZZLES)) == len(PUZZLES) == 25 and set(PUZZLES) <= set(PRESETS)


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
    whole = raw.read_text()
    assert main([*command, "--docs", str(tmp_path)]) == 0 and raw.read_text() == whole
    raw.write_text("".join(whole.splitlines(keepends=True)[:-1]))
    assert main([*command, "--docs", str(tmp_path)]) == 0 and raw.read_text() == whole, "the same to the bit"


def make_findings(lengths: dict[str, tuple[int | None, ...]]) -> list[SolvedRoom | PlayedRun]:
    return [SolvedRoom("light-box", 9, 0.5, 70), *(PlayedRun("light-box", agent, 0, 100, each)
                                                  for agent, each in lengths.items())]


def test_scores_are_those_of_the_episodes():
    random, order, searcher, learner = PLAYERS
    ends = {random: (10, 30), order: (None, 5), searcher: (4, 4), learner: (None, None)}
    found = analyse(GALLERY, make_findings(ends))
    assert "| `light-box` | 9 | 70 | 100%, 20 | 50%, 5 | 100%, 4 | 0% |  |" in found.tables["puzzles"]
    assert found.numbers.always == {random: ["light-box"], order: [], searcher: ["light-box"], learner: [], "bayes": []}


def test_every_puzzle_is_measured():
    found = Store(GALLERY.folder / "raw.jsonl", (SolvedRoom, PlayedRun)).load()
    measured = {each.preset for each in found if isinstance(each, SolvedRoom)}
    assert measured == set(PUZZLES)


def test_a_damaged_line_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = save("gallery", make_findings({}), tmp_path)
    path.write_text(f'{HEADER}\n{{"preset": "hanoi", "fewest": 14}}\n')
    assert main(["gallery", "--from-raw", "--docs", str(tmp_path)]) == 2
    assert "gallery.jsonl, line 2" in capsys.readouterr().err
