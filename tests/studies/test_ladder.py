"""Baselines of the ladder: comparisons of known lines, and a real run through the command line."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.benchmark.protocols import SEQUENCE
from hrl_escape.benchmark.standings import compute_ladder_score
from hrl_escape.sets.benchmark import load_benchmark
from studies.__main__ import main
from studies.baseline import BaselineRun
from studies.ladder.analysis import describe
from studies.ladder.baselines import BaselineArgs, make_baseline_grids
from studies.ladder.calibration import CHANCE, IN_ORDER, KNOWN, ROUND
from tests.studies.lines import load, save

RUNGS_OF_TWO = ("doormat", "pair")
RUNGS = ("low", "middle", "high")
LINE = BaselineRun("per-instance", "low", "x/low/test#0", "dqn", 0, 1000, 0.8, None, 1.0, 5, 1.0, 70, "abc")


def make_lines(rung: str, agent: str, efficiency: float, escapes: float, runs: int) -> list[BaselineRun]:
    return [dataclasses.replace(LINE, rung=rung, agent=agent, efficiency=efficiency, escapes=escapes, seed=seed)
            for seed in range(runs)]


def make_cells(curves: dict[str, list[float]], primitives: int = 0) -> list[BaselineRun]:
    """Ten rooms of each rung, with slightly different efficiencies."""
    return [dataclasses.replace(LINE, rung=rung, agent=agent, efficiency=round(value + 0.001 * number, 3),
                                rooms=f"x/{rung}/test#{number}", primitives=primitives)
            for agent, curve in curves.items() for rung, value in zip(RUNGS, curve, strict=True)
            for number in range(10)]


SOUND = {CHANCE: [0.4, 0.3, 0.1], KNOWN: [1.0, 1.0, 1.0], IN_ORDER: [0.5, 0.4, 0.2], ROUND: [0.51, 0.41, 0.21]}


def test_tables_mark_mastered_rungs_and_a_rung_needs_escapes_and_efficiency():
    lines = [*make_lines("low", "smdp-dqn", 0.8, 1.0, 35), *make_lines("high", "smdp-dqn", 0.49, 1.0, 10),
             *make_lines("low", "smdp-ppo", 0.9, 0.89, 10)]
    found = describe(lines, RUNGS)
    assert found.numbers.mastered == {"smdp-dqn": ["low"], "smdp-ppo": []}
    assert "| rung | DQN over options | PPO over options |" in found.tables["ladder"]
    assert "| `low` | **0.80** (35) | 0.90 (10) |" in found.tables["ladder"]
    assert "| `high` | 0.49 (10) | - |" in found.tables["ladder"]


@pytest.mark.parametrize(("chance", "rises", "falls"), [
    ([0.4, 0.3, 0.1], 0, 2), ([0.3, 0.4, 0.1], 1, 1), ([0.401, 0.4, 0.1], 0, 1), ([0.3, 0.302, 0.301], 0, 0)])
def test_neighbouring_rungs_are_compared_by_random_options(chance: list[float], rises: int, falls: int):
    steps = describe(make_cells({**SOUND, CHANCE: chance}), RUNGS).numbers.steps
    shown = [step.change for step in steps if step.p < 0.05]
    assert (sum(change > 0 for change in shown), sum(change < 0 for change in shown)) == (rises, falls)


def test_sweeps_in_the_order_of_the_numbers_are_compared_with_random_orders():
    orders = describe(make_cells({**SOUND, IN_ORDER: [0.5, 0.6, 0.2]}), RUNGS).numbers.orders
    assert [rung for rung, (gain, p) in orders.items() if p < 0.05 and gain > 0] == ["middle"]
    assert orders["middle"][0] == pytest.approx(0.19)


def test_runs_in_one_room_are_one_room_to_the_tests():
    """Four rooms with ten seeds each: 40 runs that differ as their rooms do hold as much as four."""
    luck = (0.2, 0.25, 0.3, -0.35)
    lines = [dataclasses.replace(LINE, rung=rung, agent=agent, rooms=f"x/{rung}/test#{number}", seed=seed,
                                 primitives=0, efficiency=0.5 + (1 if agent in better else -1) * gain / 2)
             for rung, better in (("low", (CHANCE, IN_ORDER)), ("middle", (IN_ORDER,)))
             for agent in (CHANCE, IN_ORDER, ROUND) for number, gain in enumerate(luck) for seed in range(10)]
    numbers = describe(lines, RUNGS).numbers
    assert len(numbers.steps) == 1 and numbers.steps[0].p > 0.05
    assert len(numbers.orders) == 2 and all(p > 0.05 for _, p in numbers.orders.values())


def test_agents_over_options_and_over_primitives_have_tables_of_their_own():
    found = describe([*make_cells({"smdp-ppo": [0.9, 0.8, 0.7]}, 1000), *make_cells({"ppo": [0.2, 0.1, 0.0]}, 1000)],
                     RUNGS)
    assert "| rung | PPO |" in found.tables["ladder_moves"] and "| rung | PPO over options |" in found.tables["ladder"]
    assert set(found.numbers.means) == {"smdp-ppo"}


def test_ladder_scores_are_over_the_largest_table_without_gaps():
    curves = {"smdp-dqn": [0.9, 0.7, 0.5], "smdp-ppo": [0.8, 0.6, 0.4]}
    lines = [line for line in make_cells(curves, 1000) if (line.agent, line.rung) != ("smdp-ppo", "high")]
    found = describe(lines, RUNGS)
    assert found.numbers.score_rungs == ["low", "middle"]
    score = compute_ladder_score([[np.array([0.9 + 0.001 * number]) for number in range(10)],
                                  [np.array([0.7 + 0.001 * number]) for number in range(10)]],
                                 np.random.default_rng(0))
    assert f"| DQN over options | {score.value:.2f} | {score.low:.2f} to {score.high:.2f} |" in found.tables[
        "ladder_scores"]


def test_a_sequence_counts_in_no_rung():
    sequence = [dataclasses.replace(line, protocol=SEQUENCE, rung=SEQUENCE)
                for line in make_lines("low", CHANCE, 0.3, 0.5, 2)]
    found = describe([*make_cells(SOUND), *sequence], RUNGS)
    assert found.numbers.rungs == list(RUNGS) and found.numbers.sequence == 2
    assert "(2) |" in found.tables["ladder_sequences"]


def compare(learner: float, nearest: float) -> dict[str, int]:
    """Sign of each learner's difference from the search baselines."""
    def make(agent: str, efficiency: float, primitives: int) -> list[BaselineRun]:
        return [dataclasses.replace(LINE, rung=rung, rooms=f"x/{rung}/test#{room}", agent=agent, primitives=primitives,
                                    efficiency=efficiency + 0.01 * ((3 * room + primitives // 500) % 10))
                for rung in RUNGS[:2] for room in range(10)]

    lines = [*make("smdp-dqn", learner, 1000), *make(CHANCE, 0.1, 0), *make(ROUND, nearest - 0.3, 0),
             *make("search-nearest", nearest, 0)]
    beyond = describe(lines, RUNGS).numbers.beyond
    assert {own.rungs for own in beyond.values()} == {2}
    return {agent: own.found.sign for agent, own in beyond.items()}


def test_learners_are_compared_with_the_best_search_baseline():
    assert compare(0.9, 0.7) == {"smdp-dqn": 1} and compare(0.6, 0.7) == {"smdp-dqn": -1}
    alone = make_cells({CHANCE: [0.1, 0.1, 0.1]}) + make_cells({"smdp-dqn": [0.9, 0.9, 0.9]}, 1000)
    assert not describe(alone, RUNGS).numbers.beyond


def test_a_learner_that_acts_as_random_options_do_is_found():
    lines = [dataclasses.replace(LINE, rung=RUNGS[0], rooms=f"test#{room}", agent=agent, primitives=primitives,
                                 efficiency=0.1 + 0.01 * room, escapes=0.4)
             for agent, primitives in ((CHANCE, 0), ("smdp-dqn", 1_000)) for room in range(10)]
    assert describe(lines, RUNGS).numbers.blank == {"smdp-dqn": [RUNGS[0]]}
    assert not describe([*lines[:-1], dataclasses.replace(lines[-1], efficiency=0.2)], RUNGS).numbers.blank
    never = [dataclasses.replace(line, efficiency=0.0, escapes=0.0) for line in lines]
    assert not describe(never, RUNGS).numbers.blank, "a learner that never escapes is not counted"


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


def test_grids_of_a_sequence_have_all_rungs():
    args = BaselineArgs(rung=RUNGS_OF_TWO, protocol=(SEQUENCE,), rooms=2, runs=1)
    grids = list(make_baseline_grids(load_benchmark("ladder-1"), args))
    assert [(place.rung, place.kind, len(grid.agents)) for place, grid in grids] == [
        (SEQUENCE, kind, count) for kind, most in (("references", 3), ("learners", 2)) for count in range(1, most + 1)]
    (place,) = grids[-1][1].make_places()
    assert [floor.name for floor in place.split.test.sets] == [f"ladder-1/{rung}/test#0..2" for rung in RUNGS_OF_TWO]


@pytest.mark.nightly
def test_baselines_run_join_the_lines_that_are_there(tmp_path: Path, capsys):
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
    assert main(["ladder", "--from-raw", "--docs", str(docs)]) == 0
    assert "| `doormat` | **1.00** (1) |" in capsys.readouterr().out
