"""Learning curves of many runs: common points, bands and groups, from results and files of other programs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from scipy import stats

from hrl_escape.agents import RunCurve, TrainResult, plot_runs, read_csv_curve, train
from hrl_escape.errors import ConfigError, FileReadError
from hrl_escape.intervals import compute_mean_interval


@pytest.fixture(scope="module")
def result() -> TrainResult:
    return train("random", gymnasium.make("CartPole-v1"), primitives=60, eval_every=30, eval_episodes=1, progress=False)


def test_a_band_is_students_interval_of_the_mean_on_common_points():
    runs = [RunCurve("a", np.array([0.0, 10.0, 40.0]), np.array([0.0, 10.0, 40.0])),
            RunCurve("a", np.array([5.0, 30.0]), np.array([4.0, 4.0])), RunCurve("b", np.arange(3.0), np.ones(3))]
    axes = plot_runs(runs).axes[0]
    assert [line.get_label() for line in axes.lines] == ["a (2 runs)", "b"] and len(axes.collections) == 1
    x, y = axes.lines[0].get_data()
    assert (x[0], x[-1]) == (5.0, 30.0) and np.allclose(y, (np.asarray(x) + 4.0) / 2)
    values = np.random.default_rng(0).normal(size=(3, 6))
    mean, low, high = compute_mean_interval(values)
    expected = stats.t.interval(0.95, 5, values.mean(-1), stats.sem(values, axis=-1))
    assert np.allclose(mean, values.mean(-1)) and np.allclose([low, high], expected)


def test_equal_agents_are_one_line_and_changed_settings_are_named(result: TrainResult):
    other = dataclasses.replace(result, settings={**result.settings, "gamma": 0.5})
    labels = [line.get_label() for line in result.plot(beside=[result, other]).axes[0].lines]
    assert labels == [f"random (gamma {result.settings['gamma']}) (2 runs)", "random (gamma 0.5), seed 0"]
    assert len(plot_runs([result, other], by=lambda run: "all").axes[0].lines) == 1
    assert len(plot_runs([result, other], by="run").axes[0].lines) == 2
    for wrong in ([], [3]):
        with pytest.raises(ConfigError):
            plot_runs(wrong)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="agent, run"):
        plot_runs([result], by="colour")


def test_files_of_other_programs_are_read(tmp_path: Path):
    for folder, text in (("monitor", '#{"t_start": 1}\nr,l,t\n1.5,10,0.1\n2.5,20,0.2\n'),
                         ("board", "Wall time,Step,Value\n1,10,1.5\n2,30,2.5\n"),
                         ("cleanrl", "global_step,charts/episodic_return,x\n30,2.5,\n,,7\n10,1.5,\n")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "log.csv").write_text(text)
        curve = read_csv_curve(tmp_path / folder / "log.csv")
        assert (curve.agent, curve.x.tolist(), curve.y.tolist()) == (folder, [10, 30], [1.5, 2.5])
    (tmp_path / "odd.csv").write_text("n,score\n1,2\n")
    with pytest.raises(FileReadError, match="no column of steps among n, score"):
        read_csv_curve(tmp_path / "odd.csv")
    assert read_csv_curve(tmp_path / "odd.csv", "mine", "n", "score") == RunCurve("mine", pytest.approx([1]),  # type: ignore[arg-type]
                                                                                 pytest.approx([2]))
    with pytest.raises(dataclasses.FrozenInstanceError):
        curve.seed = 1  # type: ignore[misc]  # a value, as results are
    axes = plot_runs([tmp_path / "board/log.csv", tmp_path / "monitor/log.csv"]).axes[0]
    assert [line.get_label() for line in axes.lines] == ["board", "monitor"]
