"""Training: one loop for every agent, budgets counted in primitives, runs that survive being killed.

An episode's seed is a function of the run's seed and its number, and checkpoints are taken between episodes, so no
environment needs saving: a killed run resumes to the same bits. Evaluations happen between episodes
too. It starts no processes and compares nothing; that is for `hrl_escape.experiments`.
"""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from hrl_escape.agents.agent import (
    Agent,
    SMDPTransition,
    StateTree,
    count_actions,
    make_transition,
    read_action_mask,
)
from hrl_escape.agents.checkpoint import load_checkpoint
from hrl_escape.agents.evaluation import Evaluation, compute_episode_seed, evaluate
from hrl_escape.agents.progress import Reporter, show_progress
from hrl_escape.agents.registry import make_agent
from hrl_escape.agents.results import EpisodeRecord, TrainResult, make_evaluation_row, read_evaluation_row
from hrl_escape.agents.run_folder import RunFolder
from hrl_escape.errors import AgentSettingsError, CheckpointError, DivergenceError
from hrl_escape.files import read_json

__all__ = ["load_agent", "train"]


def train(
    agent: str | Agent,
    env: gymnasium.Env,
    *,
    primitives: int,
    decisions: int | None = None,
    seed: int = 0,
    recipe: str = "corrected",
    settings: Mapping[str, Any] | None = None,
    eval_env: gymnasium.Env | None = None,
    eval_every: int | None = None,
    eval_episodes: int = 5,
    eval_seed: int = 0,
    out: str | os.PathLike[str] | None = None,
    checkpoint_seconds: float = 30.0,
    tensorboard: bool = False,
    progress: bool | None = None,
) -> TrainResult:
    """Train an agent on an environment, flat or with options.

    Args:
        agent: a name (see `registry.list_agents`, with or without `smdp-`), or an agent of your own, made new.
        env: Discrete actions; what `step` must return is in `agent.make_transition`. It must depend on nothing
            before `reset(seed=...)`, which is called for every episode.
        primitives: the budget. The decision that reaches it is the last.
        decisions: end after so many decisions too, if these are fewer; for programs that counted so.
        seed: 0 or more; fixes the agent (if named) and every training episode.
        recipe: `corrected` or `paper`, for a named agent.
        settings: fields of a named agent's settings to change.
        eval_env: where to evaluate; by default `env` itself, between episodes.
        eval_every: primitives between evaluations, a twentieth of the budget by default. Each is made at
            the first episode's end from there on, besides one before training and one after.
        eval_episodes: episodes in an evaluation; 0 leaves evaluations out.
        eval_seed: fixes evaluation episodes; leave it alone where runs are to be compared.
        out: folder for log, checkpoints and result. A run found there with the same settings goes on where its
            last checkpoint was taken, to the same bits; a finished one is returned at once.
        checkpoint_seconds: least wall time between checkpoints; 0 makes one after every episode.
        tensorboard: also write event files (needs `out` and the extra `tensorboard`).
        progress: show a progress line; by default on a terminal only.

    Returns:
        Curves, episodes, totals and the trained agent.

    Raises:
        AgentSettingsError: an argument or setting is impossible.
        UnknownNameError: no such agent, recipe or setting.
        StepContractError: the environment breaks the contract.
        DivergenceError: a loss became NaN; names run and primitive.
        RunMismatchError, RunBusyError, CheckpointError, FileWriteError: about `out`.
    """
    eval_every = eval_every or max(1, primitives // 20)
    for name, value, least in (
        ("primitives", primitives, 1),
        ("decisions", 1 if decisions is None else decisions, 1),
        ("eval_every", eval_every, 1),
        ("eval_episodes", eval_episodes, 0),
        ("eval_seed", eval_seed, 0),
        ("seed", seed, 0),
    ):
        if not isinstance(value, (int, np.integer)) or value < least:
            raise AgentSettingsError(name, value, f"it must be a whole number, {least} or more")
    if tensorboard and out is None:
        raise AgentSettingsError("tensorboard", True, "event files need a folder: give out=")
    if isinstance(agent, str):
        name, spaces = agent, (env.observation_space, env.action_space)
        learner = make_agent(agent, *spaces, seed, recipe, **settings or {})
    else:
        name, learner = type(agent).__name__, agent
    chosen = json.loads(json.dumps(dataclasses.asdict(learner.settings)))
    plan = _Plan(name, seed, primitives, decisions, eval_every, eval_episodes, eval_seed)
    run = _Run(learner, env, eval_env or env, plan)
    folder = None
    if out is not None:
        identity = {
            "format": 1,
            **dataclasses.asdict(run.plan),
            "settings": chosen,
            "environment": env.spec.id if env.spec else type(env.unwrapped).__name__,
            "observation_space": repr(env.observation_space),
            "action_space": repr(env.action_space),
        }
        folder = RunFolder(out, identity, tensorboard)
    try:
        if folder is not None and folder.state is not None:
            run.load_state_dict(folder.state, folder.rows)
            if (finished := folder.result) is not None:
                return TrainResult.from_json(finished, learner)
        with show_progress(f"{name} seed {seed}", primitives, run.primitives, progress) as report:
            run.train(folder, checkpoint_seconds, report)
        result = run.make_result(chosen)
        if folder is not None:
            folder.finish(result.to_json())
        return result
    except DivergenceError as error:
        label = f"{name}, seed {seed}" + (f", {folder.path}" if folder is not None else "")
        raise DivergenceError(error.agent, error.updates, label, run.primitives) from error
    finally:
        if folder is not None:
            folder.close()


def load_agent(folder: str | os.PathLike[str], env: gymnasium.Env) -> Agent:
    """The agent of a run as of its last checkpoint; in a finished run, the trained one.

    Args:
        folder: the run's, of a named agent.
        env: gives the spaces; the same environment as in training.

    Raises:
        FileReadError: no checkpoint or description there.
        CheckpointError: the checkpoint is damaged or does not fit.
    """
    described = read_json(Path(folder) / "run.json", "description of a run")
    state = load_checkpoint(Path(folder) / "checkpoint.npz")
    agent = make_agent(
        described["name"], env.observation_space, env.action_space, described["seed"], **described["settings"]
    )
    _load_agent_state(agent, state, str(folder))
    return agent


def _load_agent_state(agent: Agent, state: StateTree, where: str) -> None:
    try:
        agent.load_state_dict(state["agent"])
    except CheckpointError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, RuntimeError) as error:
        raise CheckpointError(
            f"{where}: the checkpoint does not fit the agent {type(agent).__name__} ({error!r})"
        ) from error


@dataclass(frozen=True)
class _Plan:
    """What a run was asked for; see `train`."""

    name: str
    seed: int
    primitives: int
    decisions: int | None
    eval_every: int
    eval_episodes: int
    eval_seed: int


class _Run:
    """A run's state between episodes: the agent, its totals, what was measured so far."""

    def __init__(self, agent: Agent, env: gymnasium.Env, eval_env: gymnasium.Env, plan: _Plan) -> None:
        self.agent, self.env, self.eval_env, self.plan = agent, env, eval_env, plan
        self.actions = count_actions(env.action_space, plan.name)
        self.episodes: list[EpisodeRecord] = []
        self.evaluations: list[Evaluation] = []
        self.primitives = self.decisions = self.planner_calls = 0
        self.seconds = self.planner_seconds = 0.0

    def train(self, folder: RunFolder | None, checkpoint_seconds: float, report: Reporter) -> None:
        """Run episodes until the budget is spent, evaluating and saving between them."""
        last_save = time.monotonic()
        if not self.episodes:
            self._evaluate(folder)
        next_evaluation = self._next_evaluation()
        while not self.is_over:
            row = self._run_episode(report)
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

    def _run_episode(self, report: Reporter) -> dict[str, Any]:
        """Train for one episode; returns its row of the log."""
        started = time.perf_counter()
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
            metrics = agent.observe(transition)
            self.primitives += transition.duration
            self.decisions += 1
            tally.add(transition, step[4], metrics)
            report(self.primitives, words)
            if transition.terminated or transition.truncated:
                end = "terminated" if transition.terminated else "truncated"
            observation, mask = transition.next_observation, transition.next_action_mask
        seconds = time.perf_counter() - started
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
        _load_agent_state(self.agent, state, self.plan.name)
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
