"""One training run: its episodes, evaluations and totals, in a folder or without one.

A run is a generator, so that several can go side by side and have their updates made together (`trials.py`); a run
that makes its own updates never yields. What may be asked for, and the defaults, are in `training.py`.
"""

from __future__ import annotations

import dataclasses
import json
import os
import time
import warnings
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium

from hrl_escape.agents.agent import (
    Agent,
    SMDPTransition,
    StateTree,
    count_actions,
    make_transition,
    read_action_mask,
)
from hrl_escape.agents.evaluation import Evaluation, compute_episode_seed, evaluate
from hrl_escape.agents.progress import Reporter
from hrl_escape.agents.registry import SMDP_PREFIX
from hrl_escape.agents.results import EpisodeRecord, TrainResult, make_evaluation_row, read_evaluation_row
from hrl_escape.agents.run_folder import RunFolder
from hrl_escape.agents.updates import Metrics, Updates
from hrl_escape.errors import CheckpointError, DivergenceError

__all__ = ["Plan", "Reply", "Run", "Steps", "load_agent_state"]


@dataclass(frozen=True)
class Plan:
    """What a run was asked for; see `train`."""

    name: str
    seed: int
    primitives: int
    decisions: int | None
    eval_every: int
    eval_episodes: int
    eval_seed: int


class Reply(NamedTuple):
    """What is sent to a run that handed out an update.

    Attributes:
        metrics: what came of it.
        seconds: this run's share of the time it took.
    """

    metrics: Metrics
    seconds: float


NO_OPTIONS = (
    "{name} chooses options, and this environment's steps have no info['duration'], so that each counts as one "
    "primitive. Where it should have options, give train OptionsEnv(env)"
)

Steps = Generator[Any, Reply, TrainResult]
"""A run under way. It yields only where its learner hands out updates."""


class Run:
    """A run's state between episodes: the agent, its totals, what was measured so far.

    Args:
        agent: made new.
        env: where it trains.
        eval_env: where it is evaluated.
        plan: what was asked for.
        hands_out: yield the learner's updates (see `updates.py`), not make them here.
    """

    def __init__(
        self, agent: Agent, env: gymnasium.Env, eval_env: gymnasium.Env, plan: Plan, hands_out: bool = False
    ) -> None:
        self.agent, self.env, self.eval_env, self.plan = agent, env, eval_env, plan
        learner: Any = agent  # not every agent can hand out
        self._learn: Callable[[SMDPTransition], Updates] | None = learner.learn if hands_out else None
        self.actions = count_actions(env.action_space, plan.name)
        self.episodes: list[EpisodeRecord] = []
        self.evaluations: list[Evaluation] = []
        self.primitives = self.decisions = self.planner_calls = 0
        self.seconds = self.planner_seconds = 0.0
        self._folder: RunFolder | None = None
        self._seconds_away = 0.0

    def open(self, out: str | os.PathLike[str], tensorboard: bool) -> None:
        """Take a folder, and go on from what is there."""
        identity = {
            "format": 1,
            **dataclasses.asdict(self.plan),
            "settings": self._list_settings(),
            "environment": self.env.spec.id if self.env.spec else type(self.env.unwrapped).__name__,
            "observation_space": repr(self.env.observation_space),
            "action_space": repr(self.env.action_space),
        }
        self._folder = RunFolder(out, identity, tensorboard)
        if self._folder.state is not None:
            self.load_state_dict(self._folder.state, self._folder.rows)

    def close(self) -> None:
        """Let go of the folder."""
        if self._folder is not None:
            self._folder.close()

    def _list_settings(self) -> dict[str, Any]:
        return json.loads(json.dumps(dataclasses.asdict(self.agent.settings)))

    def finish(self, checkpoint_seconds: float, report: Reporter) -> TrainResult:
        """Follow a run that makes its own updates to the end."""
        try:
            next(self.follow(checkpoint_seconds, report))
        except StopIteration as end:
            return end.value
        raise AssertionError("a run that makes its own updates never yields")

    def follow(self, checkpoint_seconds: float, report: Reporter) -> Steps:
        """Run to the end, or return at once what a finished folder holds.

        Raises:
            DivergenceError: a loss became NaN; names run and primitive.
        """
        folder = self._folder
        if folder is not None and folder.state is not None and (finished := folder.result) is not None:
            return TrainResult.from_json(finished, self.agent)
        try:
            yield from self._train(folder, checkpoint_seconds, report)
        except DivergenceError as error:
            label = f"{self.plan.name}, seed {self.plan.seed}" + (f", {folder.path}" if folder is not None else "")
            raise DivergenceError(error.agent, error.updates, label, self.primitives) from error
        result = self.make_result(self._list_settings())
        if folder is not None:
            folder.finish(result.to_json())
        return result

    def _train(
        self, folder: RunFolder | None, checkpoint_seconds: float, report: Reporter
    ) -> Generator[Any, Reply, None]:
        """Run episodes until the budget is spent, evaluating and saving between them."""
        last_save = time.monotonic()
        if not self.episodes:
            self._evaluate(folder)
        next_evaluation = self._next_evaluation()
        while not self.is_over:
            row = yield from self._run_episode(report)
            if folder is not None:
                folder.log(row)
            if self.is_over or self.primitives >= next_evaluation:
                self._evaluate(folder)
                next_evaluation = self._next_evaluation()
            if folder is not None and (self.is_over or time.monotonic() - last_save >= checkpoint_seconds):
                folder.save(self.state_dict())
                last_save = time.monotonic()

    @property
    def is_over(self) -> bool:
        """The budget is spent."""
        most = self.plan.decisions
        return self.primitives >= self.plan.primitives or (most is not None and self.decisions >= most)

    def _next_evaluation(self) -> int:
        return (self.primitives // self.plan.eval_every + 1) * self.plan.eval_every

    def _run_episode(self, report: Reporter) -> Generator[Any, Reply, dict[str, Any]]:
        """Train for one episode; returns its row of the log."""
        started, self._seconds_away = time.perf_counter(), 0.0
        tally = _Tally()
        agent, env = self.agent, self.env
        observation, info = env.reset(seed=compute_episode_seed(self.plan.seed, "training", len(self.episodes)))
        mask = read_action_mask(info, self.actions)
        words = self._describe()
        end = "budget"
        while end == "budget" and not self.is_over:
            action = agent.act(observation, mask)
            step = env.step(action)
            transition = make_transition(observation, action, mask, step, agent.gamma)
            if self.decisions == 0 and "duration" not in step[4] and self.plan.name.startswith(SMDP_PREFIX):
                warnings.warn(NO_OPTIONS.format(name=self.plan.name), stacklevel=2)
            metrics = agent.observe(transition) if self._learn is None else (yield from self._hand_out(transition))
            self.primitives += transition.duration
            self.decisions += 1
            tally.add(transition, step[4], metrics)
            report(self.primitives, words)
            if transition.terminated or transition.truncated:
                end = "terminated" if transition.terminated else "truncated"
            observation, mask = transition.next_observation, transition.next_action_mask
        seconds = time.perf_counter() - started - self._seconds_away
        self.seconds += seconds
        self.planner_calls += tally.planner_calls
        self.planner_seconds += tally.planner_seconds
        row = {
            "kind": "episode",
            "episode": len(self.episodes),
            "primitives": self.primitives,
            "decisions": self.decisions,
            "train/return": tally.episode_return,
            "train/length": tally.length,
            "train/decisions": tally.decisions,
            "train/success": int(tally.success),
            "train/end": end,
            **tally.make_row(),
            "option/planner_calls": self.planner_calls,
            "time/planner_seconds": self.planner_seconds,
            "time/seconds": self.seconds,
            "time/primitives_per_second": tally.length / max(seconds, 1e-9),
        }
        self.episodes.append(EpisodeRecord.from_row(row))
        return row

    def _hand_out(self, transition: SMDPTransition) -> Generator[Any, Reply, Metrics]:
        """Learn from a decision while others make the updates; their time is not this run's."""
        assert self._learn is not None, "asked only of a run that hands out"
        updates = self._learn(transition)
        try:
            request = next(updates)
            while True:
                left = time.perf_counter()
                reply = yield request
                self._seconds_away += time.perf_counter() - left - reply.seconds
                request = updates.send(reply.metrics)
        except StopIteration as end:
            return end.value

    def _describe(self) -> str:
        """Latest returns, for the progress line."""
        recent = [record.episode_return for record in self.episodes[-10:]]
        words = [f"return {sum(recent) / len(recent):.1f}"] if recent else []
        if self.evaluations:
            words.append(f"eval {self.evaluations[-1].mean_return:.1f}")
        return " ".join(words)

    def _evaluate(self, folder: RunFolder | None) -> None:
        if not self.plan.eval_episodes:
            return
        evaluation = evaluate(
            self.agent,
            self.eval_env,
            self.plan.eval_episodes,
            self.plan.eval_seed,
            primitives=self.primitives,
            decisions=self.decisions,
        )
        self.evaluations.append(evaluation)
        if folder is not None:
            folder.log(make_evaluation_row(evaluation))

    def make_result(self, settings: Mapping[str, Any]) -> TrainResult:
        """What came of it."""
        return TrainResult(
            agent_name=self.plan.name,
            seed=self.plan.seed,
            settings=settings,
            primitives=self.primitives,
            decisions=self.decisions,
            planner_calls=self.planner_calls,
            evaluations=tuple(self.evaluations),
            episodes=tuple(self.episodes),
            seconds=self.seconds,
            planner_seconds=self.planner_seconds,
            agent=self.agent,
        )

    def state_dict(self) -> StateTree:
        """All that is not in the log."""
        return {
            "agent": self.agent.state_dict(),
            "primitives": self.primitives,
            "decisions": self.decisions,
            "planner_calls": self.planner_calls,
            "seconds": self.seconds,
            "planner_seconds": self.planner_seconds,
        }

    def load_state_dict(self, state: StateTree, rows: list[dict[str, Any]]) -> None:
        """Go on from a checkpoint and the log up to it."""
        load_agent_state(self.agent, state, self.plan.name)
        self.primitives, self.decisions = state["primitives"], state["decisions"]
        self.planner_calls = state["planner_calls"]
        self.seconds, self.planner_seconds = state["seconds"], state["planner_seconds"]
        self.episodes = [EpisodeRecord.from_row(row) for row in rows if row["kind"] == "episode"]
        self.evaluations = [read_evaluation_row(row) for row in rows if row["kind"] == "evaluation"]


class _Tally:
    """Sums over one training episode."""

    def __init__(self) -> None:
        self.episode_return = self.planner_seconds = 0.0
        self.length = self.decisions = self.planner_calls = 0
        self.success = False
        self._choices: dict[str, int] = {}
        self._choice_primitives: dict[str, int] = {}
        self._failures = 0
        self._sums: dict[str, float] = {}
        self._counts: dict[str, int] = {}

    def add(self, transition: SMDPTransition, info: Mapping[str, Any], metrics: Mapping[str, float]) -> None:
        """Take in one decision."""
        self.episode_return += transition.summed_reward
        self.length += transition.duration
        self.decisions += 1
        if transition.terminated or transition.truncated:
            self.success = bool(info.get("is_success", transition.terminated))
        if (option := info.get("option")) is not None:
            name = option["name"]
            self._choices[name] = self._choices.get(name, 0) + 1
            self._choice_primitives[name] = self._choice_primitives.get(name, 0) + transition.duration
            self._failures += option.get("ended") == "planning-failed"
            self.planner_calls += option.get("planner_calls", 0)
            self.planner_seconds += option.get("planner_seconds", 0.0)
        for name, value in metrics.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
            self._counts[name] = self._counts.get(name, 0) + 1

    def make_row(self) -> dict[str, Any]:
        """The agent's numbers and what was chosen, under their logged names."""
        row: dict[str, Any] = {f"train/{name}": total / self._counts[name] for name, total in self._sums.items()}
        if self._choices:
            row["option/choices"] = self._choices
            row["option/primitives"] = self._choice_primitives
            row["option/failures"] = self._failures
        return row


def load_agent_state(agent: Agent, state: StateTree, where: str) -> None:
    """Restore an agent from a run's checkpoint.

    Raises:
        CheckpointError: it does not fit the agent.
    """
    try:
        agent.load_state_dict(state["agent"])
    except CheckpointError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, RuntimeError) as error:
        raise CheckpointError(
            f"{where}: the checkpoint does not fit the agent {type(agent).__name__} ({error!r})"
        ) from error
