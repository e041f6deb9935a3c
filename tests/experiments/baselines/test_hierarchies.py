"""The study of synthesised hierarchies: what its page says follows from the lines, whatever they say."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from hrl_escape.cli import main
from hrl_escape.experiments.baselines.hierarchies_page import (
    QUESTIONS,
    compare_twins,
    conclude_contrasts,
    write_hierarchies_page,
)
from hrl_escape.experiments.baselines.lines import BaselineRun, load_lines, save_lines
from hrl_escape.experiments.presets import HIERARCHICAL, get_grid

ROOMS = ("near", "far")
LEARNERS = [agent.label for agent in get_grid("hierarchies").agents if agent.learns]
LINE = BaselineRun("per-instance", "hierarchies", "near", "", 0, 1_000, 0.0, None, 0.0, 1, 0.0, None, "abc")


def make_lines(better: dict[str, float], runs: int = 10) -> list[BaselineRun]:
    """Efficiencies by a part of the label, and 0 for the rest; who escapes at all does so after 100 primitives."""
    found = {label: next((score for part, score in better.items() if part in label), 0.0) for label in LEARNERS}
    return [dataclasses.replace(LINE, rooms=room, agent=label, seed=seed, efficiency=score * (1 + seed / 100),
                                first_escape=100 if score else None)
            for room in ROOMS for label, score in found.items() for seed in range(runs)]


def test_every_agent_of_a_question_is_in_the_grid():
    assert {label for question in QUESTIONS for pair in question.pairs for label in pair} <= set(LEARNERS)
    assert [len(question.pairs) for question in QUESTIONS] == [len(HIERARCHICAL)] * 3


@pytest.mark.parametrize(("better", "structure", "planned", "beside"), [
    ({"+planned": 0.9, "smdp": 0.5}, "no gain is shown in any of 2 rooms", "some hierarchy gains in 2 of 2 rooms",
     "some hierarchy gains in 2 of 2 rooms"),
    ({"+learned": 0.5, "+planned": 0.5, "smdp": 0.9}, "some hierarchy gains in 2 of 2 rooms",
     "no gain is shown in any of 2 rooms", "no gain is shown in any of 2 rooms, some loses in 2"),
    ({"+learned": 0.9, "+planned": 0.2, "q-learning": 0.2}, "some hierarchy gains in 2 of 2 rooms",
     "no gain is shown in any of 2 rooms, some loses in 2", "no gain is shown in any of 2 rooms"),
])
def test_another_truth_is_another_conclusion(better, structure, planned, beside):
    lines = make_lines(better)
    assert [sentence.split(": ")[1] for sentence in conclude_contrasts(compare_twins(lines), lines)] == [
        f"{said}." for said in (structure, planned, beside)]


def test_nothing_is_concluded_from_nine_runs():
    lines = make_lines({"+planned": 0.9, "smdp": 0.5}, runs=9)
    contrasts = compare_twins(lines)
    assert not any(contrast.is_shown for contrast in contrasts)
    assert all("nothing is concluded" in sentence for sentence in conclude_contrasts(contrasts, lines))
    lines += [line for line in make_lines({"+planned": 0.9}) if (line.rooms, line.seed) == (ROOMS[0], 9)]
    assert "gains in 1 of 1 room." in conclude_contrasts(compare_twins(lines), lines)[1]


def test_findings_name_room_and_size(tmp_path: Path):
    slow = [dataclasses.replace(line, first_escape=400) if line.agent == "maxq-q+planned" else line
            for line in make_lines({"+planned": 0.5, "smdp": 0.5})]
    write_hierarchies_page(slow, tmp_path / "page.md")
    page = (tmp_path / "page.md").read_text()
    assert "**Structure alone: no gain is shown in any of 2 rooms." in page
    assert page.count("| `maxq-q+planned` | 10 | 0.5") == 2
    assert "- `maxq-q+planned`: escapes later in far (by 300 primitives), near (by 300 primitives)." in page
    assert "- `hamq+planned`: no difference is shown." in page and "`hamq+planned` (program, state, planner)" in page
    assert "then one episode of the frozen policy" in page and "Too few runs" not in page


def test_another_truth_is_another_page(tmp_path: Path):
    fast = [dataclasses.replace(line, episodes=3, first_escape=40) if line.agent == "hamq+planned" else line
            for line in make_lines({"maxq-q+planned": 0.2, "+planned": 0.5, "smdp": 0.5})
            if line.agent != "h-dqn@table+planned" or (line.rooms, line.seed) != ("far", 9)]
    write_hierarchies_page(fast, tmp_path / "page.md")
    page = (tmp_path / "page.md").read_text()
    beside = page.partition("## Structure where a planner walks anyway")[2]
    assert "- `maxq-q+planned`: less efficient in far (-0.31), near (-0.31)." in beside
    assert "- `hamq+planned`: escapes sooner in far (by 60 primitives), near (by 60 primitives)." in beside
    assert "- `maxq-q+planned`: more efficient in far (+0.21), near (+0.21); escapes sooner in far (by 900" in page
    assert page.count("Too few runs to conclude anything: far.") == 2, "of the questions that it is a part of"
    assert "then three episodes of the frozen policy" in page
    write_hierarchies_page([line for line in fast if "+" not in line.agent], tmp_path / "page.md")
    assert "Privileged" not in (tmp_path / "page.md").read_text()


def test_what_the_page_says_of_its_grid_holds():
    grid = get_grid("hierarchies")
    for agent in (agent for agent in grid.agents if agent.learns):
        settings = agent.resolve_settings()
        assert "hidden" not in settings or settings["values"] == "table", f"{agent.label} learns in a network"
        assert not agent.settings, f"{agent.label} is not at its default settings"
    for room in grid.rooms:
        instance = room.make_instance()
        assert len(instance.starts) == len(instance.puzzle.list_starts()) == 1 and not instance.dynamics.is_random


def test_the_command_runs_and_writes_the_page_again_from_its_lines(tmp_path: Path, monkeypatch, capsys):
    from hrl_escape.commands.experiment import hierarchies

    agents = tuple(agent for agent in hierarchies._GRID.agents if agent.label in ("hamq+planned", "planner"))
    small = dataclasses.replace(hierarchies._GRID, agents=agents, rooms=hierarchies._GRID.rooms[:1], eval_every=60)
    monkeypatch.setattr(hierarchies, "_GRID", small)
    arguments = ["experiment", "hierarchies", "--runs", "1", "--primitives", "60", "--workers", "1",
                 "--docs", str(tmp_path), "--out", str(tmp_path / "runs")]
    assert main(arguments) == 0 and "nothing is concluded" in capsys.readouterr().out
    page, lines = (tmp_path / "hierarchies.md").read_text(), load_lines(tmp_path / "raw" / "hierarchies.jsonl")
    assert {line.agent: line.first_escape for line in lines} == {"hamq+planned": 36, "planner": None}
    save_lines(tmp_path / "raw" / "hierarchies.jsonl", [dataclasses.replace(line, efficiency=0.5) for line in lines])
    assert main(["experiment", "hierarchies", "--from-raw", "--docs", str(tmp_path)]) == 0
    again = (tmp_path / "hierarchies.md").read_text()
    assert again != page and "0.500" in again
