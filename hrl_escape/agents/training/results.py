"""Results of a training run: episodes, evaluations, totals, and the rows of its log.

Results are plain data that JSON stores without loss. Fields that depend on the
wall clock are excluded from equality: two results are equal if all results of learning are equal, bit for bit.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.training.curves import Line, draw_lines, name_agents
from hrl_escape.agents.training.evaluation import Evaluation
from hrl_escape.errors import CheckpointError, EscapeError, describe_damage
from hrl_escape.figures import make_svg
from hrl_escape.files import read_json
from hrl_escape.settings import read_record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METRICS = {
    "train/return": "undiscounted return of a training episode, exploration included",
    "train/length": "primitives in a training episode",
    "train/decisions": "decisions in a training episode",
    "train/success": "1 if the episode succeeded, else 0; absent where the environment reports no success",
    "train/episodes": "episodes that ended in a segment of training in many environments",
    "train/successes": "episodes that ended in a segment with success; absent where none of them reports it",
    "train/end": "how the episode ended: terminated, truncated, or budget where the run's budget cut it",
    "train/loss": "mean loss of the updates in the episode",
    "train/gradient_norm": "mean norm of the loss's gradient at the last update of a decision, before clipping",
    "train/actor_loss": "mean loss of ddpg's actor",
    "train/policy_loss": "the objective of the policy of ppo, dac, ppoc and a2oc, negated",
    "train/value_loss": "half the squared error of the values of ppo, dac, ppoc and a2oc, in scaled rewards",
    "train/high_loss": "loss of dac's choice of options",
    "train/high_policy_loss": "clipped objective of dac's choice of options, negated",
    "train/high_value_loss": "half the squared error of dac's values of options, in scaled rewards",
    "train/choice_loss": "loss of ppoc's policy over options",
    "train/choice_entropy": "mean entropy of dac's and ppoc's choice of options, in nats",
    "train/termination_loss": "loss of the terminations of ppoc and a2oc",
    "train/entropy": "mean entropy of the exploring policy, in nats; ddpg's is the softmax of its actor's outputs",
    "train/greedy": "share of decisions for an action that the agent values most, ties included",
    "train/longest_repeat": "most decisions in a row for the same action",
    "train/value": "mean predicted value in the updates, in units of return",
    "train/td_error": "mean absolute error of tabular updates, in units of return",
    "train/epsilon": "mean share of random actions asked for",
    "train/states": "states in the table",
    "train/skills": "options found so far",
    "train/planned": "share of decisions that follow a plan in a learned model; 0 without a model to plan in",
    "train/subgoals": "bits that hrc can reach",
    "train/interventions": "bits that hrc has intervened on",
    "train/intervention_cost": "cost of hrc's search so far, see its page",
    "train/termination": "mean probability that the running option ends",
    "train/skill_reward": "mean reward of diayn's skills for being distinguishable, in nats",
    "train/discriminator_loss": "cross entropy of diayn's discriminator",
    "train/option_duration": "mean decisions that a learned option lasts, over its latest 500 runs",
    "train/option_entropy": "entropy of the learned option that acts, in nats, over the same runs",
    "train/option_collapse": "1 where learned options have collapsed: into one, or into options of one decision",
    "eval/return": "mean undiscounted return of frozen weights",
    "eval/success": "share of evaluation episodes that succeeded, of those that report it; absent where none does",
    "eval/length": "mean primitives of an evaluation episode",
    "eval/returns": "return of each evaluation episode",
    "eval/lengths": "primitives of each evaluation episode",
    "eval/decision_counts": "decisions of each evaluation episode",
    "eval/successes": "whether each evaluation episode succeeded; absent where none reports it",
    "eval/progress": "share of the task done at best in each: the largest info['progress'], else its success; "
                     "absent where no episode reports either",
    "option/choices": "decisions of the episode by the name of what was chosen, primitives included",
    "option/primitives": "primitives of the episode by the name of what was chosen",
    "option/failures": "decisions of the episode whose planning failed",
    "option/planner_calls": "planner calls so far in the run",
    "time/planner_seconds": "seconds in planners so far in the run",
    "time/seconds": "seconds of training so far in the run, evaluations left out",
    "time/primitives_per_second": "rate of training over the episode",
    "time/eval_seconds": "seconds of one evaluation",
}
"""Names in a log and their meaning. An agent of your own adds its `observe` metrics under `train/`."""


@dataclass(frozen=True)
class EpisodeRecord:
    """One training episode."""

    primitives: int  # primitives trained for, at its end
    decisions: int  # decisions trained for, at its end
    episode_return: float  # undiscounted sum of primitive rewards
    length: int  # primitives in it
    success: bool | None  # info["is_success"], else info["success"], at its end, or None if it has neither
    end: str  # `terminated`, `truncated`, or `budget` where the run's budget cut it
    seconds: float = field(compare=False)
    """Seconds of training at its end, without evaluations; left out of comparisons."""


@dataclass(frozen=True)
class SegmentRecord:
    """A segment of training in many environments, with the episodes that ended in it."""

    primitives: int  # primitives trained for, at its end, of all environments together
    decisions: int  # decisions trained for, at its end
    episodes: int  # episodes that ended in it
    successes: int | None  # of these episodes, or None if none of them reports its success
    mean_return: float | None  # their mean undiscounted return, or None if none ended
    mean_length: float | None  # their mean number of primitives, or None if none ended
    seconds: float = field(compare=False)
    """Seconds of training at its end, without evaluations; left out of comparisons."""


def make_evaluation_row(evaluation: Evaluation) -> dict[str, Any]:
    """Make the row of the log for an evaluation."""
    return {
        "kind": "evaluation",
        "primitives": evaluation.primitives,
        "decisions": evaluation.decisions,
        "eval/return": evaluation.mean_return,
        "eval/success": evaluation.success_rate,
        "eval/length": evaluation.mean_length,
        **{name: getattr(evaluation, field) for field, name in _ROWS["evaluation"][1].items()},
    }


_OPTIONAL = frozenset({"train/success", "train/successes", "eval/success", "eval/successes", "eval/progress"})


def omit_absent(row: Mapping[str, Any]) -> dict[str, Any]:
    """Copy a row without the success and progress of episodes that report none."""
    return {name: value for name, value in row.items() if name not in _OPTIONAL or value is not None and (
        not isinstance(value, tuple) or any(each is not None for each in value))}


_ROWS: dict[str, tuple[type, dict[str, str]]] = {
    "episode": (EpisodeRecord, {
        "primitives": "primitives", "decisions": "decisions", "episode_return": "train/return",
        "length": "train/length", "success": "train/success", "end": "train/end", "seconds": "time/seconds"}),
    "segment": (SegmentRecord, {
        "primitives": "primitives", "decisions": "decisions", "episodes": "train/episodes",
        "successes": "train/successes", "mean_return": "train/return", "mean_length": "train/length",
        "seconds": "time/seconds"}),
    "evaluation": (Evaluation, {
        "primitives": "primitives", "decisions": "decisions", "returns": "eval/returns", "lengths": "eval/lengths",
        "decision_counts": "eval/decision_counts", "successes": "eval/successes", "progress": "eval/progress",
        "seconds": "time/eval_seconds"}),
}
"""Kind of a row -> its subject, and the name in the row of each field."""


def read_row(row: Mapping[str, Any]) -> EpisodeRecord | SegmentRecord | Evaluation:
    """Convert a row of the log to an episode, a segment or an evaluation.

    Raises:
        KeyError: the row lacks a name.
        ConfigError: a value is invalid.
    """
    kind, names = _ROWS[row["kind"]]
    fields = {field: row.get(name) if name in _OPTIONAL else row[name] for field, name in names.items()}
    if fields.get("success") is not None:
        fields["success"] = bool(fields["success"])
    if kind is Evaluation:
        none = (None,) * len(row["eval/returns"])
        fields |= {name: none for name in ("successes", "progress") if fields[name] is None}
    return read_record(kind, fields)


@dataclass(frozen=True)
class TrainResult:
    """Result of a training run."""

    agent_name: str  #: registered name of the agent, or the name of its class
    seed: int  #: of the run
    settings: Mapping[str, Any]  #: of the agent, as a JSON value
    primitives: int  #: trained for; the last option can exceed the budget
    decisions: int  #: trained for
    planner_calls: int
    """Requests to planners behind options, by `OptionsEnv.planning_total`; 0 where the environment is a vector."""
    evaluations: tuple[Evaluation, ...]  #: the first before training, the last after it
    episodes: tuple[EpisodeRecord, ...]  #: every training episode; none in a run of many environments
    seconds: float = field(compare=False)  #: wall time of training, evaluations excluded
    planner_seconds: float = field(compare=False)  #: share of it spent in planners
    segments: tuple[SegmentRecord, ...] = ()  #: segments of training, in a run of many environments
    agent: Agent | None = field(default=None, compare=False, repr=False)
    """The trained agent, or None in a result read from a file."""
    folder: Path | None = field(default=None, compare=False)  #: of the run, or None if it left no files
    resumed_at: int = field(default=0, compare=False)  #: primitives that its folder held already; 0 in a new run

    def __repr__(self) -> str:
        first, last = self.first_escape, self.evaluations[-1] if self.evaluations else None
        words = [f"{self.primitives:,} primitives"]
        if last is not None:
            rate = last.success_rate
            words.append(f"return {last.mean_return:.4g}"
                         + ("" if rate is None else f" in {rate:.0%} successful episodes"))
        if self.reports_success:
            words.append("no success in training" if first is None else f"first success at {first:,}")
        return f"<TrainResult {self.agent_name}, seed {self.seed}: {', '.join(words)}>"

    def _repr_svg_(self) -> str:
        return make_svg(self.plot())

    @property
    def reports_success(self) -> bool:
        """True if the environment reports the success of an episode, in training or in evaluations."""
        return (any(episode.success is not None for episode in self.episodes)
                or any(segment.successes is not None for segment in self.segments)
                or any(evaluation.success_rate is not None for evaluation in self.evaluations))

    @property
    def first_escape(self) -> int | None:
        """Primitives trained for at the end of the first episode that succeeded, or None without one.

        With many environments it is the end of the segment of that episode.
        """
        if self.segments:
            return next((segment.primitives for segment in self.segments if segment.successes), None)
        return next((episode.primitives for episode in self.episodes if episode.success), None)

    def curve(self, metric: str = "mean_return", against: str = "primitives") -> tuple[NDArray, NDArray]:
        """Return the learning curve from the evaluations.

        Args:
            metric: `mean_return`, `success_rate`, `mean_progress` or `mean_length`.
            against: `primitives`, `decisions` or `seconds` (of training).

        Returns:
            x and y, float64 (evaluations,). Rates of an environment that reports no success are NaN.
        """
        if against == "seconds":
            ends = {record.primitives: record.seconds for record in (*self.episodes, *self.segments)}
            x = [ends.get(evaluation.primitives, 0.0) for evaluation in self.evaluations]
        else:
            x = [getattr(evaluation, against) for evaluation in self.evaluations]
        return np.array(x, float), np.array([getattr(e, metric) for e in self.evaluations], float)

    def plot(self, metric: str = "mean_return", against: str = "primitives", beside: Sequence[TrainResult] = ()
             ) -> Figure:
        """Draw the learning curve from the evaluations; runs of equal agents are one line with a band.

        Args:
            metric: as for `curve`.
            against: as for `curve`.
            beside: more runs to plot in the same axes; see `plot_runs`.

        Returns:
            A matplotlib figure without a window; a notebook displays it, and `figure.savefig(path)`
            writes it.
        """
        runs = (self, *beside)
        names = name_agents([(run.agent_name, run.settings) for run in runs])
        lines = [Line(name, *run.curve(metric, against), run.seed) for name, run in zip(names, runs, strict=True)]
        return draw_lines(lines, f"{against} of training", f"{metric.replace('_', ' ')} of frozen weights")

    def to_json(self) -> dict[str, Any]:
        """Return a JSON value without `agent`, `folder` and `resumed_at`."""
        value = dataclasses.asdict(dataclasses.replace(self, agent=None))
        return {name: each for name, each in value.items() if name not in ("agent", "folder", "resumed_at")}


def load_result(folder: str | os.PathLike[str]) -> TrainResult:
    """Read the result of a finished run, without its agent (see `load_agent`).

    Raises:
        FileReadError: the run is not finished, or its result cannot be read.
        CheckpointError: the result is damaged.
    """
    return read_result(folder)[1]


def read_result(folder: str | os.PathLike[str]) -> tuple[str, TrainResult]:
    """Read the key and the result of a finished run; see `load_result`."""
    path = Path(folder) / "result.json"
    content = read_json(path, "result of a run")
    try:
        key = content.pop("key")
        return key, dataclasses.replace(read_record(TrainResult, content), folder=Path(folder))
    except (EscapeError, AttributeError, KeyError, TypeError) as error:
        raise CheckpointError(f"{path}: this result of a run is damaged ({describe_damage(error)}). Delete the folder "
                              "to start again") from error
