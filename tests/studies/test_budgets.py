"""The ladder at its own budgets: comparisons of known data."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hrl_escape.benchmark.protocols import get_budget
from studies.baseline import BaselineRun
from studies.budgets.analysis import compare_budgets
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
