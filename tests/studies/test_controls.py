"""Studies of controls, of hierarchies and of learning inside options: what their pages say follows from the lines."""

from __future__ import annotations

import dataclasses
from importlib.util import find_spec
from pathlib import Path

import pytest

from hrl_escape.agents.hierarchy_kinds import KINDS, WITHOUT_PLANS
from hrl_escape.agents.registry import find_agent_module
from hrl_escape.benchmark.references.bayes import find_own_config
from hrl_escape.errors import UnsupportedError
from studies.__main__ import main
from studies.baseline import BaselineRun
from studies.controls import (
    analyse,
    compare_controls,
    compare_with_chance,
    compare_with_searchers,
    find_forced,
    find_repeated_rooms,
    group,
    list_questions,
    tell_beyond,
    tell_question,
    tell_visible,
)
from studies.learned.dial import DialLine
from studies.page import render
from studies.study import Study, find_study
from tests.studies.pages import load, save

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


DIAL = [DialLine("room", option, 0, failure, 0, 0.5)
        for option, failure in (("planned", 0.0), ("planned", 1.0), ("learned", None))]


def tell_page(study: Study, lines: list[BaselineRun]) -> str:
    if study is LEARNED_HIERARCHIES:
        return render(study, study.analysis.analyse(study, [*lines, *DIAL]))
    return render(study, analyse(study, lines))


@pytest.mark.parametrize(("better", "words"), [
    ({"smdp-q": 0.1, "+planned": 0.9}, ("planned` gain by it. A hierarchy alone is not shown", "searching are `")),
    ({"+learned": 0.9}, ("A planned low level is not shown to help", "gain by structure alone")),
    ({"smdp-q": 0.1, "q-learning": 0.4}, ("A hierarchy alone does harm: ", "None is shown to beat searching, though")),
])
def test_advice_follows_the_answers(better: dict[str, float], words: tuple[str, ...]):
    advice = analyse(GIVEN_HIERARCHIES, make_lines(better, searcher=0.5)).values["advice"]
    assert all(part in advice for part in words), advice


@STUDIES
def test_advice_answers_questions_of_the_study(study: Study):
    assert {table["question"] for table in study.data["advice"]} - {""} < {
        question.heading for question in list_questions(study)}


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


def conclude(study: Study, lines: list[BaselineRun]) -> tuple[str, list[str]]:
    """The finding, and a sentence a question without its heading."""
    cells, agents = group(lines), list(dict.fromkeys(line.agent for line in lines))
    beyond, chance = compare_with_searchers(cells, ROOMS, agents), compare_with_chance(cells, ROOMS, agents)
    questions = list_questions(study)
    told = [tell_question(question, contrasts, beyond, chance)
            for question, contrasts in zip(questions, compare_controls(questions, cells, ROOMS), strict=True)]
    return tell_beyond(beyond, len(ROOMS)), [sentence.partition(": ")[2] for sentence in told]


@pytest.mark.parametrize(("better", "structure", "planned", "beside"), [
    ({"+planned": 0.9, "smdp": 0.5}, "none of 4 hierarchies is shown to gain.", "4 of 4 hierarchies gain (+0.94",
     "4 of 4 hierarchies gain (+0.42"),
    ({"+learned": 0.5, "maxq-q+planned": 0.6, "+planned": 0.5, "smdp": 0.9}, "4 of 4 hierarchies gain (+0.52",
     "1 of 4 hierarchies gain (+0.10)", "none of 4 hierarchies is shown to gain, `maxq-q+planned` (-0.31), "),
])
def test_another_truth_is_another_conclusion(better, structure, planned, beside):
    _, told = conclude(GIVEN_HIERARCHIES, make_lines(better))
    assert [sentence.startswith(words) for sentence, words in zip(told, (structure, planned, beside), strict=True)] == [
        True] * 3, told


@pytest.mark.parametrize(("searcher", "finding", "gain"), [
    (0.3, "8 of 9 learners beat the best searcher that learns nothing in two rooms: `maxq-q+learned`,",
     "4 of them beat the best searcher too"),
    (0.55, "4 of 9 learners beat the best searcher that learns nothing in two rooms: `maxq-q+planned`,",
     "4 of them beat the best searcher too"),
    (0.9, "No learner is shown to beat the best searcher that learns nothing in two rooms; all 9 reach less.",
     "none of them beats the best searcher"),
])
def test_a_gain_over_a_control_is_not_called_one_over_searching(searcher, finding, gain):
    lines = [line for line in make_lines({"+planned": 0.8, "+learned": 0.5}, searcher=searcher)
             if line.agent != "smdp-q-learning"]
    headline, told = conclude(GIVEN_HIERARCHIES, lines)
    assert headline.startswith(finding) and gain in told[1]


def test_the_best_searcher_of_each_room_counts():
    lines = make_lines({"+planned": 0.5}, searcher=0.1)
    other = [dataclasses.replace(line, agent="search-backtrack", efficiency=0.9) for line in lines
             if (line.agent, line.rooms) == ("search-nearest", "far")]
    near_only = [dataclasses.replace(line, efficiency=0.9)
                 if (line.agent, line.rooms) == ("search-nearest", "near") else line for line in lines]
    assert conclude(GIVEN_HIERARCHIES, lines)[0].startswith("4 of 10 learners beat")
    assert conclude(GIVEN_HIERARCHIES, [*near_only, *other])[0].startswith("No learner is shown to beat")


@pytest.mark.parametrize(("chance", "is_told"), [(0.1, False), (0.5, True), (0.9, True)])
def test_a_gain_that_chance_reaches_too_is_told(chance, is_told):
    lines = make_lines({"option-critic": 0.5, "q-learning": 0.2}, study=LEARNED_HIERARCHIES, searcher=0.8,
                       chance=chance)
    lines = [line if line.agent != "smdp-option-critic" else
             dataclasses.replace(line, efficiency=0.5 + (-1) ** line.seed * 0.1) for line in lines]
    _, told = conclude(LEARNED_HIERARCHIES, lines)
    assert told[0].startswith("1 of 4 learners of options gain (+0.29)")
    assert ("`smdp-option-critic` is not shown to beat chance" in told[0]) == (chance == 0.5)


def test_agents_that_run_alike_are_not_compared():
    lines = make_lines({"smdp": 0.5}, study=INTRA_OPTION)
    assert "`smdp-intra-option-q` and its control run alike in every room" in conclude(
        INTRA_OPTION, lines)[1][1]
    once = [dataclasses.replace(line, first_escape=99)
            if (line.agent, line.rooms, line.seed) == ("smdp-intra-option-q", "far", 3) else line
            for line in lines]
    assert conclude(INTRA_OPTION, once)[1][1] == "`intra-option-q` is not shown to gain."


def test_rooms_in_which_all_runs_agree_count_once():
    lines = make_lines({"+planned": 0.9, "smdp": 0.5}, searcher=0.3)
    assert find_repeated_rooms(group(lines), ROOMS) == {"far": ("near", 110)}
    page = tell_page(GIVEN_HIERARCHIES, lines)
    assert "`near` and `far` are one task: all 110 runs agree in both. It counts once." in page
    assert "beat the best searcher that learns nothing in one room:" in page
    other = [dataclasses.replace(line, first_escape=7) if (line.rooms, line.seed) == ("far", 0) else line
             for line in lines]
    assert not find_repeated_rooms(group(other), ROOMS) and "are one task" not in tell_page(GIVEN_HIERARCHIES, other)


def test_a_learner_that_runs_alike_with_every_seed_had_no_choice():
    lines = make_lines({"maxq-q+planned": 0.9})
    same = [dataclasses.replace(line, efficiency=0.9, first_escape=112) if line.agent == "maxq-q+planned" else line
            for line in lines]
    assert find_forced(group(same), "near", "maxq-q+planned")
    assert not find_forced(group(lines), "near", "maxq-q+planned")
    assert not find_forced(group(lines), "near", "q-learning"), "whoever never escapes has learned nothing, too"
    said = "`maxq-q+planned` runs alike with every seed in near: what it is told leaves it no choice there."
    different = [dataclasses.replace(line, efficiency=0.5) if line.rooms == "far" and line.seed == 1 else line
                 for line in same]
    assert said in tell_page(GIVEN_HIERARCHIES, different) and said not in tell_page(GIVEN_HIERARCHIES, lines)


def test_what_would_have_been_seen_grows_with_the_spread():
    def see(spread: float) -> str:
        lines = [dataclasses.replace(line, efficiency=0.5 + spread * (-1) ** line.seed) if "+planned" in line.agent
                 else line for line in make_lines({"": 0.5})]
        cells = group(lines)
        return tell_visible(compare_controls([list_questions(GIVEN_HIERARCHIES)[1]], cells, ROOMS)[0])

    assert "80 % power to detect a gain of 0.09 in half" in see(0.1) and "0.35 in half" in see(0.4)
    assert tell_visible([]) == ""


def test_nothing_is_concluded_from_nine_runs():
    lines = make_lines({"+planned": 0.9, "smdp": 0.5}, runs=9, searcher=0.1)
    headline, told = conclude(GIVEN_HIERARCHIES, lines)
    assert all("nothing is concluded" in sentence.lower() for sentence in (headline, *told))


def test_intervals_and_verdicts_agree():
    lines = make_lines({"maxq-q+planned": 0.15, "hamq+planned": 0.11, "": 0.1})
    lines = [dataclasses.replace(line, efficiency=line.efficiency + 0.05 * (-1) ** line.seed) for line in lines
             if line.agent != "q-learning"] + [line for line in lines if line.agent == "q-learning"]
    for contrasts in compare_controls(list_questions(GIVEN_HIERARCHIES), group(lines), ROOMS):
        for contrast in contrasts:
            assert (contrast.low > 0 or contrast.high < 0) == (contrast.is_better or contrast.is_worse)


def test_rooms_where_no_learner_escapes_are_named():
    lines = make_lines({"": 0.5}, study=INTRA_OPTION)
    said = "no learner escapes after training"
    assert f"In far and near {said}" in tell_page(INTRA_OPTION, [
        dataclasses.replace(line, progress=float(line.rooms == "far"), first_escape=3 + (line.rooms == "far"))
        for line in lines])
    assert said not in tell_page(INTRA_OPTION, [dataclasses.replace(line, escapes=1.0) for line in lines])


@pytest.mark.nightly
def test_another_truth_is_another_page():
    fast = [dataclasses.replace(line, episodes=3, first_escape=40) if line.agent == "hamq+planned" else line
            for line in make_lines({"maxq-q+planned": 0.2, "+planned": 0.5, "smdp": 0.5}, searcher=0.3)
            if line.agent != "h-dqn@table+planned" or (line.rooms, line.seed) != ("far", 9)]
    page = tell_page(GIVEN_HIERARCHIES, fast)
    assert "Not run: paper-two-button, four-button-chain, ten-button and arm-two-button." in page
    assert "- `maxq-q+planned` against `smdp-q-learning`: loses, -0.31 (" in page
    assert "- `maxq-q+planned` against the best searcher: loses, -0.10 (" in page
    assert "`h-dqn@table+planned` against" not in page, "a pair that lacks a run"
    assert "then three episodes of the frozen policy" in page
    assert page.index("![Efficiency") < page.index("**3 of 9 learners beat") < page.index("<details>")
    assert "Privileged" not in tell_page(GIVEN_HIERARCHIES, [line for line in fast if "+" not in line.agent])


def test_agents_on_given_hierarchies_learn_in_tables():
    for agent in (agent for agent in GIVEN_HIERARCHIES.grids[0].agents if agent.learns):
        settings = agent.resolve_settings()
        assert "hidden" not in settings or settings["values"] == "table", f"{agent.label} learns in a network"


def test_settings_that_are_no_defaults_are_those_that_the_page_names():
    assert not any(agent.settings for agent in GIVEN_HIERARCHIES.grids[0].agents)
    changed = {agent.algorithm: agent.settings for agent in LEARNED_HIERARCHIES.grids[0].agents if agent.settings}
    found = {name for name, settings in changed.items() if settings.get("rollout") == 32}
    search = {name for name, settings in changed.items() if settings == {"discover_every": 50}}
    assert found | search == set(changed)
    told = tell_page(LEARNED_HIERARCHIES, make_lines({}, 1, LEARNED_HIERARCHIES)).partition("All numbers")[2]
    assert all(f"`{name}`" in told.partition("learn from 32")[0] for name in found)
    assert all(f"`{name}`" in told.partition("learn from 32")[2].partition("every 50")[0] for name in search)


@pytest.mark.nightly_for("hierarchies")
@STUDIES
def test_rooms_have_one_start_and_no_chance_but_where_there_is_noise(study):
    grid = study.grids[0]
    for room in grid.rooms:
        instance = room.make_instance()
        assert len(instance.starts) == len(instance.puzzle.list_starts()) == 1
        assert instance.dynamics.is_random == ("-noise" in room.label)
    introduction = tell_page(study, make_lines({}, 1, study)).partition("All numbers")[2]
    assert ("noise" in introduction) == any("-noise" in room.label for room in grid.rooms)


@pytest.mark.parametrize("study", [LEARNED_HIERARCHIES, INTRA_OPTION], ids=lambda study: study.name)
def test_rooms_are_what_the_page_says(study):
    for room in study.grids[0].rooms:
        place, puzzle = room.make_place(), room.make_instance().puzzle
        _, buttons, rule, *_ = place.name.partition("#")[0].split("-")
        needy = [child for _, child in puzzle.edge_list]
        assert place.name == room.label
        assert (puzzle.count, puzzle.on_violation) == (int(buttons), rule)
        assert 1 <= max(map(needy.count, needy)) <= 2, "some button needs another"


def test_what_is_said_of_everybody_names_everybody():
    sources = {name: Path(find_spec(find_agent_module(name)).origin).read_text() for name in HIERARCHY_LEARNERS}
    readers = {name for name, source in sources.items() if "hrl_escape.agents.factored" in source}
    granted = tell_page(LEARNED_HIERARCHIES, make_lines({}, 1, LEARNED_HIERARCHIES)).partition("takes for granted.")[2]
    note = granted.partition("\n")[0]
    assert {name for name in HIERARCHY_LEARNERS if f"`{name}`" in note} == readers


@pytest.mark.parametrize(("study", "agent", "first"), [
    (GIVEN_HIERARCHIES, "hamq+planned", 36),
    pytest.param(LEARNED_HIERARCHIES, "smdp-hrc", 57, marks=pytest.mark.slow),
    pytest.param(INTRA_OPTION, "smdp-intra-option-q+reactive", None, marks=pytest.mark.slow)],
    ids=["given", "learned", "intra-option"])
def test_the_command_runs_and_writes_the_page_again_from_its_lines(study, agent, first, tmp_path: Path, monkeypatch,
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
    assert "nothing is concluded" in capsys.readouterr().out
    file = tmp_path / f"{study.name}.md"
    page, lines = file.read_text(), [line for line in load(study.name, tmp_path) if isinstance(line, BaselineRun)]
    assert {line.agent: line.first_escape for line in lines} == {agent: first, "oracle": None}
    assert ("Learned options on the dial" in page) == (study is LEARNED_HIERARCHIES)
    save(study.name, [dataclasses.replace(line, efficiency=0.5) for line in lines], tmp_path)
    assert main([*arguments, "--from-raw"]) == 0
    again = file.read_text()
    assert again != page and "0.500" in again
