"""Point mazes: what is compared of runs, and how an evaluation counts episodes."""

import numpy as np
import torch

from benchmarks.point_mazes import (
    CHANGES,
    LEARNERS,
    PAIRS,
    TRIALS,
    compare,
    draw_curves,
    estimate_mean,
    measure,
    summarise,
)
from hrl_escape.agents.decisions import Policy


class Drive(Policy):
    """The same velocities in all mazes."""

    def __init__(self, action):
        self._action = torch.tensor(action)

    def begin_episode(self, rng, num_envs=1):
        pass

    def act(self, batch):
        return self._action.expand(len(batch.env), 2)


def test_success_and_steps_are_of_the_first_episode_of_each_maze():
    still, moving = measure(Drive([0.0, 0.0]), "u"), measure(Drive([1.0, 0.0]), "u")
    assert still == (0.0, 150.0), "starts and goals are in different cells"
    assert 0 < moving[0] < 0.5
    assert 150 * (1 - moving[0]) < moving[1] < 150 * (1 - moving[0]) + 20 * moving[0], "goals to the right are near"


def test_learners_are_agents_with_known_settings_and_pairs_are_of_learners():
    assert {each for pair in PAIRS for each in pair} <= set(LEARNERS)
    assert set(TRIALS) | set(CHANGES) == set(LEARNERS)


def test_tables_have_means_over_seeds_and_paired_differences():
    rows = [{"maze": "u", "learner": learner, "seed": seed, "trial": 0, "primitives": 100, "seconds": 2.0,
             "scores": [[50, level, 90.0], [100, level + 0.01 * seed, 40.0]]}
            for learner, level in (("hiro", 0.8), ("hiro-uncorrected", 0.5)) for seed in range(10)]
    lines = summarise(rows).splitlines()
    assert len(lines) == 4 and "| u | hiro | 10 | 0.85 (0.83 to 0.86) | 0.82" in lines[2]
    area = compare(rows).splitlines()[-1]
    assert "| u | hiro, hiro-uncorrected | area | 10 | +0.30 |" in area and area.endswith("hiro higher |")


def test_curves_have_a_panel_for_each_maze_and_intervals_over_seeds(tmp_path):
    rows = [{"maze": maze, "learner": "hiro", "seed": seed, "trial": 0, "primitives": 100, "seconds": 2.0,
             "scores": [[50, 0.2, 90.0], [100, 0.8, 40.0]]} for maze in ("u", "large") for seed in range(3)]
    draw_curves(rows, tmp_path / "curves.svg")
    text = (tmp_path / "curves.svg").read_text()
    assert all(f"<!-- {word} -->" in text for word in ("u", "large", "hiro")) and "<!-- medium -->" not in text
    low, mean, high = estimate_mean(np.array([[0.0, 0.5], [1.0, 0.5]]))
    assert mean.tolist() == [0.5, 0.5] and (low[0], high[0]) == (0.0, 1.0) and low[1] == high[1] == 0.5
