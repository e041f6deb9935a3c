"""One training run: its episodes, evaluations and totals, in a folder or without one.

The arguments and their defaults are documented in `train.py`.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from types import FrameType
from typing import Any, Protocol, cast

import gymnasium
import numpy as np

from hrl_escape.agents.agent import Agent, SMDPTransition, check_actions, check_same_observations, read_success
from hrl_escape.agents.registry import split_name
from hrl_escape.agents.single_env import serve_one
from hrl_escape.agents.state import Stateful, StateTree
from hrl_escape.agents.training.callbacks import Callback, RunDescription
from hrl_escape.agents.training.env_description import compute_digest, describe_env, hash_files, hash_large_parts
from hrl_escape.agents.training.evaluation import (
    Evaluation,
    compute_episode_seed,
    count_planning,
    evaluate,
    walk_episode,
)
from hrl_escape.agents.training.results import (
    EpisodeRecord,
    SegmentRecord,
    TrainResult,
    make_evaluation_row,
    omit_absent,
    read_row,
)
from hrl_escape.agents.training.run_folder import FORMAT, RunFolder
from hrl_escape.errors import CheckpointError, DivergenceError, describe_damage
from hrl_escape.progress import Reporter, describe_results
from hrl_escape.signals import end_by_signal
from hrl_escape.step_info import is_decision, read_option
from hrl_escape.version import __version__, find_versions

NOTICE = b"\ninterrupted: the run is saved once this episode ends; interrupt again to stop it at once\n"
NO_OPTIONS = (
    "{name} chooses options, and this environment's steps have no info['duration'], so that each counts as one "
    "primitive. Where it should have options, give train OptionsEnv(env)"
)


@dataclasses.dataclass(frozen=True)
class RunArguments:
    """Arguments of a run that are part of its identity; see `train`."""

    name: str
    seed: int
    primitives: int
    decisions: int | None
    eval_every: int
    eval_episodes: int
    eval_seed: int
    agent_state: str | None = None
    """Hash of the state of an agent that was given as an object, or None for one made by name."""
    threads: int = 1  # of torch
    until_return: float | None = None
    """Mean return of two evaluations in a row that ends the run, or None if the budget alone does."""
    eval_trials: int = 1  # parts of an evaluation episode that count as episodes of their own

    @property
    def identity(self) -> dict[str, Any]:
        """The arguments as JSON values, without defaults of `threads`, `until_return` and `eval_trials`."""
        unsaid = {"threads": 1, "until_return": None, "eval_trials": 1}
        return {name: value for name, value in dataclasses.asdict(self).items()
                if name not in unsaid or value != unsaid[name]}


class Probe(Protocol):
    """Measurements of an agent during training, which can end the run before its budget.

    A probe must not change the agent or later episodes.

    Its state is part of the run's checkpoints, so a resumed run has the measurements of an uninterrupted one.
    """

    @property
    def identity(self) -> dict[str, Any]:
        """The measurement and the stopping rule as a JSON value, part of the run's identity."""
        ...

    @property
    def is_done(self) -> bool:
        """Measurements are complete: the run ends after the present episode."""
        ...

    def after_decision(self, agent: Agent, primitives: int) -> None:
        """Measure after a decision, with this many primitives trained for."""

    def after_episode(self, agent: Agent, episode: EpisodeRecord) -> None:
        """Measure between training episodes; the evaluation environment is free for use."""

    def state_dict(self) -> StateTree:
        """State of later measurements, and the results of past ones."""
        ...

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the state of `state_dict`."""


class Run(Stateful):
    """State of a run between episodes: the agent, totals, and measurements so far."""

    STATE = ("agent", "primitives", "decisions", "planner_calls", "seconds", "planner_seconds", "probe")
    """State beyond the log."""

    def __init__(self, agent: Agent, env: gymnasium.Env, eval_env: gymnasium.Env, arguments: RunArguments,
                 probe: Probe | None = None, callbacks: Sequence[Callback] = ()) -> None:
        self.agent, self.env, self.eval_env, self.arguments, self.probe = agent, env, eval_env, arguments, probe
        self.callbacks, self._is_stopped = tuple(callbacks), False
        self.actions = check_actions(agent, env.action_space)
        check_actions(agent, eval_env.action_space)
        check_same_observations(env.observation_space, eval_env.observation_space)
        self.episodes: list[EpisodeRecord] = []
        self.evaluations: list[Evaluation] = []
        self.primitives = self.decisions = self.planner_calls = 0
        self.seconds = self.planner_seconds = 0.0
        self.segments: list[SegmentRecord] = []
        self._folder: RunFolder | None = None

    @property
    def identity(self) -> dict[str, Any]:
        """Everything that decides the run's numbers, as a JSON value; `run.json` keeps it."""
        apart, environment = self.eval_env is not self.env, describe_env(self.env)
        files = hash_files(environment)
        return {
            "format": FORMAT,
            "version": __version__,
            "versions": find_versions(),
            "agent": f"{type(self.agent).__module__}:{type(self.agent).__qualname__}",
            **self.arguments.identity,
            "settings": self._list_settings(),
            "environment": environment,
            "evaluation_environment": describe_env(self.eval_env) if apart else None,
            "observation_space": repr(self.env.observation_space),
            "action_space": repr(self.env.action_space),
            **({"files": files} if files else {}),
            **({} if self.probe is None else {"probe": self.probe.identity}),
        }

    @property
    def key(self) -> str:
        """Short hash of the identity: different numbers, different keys."""
        return compute_digest(hash_large_parts(self.identity))

    def open(self, out: str | os.PathLike[str]) -> None:
        """Claim a folder, and resume from its checkpoint."""
        self._folder = RunFolder(out, self.identity)
        if self._folder.state is not None:
            self.resume(self._folder.state, self._folder.rows)

    def close(self) -> None:
        """Close the run folder for another process to continue the run."""
        if self._folder is not None:
            self._folder.close()

    def _list_settings(self) -> dict[str, Any]:
        return json.loads(json.dumps(dataclasses.asdict(self.agent.settings)))

    def finish(self, checkpoint_seconds: float, report: Reporter) -> TrainResult:
        """Train to the end; the result of a finished folder is returned at once.

        Raises:
            DivergenceError: a loss became NaN; names run and primitive.
            KeyboardInterrupt: Ctrl-C was pressed; a run with a folder has saved the episode that was running. SIGTERM
                and SIGHUP save it too, and then end the process as they would have at once.
        """
        folder, resumed_at = self._folder, self.primitives
        if folder is not None and folder.state is not None and (finished := folder.result) is not None:
            self._sign()
            return dataclasses.replace(finished, agent=self.agent, resumed_at=finished.primitives)
        with nullcontext(lambda: False) if folder is None else _deferring_signals() as is_interrupted:
            return self._finish(folder, resumed_at, checkpoint_seconds, report, is_interrupted)

    def _finish(self, folder: RunFolder | None, resumed_at: int, checkpoint_seconds: float, report: Reporter,
                is_interrupted: Callable[[], bool]) -> TrainResult:
        result: TrainResult | None = None
        begun: list[Callback] = []
        try:
            if self.callbacks:
                described = self._describe()
                for callback in self.callbacks:
                    stops = bool(callback.on_begin(described))
                    begun.append(callback)
                    self._is_stopped |= stops and described.first > 0
            self._train(folder, checkpoint_seconds, report, is_interrupted)
            made = self.make_result()
            if folder is not None and not self._is_stopped:
                folder.finish(made.to_json())
            result = dataclasses.replace(made, resumed_at=resumed_at)
            return result
        except DivergenceError as error:
            where = f", {folder.path}" if folder is not None else ""
            label = f"{self.arguments.name}, seed {self.arguments.seed}{where}"
            raise DivergenceError(error.agent, error.updates, label, self.primitives, error.loss,
                                  error.gradient_norm) from error
        finally:
            for callback in begun:
                try:
                    callback.on_end(result)
                except Exception as error:
                    warnings.warn(f"{type(callback).__name__}.on_end raised {type(error).__name__}: {error}. The run "
                                  f"{'is complete' if result is not None else 'ended'}, and its files and result are "
                                  "as without this callback", RuntimeWarning, stacklevel=3)

    def _describe(self) -> RunDescription:
        rows, path = (self._folder.rows, self._folder.path) if self._folder is not None else ([], None)
        first = rows[-1]["primitives"] + 1 if rows else 0
        return RunDescription(self.arguments.name, self.arguments.seed, self.key, self.identity, path, first,
                              tuple(self.evaluations))

    def _log(self, row: Mapping[str, Any], folder: RunFolder | None) -> None:
        row = omit_absent(row)
        if folder is not None:
            folder.log(row)
        for callback in self.callbacks:
            callback.on_row(row)

    def _train(self, folder: RunFolder | None, checkpoint_seconds: float, report: Reporter,
               is_interrupted: Callable[[], bool]) -> None:
        """Run episodes until the budget is spent, evaluating and saving between them."""
        last_save = time.monotonic()
        self.agent.note_budget(self.arguments.primitives)
        if not self.decisions:
            self._evaluate(folder)
            report(self.primitives, self.describe_returns())
        next_evaluation = self._next_evaluation()
        while not self.is_over:
            self._log(self.run_unit(report), folder)
            if self.is_over or self.primitives >= next_evaluation:
                self._evaluate(folder)
                report(self.primitives, self.describe_returns())
                next_evaluation = self._next_evaluation()
            stops = self.is_over or is_interrupted()
            is_due = stops or time.monotonic() - last_save >= checkpoint_seconds
            if folder is not None and is_due and self.can_be_saved:
                folder.save(self.state_dict())
                last_save = time.monotonic()
                for callback in self.callbacks:
                    callback.on_checkpoint(folder.path)
            is_lost = not self.agent.is_resumable
            if folder is not None and is_interrupted() and (self.can_be_saved or is_lost) and not self.is_over:
                then = ("the same command starts this run again" if is_lost else
                        f"{folder.path} holds the run, and the same command continues it")
                raise KeyboardInterrupt(f"interrupted after {self.primitives:,} primitives; {then}")

    @property
    def is_over(self) -> bool:
        """True once the budget is spent, two evaluations in a row were good enough, or a callback or probe ends it."""
        is_done = self.probe is not None and self.probe.is_done
        return self.is_spent or self._is_stopped or is_done or self._is_good_enough

    @property
    def _is_good_enough(self) -> bool:
        least = self.arguments.until_return
        if least is None or len(self.evaluations) < 2:
            return False
        return all(found.mean_return >= least for found in self.evaluations[-2:])

    @property
    def is_spent(self) -> bool:
        """True once the budget of primitives or of decisions is spent."""
        most = self.arguments.decisions
        return self.primitives >= self.arguments.primitives or (most is not None and self.decisions >= most)

    def _next_evaluation(self) -> int:
        return (self.primitives // self.arguments.eval_every + 1) * self.arguments.eval_every

    @property
    def can_be_saved(self) -> bool:
        """True if a checkpoint taken now resumes to the same bits."""
        return self.agent.is_resumable or self.is_over

    def run_unit(self, report: Reporter) -> dict[str, Any]:
        """Train for one episode; returns its row of the log."""
        started, before, tally = time.perf_counter(), self.primitives, _Tally()
        calls, planning = count_planning(self.env)
        agent, words, end = serve_one(self.agent), self.describe_returns(), "budget"
        seed = compute_episode_seed(self.arguments.seed, "training", len(self.episodes))
        for transition, info in walk_episode(self.env, seed, self.actions, self.agent.gamma, agent.act):
            if self.decisions == 0 and not is_decision(info) and split_name(self.arguments.name)[1]:
                warnings.warn(NO_OPTIONS.format(name=self.arguments.name), stacklevel=2)
            metrics = agent.observe(transition)
            self.primitives += transition.duration
            self.decisions += 1
            tally.add(transition, info, metrics)
            if self.probe is not None:
                self.probe.after_decision(self.agent, self.primitives)
            report(self.primitives, words)
            if transition.terminated or transition.truncated:
                end = "terminated" if transition.terminated else "truncated"
            if self.is_spent:
                break
        clock = self.stop_clock(started, before)
        calls_now, planning_now = count_planning(self.env)
        self.planner_calls += calls_now - calls
        self.planner_seconds += planning_now - planning
        row = {
            "kind": "episode",
            "episode": len(self.episodes),
            "primitives": self.primitives,
            "decisions": self.decisions,
            "train/return": tally.episode_return,
            "train/length": tally.length,
            "train/decisions": tally.decisions,
            "train/success": None if tally.success is None else int(tally.success),
            "train/end": end,
            **tally.make_row(),
            "option/planner_calls": self.planner_calls,
            "time/planner_seconds": self.planner_seconds,
            **clock,
        }
        self.episodes.append(cast("EpisodeRecord", read_row(row)))
        if self.probe is not None:
            self.probe.after_episode(self.agent, self.episodes[-1])
        return row

    def stop_clock(self, started: float, before: int) -> dict[str, float]:
        """Count the seconds since a moment after `before` primitives; return the times for the log."""
        seconds = time.perf_counter() - started
        self.seconds += seconds
        return {"time/seconds": self.seconds,
                "time/primitives_per_second": (self.primitives - before) / max(seconds, 1e-9)}

    def end_segment(self, ended: Mapping[str, Any], means: Means, started: float, before: int) -> dict[str, Any]:
        """Row of a stretch of training, with the episodes that ended in it; see `stop_clock`."""
        row = {"kind": "segment", "primitives": self.primitives, "decisions": self.decisions, **ended,
               **means.make_row(), **self.stop_clock(started, before)}
        self.segments.append(cast("SegmentRecord", read_row(row)))
        return row

    def describe_returns(self) -> str:
        """Describe the latest returns and successes for the progress line."""
        recent, segments = self.episodes[-10:], [segment for segment in self.segments[-1:] if segment.episodes]
        words = [describe_results(
            [record.episode_return for record in recent] + [record.mean_return or 0.0 for record in segments],
            [*(record.success for record in recent),
             *(None if each.successes is None else each.successes / each.episodes for each in segments)])]
        if self.evaluations:
            words.append(f"eval {self.evaluations[-1].mean_return:.1f}")
        return " ".join(filter(None, words))

    def _evaluate(self, folder: RunFolder | None) -> None:
        if not self.arguments.eval_episodes:
            return
        evaluation = evaluate(self.agent, self.eval_env, self.arguments.eval_episodes, self.arguments.eval_seed,
                              primitives=self.primitives, decisions=self.decisions, trials=self.arguments.eval_trials)
        is_best = all(evaluation.mean_return > earlier.mean_return for earlier in self.evaluations)
        self.evaluations.append(evaluation)
        self._log(make_evaluation_row(evaluation), folder)
        if folder is not None and is_best:
            folder.save_best(self.state_dict())
        stops = [callback.on_evaluation(self.agent, evaluation) for callback in self.callbacks]
        self._is_stopped = any(stops) and not self.is_over

    def make_result(self) -> TrainResult:
        """Build the result, and set the agent's origin."""
        self._sign()
        return TrainResult(
            agent_name=self.arguments.name,
            seed=self.arguments.seed,
            settings=self._list_settings(),
            primitives=self.primitives,
            decisions=self.decisions,
            planner_calls=self.planner_calls,
            evaluations=tuple(self.evaluations),
            episodes=tuple(self.episodes),
            segments=tuple(self.segments),
            seconds=self.seconds,
            planner_seconds=self.planner_seconds,
            agent=self.agent,
            folder=self._folder.path if self._folder is not None else None,
        )

    def _sign(self) -> None:
        key = "" if self._folder is None else self._folder.key
        self.agent.origin = make_origin(self.arguments.name, key, self.arguments.seed, self.primitives)

    def resume(self, state: StateTree, rows: list[dict[str, Any]]) -> None:
        """Continue from a checkpoint and the log up to it."""
        with refusing_damage(f"{self.arguments.name}: the checkpoint or its log"):
            probe = self.probe
            self.load_state_dict(state)
            if None in (self.primitives, self.decisions, self.planner_calls, self.seconds, self.planner_seconds):
                raise ValueError("a total is missing")
            if self.probe is not probe:
                raise ValueError("it has the state of a probe, and this run has none")
            records = [read_row(row) for row in rows]
        self.episodes = [record for record in records if isinstance(record, EpisodeRecord)]
        self.segments = [record for record in records if isinstance(record, SegmentRecord)]
        self.evaluations = [record for record in records if isinstance(record, Evaluation)]


_DEFERRED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def _deferring_signals() -> Iterator[Callable[[], bool]]:
    """Note a first Ctrl-C, SIGTERM or SIGHUP, and act on it at the end; a second one acts at once.

    Yields whether one came, and prints a line on a terminal. The caller raises `KeyboardInterrupt` after Ctrl-C, as a
    run can be over by then; the other two always end the process. Existing handlers and ignored signals stay, and
    threads are not affected.
    """
    noted: list[int] = []

    def act(number: int) -> None:
        handler = before[number]
        if callable(handler):
            handler(number, None)
        else:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)

    def note(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        if len(noted) > 1:
            act(number)
        elif sys.stderr is not None and sys.stderr.isatty():
            os.write(2, NOTICE)  # a handler may run amid a print

    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        plain = (signal.SIG_DFL, signal.default_int_handler, end_by_signal)
        before = {number: handler for number in _DEFERRED if (handler := signal.getsignal(number)) in plain}
    try:
        for number in before:
            signal.signal(number, note)
        yield lambda: bool(noted)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if noted and noted[0] != signal.SIGINT:
            act(noted[0])


class Means:
    """Means of what an agent logs, each over the times that it was logged."""

    def __init__(self) -> None:
        self._sums: dict[str, float] = {}
        self._counts: dict[str, int] = {}

    def note(self, metrics: Mapping[str, float]) -> None:
        """Take in the numbers of one decision, step or update."""
        for name, value in metrics.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
            self._counts[name] = self._counts.get(name, 0) + 1

    def make_row(self) -> dict[str, Any]:
        """The means, under their logged names."""
        return {f"train/{name}": total / self._counts[name] for name, total in self._sums.items()}


class _Tally(Means):
    """Sums over one training episode."""

    def __init__(self) -> None:
        super().__init__()
        self.episode_return = 0.0
        self.length = self.decisions = 0
        self._info: Mapping[str, Any] = {}  # of the latest decision
        self._choices: dict[str, int] = {}
        self._choice_primitives: dict[str, int] = {}
        self._failures = 0
        self._last_action: Any = None
        self._repeat = self._longest_repeat = 0

    def add(self, transition: SMDPTransition, info: Mapping[str, Any], metrics: Mapping[str, float]) -> None:
        """Count a decision's reward, primitives and metrics, and how often it repeats the one before."""
        self.episode_return += transition.summed_reward
        self.length += transition.duration
        self.decisions += 1
        self._repeat = self._repeat + 1 if np.array_equal(transition.action, self._last_action) else 1
        self._last_action = transition.action
        self._longest_repeat = max(self._longest_repeat, self._repeat)
        self._info = info
        if (option := read_option(info)) is not None:
            name = option.get("name", "")
            self._choices[name] = self._choices.get(name, 0) + 1
            self._choice_primitives[name] = self._choice_primitives.get(name, 0) + transition.duration
            self._failures += option.get("ended") == "planning-failed"
        self.note(metrics)

    @property
    def success(self) -> bool | None:
        """Success at the latest decision."""
        return read_success(self._info)

    def make_row(self) -> dict[str, Any]:
        """Means of the agent's metrics, and counts of its choices, under their logged names."""
        row = super().make_row() | {"train/longest_repeat": self._longest_repeat}
        if self._choices:
            row["option/choices"] = self._choices
            row["option/primitives"] = self._choice_primitives
            row["option/failures"] = self._failures
        return row


def make_origin(agent: str, run: str, seed: int, primitives: int) -> Mapping[str, Any]:
    """Training that made an agent what it is; see `Agent.origin`."""
    return {"agent": agent, "run": run, "seed": seed, "primitives": primitives}


def load_agent_state(agent: Agent, state: StateTree, where: str) -> None:
    """Restore an agent from a run's checkpoint.

    Raises:
        CheckpointError: it does not fit the agent.
    """
    with refusing_damage(f"{where}: the checkpoint"):
        agent.load_state_dict(state["agent"])


@contextmanager
def refusing_damage(what: str) -> Iterator[None]:
    """Raise a `CheckpointError` for any error in reading damaged content."""
    try:
        yield
    except CheckpointError:
        raise
    except Exception as error:
        raise CheckpointError(f"{what} is damaged, or of another agent ({describe_damage(error)}). Delete the run's "
                              "folder to start again") from error
