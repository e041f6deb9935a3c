"""Connected rooms: efficiency in unseen rooms with doors and in houses, of search, the Bayes planner and a learner."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.decisions import Moments
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.room_intervals import compute_crossed_interval
from hrl_escape.benchmark.standings import compute_headroom
from hrl_escape.errors import ComparisonError
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.options.memory import VectorDecisionMemory
from hrl_escape.sets.benchmark import load_benchmark
from studies.running import StudyArgs, make_missing
from studies.store import Line, Store
from studies.study import Findings, Study
from studies.tables import make_table
from studies.titles import find_title
from studies.unseen import measure_efficiencies

__all__ = ["LINES", "Args", "ConnectedRun", "analyse", "list_jobs", "measure", "play_many", "run_job"]


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    minutes: float | None = None
    """Begin no run after so long; the same command continues."""
    references: bool = False
    """Run the search baselines and the Bayes planner alone."""


@dataclasses.dataclass(frozen=True)
class ConnectedRun(Line):
    """An agent in the test rooms of a rung.

    Attributes:
        rung: name.
        agent: label.
        rooms: training rooms; 0 without training.
        seed: of training.
        primitives: of training.
        efficiencies: in each test room.
        seconds: of processor time, with the time to make the rooms where a run is the first to need them.
    """

    rung: str
    agent: str
    rooms: int
    seed: int
    primitives: int
    efficiencies: tuple[float, ...]
    seconds: float

    PLACE = ("rung", "agent", "rooms", "seed")


LINES = (ConnectedRun,)


def list_jobs(data: Mapping[str, Any]) -> Iterator[ConnectedRun]:
    """Lines without results: references of all rungs, then the learner's runs."""
    for rung in data["rungs"]:
        for agent in (*data["searches"], data["planner"]):
            yield ConnectedRun(rung, agent, 0, 0, 0, (), 0.0)
    for rung in data["rungs"]:
        for rooms in data["train_sizes"]:
            for seed in range(data["seeds"]):
                yield ConnectedRun(rung, data["learner"], rooms, seed, 0, (), 0.0)


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing, until the time is up."""
    jobs = (job for job in list_jobs(study.data) if not (job.rooms and args.references))
    with tempfile.TemporaryDirectory() as folder:
        make_missing(jobs, lambda job: run_job(job, study.data, Path(folder)), store, args.minutes)


def run_job(job: ConnectedRun, data: Mapping[str, Any], cache: Path) -> ConnectedRun:
    """Train the agent if it has training rooms, and test it in one episode of each test room."""
    started = time.process_time()
    rung = load_benchmark(data["benchmark"])[job.rung]
    tested, spec, agent, primitives = rung.test[: data["tested"]], AgentSpec.parse(job.agent), None, 0
    if job.rooms:
        envs = _make_envs(data["benchmark"], job.rung, job.rooms, data["copies"], data["compile"])
        result = train(spec, envs, primitives=data["primitives"], seed=job.seed, eval_episodes=0, progress=False,
                       observed=False)
        agent, primitives = result.agent, result.primitives

    def play(env: gymnasium.Env, recorder: StateRecorder) -> tuple[ArrayLike, ArrayLike]:
        if agent is not None:
            return play_many(agent, _make_tests(data["benchmark"], job.rung, len(tested), data["compile"]))
        played = evaluate(make_reference(spec.name, env, recorder), env, len(tested))
        return played.escaped, played.lengths

    found = measure_efficiencies(spec, tested, "objects", cache, play)
    return dataclasses.replace(job, primitives=primitives, seconds=round(time.process_time() - started, 3),
                               efficiencies=found)


@lru_cache(maxsize=1)
def _make_envs(benchmark: str, rung: str, count: int, copies: int, is_compiled: bool) -> VectorDecisionMemory:
    """Copies that draw one of the training rooms in each episode; all training seeds share them."""
    rooms = load_benchmark(benchmark)[rung].train[:count]
    return VectorDecisionMemory(BatchedOptionsEnv(copies, instance=list(rooms), resample_instance=True,
                                                  observation="objects", include_primitives=False,
                                                  compile=is_compiled))


@lru_cache(maxsize=1)
def _make_tests(benchmark: str, rung: str, count: int, is_compiled: bool) -> VectorDecisionMemory:
    """One copy of each test room, which waits where its episode has ended."""
    rooms = load_benchmark(benchmark)[rung].test[:count]
    return VectorDecisionMemory(BatchedOptionsEnv(len(rooms), instance=list(rooms), autoreset=False,
                                                  observation="objects", include_primitives=False,
                                                  compile=is_compiled))


def play_many(agent: Agent, envs: VectorDecisionMemory) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Play one episode in each environment, by the agent's policy without learning.

    Returns:
        Whether each escaped, bool (environments,), and its primitives, int64 (environments,).
    """
    policy, count = agent.make_policy(), envs.count
    policy.begin_episode(np.random.default_rng(0), count)
    envs.set_option_discount(agent.gamma)
    envs.reset(0)
    escaped, over = (torch.zeros(count, dtype=torch.bool) for _ in range(2))
    lengths = torch.zeros(count, dtype=torch.int64)
    while not bool(over.all()):
        action = torch.zeros(count, dtype=torch.int64)
        if len(rows := envs.is_waiting.nonzero().squeeze(1)):
            action[rows] = torch.as_tensor(policy.act(Moments(rows, envs.observation[rows], envs.action_mask[rows])))
        ended = envs.step(action)
        where = ended.where & ~over
        lengths += torch.where(where, ended.duration, 0)
        escaped |= where & ended.terminated & (ended.success > 0)
        over |= where & (ended.terminated | ended.truncated)
    return escaped.numpy(), lengths.numpy()


def analyse(study: Study, lines: Sequence[ConnectedRun]) -> Findings:
    """Efficiency by rung with intervals over rooms, and over training seeds where there are enough.

    Rungs without all references are left out.

    Raises:
        ComparisonError: no rung has all references.
    """
    data, found = study.data, {}
    cells: dict[tuple[str, str, int], list[tuple[float, ...]]] = {
        (line.rung, line.agent, line.rooms): [] for line in lines}
    for line in sorted(lines, key=lambda line: line.seed):
        cells[line.rung, line.agent, line.rooms].append(line.efficiencies)
    for rung in data["rungs"]:
        if all((rung, agent, 0) in cells for agent in (*data["searches"], data["planner"])):
            found[rung] = _summarise(data, {(agent, rooms): np.array(runs).T
                                            for (own, agent, rooms), runs in cells.items() if own == rung})
    if not found:
        raise ComparisonError("every rung lacks a reference: run this study with --references")
    rows = [[f"`{rung}`", *(f"{own.means[agent]:.2f}" for agent in (*data["searches"], data["planner"])),
             f"{own.headroom:+.2f}"] for rung, own in found.items()]
    names = [find_title(agent) for agent in (*data["searches"], data["planner"])]
    learned = [[f"`{rung}`", rooms, own.runs[rooms], *(f"{value:{form}}" for value, form in (
        (own.learned[rooms], ".2f"), (own.gains[rooms], "+.2f")))]
        for rung, own in found.items() for rooms in own.learned]
    return Findings(
        SimpleNamespace(rungs=found, rooms=data["tested"], minutes=sum(line.seconds for line in lines) / 60, data=data),
        {"connected": make_table(["rung", *names, "Bayes planner minus the best search baseline"], rows),
         "connected_learner": make_table(["rung", "training rooms", "runs", find_title(data["learner"]),
                                          "minus the best search baseline"], learned),
         "connected_missing": make_table(["rung", "agent", "training rooms", "runs"], _list_missing(data, lines))})


def _list_missing(data: Mapping[str, Any], lines: Sequence[ConnectedRun]) -> list[list[Any]]:
    """Rows of the runs that are not made."""
    known = {line.place for line in lines}
    missing = Counter((job.rung, job.agent, job.rooms) for job in list_jobs(data) if job.place not in known)
    return [[f"`{rung}`", find_title(agent), rooms or "", runs] for (rung, agent, rooms), runs in missing.items()]


def _summarise(data: Mapping[str, Any], cells: Mapping[tuple[str, int], NDArray[np.float64]]) -> SimpleNamespace:
    """Means of references over rooms, the headroom, and gains of the learner with as many runs as `seeds`."""
    scores = {agent: own[:, 0] for (agent, rooms), own in cells.items() if not rooms}
    best = max(data["searches"], key=lambda agent: scores[agent].mean())
    learned = {rooms: own for (agent, rooms), own in sorted(cells.items())
               if agent == data["learner"] and own.shape[1] >= data["seeds"]}
    return SimpleNamespace(
        best=best, headroom=compute_headroom(scores[best], scores[data["planner"]]),
        means={agent: compute_crossed_interval(own[:, None]) for agent, own in scores.items()},
        runs={rooms: own.shape[1] for rooms, own in learned.items()},
        learned={rooms: compute_crossed_interval(own) for rooms, own in learned.items()},
        gains={rooms: compute_crossed_interval(own - scores[best][:, None]) for rooms, own in learned.items()})
