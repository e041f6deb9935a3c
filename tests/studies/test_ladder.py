"""Baselines: lines that join, what the page calls mastered and passed, and a real run through the command line."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.benchmark.protocols import TOWER, compute_ladder_score
from hrl_escape.sets.benchmark import load_benchmark
from studies.__main__ import main
from studies.baseline import BaselineRun
from studies.ladder.analysis import describe
from studies.ladder.baselines import BaselineArgs, make_baseline_grids
from studies.ladder.calibration import CHANCE, IN_ORDER, KNOWN, ROUND
from studies.page import render
from studies.study import find_study
from tests.studies.pages import load, save

RUNGS_OF_TWO = ("doormat", "pair")
RUNGS = ("low", "middle", "high")
LINE = BaselineRun("per-instance", "low", "x/low/test#0", "dqn", 0, 1000, 0.8, None, 1.0, 5, 1.0, 70, "abc")


def tell(lines: list[BaselineRun], rungs: Sequence[str], noisy: Sequence[str] = ()) -> str:
    """Text of the page of lines on rungs of these names."""
    return render(find_study("ladder"), describe(lines, rungs, noisy))


def make_lines(rung: str, agent: str, efficiency: float, escapes: float, runs: int) -> list[BaselineRun]:
    return [dataclasses.replace(LINE, rung=rung, agent=agent, efficiency=efficiency, escapes=escapes, seed=seed)
            for seed in range(runs)]


def test_the_page_names_the_highest_rung_mastered_and_the_highest_that_enough_runs_prove():
    lines = [*make_lines("low", "dqn", 0.8, 1.0, 35), *make_lines("middle", "dqn", 0.6, 1.0, 34),
             *make_lines("high", "dqn", 0.49, 1.0, 1), *make_lines("low", "ppo", 0.9, 0.89, 2)]
    page = tell(lines, RUNGS)
    assert "| `dqn` | middle | low |" in page, "34 of 34 leave Wilson's interval below 0.9, 35 of 35 do not"
    assert "| `ppo` | none | none |" in page and "three-parents" not in page
    assert ("python -m studies ladder --protocol per-instance --rung low middle high --agents dqn ppo --runs 35 "
            "--rooms 1 --eval-episodes 5 --primitives 1000\n") in page
    assert "stays below 0.9. Some cells have only 1." in page
    assert "| `low` | **0.80** (35) | 0.90 (2) |" in page and "| `high` | 0.49 (1) | - |" in page
    assert "The highest rung that a learner masters is `middle`, by `dqn`" in page
    assert "cannot pass a rung" not in tell(make_lines("low", "dqn", 0.8, 1.0, 35), RUNGS)


@pytest.mark.parametrize(("efficiency", "runs", "sentence"), [
    (0.95, 9, "No learner is shown to master a rung: none has 10 runs on one"),
    (0.95, 10, "The highest rung that a learner masters is `high`, by `dqn`"),
    (0.45, 10, "No learner is shown to master a rung."),
])
def test_few_runs_lead_to_no_conclusion(efficiency: float, runs: int, sentence: str):
    assert sentence in tell(make_lines("high", "dqn", efficiency, 1.0, runs), RUNGS)


def make_cells(curves: dict[str, list[float]], primitives: int = 0) -> list[BaselineRun]:
    """Ten rooms of each rung, whose efficiencies differ a little."""
    return [dataclasses.replace(LINE, rung=rung, agent=agent, efficiency=round(value + 0.001 * number, 3),
                                                rooms=f"x/{rung}/test#{number}", primitives=primitives)
            for agent, curve in curves.items() for rung, value in zip(RUNGS, curve, strict=True)
            for number in range(10)]


SOUND = {CHANCE: [0.4, 0.3, 0.1], KNOWN: [1.0, 1.0, 1.0], IN_ORDER: [0.5, 0.4, 0.2], ROUND: [0.51, 0.41, 0.21]}
ALL = "stay below an efficiency of 0.5 on 3 of 3 rungs."


@pytest.mark.nightly
@pytest.mark.nightly_for(
    "references3-learner3-noisy3-told3", "references4-learner4-noisy4-told4", "references6-learner6-noisy6-told6",
    "references0-learner0-noisy0-told0", "references1-learner1-noisy1-told1", "references2-learner2-noisy2-told2",
    "references5-learner5-noisy5-told5")
@pytest.mark.parametrize(("references", "learner", "noisy", "told"), [
    ({}, [1.0, 0.5, 0.0], (), [ALL, "order of what chance reaches: it falls from each to the next.",
                               "as efficient as possible on 3 of 3 rungs.", "on none of 3 rungs",
                               "No learner falls from above 0.9 on one rung to below 0.1"]),
    ({CHANCE: [0.8, 0.3, 0.1]}, [1.0, 0.05, 0.0], (),
     ["on 2 of 3 rungs, but not on `low` (0.80).", "The fall is not smooth: smdp-dqn falls from 1.00 on low to 0.05"]),
    ({CHANCE: [0.3, 0.4, 0.1]}, [0.2, 0.1, 0.0], (),
     ["not in the order of what chance reaches: `middle` (0.40) after `low` (0.30)."]),
    ({CHANCE: [0.401, 0.4, 0.1]}, [0.2, 0.1, 0.0], (),
     ["No rung is shown to be out of the order of what chance reaches: it falls from `middle` to `high`, and no "
      "difference is shown on 1 of 2 steps"]),
    ({CHANCE: [0.3, 0.302, 0.301]}, [0.2, 0.1, 0.0], (),
     ["No rung is shown to be out of the order of what chance reaches: no difference is shown on 2 of 2 steps"]),
    ({KNOWN: [1.0, 1.0, 0.96]}, [0.2, 0.1, 0.0], (), ["as possible on 2 of 3 rungs, but not on `high` (0.96)"]),
    ({KNOWN: [1.0, 1.0, 0.96]}, [0.2, 0.1, 0.0], ("high",), ["as efficient as possible on 3 of 3 rungs."]),
    ({IN_ORDER: [0.5, 0.6, 0.2]}, [0.2, 0.1, 0.0], (), ["a random order on `middle` (by 0.19), so numbers say"]),
])
def test_calibration_tells_what_the_lines_say(references: dict, learner: list, noisy: tuple, told: list):
    lines = [*make_cells({**SOUND, **references}), *make_cells({"smdp-dqn": learner}, 1000)]
    page = tell(lines, RUNGS, noisy)
    assert not [words for words in told if words not in page], page
    assert "Open, for want of runs" not in page
    assert "Open, for want of runs: `top`." in tell(lines, (*RUNGS, "top"), noisy)
    page = tell([line for line in lines if not line.rooms.endswith("#9")], RUNGS)
    assert "**Calibration**" not in page and "Ladder score" not in page, "nine rooms are too few"


def test_learners_that_fall_are_told_beside_those_that_do_not():
    learners = {"smdp-dqn": [1.0, 0.05, 0.0], "smdp-ppo": [1.0, 0.5, 0.0], "smdp-sarsa": [0.9, 0.3, 0.0]}
    page = tell([*make_cells(SOUND), *make_cells(learners, 1000)], RUNGS)
    assert ("Of 3 learners 2 never fall from above 0.9 on one rung to below 0.1 on the next that they were run on: "
            "`smdp-ppo` and `smdp-sarsa`.\n") in page
    assert "The fall is not smooth: smdp-dqn falls from 1.00 on low to 0.05 on middle.\n" in page


def test_the_rungs_that_come_with_the_package_are_calibrated_by_their_published_runs():
    page = (Path(__file__).parents[2] / "docs" / "results" / "ladder.md").read_text()
    for sentence in ("No rung is shown to be out of the order of what chance reaches", "on 18 of 18 rungs."):
        assert sentence in page
    smooth = re.search(r"(?:No learner falls|\w+ never fall) from above 0.9 on .* run on: (.*)\.\n", page)
    assert smooth is not None and smooth[1].count("`smdp-") >= 3, "three learners at least fall off step by step"


def test_runs_in_one_room_are_one_room_to_the_tests():
    """Four rooms with ten seeds each: 40 runs that differ as their rooms do say no more than these four do."""
    luck = (0.2, 0.25, 0.3, -0.35)
    lines = [dataclasses.replace(LINE, rung=rung, agent=agent, rooms=f"x/{rung}/test#{number}", seed=seed,
                                 primitives=0, efficiency=0.5 + (1 if agent in better else -1) * gain / 2)
             for rung, better in (("low", (CHANCE, IN_ORDER)), ("middle", (IN_ORDER,)))
             for agent in (CHANCE, IN_ORDER, ROUND) for number, gain in enumerate(luck) for seed in range(10)]
    page = tell(lines, RUNGS)
    assert "no difference is shown on 1 of 1 step" in page and "on none of 2 rungs (paired by room, Holm)" in page


@pytest.mark.nightly
def test_of_a_learner_on_one_rung_no_fall_is_denied():
    once = [line for line in make_cells({"smdp-ppo": [1.0, 1.0, 1.0]}, 1000) if line.rung == "low"]
    for others, told in (({}, False), ({"smdp-dqn": [1.0, 0.5, 0.0]}, True)):
        page = tell([*make_cells(SOUND), *once, *make_cells(others, 1000)], RUNGS)
        assert ("No learner falls" in page) is told and ("that it was run on: `smdp-dqn`.\n" in page) is told


def test_agents_over_options_and_over_primitives_have_tables_of_their_own():
    flat = {"random": [0.1, 0.0, 0.0], "ppo": [1.0, 0.0, 0.0]}
    lines = [*make_cells(SOUND), *make_cells({"smdp-ppo": [0.8, 0.5, 0.2]}, 1000), *make_cells(flat, 1000)]
    options, primitives, calibration = re.split(r"\n\*\*(?=Over |Calibration\*\*)", tell(lines, RUNGS))[1:]
    assert options.startswith("Over options**\n\n| rung | ") and "| `oracle` | `smdp-ppo` |" in options
    assert primitives.startswith("Over primitives**\n\n| rung | `random` | `ppo` |") and "smdp" not in primitives
    assert "| `low` | 0.10 (10) | **1.00** (10) |" in primitives and primitives.count("Ladder score") == 1
    assert "to below 0.1 on the next that it was run on: `smdp-ppo`." in calibration, "flat agents ask another question"
    assert "--agents random ppo --runs 1" in calibration and "planner smdp-ppo" not in calibration
    assert "**Over" not in tell(make_cells(flat, 1000), RUNGS)


@pytest.mark.nightly
def test_ladder_scores_are_over_the_largest_table_without_gaps():
    lines = [*make_cells(SOUND), *make_cells({"smdp-dqn": [0.9, 0.6, 0.0]}, 1000),
             *(line for line in make_cells({"smdp-ppo": [1.0, 1.0, 1.0]}, 1000) if line.rung == "low")]
    page = tell(lines, RUNGS)
    assert "the mean of the efficiency over `low`, `middle` and `high`" in page
    units = [[np.array([run.efficiency]) for run in lines if (run.agent, run.rung) == ("smdp-dqn", rung)]
             for rung in RUNGS]
    score = compute_ladder_score(units, np.random.default_rng(0))
    assert f"| `smdp-dqn` | 0.50 | {score.low:.2f} to {score.high:.2f} |" in page
    assert "| `smdp-ppo` | 1.00 |" not in page, "on one rung only"
    assert ("less than the rung's own budget on `low` (100,000), `middle` (100,000) and `high` (100,000); "
            "[learners with these budgets](budgets.md)") in page
    longer = [dataclasses.replace(line, primitives=100 * line.primitives) for line in lines]
    assert "less than the rung\'s own" not in tell(longer, RUNGS)


def test_whole_cells_come_first_and_grids_of_more_agents_and_seeds_hold_the_runs_of_those_before():
    args = BaselineArgs(rung=RUNGS_OF_TWO, protocol=("per-instance",), agents=("dqn", "oracle", "ppo"), rooms=2,
                        runs=2, primitives=5000, first_seed=100)
    grids = list(make_baseline_grids(load_benchmark("ladder-1"), args))
    assert all(len(grid.rooms) == 2 and grid.first_seed == 100 for _, grid in grids)
    alone, both = ["dqn"], ["dqn", "ppo"]
    assert [(place.rung, [agent.label for agent in grid.agents], grid.runs) for place, grid in grids] == [
        (rung, agents, runs) for runs in (1, 2) for agents in (["oracle"], alone, both) for rung in RUNGS_OF_TWO]
    assert {grid.primitives for place, grid in grids if place.kind == "learners"} == {5000}
    assert {grid.primitives for place, grid in grids if place.kind == "references"} == {100}, "nothing is to be learned"
    keys = [{run.folder for run in grid.make_runs(grid.make_places())} for place, grid in grids
            if place.rung == "doormat" and place.kind == "learners"]
    assert keys[0] < keys[1] < keys[3] and keys[0] < keys[2] < keys[3]


def test_the_page_says_what_an_agent_with_three_parents_is_told():
    agents = [f"smdp-factored-r-max{named}" for named in ("", "@three-parents")]
    lines = [line for agent, value in zip(agents, (0.4, 0.9), strict=True)
             for line in make_lines("high", agent, value, 1.0, 10)]
    page = tell(lines, RUNGS)
    assert "`@three-parents`: told that up to three buttons may have to be on together" in page
    assert f"| rung | `{agents[0]}` | `{agents[1]}` |" in page and f"masters is `high`, by `{agents[1]}`." in page


@pytest.mark.nightly
def test_a_tower_has_a_section_of_its_own_and_counts_in_no_rung():
    rooms = "x/low/train#0..64 and 2 more > x/low/test#0..3 and 2 more"
    runs = [dataclasses.replace(LINE, protocol=TOWER, rung=TOWER, rooms=rooms, agent=agent, seed=seed, episodes=3,
                                primitives=0, efficiency=value, escapes=climbed)
            for agent, value, climbed in ((CHANCE, 0.125, 1 / 3), (KNOWN, 1.0, 1.0)) for seed in range(2)]
    lines = make_cells(SOUND)
    page = tell([*lines, *runs], RUNGS)
    assert f"| `{KNOWN}` | 2 | 0 | 1.00 | 100% |\n| `{CHANCE}` | 2 | 0 | 0.12 | 33% |" in page
    assert "one episode of 20,000 primitives: x/low/test#0..3 and 2 more." in page
    assert f"--protocol tower --agents {KNOWN} {CHANCE} --runs 2 --rooms 3\n" in page
    trained = [dataclasses.replace(run, agent="dqn", primitives=budget) for run in runs[:1] for budget in (500, 900)]
    assert "--runs 2 --rooms 3 --primitives 900\n" in (text := tell([*lines, *runs, *trained], RUNGS))
    assert "Learners train for 900 primitives, less than the tower's own 100,000." in text
    enough = [dataclasses.replace(trained[0], seed=seed, primitives=100_000) for seed in range(10)]
    assert "Nothing is concluded" in page and "Learners train" not in page[page.index("<details><summary>tower"):]
    assert "Nothing is concluded" not in (text := tell(enough, RUNGS)) and "less than" not in text
    start = page.index("<details><summary>tower")
    assert page[:start] + page[page.index("```console\npython", page.index("--rooms 3")):] == tell(lines, RUNGS)


def test_a_tower_s_grids_have_the_rungs_as_floors():
    args = BaselineArgs(rung=RUNGS_OF_TWO, protocol=(TOWER,), rooms=2, runs=1)
    grids = list(make_baseline_grids(load_benchmark("ladder-1"), args))
    assert [(place.rung, place.kind, len(grid.agents)) for place, grid in grids] == [
        (TOWER, kind, count) for kind, most in (("references", 3), ("learners", 2)) for count in range(1, most + 1)]
    (place,) = grids[-1][1].make_places()
    assert [floor.name for floor in place.split.test.sets] == [f"ladder-1/{rung}/test#0..2" for rung in RUNGS_OF_TWO]


def test_baselines_run_join_what_is_there_and_need_no_runs_for_the_page(tmp_path: Path, capsys):
    docs = tmp_path / "docs"
    save("ladder", make_lines("pair", "smdp-sarsa", 1.0, 1.0, 1), docs)
    command = ["ladder", "--rung", "doormat", "--protocol", "per-instance", "--rooms", "1", "--runs", "1",
               "--primitives", "200", "--eval-episodes", "1", "--agents", "smdp-q-learning", "oracle",
               "--workers", "1", "--out", str(tmp_path / "runs"), "--docs", str(docs)]
    assert main(command) == 0
    assert "0 runs are left" in capsys.readouterr().out
    lines = {line.agent: line for line in load("ladder", docs)}
    assert set(lines) == {"smdp-q-learning", "oracle", "smdp-sarsa"}
    assert lines["oracle"].efficiency == 1.0 and lines["oracle"].primitives == 0
    page = (docs / "ladder.md").read_text()
    (docs / "ladder.md").unlink()
    assert main(["ladder", "--from-raw", "--docs", str(docs)]) == 0
    assert (docs / "ladder.md").read_text() == page


@pytest.mark.parametrize(("learner", "nearest", "finding"), [
    (0.9, 0.7, "**1 of 1 learners beat the best searcher that learns nothing: `smdp-dqn` (+0.20, +0."),
    (0.6, 0.7, "**No learner is shown to beat the best searcher that learns nothing over the rungs that it was run"),
])
def test_learners_are_held_against_the_best_searcher(learner: float, nearest: float, finding: str):
    def make(agent: str, efficiency: float, primitives: int) -> list[BaselineRun]:
        return [dataclasses.replace(LINE, rung=rung, rooms=f"x/{rung}/test#{room}", agent=agent, primitives=primitives,
                                    efficiency=efficiency + 0.01 * ((3 * room + primitives // 500) % 10))
                for rung in RUNGS[:2] for room in range(10)]

    lines = [*make("smdp-dqn", learner, 1000), *make(CHANCE, 0.1, 0), *make(ROUND, nearest - 0.3, 0),
             *make("search-nearest", nearest, 0)]
    page = tell(lines, RUNGS)
    assert finding in page and "80 % power to detect a gain of 0.0" in page
    assert "is the best searcher that learns nothing, and not chance or a round in the order of the numbers" in page
    lucky = [dataclasses.replace(line, efficiency=0.95) if line.agent == CHANCE and line.rung == RUNGS[1] else line
             for line in lines]
    told = tell(lucky, RUNGS)
    assert f"and `{CHANCE}`, which does better there, on `{RUNGS[1]}`; the columns stand in the table" in told
    alone = [line for line in lines if line.agent in (CHANCE, "smdp-dqn")]
    assert "Nothing is concluded, as no learner has 10 rooms on a rung beside a searcher" in tell(alone, RUNGS)


@pytest.mark.nightly
def test_who_plays_as_chance_does_is_said_to_have_no_model():
    lines = [dataclasses.replace(LINE, rung=RUNGS[0], rooms=f"test#{room}", agent=agent, primitives=primitives,
                                 efficiency=0.1 + 0.01 * room, escapes=0.4)
             for agent, primitives in ((CHANCE, 0), ("smdp-dqn", 1_000)) for room in range(10)]
    said = f"`smdp-dqn` has no model on `{RUNGS[0]}`: after training it plays every episode as `{CHANCE}"
    assert said in tell(lines, RUNGS)
    assert said not in tell([*lines[:-1], dataclasses.replace(lines[-1], efficiency=0.2)], RUNGS), "one room differs"
    never = [dataclasses.replace(line, efficiency=0.0, escapes=0.0) for line in lines]
    assert said not in tell(never, RUNGS), "who never escapes is not said to play alike"
