"""Learning from data sets: the horizon (decisions or primitives), stitching (cut trajectories), and unseen rooms."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from hrl_escape.agents.spec import REFERENCES, AgentSpec
from hrl_escape.agents.training.evaluation import Evaluation, compute_episode_seed, evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.inference import LEVEL
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES, make_reference
from hrl_escape.benchmark.statistics import compute_mean_efficiency
from hrl_escape.commands.room_choice import split_assignment
from hrl_escape.data.catalogue import find_recording
from hrl_escape.data.materialise import load_data
from hrl_escape.data.recording import load_recording
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ComparisonError, ConfigError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.best_known import find_best_known, list_start_states
from hrl_escape.sets.benchmark import load_benchmark
from studies.figures import Theme, make_figure, write_label
from studies.running import StudyArgs, make_missing
from studies.statistics import Mean, compare_signs, compute_mean
from studies.store import Line, Store
from studies.study import Findings, Study
from studies.tables import format_interval, make_table

__all__ = ["LINES", "Args", "OfflineResult", "analyse", "measure", "name_unseen", "reads_decisions", "run_once",
           "run_unseen"]

BEHAVIOUR, UNSEEN = "behaviour", "unseen"
WHOLE = "play"
"""Kind whose trajectories begin where episodes do, so that they have an efficiency of their own."""
OPTIONS_ALONE = AgentSpec.parse("random-options")
"""Says what all choose among in unseen rooms."""


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    runs: int | None = None
    """Rooms; those of `study.toml` by default."""


@dataclasses.dataclass(frozen=True)
class OfflineResult(Line):
    """Efficiency of one learner with one data set in one room, or in rooms that the data does not hold.

    Attributes:
        agent: with its settings; `behaviour` is the data itself, others without a data set are references.
        kind: of the data set; empty for a reference; after `UNSEEN` where it learned of all rooms and is tested in
            others, as in `unseen play`.
        run: number of the room, in unseen rooms the training seed.
        efficiency: mean over episodes of escaped x best known primitives / primitives.
    """

    agent: str
    kind: str
    run: int
    efficiency: float

    PLACE = ("agent", "kind", "run")


LINES = (OfflineResult,)


# --- runs ------------------------------------------------------------------------------------


def score(evaluation: Evaluation, fewest: ArrayLike) -> float:
    """Mean efficiency of some episodes."""
    return compute_mean_efficiency(evaluation.escaped, evaluation.lengths, fewest, is_expected=False)


def read_learner(text: str) -> tuple[str, dict[str, Any]]:
    """Name and settings of a learner, from `name setting=value ...`."""
    name, *settings = text.split()
    return name, dict(split_assignment(each, "learner", "best=0.1") for each in settings)


def name_unseen(kind: str) -> str:
    """`kind` of a result in unseen rooms; `UNSEEN` alone for a search baseline, which has no data set."""
    return f"{UNSEEN} {kind}".strip()


def count_fewest(room: RoomInstance) -> float:
    """Primitives of the best known escape, from the first start."""
    found = find_best_known(room, list_start_states(room)[0]).primitives
    assert found is not None, "rooms of the benchmark can be escaped from"
    return float(found)


def run_unseen(agent: str, kind: str, rung: str, seed: int, tested: int) -> OfflineResult:
    """Train on all rooms of a data set, or take a search baseline; play an episode in each of the first test rooms."""
    rooms = load_benchmark("ladder-1")[rung].test[:tested]
    order = {str(compute_episode_seed(0, "evaluation", number)): number for number in range(tested)}
    env, recorder = make_agent_env(OPTIONS_ALONE, rooms, "objects", order)
    with closing(env):
        if agent in REFERENCES:
            player = make_reference(agent, env, recorder)
        else:
            name, settings = read_learner(agent)
            player = train(name, env, data=load_data(f"{rung}-{kind}-v1", observation="objects"), seed=seed,
                           settings={"values": "network", "network": "objects"} | settings, eval_episodes=0,
                           progress=False).agent
            assert player is not None  # a run without a folder gives its agent back
        found = evaluate(player, env, tested)
    return OfflineResult(agent, name_unseen(kind), seed, round(score(found, [count_fewest(room) for room in rooms]), 4))


def run_once(agent: str, kind: str, rung: str, run: int, episodes: int) -> OfflineResult:
    """Train one learner on what a data set holds of one room, and test it there; for `BEHAVIOUR` rate the data."""
    whole = load_recording(find_recording(f"{rung}-{kind}-v1"))
    recording, fewest = whole.select(run), count_fewest(whole.rooms[run])
    if agent == BEHAVIOUR:
        data = load_data(recording, observation="features").read_decisions(1.0)
        ended = np.bincount(data.trajectory, data.terminated) > 0
        lengths = np.bincount(data.trajectory, data.duration)
        return OfflineResult(agent, kind, run, compute_mean_efficiency(ended, lengths, fewest, is_expected=False))
    name, given = read_learner(agent)
    options = name.startswith("smdp-")
    env = whole.rooms[run : run + 1].make_env({"include_primitives": False} if options else False,
                                              observation="features")
    try:
        result = train(name, env, data=load_data(recording, observation="features"), seed=run, eval_episodes=episodes,
                       settings={"values": "table", "passes": 400} | given, eval_every=2**40, progress=False,
                       observed=False)
    finally:
        env.close()
    return OfflineResult(agent, kind, run, score(result.evaluations[-1], fewest))


def run_searcher(searcher: str, rung: str, run: int, episodes: int) -> OfflineResult:
    """Play a search baseline in the room of a run."""
    recording = load_recording(find_recording(f"{rung}-play-v1"))
    recorder = StateRecorder(recording.rooms[run : run + 1].make_env(observation="features"))
    env = OptionsEnv(recorder, include_primitives=False)
    try:
        found = evaluate(make_reference(searcher, env, recorder), env, episodes)
    finally:
        env.close()
    return OfflineResult(searcher, "", run, score(found, count_fewest(recording.rooms[run])))


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing: room by room, then seed by seed in unseen rooms.

    Raises:
        ConfigError: the rooms would include rooms where settings were chosen; no run is made.
    """
    data = study.data
    runs, tuned = args.runs or data["runs"], data["tuned_rooms"][0]
    if runs > tuned:
        raise ConfigError("runs", runs, f"at most {tuned}, since settings were chosen in the rooms from {tuned} on")
    make_missing(list_jobs(data, args.runs), lambda job: run_job(job, data), store, None)


def list_jobs(data: Mapping[str, Any], runs: int | None) -> Iterator[OfflineResult]:
    """Lines without results, in the order of running."""
    unseen = data["unseen"]
    for run in range(runs or data["runs"]):
        for agent, kind in ((BEHAVIOUR, WHOLE), *itertools.product(data["learners"], data["kinds"]),
                            *((searcher, "") for searcher in data["searchers"])):
            yield OfflineResult(agent, kind, run, math.nan)
    for searcher in data["searchers"]:
        yield OfflineResult(searcher, UNSEEN, 0, math.nan)
    for seed in range(runs or unseen["runs"]):
        for kind in unseen["kinds"]:
            for agent in unseen["learners"]:
                yield OfflineResult(agent, name_unseen(kind), seed, math.nan)


def run_job(job: OfflineResult, data: Mapping[str, Any]) -> OfflineResult:
    """Make the run of a line without results."""
    rung, kind = data["rung"], job.kind
    if kind.startswith(UNSEEN):
        return run_unseen(job.agent, kind.removeprefix(UNSEEN).strip(), rung, job.run, data["unseen"]["tested"])
    if not kind:
        return run_searcher(job.agent, rung, job.run, data["episodes"])
    return run_once(job.agent, kind, rung, job.run, data["episodes"])


# --- findings --------------------------------------------------------------------------------


def reads_decisions(agent: str) -> bool:
    """Return whether a learner reads the decisions of a data set, alone or with their primitives."""
    return agent.startswith(("smdp-", "hiql"))


def analyse(study: Study, lines: Sequence[OfflineResult]) -> Findings:
    """Efficiency of each learner with each data set, in the rooms of the data and in others.

    Raises:
        ComparisonError: there are no runs.
    """
    if not lines:
        raise ComparisonError("there are no runs")
    data = study.data
    learners: Mapping[str, str] = data["learners"]
    by = {line.place: line.efficiency for line in lines}
    rooms = sorted({line.run for line in lines if not line.kind.startswith(UNSEEN)})

    def read(agent: str, kind: str) -> NDArray[np.float64]:
        return np.array([by[agent, kind, room] for room in rooms])

    searched = {name: read(name, "") for name in data["searchers"]}
    bars = [name for name in data["searchers"] if name in SEARCH_BASELINES]
    best = max(bars, key=lambda name: searched[name].mean())
    whole, cut = ({agent: compute_mean(read(agent, kind)) for agent in learners} for kind in ("play", "stitch"))
    outside = {(agent, kind): np.array([line.efficiency for line in lines
                                        if (line.agent, line.kind) == (agent, name_unseen(kind))])
               for agent in data["unseen"]["learners"] for kind in data["unseen"]["kinds"]}
    level = 1 - (1 - LEVEL) / len(outside)  # of any cell, since the best of all is looked at
    unseen = {cell: compute_mean(values, level) for cell, values in outside.items()}
    elsewhere = {name: by[name, UNSEEN, 0] for name in data["searchers"]}
    numbers = SimpleNamespace(
        horizon=compare_signs({agent: read(agent, "play") - read(other, "play")
                               for agent, other in data["pairs"].items()}),
        stitching=compare_signs({agent: read(agent, "play") - read(agent, "stitch")
                                 for agent in learners if reads_decisions(agent)}),
        unseen=unseen, best=max(unseen.values()), unseen_search=max(elsewhere[name] for name in bars), rooms=len(rooms),
        seeds=min(map(len, outside.values())), data=data)
    references = {name: AgentSpec.parse(name).title for name in data["searchers"]}
    return Findings(numbers, {
        "rooms": make_table(["learner", "settings", "whole trajectories", "cut trajectories"], [
            ["the recorded play itself", "", f"{read(BEHAVIOUR, WHOLE).mean():.2f}", ""],
            *([words, f"`{agent}`", _format(whole[agent]), _format(cut[agent])] for agent, words in learners.items()),
            *([title, f"`{name}`", f"{searched[name].mean():.2f}", ""] for name, title in references.items())]),
        "stitching": make_table(["learner", "whole less cut"], [
            [learners[agent], format_interval(found, "+.2f")] for agent, found in numbers.stitching.items()]),
        "unseen": make_table(["learner", *(f"`{kind}`" for kind in data["unseen"]["kinds"])], [
            *([words, *(_format(unseen[agent, kind]) for kind in data["unseen"]["kinds"])]
              for agent, words in data["unseen"]["learners"].items()),
            *([title, *[f"{elsewhere[name]:.2f}"] * len(data["unseen"]["kinds"])]
              for name, title in references.items())]),
    }, {"offline": lambda theme: draw(learners, whole, cut, searched[best].mean(), theme)})


def _format(cell: Mean) -> str:
    return format_interval(cell, ".2f")


def draw(learners: Mapping[str, str], whole: Mapping[str, Mean], cut: Mapping[str, Mean], search: float, theme: Theme
         ) -> Figure:
    """Draw the efficiency of each learner from whole and from cut trajectories."""

    def draw_axes(axes: Axes) -> None:
        for number, agent in enumerate(learners):
            for shift, cell, colour in ((-0.16, whole[agent], theme.lines[0]), (0.16, cut[agent], theme.lines[2])):
                axes.plot([cell.low, cell.high], [number + shift] * 2, color=colour, linewidth=2)
                axes.plot(cell.mean, number + shift, "o", color=colour, markersize=6)
        axes.axvline(search, color=theme.muted, linewidth=1.4, linestyle="--")
        last = len(learners) - 0.35
        write_label(axes, search - 0.02, last, "search", theme.muted, ha="right")
        axes.set(xlabel="efficiency in the room of the data", xlim=(0, 1.02), ylim=(last + 0.35, -0.6))
        axes.set_yticks(range(len(learners)), list(learners.values()))
        first = next(iter(learners))
        write_label(axes, whole[first].high + 0.06, -0.16, "whole trajectories", theme.lines[0])
        write_label(axes, whole[first].high + 0.06, 0.34, "cut trajectories", theme.lines[2])

    return make_figure(theme, draw_axes, height=4.6, grid="x")
