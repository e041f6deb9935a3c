"""What a training run leaves: episodes, evaluations, totals, and the rows of its log.

Everything here is plain data that goes to JSON and back without loss. Fields that depend on the
wall clock take no part in equality, so two results are equal if all that learning decides is equal, bit for bit.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.evaluation import Evaluation
from hrl_escape.files import read_json

__all__ = ["METRICS", "EpisodeRecord", "TrainResult", "load_result"]

METRICS = {
    "train/return": "undiscounted return of a training episode, exploration included",
    "train/length": "primitives in a training episode",
    "train/decisions": "decisions in a training episode",
    "train/success": "1 if it succeeded (info['is_success'] if given, else terminated), else 0",
    "train/end": "how it ended: terminated, truncated, or budget where the run's budget cut it",
    "train/loss": "mean loss of the updates in the episode",
    "train/actor_loss": "mean loss of ddpg's actor",
    "train/policy_loss": "ppo's clipped objective, negated",
    "train/value_loss": "ppo's half squared value error, in scaled rewards",
    "train/entropy": "mean entropy of ppo's policy, in nats",
    "train/value": "mean predicted value in the updates, in units of return",
    "train/td_error": "mean absolute error of tabular updates, in units of return",
    "train/epsilon": "mean share of random actions asked for",
    "train/states": "states in the table",
    "eval/return": "mean undiscounted return of frozen weights",
    "eval/success": "share of evaluation episodes that succeeded",
    "eval/length": "mean primitives of an evaluation episode",
    "eval/returns": "return of each evaluation episode",
    "eval/lengths": "primitives of each",
    "eval/decision_counts": "decisions of each",
    "eval/successes": "whether each succeeded",
    "option/choices": "decisions of the episode by the name of what was chosen, primitives included",
    "option/primitives": "primitives of the episode by the name of what was chosen",
    "option/failures": "decisions of the episode whose planning failed",
    "option/planner_calls": "planner calls so far in the run",
    "time/planner_seconds": "seconds in planners so far in the run",
    "time/seconds": "seconds of training so far in the run, evaluations left out",
    "time/primitives_per_second": "rate of training over the episode",
    "time/eval_seconds": "seconds of one evaluation",
}
"""Every name in a log and what it means. An agent of your own adds `train/` and whatever its `observe` returns."""


@dataclass(frozen=True)
class EpisodeRecord:
    """One training episode.

    Attributes:
        primitives: primitives trained for, at its end.
        decisions: decisions trained for, at its end.
        episode_return: undiscounted sum of primitive rewards.
        length: primitives in it.
        success: `info["is_success"]` at its end if given, else `terminated`.
        end: `terminated`, `truncated`, or `budget` where the run's budget cut it.
        seconds: seconds of training at its end, without evaluations; left out of comparisons.
    """

    primitives: int
    decisions: int
    episode_return: float
    length: int
    success: bool
    end: str
    seconds: float = field(compare=False)

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> EpisodeRecord:
        """From a row of the log."""
        return cls(
            row["primitives"],
            row["decisions"],
            row["train/return"],
            row["train/length"],
            bool(row["train/success"]),
            row["train/end"],
            row["time/seconds"],
        )


def make_evaluation_row(evaluation: Evaluation) -> dict[str, Any]:
    """The row of the log for an evaluation."""
    return {
        "kind": "evaluation",
        "primitives": evaluation.primitives,
        "decisions": evaluation.decisions,
        "eval/return": evaluation.mean_return,
        "eval/success": evaluation.success_rate,
        "eval/length": evaluation.mean_length,
        "eval/returns": list(evaluation.returns),
        "eval/lengths": list(evaluation.lengths),
        "eval/decision_counts": list(evaluation.decision_counts),
        "eval/successes": list(evaluation.successes),
        "time/eval_seconds": evaluation.seconds,
    }


def read_evaluation_row(row: Mapping[str, Any]) -> Evaluation:
    """The evaluation that `make_evaluation_row` wrote."""
    return Evaluation(
        row["primitives"],
        row["decisions"],
        tuple(row["eval/returns"]),
        tuple(row["eval/lengths"]),
        tuple(row["eval/decision_counts"]),
        tuple(row["eval/successes"]),
        row["time/eval_seconds"],
    )


@dataclass(frozen=True)
class TrainResult:
    """What came of a training run.

    Attributes:
        agent_name: the name it was made by, or its class's name.
        seed: the run's seed.
        settings: the agent's settings, as a JSON value.
        primitives: primitives trained for; a last option may carry it beyond the budget.
        decisions: decisions trained for.
        planner_calls: calls of planners behind options, summed over `info["option"]["planner_calls"]`.
        evaluations: the first before training, the last after it.
        episodes: every training episode.
        seconds: wall time of training, without evaluations.
        planner_seconds: of these, in planners.
        agent: the trained agent; None in a result read from a file.
    """

    agent_name: str
    seed: int
    settings: Mapping[str, Any]
    primitives: int
    decisions: int
    planner_calls: int
    evaluations: tuple[Evaluation, ...]
    episodes: tuple[EpisodeRecord, ...]
    seconds: float = field(compare=False)
    planner_seconds: float = field(compare=False)
    agent: Agent | None = field(default=None, compare=False, repr=False)

    def curve(self, metric: str = "mean_return", against: str = "primitives") -> tuple[NDArray, NDArray]:
        """A learning curve from the evaluations.

        Args:
            metric: `mean_return`, `success_rate` or `mean_length`.
            against: `primitives`, `decisions` or `seconds` (of training).

        Returns:
            x and y, float64 (evaluations,).
        """
        if against == "seconds":
            ends = {record.primitives: record.seconds for record in self.episodes}
            x = [ends.get(evaluation.primitives, 0.0) for evaluation in self.evaluations]
        else:
            x = [getattr(evaluation, against) for evaluation in self.evaluations]
        return np.array(x, float), np.array([getattr(e, metric) for e in self.evaluations], float)

    def to_json(self) -> dict[str, Any]:
        """A JSON value; the agent is left out."""
        value = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "agent"}
        return value | {
            "settings": dict(self.settings),
            "evaluations": [dataclasses.asdict(evaluation) for evaluation in self.evaluations],
            "episodes": [dataclasses.asdict(record) for record in self.episodes],
        }

    @classmethod
    def from_json(cls, value: Mapping[str, Any], agent: Agent | None = None) -> TrainResult:
        """What `to_json` gave, equal to the original."""
        evaluations = tuple(Evaluation.from_json(evaluation) for evaluation in value["evaluations"])
        episodes = tuple(EpisodeRecord(**record) for record in value["episodes"])
        return cls(**{**value, "evaluations": evaluations, "episodes": episodes, "agent": agent})


def load_result(folder: str | os.PathLike[str]) -> TrainResult:
    """The result of a finished run, without its agent (see `training.load_agent`).

    Raises:
        FileReadError: the run is not finished, or its result is damaged.
    """
    return TrainResult.from_json(read_json(Path(folder) / "result.json", "result of a run"))
