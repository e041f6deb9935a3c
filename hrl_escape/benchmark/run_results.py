"""Results of the runs of a comparison, and the files that hold them."""

from __future__ import annotations

import dataclasses
import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.training.evaluation import Evaluation
from hrl_escape.agents.training.results import TrainResult
from hrl_escape.benchmark.episode_record import check_episodes
from hrl_escape.benchmark.grid import GridRun
from hrl_escape.benchmark.score_range import ScoreRange
from hrl_escape.benchmark.statistics import compute_efficiency, compute_final, compute_mean_efficiency
from hrl_escape.errors import EscapeError, FileReadError, describe_damage
from hrl_escape.files import read_json
from hrl_escape.settings import read_record
from hrl_escape.version import __version__, find_versions


@dataclass(frozen=True)
class RunResult:
    """Result of one run of a grid."""

    budget: int  # training budget in primitives; the primitives trained for if it ended early
    primitives: int  # trained for; the last option can exceed the budget
    decisions: int  # trained for
    episodes: int  # trained for
    planner_calls: int  # of options, in training
    first_escape: int | None
    """Primitives at the end of the first successful training episode, or None. A reference counts from its first
    evaluation episode."""
    evaluations: tuple[Evaluation, ...]  # the first before training, the last after it; one for a reference
    score_range: ScoreRange | None  # scale of its scores; None in an environment from elsewhere
    seconds: tuple[float, ...] = dataclasses.field(compare=False)
    """Training time at each evaluation; ignored by `==`."""
    planner_seconds: float = dataclasses.field(compare=False)  # training time in planners; ignored by `==`
    versions: Mapping[str, str] = dataclasses.field(compare=False)
    """Versions of packages; ignored by `==`."""
    seen: Evaluation | None = None  # final evaluation in training rooms, for runs with other test rooms
    seen_range: ScoreRange | None = None  # its scale
    trials: tuple[Evaluation, ...] = ()
    """Final evaluation of each trial over all test rooms, for grids with trials."""
    trial_ranges: tuple[ScoreRange, ...] = ()  # their scales
    escapes: int | None = None
    """Training episodes that succeeded; None for references without training and for results of earlier versions."""

    @classmethod
    def make(cls, budget: int, result: TrainResult, score_range: ScoreRange | None) -> RunResult:
        """Make the result of a finished training run."""
        return cls(budget, result.primitives, result.decisions, len(result.episodes), result.planner_calls,
                   result.first_escape, result.evaluations, score_range,
                   tuple(result.curve(against="seconds")[0].tolist()), result.planner_seconds, list_versions(),
                   escapes=None if result.segments else sum(bool(episode.success) for episode in result.episodes))

    @classmethod
    def make_reference(cls, budget: int, evaluation: Evaluation, score_range: ScoreRange | None) -> RunResult:
        """Make the result of a reference from its evaluation."""
        waited = np.cumsum(evaluation.lengths)
        escapes = [int(at) for at, success in zip(waited, evaluation.successes, strict=True) if success]
        return cls(budget, 0, 0, 0, 0, escapes[0] if escapes else None, (evaluation,), score_range, (0.0,), 0.0,
                   list_versions())

    def get_curve(self, metric: str) -> NDArray[np.float64]:
        """Return a metric at every evaluation: `primitives`, `decisions`, `seconds`, `efficiency` or a mean.

        Values that the environment does not define are NaN.
        """
        if metric == "seconds":
            return np.array(self.seconds)
        if metric == "efficiency":
            return np.array([_compute_efficiency(found, self.score_range) for found in self.evaluations])
        return np.array([getattr(evaluation, metric) for evaluation in self.evaluations], dtype=np.float64)

    @property
    def seen_efficiency(self) -> float | None:
        """Final efficiency in training rooms, or None without separate test rooms."""
        if self.seen is None or self.seen_range is None:
            return None
        return _compute_efficiency(self.seen, self.seen_range)

    @property
    def regret(self) -> float | None:
        """Share of the training primitives lost relative to the oracle, or None if the run trained in other rooms.

        The oracle escapes after the fewest known primitives in each episode, so the rest is lost. The regret of a
        reference without training is that of its evaluation episodes.
        """
        if self.score_range is None or self.seen is not None or (self.escapes is None and self.primitives):
            return None
        fewest = np.array(self.score_range.fewest, dtype=np.float64)
        if self.escapes is None:
            final = self.evaluations[-1]
            return float(1.0 - fewest[final.escaped].sum() / max(1, sum(final.lengths)))
        return float(1.0 - self.escapes * fewest.mean() / max(1, self.primitives))

    @property
    def room_efficiencies(self) -> NDArray[np.float64]:
        """Efficiency of each episode of the final evaluation, at most 1; one per test room in grids of sets.

        Values are NaN in an environment from elsewhere.
        """
        final = self.evaluations[-1]
        if self.score_range is None:
            return np.full(len(final.lengths), np.nan)
        return np.minimum(compute_efficiency(final.escaped, final.lengths, self.score_range.fewest), 1.0)

    @property
    def trial_efficiencies(self) -> NDArray[np.float64]:
        """Efficiency at each trial in test rooms; empty without trials."""
        return np.array([_compute_efficiency(*scored) for scored in zip(self.trials, self.trial_ranges, strict=True)])

    def get_final(self, metric: str) -> float:
        """Return the mean of a curve over the last fifth of the budget; see `compute_final`."""
        return compute_final(self.get_curve("primitives"), self.get_curve(metric), self.budget)

    @property
    def reports_success(self) -> bool:
        """True if every evaluation has a success rate."""
        return all(evaluation.success_rate is not None for evaluation in self.evaluations)

    def describe_final(self) -> str:
        """Describe the final values in words: efficiency or return, success rate, and primitives."""
        first = (f"efficiency {self.get_final('efficiency'):.3f}" if self.score_range is not None else
                 f"return {self.get_final('mean_return'):.4g}")
        success = f", success rate {self.get_final('success_rate'):.0%}" if self.reports_success else ""
        return f"{first}{success}, {self.get_final('mean_length'):.0f} primitives an episode"

    @property
    def is_stuck(self) -> bool:
        """True if no evaluation episode succeeded in the last fifth of the budget."""
        return self.get_final("success_rate") == 0.0


def _compute_efficiency(evaluation: Evaluation, score_range: ScoreRange | None) -> float:
    if score_range is None:
        return math.nan
    return compute_mean_efficiency(evaluation.escaped, evaluation.lengths, score_range.fewest,
                                   score_range.is_expected)


def load_run_result(out: Path, run: GridRun) -> RunResult | None:
    """Read the result of a run, or None if it is not finished.

    Raises:
        FileReadError: the result is damaged or belongs to another run.
    """
    path = get_run_folder(out, run) / "run_result.json"
    if not path.exists():
        return None
    value = read_json(path, "result of a run")
    try:
        if value["identity"] != run.identity:
            raise FileReadError(f"{path}: this result belongs to another run than its folder's name says")
        return read_record(RunResult, value["result"])
    except FileReadError:
        raise
    except (EscapeError, KeyError, TypeError, AttributeError) as error:
        raise FileReadError(f"{path}: this result of a run is damaged ({describe_damage(error)})") from error


def read_episodes(out: Path, run: GridRun) -> list[dict[str, Any]]:
    """Read the recorded episodes of a finished run, see `record_episode`.

    Raises:
        FileReadError: they are missing or damaged.
    """
    path = get_run_folder(out, run) / "episodes.json"
    try:
        return check_episodes(read_json(path, "record of episodes"))
    except FileReadError:
        raise
    except EscapeError as error:
        raise FileReadError(f"{path}: this record of episodes is damaged ({describe_damage(error)})") from error


def list_versions() -> dict[str, str]:
    """Return the versions of Python, this package and the libraries that decide numbers."""
    return {"python": platform.python_version(), "hrl-escape": __version__, **find_versions()}


def get_run_folder(out: Path, run: GridRun) -> Path:
    """Return the folder of a run."""
    return out / "runs" / run.folder


def get_training_folder(out: Path, run: GridRun) -> Path:
    """Return the folder of a run's training: log, checkpoint and result."""
    return get_run_folder(out, run) / "training"


def get_room_file(out: Path, instance_id: str) -> Path:
    """Return the file of a room."""
    return out / "rooms" / f"{instance_id}.json"
