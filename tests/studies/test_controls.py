"""Studies of controls, of hierarchies and of learning inside options: comparisons of known data."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from hrl_escape.agents.hierarchy_kinds import KINDS, WITHOUT_PLANS
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.errors import UnsupportedError
from hrl_escape.sets.own_config import find_own_config
from studies.__main__ import main
from studies.baseline import BaselineRun
from studies.controls import (
    analyse,
    compare_controls,
    find_repeated_rooms,
    group,
    list_questions,
)
from studies.study import Study, find_study
from tests.studies.lines import load, save

GIVEN_HIERARCHIES, LEARNED_HIERARCHIES, INTRA_OPTION = map(find_study, ("hierarchies", "learned", "intra-option"))
HIERARCHY_LEARNERS = [agent.algorithm for agent in LEARNED_HIERARCHIES.grids[0].agents if agent.learns]
ROOMS = ("near", "far")
STUDIES = pytest.mark.parametrize("study", [GIVEN_HIERARCHIES, LEARNED_HIERARCHIES, INTRA_OPTION],
                                  ids=lambda study: study.name)
LINE = BaselineRun("per-instance", "hierarchies", "near", "", 0, 1_000, 0.0, None, 0.0, 1, 0.0, None, "abc")


def make_lines(better: dict[str, float], runs: int = 10, study=GIVEN_HIERARCHIES, searcher: float | None = None,
               chance: float | None = None) -> list[BaselineRun]:
    """Efficiencies by a part of the label, and 0 for the rest; who escapes at all does so after 100 primitives."""
    learners = [agent.label for agent in study.grids[0].agents if agent.learns]
    found = {label: next((score for part, score in better.items() if part in label), 0.0) for label in learners}
    others = {"search-nearest": searcher, "random-options": chance}
    found |= {label: score for label, score in others.items() if score is not None}
    return [dataclasses.replace(LINE, rooms=room, agent=label, seed=seed, efficiency=score * (1 + seed / 100),
                                first_escape=100 + seed if score and label in learners else None,
                                primitives=1_000 if label in learners else 0)
            for room in ROOMS for label, score in found.items() for seed in range(runs)]


@pytest.mark.parametrize("study", [LEARNED_HIERARCHIES, INTRA_OPTION], ids=lambda study: study.name)
def test_the_optimal_searcher_does_not_know_rooms_of_no_preset(study: Study):
    for room in study.grids[0].rooms:
        with pytest.raises(UnsupportedError, match="take a preset, a rung"):
            find_own_config(room.make_instance())


@STUDIES
def test_every_learner_of_the_grid_is_asked_about_or_a_control_and_nobody_else(study):
    grid = study.grids[0]
    asked = {label for question in list_questions(study) for pair in question.pairs for label in pair}
    assert asked == {agent.label for agent in grid.agents if agent.learns}


def test_questions_ask_about_every_hierarchy():
    planned = [kind for kind in KINDS if kind not in WITHOUT_PLANS]
    assert [len(question.pairs) for question in list_questions(GIVEN_HIERARCHIES)] == [len(planned)] * 3
    asked = sum(len(question.pairs) for question in list_questions(LEARNED_HIERARCHIES)[:3])
    assert asked == len(HIERARCHY_LEARNERS) - 3, "all but three controls"


def read(lines: list[BaselineRun], study: Study = GIVEN_HIERARCHIES) -> Any:
    """Numbers of the analysis; the two rooms differ in one run, and so count as two."""
    first, *rest = sorted(lines, key=lambda line: not line.primitives)
    return analyse(study, [dataclasses.replace(first, first_escape=7), *rest]).numbers


@pytest.mark.parametrize(("better", "structure", "planned", "given"), [
    ({"+planned": 0.9, "smdp": 0.5}, 0, 4, 4),
    ({"+learned": 0.5, "maxq-q+planned": 0.6, "+planned": 0.5, "smdp": 0.9}, 4, 1, 0),
])
def test_another_truth_is_another_count_of_gains(better: dict[str, float], structure: int, planned: int, given: int):
    questions = read(make_lines(better)).questions
    assert [sum(each.is_better for each in own.values()) for own in questions.values()] == [structure, planned, given]


@pytest.mark.parametrize(("searcher", "count"), [(0.3, 8), (0.55, 4), (0.9, 0)])
def test_learners_are_compared_with_the_search_baseline(searcher: float, count: int):
    lines = [line for line in make_lines({"+planned": 0.8, "+learned": 0.5}, searcher=searcher)
             if line.agent != "smdp-q-learning"]
    beyond = read(lines).beyond
    assert sum(each.is_better for each in beyond.values()) == count and len(beyond) == 9


def test_the_best_search_baseline_of_each_room_counts():
    lines = make_lines({"+planned": 0.5}, searcher=0.1)
    other = [dataclasses.replace(line, agent="search-backtrack", efficiency=0.9) for line in lines
             if (line.agent, line.rooms) == ("search-nearest", "far")]
    near_only = [dataclasses.replace(line, efficiency=0.9)
                 if (line.agent, line.rooms) == ("search-nearest", "near") else line for line in lines]
    assert sum(each.is_better for each in read(lines).beyond.values()) == 4
    assert not any(each.is_better for each in read([*near_only, *other]).beyond.values())


def test_agents_that_run_alike_are_marked():
    lines = make_lines({"smdp": 0.5}, study=INTRA_OPTION)
    (found,) = compare_controls([list_questions(INTRA_OPTION)[1]], group(lines), ROOMS)
    assert found[0].is_same
    once = [dataclasses.replace(line, first_escape=99)
            if (line.agent, line.rooms, line.seed) == ("smdp-intra-option-q", "far", 3) else line
            for line in lines]
    (found,) = compare_controls([list_questions(INTRA_OPTION)[1]], group(once), ROOMS)
    assert not found[0].is_same and not found[0].is_better and not found[0].is_worse


def test_nine_runs_give_no_comparison():
    numbers = read(make_lines({"+planned": 0.9, "smdp": 0.5}, runs=9, searcher=0.1))
    assert not numbers.beyond and not any(numbers.questions.values())


def test_tables_have_display_names_and_mark_significant_differences():
    found = analyse(GIVEN_HIERARCHIES, make_lines({"maxq-q+planned": 0.2, "+planned": 0.5, "smdp": 0.5}, searcher=0.3))
    (row,) = [row for row in found.tables["hierarchies_controls"].splitlines()
              if row.startswith("| Structure where") and "| MAXQ-Q, with a planned low level |" in row]
    assert "| Q-learning over options | **-0.31 (" in row
    assert "| MAXQ-Q, with a planned low level | `maxq-q+planned` | 10 | 0.20" in found.tables["hierarchies_rooms"]


def test_rooms_in_which_all_runs_agree_count_once():
    lines = make_lines({"+planned": 0.9, "smdp": 0.5}, searcher=0.3)
    assert find_repeated_rooms(group(lines), ROOMS) == {"far"}
    assert analyse(GIVEN_HIERARCHIES, lines).numbers.rooms == 1
    other = [dataclasses.replace(line, first_escape=7) if (line.rooms, line.seed) == ("far", 0) else line
             for line in lines]
    assert not find_repeated_rooms(group(other), ROOMS) and analyse(GIVEN_HIERARCHIES, other).numbers.rooms == 2


def test_intervals_and_verdicts_agree():
    lines = make_lines({"maxq-q+planned": 0.15, "hamq+planned": 0.11, "": 0.1})
    lines = [dataclasses.replace(line, efficiency=line.efficiency + 0.05 * (-1) ** line.seed) for line in lines
             if line.agent != "q-learning"] + [line for line in lines if line.agent == "q-learning"]
    for contrasts in compare_controls(list_questions(GIVEN_HIERARCHIES), group(lines), ROOMS):
        for contrast in contrasts:
            assert (contrast.found.low > 0 or contrast.found.high < 0) == (contrast.is_better or contrast.is_worse)


def test_agents_on_given_hierarchies_learn_in_tables():
    for agent in (agent for agent in GIVEN_HIERARCHIES.grids[0].agents if agent.learns):
        settings = agent.resolve_settings()
        assert "hidden" not in settings or settings["values"] == "table", f"{agent.label} learns in a network"


def test_settings_that_are_no_defaults_are_of_two_kinds():
    assert not any(agent.settings for agent in GIVEN_HIERARCHIES.grids[0].agents)
    changed = {agent.algorithm: agent.settings for agent in LEARNED_HIERARCHIES.grids[0].agents if agent.settings}
    found = {name for name, settings in changed.items() if settings.get("rollout") == 32}
    search = {name for name, settings in changed.items() if settings == {"discover_every": 50}}
    assert found | search == set(changed)


@pytest.mark.nightly_for("hierarchies")
@STUDIES
def test_rooms_have_one_start_and_no_chance_but_where_there_is_noise(study):
    grid = study.grids[0]
    for room in grid.rooms:
        instance = room.make_instance()
        assert len(instance.starts) == len(instance.puzzle.list_starts()) == 1
        assert instance.dynamics.is_random == ("-noise" in room.label)


@pytest.mark.parametrize("study", [LEARNED_HIERARCHIES, INTRA_OPTION], ids=lambda study: study.name)
def test_rooms_are_what_the_page_says(study):
    for room in study.grids[0].rooms:
        place, puzzle = room.make_place(), room.make_instance().puzzle
        _, buttons, rule, *_ = place.name.partition("#")[0].split("-")
        needy = [child for _, child in puzzle.edge_list]
        assert place.name == room.label
        assert (puzzle.count, puzzle.on_violation) == (int(buttons), rule)
        assert 1 <= max(map(needy.count, needy)) <= 2, "some button needs another"


@pytest.mark.nightly_for("given")
@pytest.mark.parametrize(("study", "agent", "first"), [
    (GIVEN_HIERARCHIES, "hamq+planned", 36),
    pytest.param(LEARNED_HIERARCHIES, "smdp-hrc", 57, marks=pytest.mark.slow),
    pytest.param(INTRA_OPTION, "smdp-intra-option-q+reactive", None, marks=pytest.mark.slow)],
    ids=["given", "learned", "intra-option"])
def test_the_command_runs_and_analyses_its_lines_again(study, agent, first, tmp_path: Path, monkeypatch,
                                                                   capsys):
    grid = study.grids[0]
    agents = tuple(spec for spec in grid.agents if spec.label in (agent, "oracle"))
    small = dataclasses.replace(grid, agents=agents, rooms=grid.rooms[:1], eval_every=60).to_dict()
    few = {"room": "layered-2-ignore#1", "algorithms": ["hrc"], "shares": [1.0], "failures": [0.0, 1.0], "draws": 1,
           "calls": 1, "longest": 200}
    monkeypatch.setattr("studies.study.read_toml", lambda *_: {**study.data, "grid": [small], "dial": few})
    arguments = [study.name, "--docs", str(tmp_path)]
    assert main([*arguments, "--runs", "1", "--primitives", "60", "--workers", "1",
                 "--out", str(tmp_path / "runs")]) == 0
    title = AgentSpec.parse(agent).title
    assert f"| {title} | `{agent}` | 1 | 0." in (printed := capsys.readouterr().out)
    assert ("learned_dial" in printed) == (study is LEARNED_HIERARCHIES)
    lines = [line for line in load(study.name, tmp_path) if isinstance(line, BaselineRun)]
    assert {line.agent: line.first_escape for line in lines} == {agent: first, "oracle": None}
    save(study.name, [dataclasses.replace(line, efficiency=0.5) for line in lines], tmp_path)
    assert main([*arguments, "--from-raw"]) == 0
    assert f"| {title} | `{agent}` | 1 | 0.500 (" in capsys.readouterr().out
