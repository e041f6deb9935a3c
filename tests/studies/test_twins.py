"""Studies of twins, of hierarchies and of learning inside options: what their pages say follows from the lines."""

from __future__ import annotations

import dataclasses
from importlib.util import find_spec
from pathlib import Path

import pytest

from hrl_escape.agents.registry import find_agent_module
from hrl_escape.synthesis.kinds import KINDS
from studies.__main__ import main
from studies.baseline import BaselineRun
from studies.learned.dial import DialLine
from studies.page import render
from studies.study import Study, find_study
from studies.twins import analyse, compare_twins, conclude_contrasts, list_questions
from tests.studies.pages import load, save

GIVEN_HIERARCHIES, LEARNED_HIERARCHIES, INTRA_OPTION = map(find_study, ("hierarchies", "learned", "intra-option"))
HIERARCHY_LEARNERS = [agent.algorithm for agent in LEARNED_HIERARCHIES.grids[0].agents if agent.learns]
ROOMS = ("near", "far")
STUDIES = pytest.mark.parametrize("study", [GIVEN_HIERARCHIES, LEARNED_HIERARCHIES, INTRA_OPTION],
                                  ids=lambda study: study.name)
LINE = BaselineRun("per-instance", "hierarchies", "near", "", 0, 1_000, 0.0, None, 0.0, 1, 0.0, None, "abc")


def make_lines(better: dict[str, float], runs: int = 10, study=GIVEN_HIERARCHIES) -> list[BaselineRun]:
    """Efficiencies by a part of the label, and 0 for the rest; who escapes at all does so after 100 primitives."""
    learners = [agent.label for agent in study.grids[0].agents if agent.learns]
    found = {label: next((score for part, score in better.items() if part in label), 0.0) for label in learners}
    return [dataclasses.replace(LINE, rooms=room, agent=label, seed=seed, efficiency=score * (1 + seed / 100),
                                first_escape=100 if score else None)
            for room in ROOMS for label, score in found.items() for seed in range(runs)]


DIAL = [DialLine("room", option, 0, failure, 0, 0.5)
        for option, failure in (("planned", 0.0), ("planned", 1.0), ("learned", None))]


def tell_page(study: Study, lines: list[BaselineRun]) -> str:
    if study is LEARNED_HIERARCHIES:
        return render(study, study.analysis.analyse(study, [*lines, *DIAL]))
    return render(study, analyse(study, lines))


@STUDIES
def test_every_learner_of_the_grid_is_asked_about_or_a_twin_and_nobody_else(study):
    grid = study.grids[0]
    asked = {label for question in list_questions(study) for pair in question.pairs for label in pair}
    assert asked == {agent.label for agent in grid.agents if agent.learns}


def test_questions_ask_about_every_hierarchy():
    assert [len(question.pairs) for question in list_questions(GIVEN_HIERARCHIES)] == [len(KINDS)] * 3
    asked = sum(len(question.pairs) for question in list_questions(LEARNED_HIERARCHIES)[:3])
    assert asked == len(HIERARCHY_LEARNERS) - 3, "all but three twins"


@pytest.mark.parametrize(("better", "structure", "planned", "beside"), [
    ({"+planned": 0.9, "smdp": 0.5}, "no hierarchy is shown to do better in any of 2 rooms",
     "at least one hierarchy does better in 2 of 2 rooms", "at least one hierarchy does better in 2 of 2 rooms"),
    ({"+learned": 0.5, "+planned": 0.5, "smdp": 0.9}, "at least one hierarchy does better in 2 of 2 rooms",
     "no hierarchy is shown to do better in any of 2 rooms",
     "no hierarchy is shown to do better in any of 2 rooms, and at least one does worse in 2"),
    ({"+learned": 0.9, "+planned": 0.2, "q-learning": 0.2}, "at least one hierarchy does better in 2 of 2 rooms",
     "no hierarchy is shown to do better in any of 2 rooms, and at least one does worse in 2",
     "no hierarchy is shown to do better in any of 2 rooms"),
])
def test_another_truth_is_another_conclusion(better, structure, planned, beside):
    lines = make_lines(better)
    assert [sentence.split(": ")[1] for sentence in conclude(GIVEN_HIERARCHIES, lines)] == [
        f"{said}." for said in (structure, planned, beside)]


@pytest.mark.parametrize(("better", "tables", "networks", "structure", "ways"), [
    ({"r-max": 0.2, "option-critic": 0.5, "q-learning": 0.4},
     "at least one learner of options does better in 2 of 2 rooms, and at least one does worse in 2",
     "no learner of options is shown to do better in any of 2 rooms",
     "no learner of structure is shown to do better in any of 2 rooms, and at least one does worse in 2",
     "no other way is shown to do better in any of 2 rooms, and at least one does worse in 2"),
    ({"hrc": 0.9, "-r-max": 0.5, "ppo+": 0.5, "ppoc": 0.6, "dac": 0.5, "a2oc": 0.5, "diayn": 0.5},
     "no learner of options is shown to do better in any of 2 rooms",
     "at least one learner of options does better in 2 of 2 rooms",
     "at least one learner of structure does better in 2 of 2 rooms, and at least one does worse in 2",
     "at least one other way does better in 2 of 2 rooms, and at least one does worse in 2"),
])
def test_another_truth_about_learned_hierarchies_is_another_conclusion(better, tables, networks, structure, ways):
    found = conclude(LEARNED_HIERARCHIES, make_lines(better, study=LEARNED_HIERARCHIES))
    assert [sentence.split(": ")[1] for sentence in found] == [f"{said}." for said in
                                                               (tables, networks, structure, ways)]


@pytest.mark.parametrize(("better", "functions", "plans", "instead"), [
    ({"intra-option-q+markov": 0.9}, "`intra-option-q` does better in 2 of 2 rooms",
     "`intra-option-q` is not shown to do better in any of 2 rooms",
     "at least one learner does better in 2 of 2 rooms"),
    ({"intra-option-q+markov": 0.5, "q-learning+markov": 0.9, "intra": 0.8, "": 0.7},
     "`intra-option-q` is not shown to do better in any of 2 rooms, and does worse in 2",
     "`intra-option-q` does better in 2 of 2 rooms",
     "at least one learner does better in 2 of 2 rooms, and at least one does worse in 2"),
    ({"": 0.5}, *["`intra-option-q` is not shown to do better in any of 2 rooms"] * 2,
     "no learner is shown to do better in any of 2 rooms"),
])
def test_another_truth_about_learning_inside_options_is_another_conclusion(better, functions, plans, instead):
    found = conclude(INTRA_OPTION, make_lines(better, study=INTRA_OPTION))
    assert [sentence.split(": ")[1] for sentence in found] == [f"{said}." for said in (functions, plans, instead)]


def conclude(study, lines):
    return conclude_contrasts(study, compare_twins(study, lines), lines)


def test_nothing_is_concluded_from_nine_runs():
    lines = make_lines({"+planned": 0.9, "smdp": 0.5}, runs=9)
    assert not any(contrast.is_shown for contrast in compare_twins(GIVEN_HIERARCHIES, lines))
    assert all("nothing is concluded" in sentence for sentence in conclude(GIVEN_HIERARCHIES, lines))
    lines += [line for line in make_lines({"+planned": 0.9}) if (line.rooms, line.seed) == (ROOMS[0], 9)]
    assert "does better in 1 room, near." in conclude(GIVEN_HIERARCHIES, lines)[1]
    assert "no hierarchy is shown to do better in the one room, near." in conclude(GIVEN_HIERARCHIES, lines)[0]


def test_findings_name_room_and_size():
    slow = [dataclasses.replace(line, first_escape=400) if line.agent == "maxq-q+planned" else line
            for line in make_lines({"+planned": 0.5, "smdp": 0.5})]
    page = tell_page(GIVEN_HIERARCHIES, slow)
    assert "**Structure alone: no hierarchy is shown to do better in any of 2 rooms." in page
    assert page.count("| `maxq-q+planned` | 10 | 0.5") == 2
    assert "- `maxq-q+planned`: escapes later in far (by 300 primitives), near (by 300 primitives)." in page
    assert "- `hamq+planned`: no difference is shown." in page and "`hamq+planned` (program, state, planner)" in page
    assert "then one episode of the frozen policy" in page and "Left out of the conclusion" not in page


def test_rooms_where_nobody_escapes_are_named_in_the_questions_that_they_cannot_answer():
    def tell(escapes: dict[tuple[str, str], float]) -> list[str]:
        lines = [dataclasses.replace(line, escapes=escapes.get((line.rooms, line.agent), 0.0))
                 for line in make_lines({"": 0.5}, study=INTRA_OPTION)]
        questions = tell_page(INTRA_OPTION, lines).split("\n## ")[1:4]
        return [text.partition("none of these")[0].rpartition("\nIn ")[2] for text in questions if "none of" in text]

    assert tell({}) == ["far and near "] * 3
    assert tell({("near", "smdp-intra-option-q+no-primitives"): 0.1}) == ["far and near ", "far ", "far "]
    assert tell({(room, f"smdp-q-learning{markov}+no-primitives"): 1.0 for room in ROOMS
                 for markov in ("", "+markov")}) == []


def test_another_truth_is_another_page():
    fast = [dataclasses.replace(line, episodes=3, first_escape=40) if line.agent == "hamq+planned" else line
            for line in make_lines({"maxq-q+planned": 0.2, "+planned": 0.5, "smdp": 0.5})
            if line.agent != "h-dqn@table+planned" or (line.rooms, line.seed) != ("far", 9)]
    page = tell_page(GIVEN_HIERARCHIES, fast)
    assert "Not run: paper-two-button, four-button-chain, ten-button and arm-two-button." in page
    beside = page.partition("## Structure where a planner walks anyway")[2]
    assert "- `maxq-q+planned`: less efficient in far (-0.31), near (-0.31)." in beside
    assert "- `hamq+planned`: escapes sooner in far (by 60 primitives), near (by 60 primitives)." in beside
    assert "- `maxq-q+planned`: more efficient in far (+0.21), near (+0.21); escapes sooner in far (by 900" in page
    left_out = "Left out of the conclusion, as not all of these agents have 10 runs there: far."
    assert page.count(left_out) == 2, "of the questions that it is a part of"
    assert "then three episodes of the frozen policy" in page
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
    told = tell_page(LEARNED_HIERARCHIES, make_lines({}, 1, LEARNED_HIERARCHIES)).partition("\n## ")[0]
    assert all(f"`{name}`" in told.partition("learn from 32")[0] for name in found)
    assert all(f"`{name}`" in told.partition("learn from 32")[2].partition("every 50")[0] for name in search)


@STUDIES
def test_rooms_have_one_start_and_no_chance_but_where_there_is_noise(study):
    grid = study.grids[0]
    for room in grid.rooms:
        instance = room.make_instance()
        assert len(instance.starts) == len(instance.puzzle.list_starts()) == 1
        assert instance.dynamics.is_random == ("-noise" in room.label)
    introduction = tell_page(study, make_lines({}, 1, study)).partition("\n## ")[0]
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
    (GIVEN_HIERARCHIES, "hamq+planned", 36), (LEARNED_HIERARCHIES, "smdp-hrc+no-primitives", 57),
    (INTRA_OPTION, "smdp-intra-option-q+markov+no-primitives", None)], ids=["given", "learned", "intra-option"])
def test_the_command_runs_and_writes_the_page_again_from_its_lines(study, agent, first, tmp_path: Path, monkeypatch,
                                                                   capsys):
    grid = study.grids[0]
    agents = tuple(spec for spec in grid.agents if spec.label in (agent, "planner"))
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
    assert {line.agent: line.first_escape for line in lines} == {agent: first, "planner": None}
    assert ("Learned options on the dial" in page) == (study is LEARNED_HIERARCHIES)
    save(study.name, [dataclasses.replace(line, efficiency=0.5) for line in lines], tmp_path)
    assert main([*arguments, "--from-raw"]) == 0
    again = file.read_text()
    assert again != page and "0.500" in again
