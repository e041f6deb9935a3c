"""Runs of learned options at scale: which there are, and how one is made.

A learner acts in many copies of one room. `streams.py` counts its training episodes, with the exploration that they
have, so all learners are measured alike and nothing is run outside the budget.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from functools import lru_cache
from typing import Any, Literal

import gymnasium
import torch

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.training.many_envs import VectorManyEnvs
from hrl_escape.agents.training.train import train
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.planning.best_known import find_best_known
from hrl_escape.settings import read_record
from studies.archive import ArchiveSettings, explore
from studies.flat import RepeatedStreams
from studies.learned_options.streams import OptionEnvs, WatchedEnvs
from studies.parts.analysis import make_config
from studies.store import Line

__all__ = ["OPEN", "TRIAL", "UNSEEN", "Learner", "ScaleRun", "choose_settings", "list_jobs", "list_learners",
           "make_run"]

OPEN = -1
"""In place of the number of settings that trials have yet to choose."""
UNSEEN = "unseen rooms"
"""Part of the study about options that were learned in other rooms."""
TRIAL = "trial"
"""Part of the study whose runs choose settings and are not counted."""


@dataclasses.dataclass(frozen=True)
class Learner:
    """An agent in the study.

    Attributes:
        label: in the results.
        title: in tables.
        agent: name, or `untrained`, or `archive`.
        family: `flat`, `learned options` or `reference`.
        menu: name of its settings on trial, or empty for none.
        settings: in addition to the menu's.
        copies: of the room.
        repeat: primitives of a decision.
        sees: name of the observation.
        acts: by `primitives`, `planned` options, or options `reused` from training rooms.
        most: largest budget, primitives; 0 for none.
    """

    label: str
    title: str
    agent: str
    family: Literal["flat", "learned options", "reference"]
    menu: str = ""
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    copies: int = 64
    repeat: int = 1
    sees: str = "features"
    acts: Literal["primitives", "planned", "reused"] = "primitives"
    most: int = 0


@dataclasses.dataclass(frozen=True)
class ScaleRun(Line):
    """A run; a job is one without results.

    Attributes:
        part: of the study.
        agent: label of the learner.
        buttons: of the room.
        rule: effect of a press with unmet parents.
        seed: of room and training.
        budget: primitives.
        choice: number of the settings in the menu.
        design: hash of the registered files; empty for a trial.
        fewest: primitives of the best known escape.
        first_escape: primitives, of all copies together, when the first training episode escaped, or None.
        episodes: that ended in each part of the budget.
        escapes: of these.
        efficiency: sum over these of `fewest` / length, 0 without an escape.
        primitives: made.
        seconds: of processor time, without compilation.
        device: where it was made.
    """

    part: str
    agent: str
    buttons: int
    rule: str
    seed: int
    budget: int
    choice: int
    design: str
    fewest: int = 0
    first_escape: int | None = None
    episodes: tuple[int, ...] = ()
    escapes: tuple[int, ...] = ()
    efficiency: tuple[float, ...] = ()
    primitives: int = 0
    seconds: float = 0.0
    device: str = "cpu"

    @property
    def place(self) -> tuple[Any, ...]:
        """Subject of the line."""
        return (self.part, self.agent, self.buttons, self.rule, self.seed, self.budget,
                self.choice if self.part == TRIAL else OPEN)

    @property
    def curve(self) -> tuple[float | None, ...]:
        """Mean efficiency of the episodes that ended in each part of the budget; None where none ended."""
        return tuple(worth / made if made else None for worth, made in zip(self.efficiency, self.episodes, strict=True))

    @property
    def late(self) -> float:
        """Mean efficiency of the episodes that ended in the last fifth of the budget."""
        last = len(self.episodes) // 5 or 1
        return sum(self.efficiency[-last:]) / max(sum(self.episodes[-last:]), 1)


def list_learners(data: Mapping[str, Any]) -> dict[str, Learner]:
    """Agents in the study by label, in its order."""
    return {table["label"]: read_record(Learner, table) for table in data["learners"]}


def list_jobs(data: Mapping[str, Any], design: str) -> Iterator[ScaleRun]:
    """All runs, in the order of execution: stage by stage, block by block, cell by cell.

    The trials of a learner come before its first counted run, whose `choice` is still open (`OPEN`).
    """
    learners, tried = list_learners(data), set[str]()
    for budget in data["budgets"]:
        for block in data["blocks"]:
            first = data["slices"][block.get("slice", "first")]
            for label in block["agents"]:
                learner = learners[label]
                yield from _list_trials(data, learner, tried)
                if block["part"] == UNSEEN:
                    yield from _list_trials(data, learners[data["reuse"]["agent"]], tried)
                if learner.most and budget != data["budgets"][0]:
                    continue  # the first stage has all of its runs
                for seed in range(first, first + data["rooms"]):
                    yield ScaleRun(block["part"], label, block["buttons"], block.get("rule", "ignore"), seed,
                                   min(budget, learner.most or budget), OPEN if learner.menu else 0, design)


def _list_trials(data: Mapping[str, Any], learner: Learner, tried: set[str]) -> Iterator[ScaleRun]:
    """Trials of a learner's settings, in a room of their own, unless they were listed."""
    trials = data["trials"]
    if learner.menu and learner.label not in tried:
        tried.add(learner.label)
        for choice in range(len(data["menus"][learner.menu])):
            yield ScaleRun(TRIAL, learner.label, trials["buttons"], "ignore", trials["seed"], trials["budget"], choice,
                           "")


def choose_settings(trials: Iterable[ScaleRun]) -> dict[str, int]:
    """Number of each learner's settings: highest late efficiency, then earliest first escape, then the first."""
    chosen: dict[str, int] = {}
    for trial in sorted(trials, key=lambda trial: (-trial.late, trial.first_escape or math.inf, trial.choice)):
        chosen.setdefault(trial.agent, trial.choice)
    return chosen


def make_run(data: Mapping[str, Any], job: ScaleRun, choices: Mapping[str, int], device: str) -> ScaleRun:
    """Make a run; returns its line.

    Args:
        data: of `study.toml`.
        job: without results.
        choices: number of the settings of the learner that learns options in training rooms.
        device: of rooms and networks.
    """
    learner = list_learners(data)[job.agent]
    settings = (data["menus"][learner.menu][job.choice] if learner.menu else {}) | learner.settings
    room = generate(make_config(data["room"], job.buttons, job.rule), job.seed)
    single: Any = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=room, observation=learner.sees,
                                 disable_env_checker=True)
    single.reset(seed=0)
    fewest = find_best_known(room, single.unwrapped.get_state()).primitives
    assert fewest is not None, "rooms of this study can be escaped from"
    if learner.agent == "archive":
        started = time.process_time()
        found = explore(single.unwrapped, read_record(ArchiveSettings, settings), job.seed, job.budget)
        return dataclasses.replace(job, fewest=fewest, first_escape=found.first_escape, primitives=found.primitives,
                                   seconds=round(time.process_time() - started, 2))
    options = _learn_options(data, job, choices, device) if learner.acts == "reused" else None
    envs = _make_envs((room,), learner.copies, learner.sees, learner.acts == "planned", device)
    if options is not None:
        envs = OptionEnvs(VectorManyEnvs(envs, options.gamma), options, data["reuse"]["longest"])
    elif learner.acts == "primitives":
        envs = RepeatedStreams(envs, learner.repeat, data["gamma"]) if learner.repeat > 1 else (
            VectorManyEnvs(envs, data["gamma"]))
    watched = WatchedEnvs(envs, fewest, job.budget, data["parts"])
    started = time.process_time()
    if learner.agent == "untrained":
        _draw(watched, job.seed, job.budget)
    else:
        agent = make_agent(learner.agent, watched.observation_space, watched.action_space, job.seed, **settings)
        spaces = gymnasium.Wrapper(single)  # compared with the spaces of `watched`, and never run
        spaces.action_space = watched.action_space
        _train(agent, watched, spaces, job)
    seconds = time.process_time() - started
    single.close()
    episodes, escapes, worth = watched.totals.T.tolist()
    return dataclasses.replace(
        job, fewest=fewest, first_escape=watched.first_escape, episodes=tuple(map(int, episodes)),
        escapes=tuple(map(int, escapes)), efficiency=tuple(round(value, 3) for value in worth),
        primitives=watched.primitives, seconds=round(seconds, 2), device=device)


def _learn_options(data: Mapping[str, Any], job: ScaleRun, choices: Mapping[str, int], device: str) -> Any:
    """Learn options in training rooms, whose primitives are not in the budget of the run that uses them."""
    reuse = data["reuse"]
    learner = list_learners(data)[reuse["agent"]]
    config = make_config(data["room"], job.buttons, job.rule)
    rooms = tuple(generate(config, seed) for seed in range(reuse["first_seed"], reuse["first_seed"] + reuse["rooms"]))
    envs = VectorManyEnvs(_make_envs(rooms, learner.copies, learner.sees, False, device), data["gamma"])
    agent = make_agent(learner.agent, envs.observation_space, envs.action_space, job.seed,
                       **data["menus"][learner.menu][choices[learner.label]], **learner.settings)
    with closing(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=rooms[0], observation=learner.sees,
                                disable_env_checker=True)) as single:
        _train(agent, WatchedEnvs(envs, 1, job.budget, 1), single, job)
    return agent


def _train(agent: Agent, envs: WatchedEnvs, single: gymnasium.Env, job: ScaleRun) -> None:
    """Train for the budget of a job.

    `train` begins all episodes again where an evaluation would be, even if there is none. None is due before the end.
    """
    train(agent, envs, primitives=job.budget, seed=job.seed, eval_env=single, eval_every=job.budget, eval_episodes=0,
          progress=False, observed=False)


def _draw(envs: WatchedEnvs, seed: int, budget: int) -> None:
    """Draw all actions evenly."""
    envs.reset(seed)
    generator = torch.Generator(envs.device).manual_seed(seed)
    while envs.primitives < budget:
        envs.step(torch.randint(int(envs.action_space.n), (envs.count,), generator=generator, device=envs.device))


@lru_cache(maxsize=1)
def _make_envs(rooms: tuple[RoomInstance, ...], copies: int, sees: str, has_options: bool, device: str) -> Any:
    """Copies of rooms whose kernels are compiled, before any time is measured."""
    compiled = copies >= 64
    if has_options:
        envs = BatchedOptionsEnv(copies, instance=rooms, observation=sees, include_primitives=False, device=device,
                                 compile=compiled)
        envs.reset(0)
    else:
        envs = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=copies, instance=rooms, observation=sees,
                                  output="torch", compile=compiled, device=device)
        envs.reset(seed=0)
    envs.step(torch.zeros(copies, dtype=torch.int64, device=device))
    return envs
