"""Figure of learning curves from runs of this package and of other programs."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.training.curves import Line, draw_lines, name_agents
from hrl_escape.agents.training.results import TrainResult, load_result
from hrl_escape.errors import ConfigError, FileReadError
from hrl_escape.files import read_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEP_COLUMNS = ("primitives", "step", "steps", "global_step", "timesteps", "total_timesteps", "time/total_timesteps",
                "num_timesteps")
"""Columns of a CSV file with the steps of training. Without one, episode lengths `l` are summed."""
VALUE_COLUMNS = ("return", "eval/return", "value", "mean_reward", "eval/mean_reward", "rollout/ep_rew_mean",
                 "charts/episodic_return", "episodic_return", "episode_reward", "r")
"""Columns of a CSV file with returns; the first that is there counts."""


@dataclass(frozen=True)
class RunCurve:
    """Learning curve of one run of another program."""

    agent: str  # name of the agent, which `plot_runs` groups by
    x: NDArray[np.float64]  # (points,) steps of training, ascending
    y: NDArray[np.float64]  # (points,) returns
    seed: int | None = None  # of the run, if known


def plot_runs(results: Sequence[TrainResult | RunCurve | str | os.PathLike[str]],
              by: str | Callable[[Any], str] = "agent", *, metric: str = "mean_return", against: str = "primitives",
              level: float = 0.95) -> Figure:
    """Draw learning curves of runs, with a line and a band for each group.

    The runs of a group are interpolated linearly to common points, from the latest start to the earliest end of its
    runs. The line is their mean, the band the interval of the mean by Student's t. A single run has no band.

    Args:
        results: results of `train`, folders of finished runs, curves, or CSV files of other programs, such as the
            `monitor.csv` of Stable-Baselines3 or a scalar downloaded from TensorBoard. The agent of a file is the name
            of its folder; see `read_csv_curve` for others.
        by: `agent` groups runs of equal agents (name and settings), `run` draws each run; or a function from a result
            to the name of its group.
        metric: as for `TrainResult.curve`; files have returns alone.
        against: as for `TrainResult.curve`; files have steps alone.
        level: confidence of the bands.

    Returns:
        A matplotlib figure without a window; a notebook displays it.

    Raises:
        ConfigError: there are no runs, or `by` is not possible.
        FileReadError: a file has no known columns.
    """
    if not results:
        raise ConfigError("results", results, "at least one run")
    runs = [_load(result) for result in results]
    agents = [(run.agent, {}) if isinstance(run, RunCurve) else (run.agent_name, run.settings) for run in runs]
    if callable(by):
        names = [str(by(run)) for run in runs]
    elif by == "agent":
        names = name_agents(agents)
    elif by == "run":
        names = [f"{name}, run {number}" for number, name in enumerate(name_agents(agents))]
    else:
        raise ConfigError("by", by, "agent, run, or a function from a result to the name of its group")
    lines = []
    for name, run in zip(names, runs, strict=True):
        x, y = (run.x, run.y) if isinstance(run, RunCurve) else run.curve(metric, against)
        if not len(x):
            raise ConfigError("results", run, "runs with evaluations")
        lines.append(Line(name, x, y, run.seed))
    return draw_lines(lines, f"{against} of training", metric.replace("_", " "), level)


def read_csv_curve(path: str | os.PathLike[str], agent: str = "", x: str = "", y: str = "") -> RunCurve:
    """Read a learning curve from a CSV file of another program.

    Args:
        path: file with a row of names. Lines that begin with # are ignored, and rows without a step or a return.
        agent: name of the agent; by default that of the file's folder.
        x: name of the column of steps; by default the first of `STEP_COLUMNS`, or sums of episode lengths `l`.
        y: name of the column of returns; by default the first of `VALUE_COLUMNS`.

    Raises:
        FileReadError: the file or a column is missing, or a value is no number.
    """
    path = Path(path)
    content = [line for line in read_text(path, "CSV file").splitlines() if line and not line.startswith("#")]
    try:
        rows = list(csv.DictReader(io.StringIO("\n".join(content))))
    except csv.Error as error:
        raise FileReadError(f"{path}: this CSV file cannot be read: {error}") from error
    names = {name.strip().lower(): name for name in (rows[0] if rows else {}) if name is not None}
    step = names.get(x.lower()) if x else next((names[name] for name in STEP_COLUMNS if name in names), names.get("l"))
    value = names.get(y.lower()) if y else next((names[name] for name in VALUE_COLUMNS if name in names), None)
    if step is None or value is None:
        raise FileReadError(f"{path}: this CSV file has no column of {'steps' if step is None else 'returns'} among "
                            f"{', '.join(names) or 'none'}: name it with read_csv_curve({str(path)!r}, x=..., y=...)")
    try:
        pairs = [(float(row[step]), float(row[value])) for row in rows if row[step] and row[value]]
    except ValueError as error:
        raise FileReadError(f"{path}: a value in {step} or {value} is no number ({error})") from error
    table = np.array(pairs, dtype=np.float64).reshape(-1, 2)
    steps = np.cumsum(table[:, 0]) if step.strip().lower() == "l" else table[:, 0]
    order = np.argsort(steps, kind="stable")
    return RunCurve(agent or path.absolute().parent.name, steps[order], table[order, 1])


def _load(result: Any) -> TrainResult | RunCurve:
    if isinstance(result, (TrainResult, RunCurve)):
        return result
    if not isinstance(result, (str, os.PathLike)):
        raise ConfigError("results", result, "results of train, RunCurve, folders of runs, or CSV files")
    path = Path(result)
    return read_csv_curve(path) if path.suffix == ".csv" else load_result(path)
