"""The ladder at its own budgets: comparisons of known data, and a real run of each learner."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.benchmark.protocols import get_budget
from hrl_escape.errors import UnknownNameError
from studies.baseline import BaselineRun
from studies.budgets.analysis import Args, compare_budgets, identify, measure, run_once
from studies.running import open_store
from studies.study import find_study

STUDY = find_study("budgets")
PPO, DQN, DAC, MEMORY = STUDY.data["agents"]
RUNGS = ("lattice-5", "lattice")


def make_run(agent: str, rung: str, room: int, efficiency: float, primitives: int) -> BaselineRun:
    return BaselineRun("per-instance", rung, f"ladder-1/{rung}/test#{room}", agent, 0, primitives, efficiency, None,
                       float(efficiency > 0), 5, float(efficiency > 0), 900, "key")


def make_lines(efficiency: Callable[[str, str], float], primitives: int | None = None) -> list[BaselineRun]:
    """A run of each learner in ten rooms of two rungs around these efficiencies, at the rungs' own budgets."""
    rng = np.random.default_rng(primitives or 0)
    return [make_run(agent, rung, room, float(np.clip(efficiency(agent, rung) + 0.02 * rng.normal(), 0, 1)),
                     primitives or get_budget(rung))
            for agent in STUDY.data["agents"] for rung in RUNGS for room in range(10)]


def group(lines: list[BaselineRun]) -> dict[tuple[str, str], list[BaselineRun]]:
    return {(agent, rung)[::-1]: [line for line in lines if (line.agent, line.rung) == (agent, rung)]
            for agent in STUDY.data["agents"] for rung in RUNGS}


def test_learners_are_compared_with_the_best_search_baseline_of_the_ladder_study():
    found = STUDY.analysis.analyse(STUDY, make_lines(lambda agent, rung: 0.95 if agent == DQN else 0.3))
    assert {agent for agent, (each, _) in found.numbers.beyond.items() if each.sign > 0} == {DQN}
    assert {rungs for _, rungs in found.numbers.beyond.values()} == {2}
    assert "| rung | random policy over options |" in found.tables["budgets"], "references are from the ladder study"
    assert "| `lattice-5` | 0.20 (10) |" in found.tables["budgets"]


def test_runs_with_another_budget_than_the_rungs_own_do_not_count():
    found = STUDY.analysis.analyse(STUDY, [*make_lines(lambda agent, rung: 0.4),
                                           *make_lines(lambda agent, rung: 1.0, primitives=2_000_000)])
    assert found.numbers.runs == 80 and not any(each.sign > 0 for each, _ in found.numbers.beyond.values())


def test_a_larger_budget_is_compared_room_by_room():
    former = group(make_lines(lambda agent, rung: 0.5, primitives=20_000))
    found = compare_budgets(group(make_lines(lambda agent, rung: {PPO: 0.8, DQN: 0.5}.get(agent, 0.3))), former, RUNGS)
    assert found[PPO].mean == pytest.approx(0.3, abs=0.02) and found[PPO].sign == 1
    assert found[DQN].sign == 0 and found[DAC].sign == -1
    del former["lattice", PPO], former["lattice-5", PPO]
    assert PPO not in compare_budgets(group(make_lines(lambda agent, rung: 0.8)), former, RUNGS)
    assert not compare_budgets(group(make_lines(lambda agent, rung: 0.8)), {}, RUNGS)


def test_names_that_are_unknown_are_refused(tmp_path: Path):
    for changes, what in (({"agents": ("smdp-pqo",)}, "agent"), ({"rungs": ("latice",)}, "rung")):
        args = Args(docs=tmp_path, **changes)
        with pytest.raises(UnknownNameError, match=f"{what} of this study"):
            measure(STUDY, args, open_store(STUDY, tmp_path))


@pytest.mark.slow
def test_a_real_run_is_kept_and_not_made_twice(tmp_path: Path):
    args = Args(docs=tmp_path, rungs=("doormat",), agents=(PPO,), rooms=2, runs=1, primitives=600, workers=1)
    store = open_store(STUDY, tmp_path)
    measure(STUDY, args, store)
    lines = store.load()
    assert [(line.rooms, line.seed, line.primitives, line.episodes) for line in lines] == [
        (f"ladder-1/doormat/test#{room}", 0, 600, 5) for room in range(2)]
    assert all(line.first_escape is not None for line in lines), "a room with one button"
    text = store.path.read_text()
    measure(STUDY, args, store)
    assert store.path.read_text() == text


@pytest.mark.nightly
def test_published_runs_count_as_made_unless_something_that_decides_them_has_changed():
    for line in {line.rung: line for line in open_store(STUDY, None).load()}.values():
        number = int(re.findall(r"#(\d+)$", line.rooms)[0])
        what = (line.rung, number, line.agent, line.seed, line.primitives)
        assert identify(STUDY.data, *what) == (line.place, line.key)
        for changes in ({"copies": 4}, {"episodes": 1}):
            place, key = identify(STUDY.data | changes, *what)
            assert place == line.place and key != line.key


def test_no_run_is_begun_after_the_time_is_up():
    assert run_once(STUDY.data, "doormat", 0, PPO, 0, 600, until=0.0) is None


@pytest.mark.slow
@pytest.mark.parametrize("agent", list(STUDY.data["agents"]))
def test_every_learner_learns_from_copies_of_a_room(agent: str):
    run = run_once(STUDY.data, "pair", 0, agent, 0, 30_000)
    assert run is not None and run.escapes == 1 and run.efficiency > 0.8
