"""Result of a run as its course: evaluations one by one, and training episodes summed up in twentieths of the run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.grid import GridRun
from hrl_escape.benchmark.run_results import RunResult, get_training_folder
from hrl_escape.benchmark.statistics import compute_efficiency, compute_score
from hrl_escape.benchmark.summary import summarise
from hrl_escape.errors import FileReadError, describe_damage
from hrl_escape.files import read_text
from studies.store import Line

__all__ = ["BINS", "OPTIMAL_SCORE", "RawRun", "collect_runs"]

BINS = 20
OPTIMAL_SCORE = 0.99
"""Smallest score of an optimal episode in these studies, as in version 0.1; stricter than the study of scaling."""

_WITH_GAPS = ("training_returns", "training_efficiencies", "entropy", "greedy", "longest_repeat")
_NEW = ("efficiencies", "training_efficiencies", "entropy", "greedy", "longest_repeat")

Axis = Literal["primitives", "decisions"]


@dataclass(frozen=True)
class RawRun(Line):
    """Result of one run of a study.

    Attributes:
        agent: label.
        room: name.
        seed: of training.
        worst: return without escape.
        best: best known return.
        axis: what its budget counted.
        budget: in that unit.
        primitives: trained for at each evaluation.
        decisions: trained for at each evaluation.
        returns: mean return of each evaluation, frozen weights.
        successes: share of each evaluation's episodes that escaped.
        episodes: training episodes that ended in each twentieth of the budget.
        training_returns: mean return of these, or None if none ended.
        training_successes: how many of these escaped.
        training_optimal: how many of these scored `OPTIMAL_SCORE` or more.
        first_escape: primitives at the end of the first training episode that escaped, or None without one.
        efficiencies: mean efficiency of each evaluation; empty in raw results of version 0.1, as all that follow.
        training_efficiencies: mean efficiency of the training episodes in each twentieth, or None if none ended.
        entropy: mean entropy of the exploring policy there, in nats, or None, also if the agent logs none.
        greedy: mean share of greedy decisions there, likewise.
        longest_repeat: mean over these episodes of the most decisions in a row for one action.
        grid: name of its grid.
    """

    agent: str
    room: str
    seed: int
    worst: float
    best: float
    axis: Axis
    budget: int
    primitives: tuple[int, ...]
    decisions: tuple[int, ...]
    returns: tuple[float, ...]
    successes: tuple[float, ...]
    episodes: tuple[int, ...]
    training_returns: tuple[float | None, ...]
    training_successes: tuple[int, ...]
    training_optimal: tuple[int, ...]
    first_escape: int | None
    efficiencies: tuple[float, ...] = ()
    training_efficiencies: tuple[float | None, ...] = ()
    entropy: tuple[float | None, ...] = ()
    greedy: tuple[float | None, ...] = ()
    longest_repeat: tuple[float | None, ...] = ()
    grid: str = ""

    def __post_init__(self) -> None:
        """Refuse a curve of the wrong length, and returns that make no scale."""
        for names, length in ((("primitives", "decisions", "returns", "successes", "efficiencies"),
                               max(1, len(self.primitives))),
                              (("episodes", "training_successes", "training_optimal", *_WITH_GAPS), BINS)):
            for name in names:
                values = getattr(self, name)
                if len(values) != length and not (values == () and name in _NEW):
                    raise ValueError(f"{name} is not a list of {length}")
        if self.budget < 1 or self.best <= self.worst:
            raise ValueError("a budget below 1, or a best return that is not above the worst")

    PLACE = ("grid", "agent", "room", "seed")

    @property
    def at(self) -> NDArray[np.float64]:
        """Time of each evaluation, in units of the budget."""
        return np.array(getattr(self, self.axis), dtype=np.float64)

    @property
    def scores(self) -> NDArray[np.float64]:
        """Score of each evaluation: 0 never escaping, 1 the best known."""
        return compute_score(self.returns, self.worst, self.best)

    @property
    def training_at(self) -> NDArray[np.float64]:
        """Middle of each twentieth, in units of the budget."""
        return (np.arange(BINS) + 0.5) * self.budget / BINS

    @property
    def training_scores(self) -> NDArray[np.float64]:
        """Mean score of training episodes in each twentieth; NaN where none ended."""
        returns = [np.nan if value is None else value for value in self.training_returns]
        return compute_score(returns, self.worst, self.best)


def collect_runs(comparison: Comparison) -> list[RawRun]:
    """Read the finished runs of a comparison, with their training episodes; references, which have none, are left out.

    Raises:
        FileReadError: a run's log is missing or damaged.
    """
    runs = []
    for run, result in summarise(comparison).runs:
        if run.agent.is_reference:
            continue
        runs.append(_make_run(run, result, load_episode_rows(get_training_folder(comparison.out, run))))
    return runs


def load_episode_rows(folder: Path) -> list[dict[str, Any]]:
    """Read the rows of a run's log about training episodes, by the names of `METRICS`.

    Raises:
        FileReadError: the log is missing or damaged.
    """
    path = folder / "log.jsonl"
    try:
        rows = [json.loads(line) for line in read_text(path, "log of a run").splitlines()]
        return [row for row in rows if row["kind"] == "episode"]
    except (ValueError, KeyError, TypeError) as error:
        raise FileReadError(f"{path}: this log of a run is damaged ({describe_damage(error)})") from error


def _make_run(run: GridRun, result: RunResult, rows: Sequence[Mapping[str, Any]]) -> RawRun:
    axis: Axis = "decisions" if run.grid.decisions else "primitives"
    budget = run.grid.decisions or run.grid.primitives
    assert result.score_range is not None, "studies run in rooms, which have a score range"
    worst, best = result.score_range.worst, float(np.mean(result.score_range.best))
    ended = [row for row in rows if row["train/end"] != "budget"]
    at = np.array([row[axis] for row in ended], dtype=np.float64)
    place = np.minimum((at - 1) * BINS // budget, BINS - 1).astype(np.int64)
    returns = np.array([row["train/return"] for row in ended])
    escaped = np.array([row["train/success"] for row in ended], dtype=bool)
    fewest = float(np.mean(result.score_range.fewest))
    efficiencies = compute_efficiency(escaped, [row["train/length"] for row in ended], fewest)
    optimal = compute_score(returns, worst, best) >= OPTIMAL_SCORE

    def count(chosen: NDArray[np.bool_]) -> tuple[int, ...]:
        return tuple(np.bincount(place[chosen], minlength=BINS).tolist())

    def average(values: Sequence[Any], digits: int) -> tuple[float | None, ...]:
        """Mean in each twentieth, or None without a value."""
        known = np.array([value is not None for value in values], dtype=bool)
        weights = [float(value) for value in values if value is not None]
        sums = np.bincount(place[known], weights=weights, minlength=BINS)
        return tuple(round(total / n, digits) if n else None for total, n in zip(sums, count(known), strict=True))

    counts = count(np.ones(len(ended), dtype=bool))
    return RawRun(
        grid=run.grid.name, agent=run.agent.label, room=run.room, seed=run.seed, worst=worst, best=best, axis=axis,
        budget=budget,
        primitives=tuple(evaluation.primitives for evaluation in result.evaluations),
        decisions=tuple(evaluation.decisions for evaluation in result.evaluations),
        returns=tuple(round(evaluation.mean_return, 3) for evaluation in result.evaluations),
        successes=tuple(round(evaluation.success_rate or 0.0, 3) for evaluation in result.evaluations),
        episodes=counts,
        training_returns=average(returns.tolist(), 2),
        training_successes=count(escaped),
        training_optimal=count(optimal),
        first_escape=next((row["primitives"] for row in ended if row["train/success"]), None),
        efficiencies=tuple(round(value, 4) for value in result.get_curve("efficiency").tolist()),
        training_efficiencies=average(efficiencies.tolist(), 4),
        entropy=average([row.get("train/entropy") for row in ended], 4),
        greedy=average([row.get("train/greedy") for row in ended], 4),
        longest_repeat=average([row.get("train/longest_repeat") for row in ended], 2),
    )
