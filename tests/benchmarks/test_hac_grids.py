"""The grids of HAC: their episodes, a run, and the tables of runs."""

import numpy as np
import pytest

from benchmarks.hac_grids import GRIDS, HORIZON, GridTask, compare, make_goals, run, summarise
from tests.classic.grid import EAST, WEST


def test_an_episode_ends_at_its_goal_or_at_the_horizon():
    env = GridTask(GRIDS["open"])
    starts = [env.reset(seed=seed)[0] for seed in range(20)]
    assert all(start != goal for start, goal in starts) and len({tuple(each) for each in starts}) > 15
    env._state[:] = env.grid.numbers[4, 4], env.grid.numbers[4, 6]
    env._steps = 0
    assert env.step(EAST)[1:] == (-1.0, False, False, {"is_success": False})
    seen, *rest = env.step(EAST)
    assert seen[0] == seen[1] and rest == [0.0, True, False, {"is_success": True}]
    env._state[:] = env.grid.numbers[4, 0], env.grid.numbers[4, 6]
    env._steps = 0
    ends = [env.step(WEST)[3] for _ in range(HORIZON)]  # against the wall
    assert ends == [False] * (HORIZON - 1) + [True]


def test_goals_are_cells_and_levels_do_not_see_the_goal_of_the_episode():
    goals = make_goals(GRIDS["rooms"])
    seen = np.array([17, 80])
    assert np.flatnonzero(goals.list_reached(seen)).tolist() == [17]
    assert goals.find_desired is not None and goals.find_desired(seen) == 80
    assert goals.view is not None and goals.view.see(seen) == 17


@pytest.mark.parametrize("levels", [1, 2])
def test_a_run_is_evaluated_after_the_parts_of_its_budget(levels):
    scores = run("open", levels, 0, 3_000, tests=10)
    assert len(scores) == 10 and scores[-1][0] == 3_000
    assert all(300 * number <= primitives <= 300 * (number + 1) + HORIZON
               for number, (primitives, *_) in enumerate(scores[:-1], 1))
    assert scores[-1][1] >= scores[0][1] and scores[-1][2] < HORIZON


def test_tables_have_means_over_seeds_and_differences_of_the_same_seeds():
    rows = [{"grid": "rooms", "levels": levels, "seed": seed, "primitives": 200, "seconds": 9.0,
             "scores": [[100, 0.1, 50.0], [200, 0.1 + 0.02 * (levels - 1) * (seed + 1), 20.0]]}
            for levels in (1, 2) for seed in range(10)]
    lines = summarise(rows).splitlines()
    assert lines[2] == ("| rooms | 1 | 200 | 10 | 0.10 (0.10 to 0.10) | 0.10 (0.10 to 0.10) | 0.10 (0.10 to 0.10) | "
                        "20.0 (20.0 to 20.0) | 9 |")
    assert lines[3].startswith("| rooms | 2 | 14 | 10 | 0.10 (0.10 to 0.10) | 0.21 (")
    line = compare(rows).splitlines()[-1]
    assert line.startswith("| rooms | 2 - 1 | 10 | +0.055 | +0.") and line.endswith("| 0.002 |")  # 2 of 2^10 signs
    assert compare(rows[:19]) == "", "nine pairs"
