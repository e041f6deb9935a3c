"""Raw results in a compact form: one line of JSON a run, small enough to keep beside the page that tells them.

A page is written from these lines alone, so that it can be checked, and written anew, without training anything.
Training episodes are summed up in twentieths of the run; evaluations are kept one by one.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.training.results import load_episode_rows
from hrl_escape.comparison.comparison import Comparison
from hrl_escape.comparison.grid import GridRun
from hrl_escape.comparison.runs import RunResult, get_training_folder
from hrl_escape.comparison.statistics import compute_efficiency, compute_score
from hrl_escape.comparison.summary import Summary
from hrl_escape.errors import FileReadError
from hrl_escape.files import read_text, write_text

__all__ = ["OPTIMAL_SCORE", "RawRun", "collect_runs", "load_runs", "save_runs"]

BINS = 20
OPTIMAL_SCORE = 0.99
"""Score from which on these studies call an episode optimal: stricter than `NEAR_BEST`, as published with 0.1."""

_WITH_GAPS = ("training_returns", "training_efficiencies", "entropy", "greedy", "longest_repeat")
_NEW = ("efficiencies", "training_efficiencies", "entropy", "greedy", "longest_repeat")

Axis = Literal["primitives", "decisions"]


@dataclass(frozen=True)
class RawRun:
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
        training_returns: mean return of these; None where none ended.
        training_successes: how many of these escaped.
        training_optimal: how many of these scored `OPTIMAL_SCORE` or more.
        first_escape: primitives at the end of the first training episode that escaped; None if none did.
        efficiencies: mean efficiency of each evaluation; empty in raw results of version 0.1, as all that follow.
        training_efficiencies: mean efficiency of the training episodes in each twentieth; None where none ended.
        entropy: mean entropy of the exploring policy there, in nats; None also where the agent logs none.
        greedy: mean share of greedy decisions there, likewise.
        longest_repeat: mean over these episodes of the most decisions in a row for one action.
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


def collect_runs(summary: Summary, comparison: Comparison) -> list[RawRun]:
    """Read the finished runs of a comparison, with their training episodes; references, which have none, are left out.

    Raises:
        FileReadError: a run's log is missing or damaged.
    """
    runs = []
    for run, result in summary.runs:
        if run.agent.is_reference:
            continue
        runs.append(_make_run(run, result, load_episode_rows(get_training_folder(comparison.out, run))))
    return runs


def _make_run(run: GridRun, result: RunResult, rows: Sequence[Mapping[str, Any]]) -> RawRun:
    axis: Axis = "decisions" if run.grid.decisions else "primitives"
    budget = run.grid.decisions or run.grid.primitives
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
        """Mean in each twentieth; None where there is no value."""
        known = np.array([value is not None for value in values], dtype=bool)
        weights = [float(value) for value in values if value is not None]
        sums = np.bincount(place[known], weights=weights, minlength=BINS)
        return tuple(round(total / n, digits) if n else None for total, n in zip(sums, count(known), strict=True))

    counts = count(np.ones(len(ended), dtype=bool))
    return RawRun(
        agent=run.agent.label, room=run.room, seed=run.seed, worst=worst, best=best, axis=axis, budget=budget,
        primitives=tuple(evaluation.primitives for evaluation in result.evaluations),
        decisions=tuple(evaluation.decisions for evaluation in result.evaluations),
        returns=tuple(round(evaluation.mean_return, 3) for evaluation in result.evaluations),
        successes=tuple(round(evaluation.success_rate, 3) for evaluation in result.evaluations),
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


def save_runs(path: Path, runs: Iterable[RawRun]) -> None:
    """Write runs, a line each.

    Raises:
        FileWriteError: the file cannot be written.
    """
    lines = [json.dumps(dataclasses.asdict(run), separators=(",", ":"), allow_nan=False) for run in runs]
    write_text(path, "\n".join(lines) + "\n")


def load_runs(path: Path) -> list[RawRun]:
    """Read what `save_runs` wrote.

    Raises:
        FileReadError: the file is missing or damaged.
    """
    runs = []
    for number, line in enumerate(read_text(path, "file of raw results").splitlines(), 1):
        try:
            fields: dict[str, Any] = json.loads(line)
            fields = {key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()}
            runs.append(_check(RawRun(**fields)))
        except (ValueError, TypeError, AttributeError) as error:
            raise FileReadError(f"{path}, line {number}: this is no run of a study ({error})") from error
    if not runs:
        raise FileReadError(f"{path}: this file of raw results holds no run")
    return runs


def _check(run: RawRun) -> RawRun:
    """Raise where a field cannot be what it is."""
    evaluations = len(run.primitives)
    for names, length in ((("primitives", "decisions", "returns", "successes", "efficiencies"), max(1, evaluations)),
                          (("episodes", "training_successes", "training_optimal", *_WITH_GAPS), BINS)):
        for name in names:
            values = getattr(run, name)
            if values == () and name in _NEW:
                continue
            if not isinstance(values, tuple) or len(values) != length:
                raise ValueError(f"{name} is not a list of {length}")
            if not all(_is_number(value) or (value is None and name in _WITH_GAPS) for value in values):
                raise ValueError(f"{name} holds something else than numbers")
    if run.axis not in get_args(Axis):
        raise ValueError(f"axis is {run.axis!r}")
    for name in ("seed", "worst", "best", "budget"):
        if not _is_number(getattr(run, name)):
            raise ValueError(f"{name} is no number")
    if run.budget < 1 or run.best <= run.worst:
        raise ValueError("a budget below 1, or a best return that is not above the worst")
    if not (run.first_escape is None or _is_number(run.first_escape)):
        raise ValueError("first_escape is no number")
    return run


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
