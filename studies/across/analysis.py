"""References across rooms: efficiency in unseen rooms by kind of cue and of family, with seasons as runs."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.state import StateTree
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.room_intervals import compute_nested_interval
from hrl_escape.benchmark.standings import LEAST_HEADROOM, compute_headroom
from hrl_escape.errors import ComparisonError
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.instance_set import InstanceSet
from studies.across.candidates import CandidateRun, list_candidates, run_candidate
from studies.across.drawing import draw
from studies.running import StudyArgs, make_missing
from studies.store import Line, Store
from studies.study import Findings, Study
from studies.tables import make_table
from studies.titles import find_title
from studies.unseen import measure_efficiencies

__all__ = ["LINES", "AcrossRun", "Args", "analyse", "list_jobs", "measure", "run_job"]


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    minutes: float | None = None
    """Begin no run after so long; the same command continues."""
    benchmark: str = ""
    """Benchmark to run; all by default."""
    candidates: bool = False
    """Run the learners that are compared by wrong presses, in place of the references."""
    learners: bool = False
    """Run the trained agents of the study, without the references."""
    rooms: int | None = None
    """Training rooms of what is run; all sizes by default."""


@dataclasses.dataclass(frozen=True)
class AcrossRun(Line):
    """A reference in the test rooms of a season.

    Attributes:
        benchmark: name.
        season: number.
        rung: name.
        agent: label.
        rooms: training rooms; 0 without training.
        primitives: of training.
        efficiencies: in each test room.
    """

    benchmark: str
    season: int
    rung: str
    agent: str
    rooms: int
    primitives: int
    efficiencies: tuple[float, ...]

    PLACE = ("benchmark", "season", "rung", "agent", "rooms")


LINES = (AcrossRun, CandidateRun)


def list_jobs(data: Mapping[str, Any], benchmark: str = "") -> Iterator[AcrossRun]:
    """Lines without results, season by season."""
    agents = [(agent, 0) for agent in (*data["searches"], data["planner"])]
    agents += [(agent, size) for agent in (data["counting"], *data["learners"]) for size in data["train_sizes"]]
    for season in range(data["seasons"]):
        for name, rungs in data["rungs"].items():
            for rung in rungs if benchmark in ("", name) else ():
                for agent, rooms in agents:
                    if agent not in data["learners"] or season in data["learner_seasons"]:
                        yield AcrossRun(name, season, rung, agent, rooms, 0, ())


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing, until the time is up."""
    if args.candidates:
        make_missing(list_candidates(study.data), run_candidate, store, args.minutes)
        return
    with tempfile.TemporaryDirectory() as folder:
        jobs = (job for job in list_jobs(study.data, args.benchmark)
                if (not args.learners or job.agent in study.data["learners"]) and args.rooms in (None, job.rooms))
        make_missing(jobs, lambda job: run_job(job, study.data, Path(folder)), store, args.minutes)


def run_job(job: AcrossRun, data: Mapping[str, Any], cache: Path) -> AcrossRun:
    """Train a reference if it has training rooms, and test it."""
    rung = load_benchmark(f"{job.benchmark}@{job.season}")[job.rung]
    primitives, state = 0, None
    if job.rooms:
        primitives, state = _train(job, rung.train[: job.rooms], data["primitives_per_room"] * job.rooms)
    spec, tested = AgentSpec.parse(job.agent), rung.test[: data["tested"]]

    def play(env: gymnasium.Env, recorder: StateRecorder) -> tuple[ArrayLike, ArrayLike]:
        player = _make_player(spec, env, recorder, job.season)
        if state is not None:
            player.load_state_dict(state)
        played = evaluate(player, env, len(tested))
        return played.escaped, played.lengths

    return dataclasses.replace(job, primitives=primitives, efficiencies=measure_efficiencies(
        spec, tested, spec.default_observation, cache, play))


def _train(job: AcrossRun, rooms: InstanceSet, primitives: int) -> tuple[int, StateTree]:
    spec = AgentSpec.parse(job.agent)
    env, recorder = make_agent_env(spec, rooms, spec.default_observation)
    try:
        player = _make_player(spec, env, recorder, job.season)
        result = train(player, env, primitives=primitives, eval_episodes=0, progress=False, observed=False)
    finally:
        env.close()
    return result.primitives, player.state_dict()


def _make_player(spec: AgentSpec, env: gymnasium.Env, recorder: StateRecorder, seed: int) -> Agent:
    if spec.is_reference:
        return make_reference(spec.name, env, recorder)
    return make_agent(spec, env.observation_space, env.action_space, seed)


def analyse(study: Study, every: Sequence[AcrossRun | CandidateRun]) -> Findings:
    """Efficiency of each reference, and the normalised score of counting, over the seasons that all were run on.

    Learners are compared over the seasons that they were run on, too.

    Raises:
        ComparisonError: there are no runs.
    """
    if not every:
        raise ComparisonError("there are no runs")
    data, found, lines = study.data, {}, [run for run in every if isinstance(run, AcrossRun)]
    for benchmark, rungs in data["rungs"].items():
        for rung in rungs:
            own = [run for run in lines if (run.benchmark, run.rung) == (benchmark, rung)]
            cells = _list_cells(data)
            values = {(run.agent, run.rooms, run.season): np.array(run.efficiencies) for run in own}
            seasons = [season for season in range(data["seasons"])
                       if all((*cell, season) in values for cell in cells)]
            if len(seasons) >= data["least"]:
                found[f"{benchmark}/{rung}"] = own = _summarise(data, cells, values, seasons)
                own.learners = _compare_learners(data, values, seasons, own.best)
    rows = [[name, str(own.seasons), *(f"{own.means[cell]:.3f}" if cell in own.means else ""
                                       for cell in _list_cells(data)),
             *("" if score is None else f"{score:.2f}" for score in own.normalised.values())]
            for name, own in found.items()]
    compared = [[name, AgentSpec.parse(agent).title, str(rooms), str(own.seasons), f"{own.efficiency:.3f}",
                 f"{own.minus_counting:.3f}", "" if own.share is None else f"{own.share:.2f}"]
                for name, rung in found.items() for (agent, rooms), own in rung.learners.items()]
    table_of_learners = make_table(["rung", "learner", "rooms", "seasons", "efficiency", "minus counting",
                                    "normalised"], compared)
    wrong = _summarise_candidates([run for run in every if isinstance(run, CandidateRun)], data)
    columns = [find_title(agent) + (f", {rooms} rooms" if rooms else "") for agent, rooms in _list_cells(data)]
    learners = list(dict.fromkeys(cell for own in wrong.values() for cell in own))
    table_of_wrong = make_table(["rung", *(name + (f", {rooms} rooms" if rooms else "") for name, rooms in learners)], [
        [rung, *(f"{own[cell]:.2f}" if cell in own else "" for cell in learners)] for rung, own in wrong.items()])
    table = make_table(["rung", "seasons", *columns, *(f"normalised, {size} rooms" for size in data["train_sizes"])],
                       rows)
    tables = {"wrong": table_of_wrong, "across": table, "learners": table_of_learners}
    return Findings(SimpleNamespace(rungs=found, wrong=wrong, data=data), tables,
                    {"across": lambda theme: draw(found, data, theme)})


def _summarise_candidates(runs: Sequence[CandidateRun], data: Mapping[str, Any]
                          ) -> dict[str, dict[tuple[str, int], Estimate]]:
    """Wrong presses in a room by rung and learner, with intervals over the seasons."""
    found: dict[str, dict[tuple[str, int], Estimate]] = {}
    for benchmark, rungs in data["candidates"].items():
        for rung in rungs:
            cells: dict[tuple[str, int], list[np.ndarray]] = {}
            for run in runs:
                if (run.benchmark, run.rung) == (benchmark, rung):
                    cells.setdefault((run.learner, run.rooms), []).append(np.array([run.wrong]))
            own = {cell: compute_nested_interval(values) for cell, values in cells.items()
                   if len(values) >= data["least"]}
            if own:
                found[f"{benchmark}/{rung}"] = own
    return found


def _list_cells(data: Mapping[str, Any]) -> list[tuple[str, int]]:
    return [(agent, 0) for agent in (*data["searches"], data["planner"])] + [
        (data["counting"], size) for size in data["train_sizes"]]


def _summarise(data: Mapping[str, Any], cells: Sequence[tuple[str, int]],
               table: Mapping[tuple[str, int, int], np.ndarray], seasons: Sequence[int]) -> SimpleNamespace:
    """Means with intervals over seasons, the headroom, and what counting gains over the best search baseline.

    Gains are normalised where there is headroom.
    """
    by_season = {cell: [table[(*cell, season)] for season in seasons] for cell in cells}
    means: dict[tuple[str, int], Estimate] = {cell: compute_nested_interval(own) for cell, own in by_season.items()}
    best = max(((agent, 0) for agent in data["searches"]), key=lambda cell: means[cell].value)
    season_means = {cell: np.array([season.mean() for season in own]) for cell, own in by_season.items()}
    headroom = compute_headroom(season_means[best], season_means[data["planner"], 0])
    normalised = {size: None if headroom.low <= LEAST_HEADROOM else
                  (means[data["counting"], size].value - means[best].value) / headroom.value
                  for size in data["train_sizes"]}
    gains = {size: compute_nested_interval([np.array([gap]) for gap in
                                            season_means[data["counting"], size] - season_means[best]])
             for size in data["train_sizes"]}
    return SimpleNamespace(seasons=len(seasons), means=means, headroom=headroom, best=best[0], gains=gains,
                           normalised=normalised, learners={})


def _compare_learners(data: Mapping[str, Any], table: Mapping[tuple[str, int, int], np.ndarray],
                      seasons: Sequence[int], best: str) -> dict[tuple[str, int], SimpleNamespace]:
    """Compare learners with counting in the same rooms, and with the headroom over the best search baseline.

    Returns:
        By learner and training rooms: number of seasons, efficiency, its difference from counting, the headroom in
        these seasons, and the share of it that is gained, None where there is too little headroom.
    """
    found = {}
    for agent in data["learners"]:
        for size in data["train_sizes"]:
            own = [season for season in seasons if (agent, size, season) in table]
            if len(own) < data["least"]:
                continue
            gains = [table[agent, size, season] - table[data["counting"], size, season] for season in own]
            cells = (best, 0), (data["planner"], 0), (agent, size)
            base, planner, learner = (np.array([table[name, rooms, season].mean() for season in own])
                                      for name, rooms in cells)
            headroom = compute_headroom(base, planner)
            share = float((learner - base).mean() / (planner - base).mean()) if headroom.low > LEAST_HEADROOM else None
            found[agent, size] = SimpleNamespace(
                seasons=len(own), efficiency=compute_nested_interval([table[agent, size, season] for season in own]),
                minus_counting=compute_nested_interval(gains), headroom=headroom, share=share)
    return found
