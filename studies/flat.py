"""Flat learners, most of them in many copies of a room at once: runs, where their time goes, repeated actions.

Shared by the studies of flat learners. Copies of a room are stepped by the batched engine; evaluations are episodes of
the greedy policy in the ordinary environment, with the same repeats.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from torch import Tensor

from hrl_escape.agents.many_envs import EndedDecisions
from hrl_escape.agents.registry import get_recipe
from hrl_escape.agents.state import StateTree
from hrl_escape.agents.training.callbacks import Callback
from hrl_escape.agents.training.env_description import compute_digest
from hrl_escape.agents.training.many_envs import VectorManyEnvs
from hrl_escape.agents.training.results import TrainResult
from hrl_escape.agents.training.train import train
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import UnknownNameError
from hrl_escape.files import read_text
from hrl_escape.planning.best_known import find_best_known
from hrl_escape.sets.goals import GoalsEnv
from hrl_escape.settings import read_record, replace_settings
from hrl_escape.version import find_versions
from studies.archive import ArchiveSettings, explore
from studies.running import StudyArgs
from studies.statistics import find_lasting
from studies.store import Store
from studies.study import Study

__all__ = ["ARCHIVE", "CORNER", "TENTHS", "FlatArgs", "FlatJob", "FlatLearner", "FlatRun", "RepeatedStreams",
           "count_untrained", "find_until", "list_learners", "measure_flat_runs", "run_flat"]

CORNER = 0.8
"""Share of the way from the middle to a wall. Robots beyond it along both walls are in a corner: 4 % of the floor."""
TENTHS = 10
ARCHIVE = "archive"
"""Name of the learner that is not an agent: `studies.archive`."""


@dataclass(frozen=True)
class FlatArgs(StudyArgs):
    """Options of studies of flat learners."""

    agents: tuple[str, ...] = ()
    """Labels of the learners to run; all by default."""
    runs: int | None = None
    """Runs of each; from `study.toml` by default."""
    first_seed: int = 0
    """Lowest seed."""
    minutes: float | None = None
    """Minutes before the last start of a run."""


@dataclass(frozen=True)
class FlatLearner:
    """A learner over primitives.

    Attributes:
        label: in tables.
        agent: name, or `ARCHIVE`.
        settings: fields to change.
        streams: copies of the room that it learns in at once, compiled; 0 for one ordinary environment.
        repeat: repetitions of each chosen action, in primitives; only with streams.
        budget: primitives, where not the study's.
        sizes: numbers of buttons, where not all of the study's.
    """

    label: str
    agent: str
    settings: dict[str, Any] = field(default_factory=dict)
    streams: int = 64
    repeat: int = 1
    budget: int | None = None
    sizes: tuple[int, ...] | None = None


@dataclass(frozen=True)
class FlatRun:
    """Result of a run.

    Attributes:
        agent: label of the learner.
        buttons: of the room.
        seed: of training; chooses the room where the study has several.
        fewest: primitives of the best known escape.
        budget: primitives; a run that ended early has spent what its last evaluation says.
        first_escape: primitives, of all streams together, at the end of the first training episode that escaped, or
            None without one.
        curve: (primitives, efficiency) of each evaluation of the greedy policy.
        escapes: share of training episodes that escaped, in each tenth of the run, or None if none ended.
        corners: share of the primitives spent in corners, in each tenth; empty of one ordinary environment.
        entropy: of the policy that trains, nats, in each tenth; empty where the agent logs none.
        seconds: of processor time.
        key: hash of everything that decides the numbers.
    """

    agent: str
    buttons: int
    seed: int
    fewest: int
    budget: int
    first_escape: int | None
    curve: tuple[tuple[int, float], ...]
    escapes: tuple[float | None, ...]
    corners: tuple[float, ...]
    entropy: tuple[float, ...]
    seconds: float
    key: str

    @property
    def place(self) -> tuple[str, int, int, int]:
        """Subject of the line."""
        return self.agent, self.buttons, self.seed, self.budget

    @property
    def efficiency(self) -> float:
        """Mean of the evaluations in the last fifth."""
        return float(np.mean([value for at, value in self.curve if at >= 0.8 * self.budget]))

    @property
    def spent(self) -> int:
        """Primitives that it trained for."""
        return self.curve[-1][0]

    def find_threshold(self, least: float) -> int | None:
        """Primitives at the first of two evaluations in a row of at least this efficiency, or None."""
        return find_lasting(self.curve, least)


class RepeatedStreams:
    """Many environments that repeat every action for some primitives, and counts of primitives in corners.

    A decision lasts `repeat` primitives, or to the end of its episode; streams decide at their own pace.

    Args:
        env: vector environment of one room, with tensors.
        repeat: primitives of a decision, 1 or more.
        gamma: discount per primitive.
    """

    def __init__(self, env: Any, repeat: int, gamma: float) -> None:
        self._env, self._inner, self._repeat = env, VectorManyEnvs(env, gamma), repeat
        self.count, self.gamma = env.num_envs, gamma
        self.observation_space, self.action_space = env.single_observation_space, env.single_action_space
        room = env.unwrapped.instances[0]
        self._reach = room.half_width, room.half_depth
        self.corners: list[float] = []
        """Share of the streams that were in a corner, primitive by primitive."""
        self.primitives = 0
        self.first_escape: int | None = None
        """Primitives of all streams together when the first of them escaped."""

    @property
    def device(self) -> torch.device:
        """Device of all tensors."""
        return self._inner.device

    @property
    def observation(self) -> Tensor:
        """Observations now, (streams, ...)."""
        return self._inner.observation

    @property
    def action_mask(self) -> Tensor:
        """Actions legal now, bool (streams, actions)."""
        return self._inner.action_mask

    @property
    def is_waiting(self) -> Tensor:
        """Streams whose last decision is over, bool (streams,)."""
        return (self._left == 0) & self._inner.is_waiting

    def describe(self) -> Mapping[str, Any]:
        """Arguments that decide the numbers, as JSON values."""
        return {**self._env.unwrapped.describe(), "repeat": self._repeat}

    def reset(self, seeds: int) -> None:
        """Begin all episodes anew."""
        self._inner.reset(seeds)
        zero = torch.zeros(self.count, dtype=torch.int64, device=self.device)
        self._left, self._action, self._duration = zero, zero.clone(), zero.clone()
        self._begun = self.observation
        self._sums = torch.zeros((2, self.count), device=self.device)

    def step(self, action: Tensor) -> EndedDecisions:
        """Run one primitive in every stream; decisions that ended with it are in `where`."""
        asked = self.is_waiting
        self._action = torch.where(asked, action, self._action)
        self._left = torch.where(asked, self._repeat, self._left)
        self._duration = torch.where(asked, 0, self._duration)
        self._sums[:, asked] = 0.0
        self._begun = torch.where(asked[:, None], self.observation, self._begun)
        done = self._inner.step(self._action)
        self._watch()
        self.primitives += int(done.where.sum())
        if self.first_escape is None and bool((done.success & done.terminated & done.where).any()):
            self.first_escape = self.primitives
        reward = torch.where(done.where, done.reward, 0.0)
        self._sums += torch.stack((reward, reward * self.gamma ** self._duration.float()))
        self._duration, over = self._duration + done.where.long(), (done.terminated | done.truncated) & done.where
        self._left = torch.where(over, 0, self._left - done.where.long())
        ended = done.where & (self._left == 0)
        return done._replace(where=ended, observation=self._begun, action=self._action, reward=self._sums[0].clone(),
                             discounted_reward=self._sums[1].clone(), duration=self._duration.clamp(min=1))

    def _watch(self) -> None:
        state = self._env.unwrapped.room.state
        away = [abs(part) >= CORNER * reach for part, reach in zip((state.x, state.y), self._reach, strict=True)]
        self.corners.append(float((away[0] & away[1]).float().mean()))

    def state_dict(self) -> StateTree | None:
        """Running episodes, decisions and counts, so that an evaluation does not end them."""
        inner = self._inner.state_dict()
        own = {name: getattr(self, f"_{name}") for name in ("left", "action", "duration", "begun", "sums")}
        seen = {"corners": np.array(self.corners), "primitives": self.primitives, "first_escape": self.first_escape}
        return None if inner is None else {"inner": inner, **seen, **own}

    def load_state_dict(self, state: StateTree) -> None:
        """Go on where `state_dict` was taken."""
        self._inner.load_state_dict(state["inner"])
        self.corners = list(state["corners"])
        self.primitives, self.first_escape = state["primitives"], state["first_escape"]
        for name in ("left", "action", "duration", "begun", "sums"):
            setattr(self, f"_{name}", torch.from_numpy(np.array(state[name])).to(self.device))


class _RepeatedEnv(gymnasium.Wrapper):
    """The same repeats in one ordinary environment, for evaluations."""

    def __init__(self, env: gymnasium.Env, repeat: int, gamma: float) -> None:
        super().__init__(env)
        self.repeat, self.gamma = repeat, gamma

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Repeat the action; `info` has the primitives that ran, and their reward as a decision's."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        rewards = [float(reward)]
        while len(rewards) < self.repeat and not (terminated or truncated):
            observation, reward, terminated, truncated, info = self.env.step(action)
            rewards.append(float(reward))
        extra = {"duration": len(rewards), "discount": self.gamma ** len(rewards),
                "discounted_reward": sum(self.gamma**number * reward for number, reward in enumerate(rewards))}
        return observation, sum(rewards), terminated, truncated, {**info, **extra}


class FlatJob(NamedTuple):
    """A run to be made.

    Attributes:
        learner: that learns.
        room: of the run.
        seed: of training.
        budget: primitives.
        eval_every: primitives between evaluations.
        until: efficiency at two evaluations in a row that ends the run; 0 for none, at the first evaluation after the
            first escape, or None to run for the whole budget.
    """

    learner: FlatLearner
    room: RoomInstance
    seed: int
    budget: int
    eval_every: int
    until: float | None = None


class _UntilEscape(Callback):
    """Ends a run with the first evaluation after an escape in training."""

    def __init__(self) -> None:
        self._has_escaped = False

    def on_row(self, row: Mapping[str, Any]) -> None:
        """An episode or a segment ended."""
        self._has_escaped |= bool(row.get("train/success") or row.get("train/successes"))

    def on_evaluation(self, agent: Any, evaluation: Any) -> bool:
        """True once it has escaped."""
        return self._has_escaped


def find_until(room: RoomInstance, fewest: int, efficiency: float, has_goals: bool) -> float:
    """Return of an escape of this efficiency: -1 a primitive and 0 for the last where goals are asked for."""
    most = fewest / efficiency
    return 1 - most - 1e-9 if has_goals else room.reward.exit + room.reward.step * most


def run_flat(learner: FlatLearner, room: RoomInstance, seed: int, budget: int, eval_every: int,
             until: float | None = None) -> FlatRun:
    """Train a learner in a room; see `FlatJob`."""
    single: Any = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=room, observation="features",
                                 disable_env_checker=True)
    single.reset(seed=0)
    fewest = find_best_known(room, single.unwrapped.get_state()).primitives
    assert fewest is not None, "rooms of these studies can be escaped from"
    key = make_key(learner, room, seed, budget, eval_every, until)
    started = time.process_time()
    if learner.agent == ARCHIVE:
        found = explore(single.unwrapped, read_record(ArchiveSettings, learner.settings), seed, budget, eval_every,
                        int(fewest / until + 1e-9) if until else 0, until == 0)
        curve = tuple((at, 0.0 if length is None else round(min(1.0, fewest / length), 4))
                      for at, length in found.lengths)
        return FlatRun(learner.label, len(room.targets), seed, fewest, budget, found.first_escape, curve, (), (), (),
                       round(time.process_time() - started, 1), key)
    env, watched, gamma = single, None, getattr(get_recipe(learner.agent), "gamma", 0.99)
    if has_goals := "hindsight_goals" in learner.settings:
        env = single = GoalsEnv(single, exits=1.0)
    if learner.streams:
        env = watched = RepeatedStreams(_make_many(room, learner.streams), learner.repeat, gamma)
        started = time.process_time()
    tested = _RepeatedEnv(single, learner.repeat, gamma) if learner.repeat > 1 else single
    with tempfile.TemporaryDirectory() as folder:
        result = train(learner.agent, env, primitives=budget, seed=seed, settings=learner.settings, eval_env=tested,
                       eval_every=eval_every, eval_episodes=1, progress=False, out=folder, checkpoint_seconds=1e9,
                       until_return=find_until(room, fewest, until, has_goals) if until else None,
                       callbacks=[_UntilEscape()] if until == 0 else [])
        rows = [json.loads(row) for row in read_text(Path(folder) / "log.jsonl").splitlines()]
    seconds = time.process_time() - started
    single.close()
    curve = tuple((evaluation.primitives, _measure_efficiency(evaluation, fewest)) for evaluation in result.evaluations)
    return FlatRun(learner.label, len(room.targets), seed, fewest, budget,
                   watched.first_escape if watched else result.first_escape, curve,
                   _list_escapes(result, budget), _split(watched.corners) if watched else (),
                   _split([row["train/entropy"] for row in rows if row.get("train/entropy") is not None]),
                   round(seconds, 1), key)


@lru_cache(maxsize=2)
def _make_many(room: RoomInstance, streams: int) -> Any:
    """Copies of a room whose kernels are compiled, kept for the next run in it."""
    many = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=streams, instance=room, observation="features",
                              output="torch", compile=streams >= 64)
    many.reset(seed=0)
    many.step(torch.zeros(streams, dtype=torch.int64))
    return many


def make_key(learner: FlatLearner, room: RoomInstance, seed: int, budget: int, eval_every: int,
             until: float | None = None) -> str:
    """Hash of everything that decides a run's numbers."""
    recipe: Any = ArchiveSettings() if learner.agent == ARCHIVE else get_recipe(learner.agent)
    defaults = dataclasses.asdict(recipe)
    settings = dataclasses.asdict(replace_settings(recipe, learner.settings))
    return compute_digest({
        "versions": find_versions(), "agent": learner.agent, "streams": learner.streams, "repeat": learner.repeat,
        "settings": {name: value for name, value in settings.items() if value != defaults[name]},
        "room": room.id, "seed": seed, "budget": budget, "eval_every": eval_every,
        **({} if until is None else {"until": until})})


def _measure_efficiency(evaluation: Any, fewest: int) -> float:
    escaped = [min(1.0, fewest / length) if success else 0.0
               for length, success in zip(evaluation.lengths, evaluation.successes, strict=True)]
    return round(float(np.mean(escaped)), 4)


def _list_escapes(result: TrainResult, budget: int) -> tuple[float | None, ...]:
    """Share of the training episodes that escaped, tenth by tenth."""
    ended = [(segment.primitives, segment.episodes, segment.successes or 0) for segment in result.segments] or [
        (episode.primitives, 1, bool(episode.success)) for episode in result.episodes if episode.end != "budget"]
    counts = np.zeros((2, TENTHS))
    for at, episodes, successes in ended:
        counts[:, min(TENTHS - 1, int(TENTHS * (at - 1) / budget))] += episodes, successes
    return tuple(round(float(escaped / total), 4) if total else None for total, escaped in counts.T)


def _split(values: Sequence[float]) -> tuple[float, ...]:
    """Means of tenths."""
    parts = np.array_split(np.array(values), TENTHS) if len(values) >= TENTHS else []
    return tuple(round(float(part.mean()), 4) for part in parts)


def count_untrained(learner: FlatLearner) -> int:
    """Most primitives before a learner's first update; 0 of one ordinary environment, where that is soon.

    A decision takes all its repeats until an episode ends, so that first escapes up to here are the untrained policy's.
    """
    recipe: Any = None if learner.agent == ARCHIVE or not learner.streams else get_recipe(learner.agent)
    if not hasattr(recipe, "rollout_per_env"):
        return 0
    settings: Any = replace_settings(recipe, learner.settings)
    return max(settings.rollout, settings.rollout_per_env * learner.streams) * learner.repeat


def list_learners(study: Study, args: FlatArgs) -> list[FlatLearner]:
    """Select a study's learners, in its order.

    Raises:
        UnknownNameError: the study has no such label.
    """
    fields = {field.name for field in dataclasses.fields(FlatLearner)}
    tables = [{name: value for name, value in table.items() if name in fields} for table in study.data["learners"]]
    every = {table["label"]: read_record(FlatLearner, table) for table in tables}
    for label in args.agents:
        if label not in every:
            raise UnknownNameError(f"learner of {study.name}", label, every)
    return [learner for label, learner in every.items() if label in (args.agents or every)]


def measure_flat_runs(store: Store, jobs: Sequence[FlatJob], minutes: float | None = None) -> None:
    """Make the runs that a store lacks, keep each there at once, and print a line a run.

    Args:
        store: of the lines.
        jobs: those in the same room one after another.
        minutes: before the last start of a run, or None for no limit.
    """
    end = None if minutes is None else time.monotonic() + 60 * minutes
    for number, job in enumerate(jobs, 1):
        if make_key(*job) in {line.key for line in store.load() if isinstance(line, FlatRun)}:
            continue
        if end is not None and time.monotonic() >= end:
            return
        made = run_flat(*job)
        store.add([made])
        print(f"[{number}/{len(jobs)}] {made.agent}, {made.buttons} buttons, seed {made.seed}: first escape "
              f"{made.first_escape}, {made.seconds:.0f} s", flush=True)
