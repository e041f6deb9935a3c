"""Summary of a comparison: efficiency, progress, success rate, learning curves, gaps, and pairwise comparisons.

Pure, deterministic functions from results to numbers. `verdict.py` writes sentences and `report.py` pages. Final values
are means over the evaluations in the last fifth of training.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hrl_escape.agents.spec import ORACLE, AgentSpec
from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.env_spec import EnvPlace
from hrl_escape.benchmark.grid import Grid, GridRun
from hrl_escape.benchmark.inference import (
    Estimate,
    Pair,
    Statistic,
    compare_agents,
    compute_interval,
    compute_wilson_interval,
)
from hrl_escape.benchmark.measures import EFFICIENCY, RETURN, SUCCESS, Measure
from hrl_escape.benchmark.room_intervals import compute_crossed_interval, compute_nested_interval
from hrl_escape.benchmark.run_results import RunResult
from hrl_escape.benchmark.score_range import ScoreRange
from hrl_escape.benchmark.statistics import (
    Floats,
    Gap,
    compute_area,
    compute_iqm,
    compute_mean,
    compute_profile,
    compute_score,
    split_gap,
)
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ComparisonError
from hrl_escape.figures import Pictured
from hrl_escape.intervals import compute_mean_interval
from hrl_escape.sets.places import RunPlace

FinishedRun: TypeAlias = tuple[GridRun, RunResult]

CURVE_METRICS = ("efficiency", "progress", "success", "length", "score")
"""Metrics of curves in rooms. Elsewhere they are `return`, `length`, and `success` and `progress` if reported."""
UNDEFINED = Estimate(math.nan, math.nan, math.nan)
"""Estimate of what an environment does not define."""
CURVE_POINTS = 41
CURVE_RESAMPLES = 500
PROFILE = np.round(np.concatenate([np.linspace(-0.05, 0.9, 96), np.linspace(0.901, 1.0, 100)]), 4)
"""Thresholds of the performance profile, denser near the best known score."""
UNIT = (0.0, 1.0)


@dataclass(frozen=True, repr=False)
class Curve:
    """A learning curve of several runs, at common numbers of primitives."""

    primitives: Floats  # (points,) of training
    decisions: Floats  # (points,) of the median run by then
    seconds: Floats  # (points,) of training of the median run by then
    metrics: dict[str, tuple[Floats, Floats, Floats]]
    """Middle, low and high of each metric, each (points,); see `CURVE_METRICS`."""

    def __repr__(self) -> str:
        return f"<Curve of {', '.join(self.metrics)} at {len(self.primitives)} points>"


@dataclass(frozen=True, repr=False)
class AgentSummary:
    """Results of one agent."""

    spec: AgentSpec  # the agent
    settings: dict[str, object]  # its settings
    primaries: tuple[Floats, ...]  # final values (runs,) of the comparison's measure for each room or environment
    primary: Estimate  # of them; in rooms the efficiency
    efficiencies: tuple[Floats, ...]  # final efficiency (runs,) for each room; empty without finished runs
    efficiency: Estimate  # interquartile mean of them
    returns: Estimate  # mean return of an episode of the last fifth, with Student's t interval
    seen: Estimate | None  # the same in training rooms, if test rooms are separate; else None
    trials: tuple[Estimate, ...]
    """Interquartile mean at each trial in test rooms; empty without trials."""
    progress: Estimate
    """Largest share of facts towards the goal in an episode, mean over the last fifth with equal room weights."""
    success: Estimate
    """Success rate of evaluation episodes in the last fifth, with equal room weights; Wilson's interval counts a run as
    one try."""
    first_escape: Estimate
    """Mean primitives of training to the first escape; runs without one count with the budget. It is the restricted
    mean of the Kaplan-Meier curve."""
    escaped_runs: int  # number of runs with a successful training episode
    length: Estimate  # interquartile mean of primitives in an episode of the last fifth
    score: Estimate  # interquartile mean of the return score: 0 at the worst, 1 at the best known return
    area: Estimate  # interquartile mean of the area under the efficiency's curve, over the budget
    regret: Estimate | None
    """Mean share of the training primitives lost relative to the oracle; None for runs that train in other rooms."""
    unseen: Estimate | None
    """Mean efficiency with an interval for unseen rooms and other seeds, see `room_intervals`; None with one room."""
    stuck: float  # share of runs without success in the last fifth
    gap: Gap  # distance to an efficiency of 1
    curve: Curve  # over all rooms
    room_curves: tuple[Curve | None, ...]  # for each room, or None without runs
    profile: Floats  # share of runs above each threshold of `PROFILE`
    failed: int  # runs that failed
    decisions: float  # mean of a run
    planner_calls: float  # mean of a run
    seconds: float  # mean of a run's training
    planner_seconds: float  # of these, in planners

    def __repr__(self) -> str:
        return f"<AgentSummary {self.label}: {self.runs} runs, success rate {self.success.value:.0%}>"

    @property
    def label(self) -> str:
        """Name in tables and figures."""
        return self.spec.label

    @property
    def is_trained(self) -> bool:
        """True if the agent made decisions in training, as learners do, and references that remember episodes."""
        return self.decisions > 0

    @property
    def runs(self) -> int:
        """Number of finished runs."""
        return sum(len(room) for room in self.efficiencies)

    @property
    def stuck_runs(self) -> int:
        """Number of runs without success in the last fifth."""
        return round(self.stuck * self.runs)

    @property
    def fewest_runs(self) -> int:
        """Smallest number of finished runs in a room."""
        return min(len(room) for room in self.efficiencies)


@dataclass(frozen=True)
class RoomSummary:
    """Room or test set with the scale of its scores."""

    place: RunPlace | EnvPlace  # the room, the sets of rooms, or the environment
    name: str  # in tables
    worst: float  # return without escape
    best: float  # best known return, mean over the evaluation episodes; the reference of an environment
    fewest: float  # primitives of the best known escape, mean over the evaluation episodes
    source: str  # finder of the best: `planner`, `ceiling`, or the label of the agent that beat the planner

    @property
    def instance(self) -> RoomInstance:
        """The room, or the first test room of a set."""
        assert isinstance(self.place, RunPlace), "an environment from elsewhere is no room"
        return self.place.instance


@dataclass(frozen=True, repr=False)
class Summary(Pictured):
    """Results of a comparison. Notebooks draw its learning curves."""

    _picture = "hrl_escape.benchmark.reporting.figures:draw_summary"

    grid: Grid  # its settings
    measure: Measure  # number that agents are compared by
    thresholds: Floats  # of the profiles
    rooms: tuple[RoomSummary, ...]  # in the grid's order
    agents: tuple[AgentSummary, ...]  # in the grid's order, without agents that have no finished run
    runs: tuple[FinishedRun, ...]  # runs with results; score ranges raised to the best results
    pairs: tuple[tuple[Pair, ...], ...]  # (agents, agents), comparison of the first with the second by the measure
    versions: dict[str, str]  # package -> version, `a, b` where runs differ

    def __repr__(self) -> str:
        labels = ", ".join(agent.label for agent in self.agents[:6]) + ", ..." * (len(self.agents) > 6)
        return f"<Summary of {len(self.runs)} runs of {len(self.agents)} agents: {labels}>"

    @property
    def reports_success(self) -> bool:
        """True if every agent's episodes report their success."""
        return not any(math.isnan(agent.success.value) for agent in self.agents)

    @property
    def covers_unseen(self) -> bool:
        """True if every agent has an interval for unseen rooms."""
        return all(agent.unseen is not None for agent in self.agents)

    def describe_intervals(self) -> str:
        """Describe what the intervals cover: seeds alone, or rooms and seeds."""
        if self.grid.env is not None:
            return f"Intervals are over training seeds in {self.rooms[0].name} alone."
        seeds = "over training seeds, with the rooms as they are"
        if self.covers_unseen:
            return ("Intervals for unseen rooms are two-way: they cover other rooms and other training seeds. All "
                    f"other intervals, and the tests, are {seeds}.")
        return f"Intervals and tests are {seeds}: they say nothing about other rooms."

    def get_pair(self, first: AgentSummary, second: AgentSummary) -> Pair:
        """Return the comparison of two agents."""
        places = {agent.label: number for number, agent in enumerate(self.agents)}
        return self.pairs[places[first.label]][places[second.label]]


def summarise(comparison: Comparison) -> Summary:
    """Summarise the finished runs.

    Raises:
        ComparisonError: no run has finished.
    """
    if not comparison.runs:
        reasons = "; ".join(sorted({failure.message for failure in comparison.failures})) or "none was run"
        raise ComparisonError(f"{comparison.out}: no run has finished, so there is nothing to report: {reasons}")
    runs = [run for place in comparison.places for run in _raise_ranges(
        [run for run in comparison.runs if run[0].place_id == place.id], place)]
    measure = _choose_measure(comparison.grid, [result for _, result in runs])
    values = np.array([result.get_final(measure.metric) for _, result in runs])
    thresholds = PROFILE if measure.largest == 1.0 else np.linspace(values.min() - 1e-9, values.max(), len(PROFILE))
    rooms = [_summarise_room(place, runs) for place in comparison.places]
    agents = [
        _summarise_agent(comparison, [run for run in runs if run[0].number == number], measure, thresholds)
        for number in sorted({run.number for run, _ in runs})
    ]
    finals = [{(run.place_id, run.seed): result.get_final(measure.metric) for run, result in runs
               if run.agent.label == agent.label} for agent in agents]
    pairs = compare_agents(finals, [agent.spec.name != ORACLE for agent in agents], _make_rng(),
                           largest=measure.largest)
    return Summary(comparison.grid, measure, thresholds, tuple(rooms), tuple(agents), tuple(runs), pairs,
                   _join_versions(runs))


def _choose_measure(grid: Grid, results: Sequence[RunResult]) -> Measure:
    """Return the efficiency for rooms, and for an environment from elsewhere what its spec and its episodes say."""
    if grid.env is None:
        return EFFICIENCY
    is_reported = all(result.reports_success for result in results)
    if grid.env.score == "success" and not is_reported:
        raise ComparisonError(f"{grid.env.name} reports no success, so agents cannot be compared by it: set score to "
                              "return, or info['is_success'] at the end of its episodes")
    return RETURN if grid.env.score == "return" or not is_reported else SUCCESS


def _raise_ranges(runs: Sequence[FinishedRun], place: RunPlace | EnvPlace) -> list[FinishedRun]:
    """Raise the best known return and fewest primitives of each start to the best result of a run.

    Rooms with noise keep their expectations, because a single episode can be better by luck.
    """
    if isinstance(place, EnvPlace):
        return list(runs)
    dynamics, is_expected = place.instance.dynamics, any(_get_range(result).is_expected for _, result in runs)
    if dynamics.is_random or dynamics.kind == "physics" or is_expected:
        return list(runs)
    best: dict[tuple[float, ...], tuple[float, float, str]] = {}
    for run, result in runs:
        score_range = _get_range(result)
        known = zip(score_range.starts, score_range.best, score_range.fewest, strict=True)
        for (start, value, fewest), (new_value, new_fewest) in zip(known, _find_reached(result), strict=True):
            found = best.setdefault(start, (value, fewest, score_range.source))
            if new_value > found[0] + 1e-9 or new_fewest < found[1]:
                best[start] = max(found[0], new_value), min(found[1], new_fewest), run.agent.label
    return [(run, dataclasses.replace(result, score_range=_raise_range(_get_range(result), best)))
            for run, result in runs]


def _get_range(result: RunResult) -> ScoreRange:
    assert result.score_range is not None, "runs in rooms have a score range"
    return result.score_range


def _find_reached(result: RunResult) -> Iterator[tuple[float, int]]:
    """Return the best return and the fewest primitives of each evaluation episode over the run.

    Minus infinity for episodes that were not played, and the largest int64 without success.
    """
    returns, lengths, escaped = (np.array([getattr(evaluation, name) for evaluation in result.evaluations])
                                 for name in ("returns", "lengths", "successes"))
    return zip(np.where(lengths, returns, -np.inf).max(axis=0).tolist(),
               np.where(escaped, lengths, np.iinfo(np.int64).max).min(axis=0).tolist(), strict=True)


def _raise_range(score_range: ScoreRange, best: dict[tuple[float, ...], tuple[float, float, str]]) -> ScoreRange:
    """Replace the best known results; a reachable best stays reachable."""
    raised, fewest, sources = zip(*(best[start] for start in score_range.starts), strict=True)
    reachable = tuple(new if reach >= old else reach
                      for reach, old, new in zip(score_range.reachable, score_range.best, raised, strict=True))
    fewest_reachable = tuple(
        new if reach is not None and reach <= old else reach
        for reach, old, new in zip(score_range.fewest_reachable, score_range.fewest, fewest, strict=True))
    return dataclasses.replace(score_range, best=raised, reachable=reachable, fewest=fewest,
                               fewest_reachable=fewest_reachable, source=", ".join(dict.fromkeys(sources)))


def _score(result: RunResult, returns: ArrayLike) -> Floats:
    if result.score_range is None:
        return np.full(np.shape(returns), np.nan)
    return compute_score(returns, result.score_range.worst, np.mean(result.score_range.best))


def _summarise_room(place: RunPlace | EnvPlace, runs: Sequence[FinishedRun]) -> RoomSummary:
    here = [(run, result) for run, result in runs if run.place_id == place.id]
    if not here:
        return RoomSummary(place, place.name, math.nan, math.nan, math.nan, "nothing")
    if isinstance(place, EnvPlace):
        best = math.nan if place.spec.reference is None else place.spec.reference
        return RoomSummary(place, place.name, math.nan, best, math.nan, "reference")
    ranges = [_get_range(result) for _, result in here]
    sources = dict.fromkeys(source for found in ranges for source in found.source.split(", "))
    best, fewest = (float(np.mean([np.mean(values) for values in ends]))
                    for ends in ([found.best for found in ranges], [found.fewest for found in ranges]))
    return RoomSummary(place, here[0][0].room, ranges[0].worst, best, fewest, ", ".join(sources))


def _compute_reachable_efficiency(result: RunResult) -> float:
    """Return the efficiency of the best known policy with the agent's actions."""
    ends = result.score_range
    if ends is None:
        return math.nan
    return float(np.mean([0.0 if reach is None else min(1.0, fewest / reach)
                          for fewest, reach in zip(ends.fewest, ends.fewest_reachable, strict=True)]))


def _summarise_agent(comparison: Comparison, runs: Sequence[FinishedRun], measure: Measure, thresholds: Floats
                     ) -> AgentSummary:
    budget, run = max(result.budget for _, result in runs), runs[0][0]
    rooms = [[result for run, result in runs if run.place_id == place.id] for place in comparison.places]
    occupied = [room for room in rooms if room]
    results = [result for _, result in runs]

    def collect(read: Callable[[RunResult], float | Floats]) -> list[Floats]:
        return [np.array([read(result) for result in room], dtype=np.float64) for room in occupied]

    def describe(metric: str, statistic: Statistic = compute_iqm, bounds: tuple[float, float] | None = UNIT
                 ) -> Estimate:
        return _estimate(statistic, collect(lambda result: result.get_final(metric)), bounds)

    efficiencies = collect(lambda result: result.get_final("efficiency"))
    efficiency = _estimate(compute_iqm, efficiencies)
    primaries = collect(lambda result: result.get_final(measure.metric))
    reachable = float(compute_mean(collect(_compute_reachable_efficiency)))
    success = float(compute_mean(collect(lambda result: result.get_final("success_rate"))))
    first = collect(lambda result: float(budget if result.first_escape is None else min(result.first_escape, budget)))
    returns = collect(lambda result: _score(result, result.get_final("mean_return")))
    areas = collect(lambda result: compute_area(result.get_curve("primitives"), result.get_curve("efficiency"), budget))
    seen = [np.array([result.seen_efficiency for result in room if result.seen_efficiency is not None])
            for room in occupied]
    filled, main = iter(efficiencies), iter(primaries)
    successes = UNDEFINED if math.isnan(success) else Estimate(success, *compute_wilson_interval(success, len(results)))
    final_return = _estimate(compute_mean, collect(lambda result: result.get_final("mean_return")), None)
    lengths = _get_length_bounds(comparison)
    regrets = [[share for result in room if (share := result.regret) is not None] for room in occupied]
    return AgentSummary(
        spec=run.agent,
        settings=run.settings,
        primaries=tuple(next(main) if room else np.zeros(0) for room in rooms),
        primary={EFFICIENCY: efficiency, SUCCESS: successes, RETURN: final_return}[measure],
        efficiencies=tuple(next(filled) if room else np.zeros(0) for room in rooms),
        efficiency=efficiency,
        returns=final_return,
        seen=_estimate(compute_iqm, seen) if all(map(len, seen)) else None,
        trials=tuple(_estimate(compute_iqm, collect(lambda result, number=number: result.trial_efficiencies[number]))
                     for number in range(min(len(result.trials) for result in results))),
        progress=describe("mean_progress", compute_mean),
        success=successes,
        first_escape=UNDEFINED if math.isnan(success) else _estimate(compute_mean, first, (0.0, float(budget))),
        escaped_runs=sum(result.first_escape is not None for result in results),
        length=describe("mean_length", bounds=lengths),
        score=_estimate(compute_iqm, returns, (min(0.0, *map(np.min, returns)), max(1.0, *map(np.max, returns)))),
        area=_estimate(compute_iqm, areas),
        regret=_estimate(compute_mean, [np.array(room) for room in regrets]) if all(map(len, regrets)) else None,
        unseen=_estimate_unseen(comparison, occupied, efficiencies),
        stuck=float(np.mean([result.is_stuck for result in results])),
        gap=split_gap(efficiency.value, reachable),
        curve=_make_curve(occupied, budget, lengths),
        room_curves=tuple(_make_curve([room], budget, lengths) if room else None for room in rooms),
        profile=compute_profile(primaries, thresholds),
        failed=sum(failure.run.number == run.number for failure in comparison.failures),
        decisions=float(np.mean([result.decisions for result in results])),
        planner_calls=float(np.mean([result.planner_calls for result in results])),
        seconds=float(np.mean([result.seconds[-1] for result in results])),
        planner_seconds=float(np.mean([result.planner_seconds for result in results])),
    )


def _get_length_bounds(comparison: Comparison) -> tuple[float, float] | None:
    """Return the least and most primitives of an episode, or None if the most are not known."""
    horizons = [place.instance.horizon for place in comparison.places if isinstance(place, RunPlace)]
    return (1.0, float(max(horizons))) if horizons else None


def _estimate_unseen(comparison: Comparison, rooms: Sequence[Sequence[RunResult]], efficiencies: Sequence[Floats]
                     ) -> Estimate | None:
    """Return the mean over rooms of one configuration: rooms with runs of their own, or rooms that all runs share."""
    if len({place.instance.name for place in comparison.places if isinstance(place, RunPlace)}) != 1:
        return None
    if len(rooms) > 1:
        return compute_nested_interval(efficiencies)
    score_range, tested = rooms[0][0].score_range, [result.room_efficiencies for result in rooms[0]]
    if score_range is None or len(set(score_range.starts)) < 2 or len(set(map(len, tested))) > 1:
        return None
    return compute_crossed_interval(np.stack(tested, axis=1))


def _make_rng() -> np.random.Generator:
    """Return a generator with fixed seed, for reproducible reports."""
    return np.random.default_rng(20_190_100)


def _estimate(statistic: Statistic, scores: Sequence[Floats], bounds: tuple[float, float] | None = UNIT) -> Estimate:
    """Estimate a statistic of runs; without bounds of the scores the mean with Student's t interval."""
    if any(np.isnan(room).any() for room in scores):
        return UNDEFINED
    if bounds is None:
        return Estimate(*map(float, compute_mean_interval(np.concatenate(scores))))
    low, high = compute_interval(statistic, scores, bounds, _make_rng())
    return Estimate(float(statistic(scores)), float(low), float(high))


def _make_curve(rooms: Sequence[Sequence[RunResult]], budget: int, lengths: tuple[float, float] | None) -> Curve:
    """Interpolate the runs' curves linearly at common numbers of primitives."""
    grid = np.linspace(0, budget, CURVE_POINTS)

    def stack(read: Callable[[RunResult], Floats]) -> list[Floats]:
        """(points, runs) a room."""
        return [np.stack([np.interp(grid, result.get_curve("primitives"), read(result)) for result in room], axis=-1)
                for room in rooms]

    def compute_median(metric: str) -> Floats:
        return np.median(np.concatenate(stack(lambda result: result.get_curve(metric)), axis=-1), axis=-1)

    scores = stack(lambda result: _score(result, result.get_curve("mean_return")))
    ends = (min(0.0, *(float(room.min()) for room in scores)), max(1.0, *(float(room.max()) for room in scores)))
    curves: dict[str, tuple[Statistic, list[Floats], tuple[float, float] | None]] = {
        "efficiency": (compute_iqm, stack(lambda result: result.get_curve("efficiency")), UNIT),
        "progress": (compute_mean, stack(lambda result: result.get_curve("mean_progress")), UNIT),
        "success": (compute_mean, stack(lambda result: result.get_curve("success_rate")), UNIT),
        "length": (compute_iqm, stack(lambda result: result.get_curve("mean_length")), lengths),
        "score": (compute_iqm, scores, ends),
    }
    if lengths is None:  # an environment from elsewhere
        returns = stack(lambda result: result.get_curve("mean_return"))
        curves = {"return": (compute_mean, returns, None)} | {
            name: curve for name, curve in curves.items() if not any(np.isnan(room).any() for room in curve[1])}
    metrics = {}
    for name, (statistic, values, bounds) in curves.items():
        if bounds is None:
            metrics[name] = compute_mean_interval(np.concatenate(values, axis=-1))
            continue
        low, high = compute_interval(statistic, values, bounds, _make_rng(), CURVE_RESAMPLES)
        metrics[name] = (statistic(values), low, high)
    return Curve(grid, compute_median("decisions"), compute_median("seconds"), metrics)


def _join_versions(runs: Sequence[FinishedRun]) -> dict[str, str]:
    names = dict.fromkeys(name for _, result in runs for name in result.versions)
    return {name: ", ".join(sorted({result.versions.get(name, "unknown") for _, result in runs})) for name in names}
