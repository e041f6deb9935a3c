"""Callbacks: observers of a training run, which can end it after an evaluation.

    train("dqn", env, primitives=100_000, out="runs/one", callbacks=[TensorBoard()])

A callback does not change the results of the run and is not part of its identity. A run that a callback ended keeps
its checkpoint and has no result yet. The same call without the callback continues it.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hrl_escape.errors import AgentSettingsError, MissingExtraError

if TYPE_CHECKING:
    from hrl_escape.agents.agent import Agent
    from hrl_escape.agents.training.results import Evaluation, TrainResult


@dataclass(frozen=True)
class RunDescription:
    """A run that begins, or continues."""

    name: str  # of the agent
    seed: int  # of the run
    key: str  # short hash of the identity
    identity: Mapping[str, Any]  # everything that decides its numbers, a JSON value
    folder: Path | None  # of the run, or None without one
    first: int  # primitives of the first row to come, 0 for a new run
    evaluations: tuple[Evaluation, ...] = ()  # made before it was resumed; empty for a new run


class Callback:
    """Base of callbacks: override the events to receive; the methods do nothing by default."""

    def on_begin(self, run: RunDescription) -> bool | None:
        """Called when the run begins, or continues from its checkpoint; return True to end a run that continues."""

    def on_row(self, row: Mapping[str, Any]) -> None:
        """Called with each row of the log: an episode, a segment or an evaluation, as in `log.jsonl`."""

    def on_evaluation(self, agent: Agent, evaluation: Evaluation) -> bool:
        """Called after an evaluation; return True to end the run."""
        return False

    def on_checkpoint(self, folder: Path) -> None:
        """Called after a checkpoint was written into the run's folder."""

    def on_end(self, result: TrainResult | None) -> None:
        """Called last, with the result of the run, or with None after an interruption.

        An exception here is reported as a warning: the result is returned, and all other callbacks are called.
        """


def list_numbers(row: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers of a row to plot, with a slash in their names."""
    return {name: value for name, value in row.items() if "/" in name and isinstance(value, (int, float))}


def _load(package: str, extra: str, purpose: str) -> Any:
    """Import a package of an extra, or raise `MissingExtraError`."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise MissingExtraError(package.partition(".")[0], extra, purpose) from error


class TensorBoard(Callback):
    """Event files in the run's folder, numbers against primitives; events after a checkpoint are dropped.

    Raises:
        MissingExtraError: at the beginning of a run, without the extra `tensorboard`.
        AgentSettingsError: a run without a folder.
    """

    def on_begin(self, run: RunDescription) -> None:
        """Open the writer."""
        if run.folder is None:
            raise AgentSettingsError("callbacks", "TensorBoard()", "one for a run with a folder: give out= as well")
        writer = _load("torch.utils.tensorboard", "tensorboard", "writing TensorBoard files").SummaryWriter
        self._events = writer(run.folder / "tensorboard", purge_step=run.first)

    def on_row(self, row: Mapping[str, Any]) -> None:
        """Add the row's numbers."""
        for name, value in list_numbers(row).items():
            self._events.add_scalar(name, value, row["primitives"])

    def on_end(self, result: TrainResult | None) -> None:
        """Close the writer."""
        self._events.close()


class WeightsAndBiases(Callback):
    """A run of Weights & Biases, offline by default; `wandb sync` uploads it later.

    Args:
        project: its name there.
        mode: `offline`, `online` or `disabled`.
        folder: where its files go; the run's own folder, or the working directory, by default.

    Raises:
        MissingExtraError: at the beginning of a run, without the extra `wandb`.
    """

    def __init__(self, project: str = "hrl-escape", mode: str = "offline", folder: str | Path | None = None) -> None:
        self.project, self.mode, self.folder = project, mode, folder

    def on_begin(self, run: RunDescription) -> None:
        """Begin the run under the hash of its identity, or continue it."""
        where = self.folder or run.folder
        self._run = _load("wandb", "wandb", "logging to Weights & Biases").init(
            project=self.project, mode=self.mode, dir=None if where is None else str(where), id=run.key,
            name=f"{run.name}, seed {run.seed}", config=dict(run.identity), resume="allow")

    def on_row(self, row: Mapping[str, Any]) -> None:
        """Log the row's numbers against primitives."""
        self._run.log({**list_numbers(row), "primitives": row["primitives"]})

    def on_end(self, result: TrainResult | None) -> None:
        """Finish the run."""
        self._run.finish()


class MLflow(Callback):
    """A run of MLflow, in a store of files or behind a server.

    Args:
        tracking_uri: of the store; MLflow's own default where it is None.
        experiment: its name there.

    Raises:
        MissingExtraError: at the beginning of a run, without the extra `mlflow`.
    """

    def __init__(self, tracking_uri: str | None = None, experiment: str = "hrl-escape") -> None:
        self.tracking_uri, self.experiment = tracking_uri, experiment

    def on_begin(self, run: RunDescription) -> None:
        """Create the run, tagged with the hash of its identity, and note its settings."""
        client = _load("mlflow", "mlflow", "logging to MLflow").MlflowClient(tracking_uri=self.tracking_uri)
        found = client.get_experiment_by_name(self.experiment)
        number = client.create_experiment(self.experiment) if found is None else found.experiment_id
        made = client.create_run(number, run_name=f"{run.name}, seed {run.seed}", tags={"key": run.key})
        self._client, self._id = client, made.info.run_id
        for name, value in {"agent": run.name, "seed": run.seed, **run.identity.get("settings", {})}.items():
            client.log_param(self._id, name, value)

    def on_row(self, row: Mapping[str, Any]) -> None:
        """Log the row's numbers against primitives."""
        for name, value in list_numbers(row).items():
            self._client.log_metric(self._id, name, value, step=row["primitives"])

    def on_end(self, result: TrainResult | None) -> None:
        """Say whether the run came to its end."""
        self._client.set_terminated(self._id, "KILLED" if result is None else "FINISHED")


class OptunaPruning(Callback):
    """Reports mean returns of evaluations to a trial of Optuna, and ends the run where the trial should be pruned.

    Args:
        trial: `optuna.trial.Trial`.

    Attributes:
        is_pruned: the run was ended; raise `optuna.TrialPruned` then.
    """

    def __init__(self, trial: Any) -> None:
        self.trial, self.is_pruned = trial, False

    def on_begin(self, run: RunDescription) -> bool:
        """Report the evaluations from before the run was resumed; return True to prune the trial."""
        for evaluation in run.evaluations:
            self.trial.report(evaluation.mean_return, evaluation.primitives)
        self.is_pruned = bool(run.evaluations) and bool(self.trial.should_prune())
        return self.is_pruned

    def on_evaluation(self, agent: Agent, evaluation: Evaluation) -> bool:
        """Report the mean return at this many primitives; return True to prune the trial."""
        self.trial.report(evaluation.mean_return, evaluation.primitives)
        self.is_pruned = bool(self.trial.should_prune())
        return self.is_pruned
