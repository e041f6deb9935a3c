"""What a comparison's runs amount to: scores, intervals, curves, gaps, and who beats whom.

Pure functions from results to numbers, the same every time; words are in `verdict.py`, pages in
`report.py`. A run is judged by its evaluations in the last fifth of training.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ComparisonError
from hrl_escape.experiments.cell import CellResult
from hrl_escape.experiments.comparison import Comparison
from hrl_escape.experiments.grid import AgentSpec, Cell, Grid
from hrl_escape.experiments.scale import Scale
from hrl_escape.experiments.statistics import (
    Gap,
    Scores,
    compute_area,
    compute_improvement,
    compute_interval,
    compute_iqm,
    compute_profile,
    compute_score,
    split_gap,
)

__all__ = ["CURVE_METRICS", "AgentSummary", "Curve", "Estimate", "RoomSummary", "Summary", "summarise"]

Floats: TypeAlias = NDArray[np.float64]
Run: TypeAlias = tuple[Cell, CellResult]

CURVE_METRICS = ("score", "success", "length")
CURVE_POINTS = 41
CURVE_RESAMPLES = 1_000
PROFILE = np.round(np.concatenate([np.linspace(-0.05, 0.9, 96), np.linspace(0.901, 1.0, 100)]), 4)
"""Thresholds of the performance profile: denser towards the best known return."""


@dataclass(frozen=True)
class Estimate:
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Curve:
    """A learning curve of several runs, at common numbers of primitives.

    Attributes:
        primitives: (points,) trained for.
        decisions: (points,) of the median run by then.
        seconds: (points,) of training of the median run by then.
        metrics: for each of `CURVE_METRICS` its middle, low and high, each (points,).
    """

    primitives: Floats
    decisions: Floats
    seconds: Floats
    metrics: dict[str, tuple[Floats, Floats, Floats]]


@dataclass(frozen=True)
class AgentSummary:
    """What one agent achieved.

    Attributes:
        spec: who.
        settings: what it ran with.
        scores: final scores (runs,) a room; a room without a finished run has none.
        score: interquartile mean of them.
        success: share of evaluation episodes in the last fifth that escaped, rooms weighing the same.
        length: interquartile mean of primitives in such an episode.
        area: interquartile mean of the area under the score's curve, over the budget.
        stuck: share of runs without any escape in the last fifth.
        gap: what is missing to the best known.
        curve: over all rooms.
        room_curves: room by room; None where it has no run.
        profile: share of runs above each threshold of `PROFILE`.
        failed: runs that failed.
        decisions: mean of a run.
        planner_calls: mean of a run.
        seconds: mean of a run's training.
        planner_seconds: of these, in planners.
    """

    spec: AgentSpec
    settings: dict[str, object]
    scores: tuple[Floats, ...]
    score: Estimate
    success: Estimate
    length: Estimate
    area: Estimate
    stuck: float
    gap: Gap
    curve: Curve
    room_curves: tuple[Curve | None, ...]
    profile: Floats
    failed: int
    decisions: float
    planner_calls: float
    seconds: float
    planner_seconds: float

    @property
    def label(self) -> str:
        """What it is called."""
        return self.spec.label

    @property
    def runs(self) -> int:
        """Finished runs."""
        return sum(len(room) for room in self.scores)

    @property
    def fewest_runs(self) -> int:
        """In the room where it has fewest."""
        return min(len(room) for room in self.scores)


@dataclass(frozen=True)
class RoomSummary:
    """A room and its scale.

    Attributes:
        instance: the room.
        name: in tables.
        worst: return without escape.
        best: best known return, mean over the evaluation episodes.
        source: what found the best: `planner`, `ceiling`, or the label of the agent that beat the planner.
    """

    instance: RoomInstance
    name: str
    worst: float
    best: float
    source: str


@dataclass(frozen=True)
class Summary:
    """All of it.

    Attributes:
        grid: what was asked for.
        rooms: in the grid's order.
        agents: in the grid's order; those without any finished run are left out.
        runs: cells with their results; scales raised to what was reached.
        improvement: (agents, agents) -> probability that a run of the first beats one of the second.
        versions: package -> version, `a, b` where runs differ.
    """

    grid: Grid
    rooms: tuple[RoomSummary, ...]
    agents: tuple[AgentSummary, ...]
    runs: tuple[Run, ...]
    improvement: tuple[tuple[Estimate, ...], ...]
    versions: dict[str, str]

    def get_improvement(self, first: AgentSummary, second: AgentSummary) -> Estimate:
        """Probability that a run of one beats a run of the other in the same room."""
        return self.improvement[self.agents.index(first)][self.agents.index(second)]


def summarise(comparison: Comparison) -> Summary:
    """Work out what the finished runs amount to.

    Raises:
        ComparisonError: no run has finished.
    """
    if not comparison.runs:
        reasons = "; ".join(sorted({failure.message for failure in comparison.failures})) or "none was run"
        raise ComparisonError(f"{comparison.out}: no run has finished, so there is nothing to report: {reasons}")
    runs = [run for instance in comparison.instances for run in _raise_scales(
        [run for run in comparison.runs if run[0].instance_id == instance.id], instance)]
    rooms = [_summarise_room(instance, runs) for instance in comparison.instances]
    agents = [
        _summarise_agent(comparison, [run for run in runs if run[0].number == number])
        for number in sorted({cell.number for cell, _ in runs})
    ]
    improvement = tuple(tuple(_estimate_improvement(first, second) for second in agents) for first in agents)
    return Summary(comparison.grid, tuple(rooms), tuple(agents), tuple(runs), improvement, _join_versions(runs))


def _raise_scales(runs: Sequence[Run], instance: RoomInstance) -> list[Run]:
    """Take over what runs in a room did better than the best known, start by start.

    In a room with noise nothing is taken over: a lucky episode is no reference.
    """
    dynamics = instance.dynamics
    if dynamics.noise or dynamics.slip or dynamics.kind == "physics":
        return list(runs)
    best: dict[tuple[float, ...], tuple[float, str]] = {}
    for cell, result in runs:
        scale = result.scale
        returns = np.max([evaluation.returns for evaluation in result.evaluations], axis=0)
        for start, known, reached in zip(scale.starts, scale.best, returns, strict=True):
            found = best.setdefault(start, (known, scale.source))
            if reached > found[0] + 1e-9:
                best[start] = float(reached), cell.agent.label
    return [(cell, dataclasses.replace(result, scale=_raise_scale(result.scale, best))) for cell, result in runs]


def _raise_scale(scale: Scale, best: dict[tuple[float, ...], tuple[float, str]]) -> Scale:
    raised = tuple(best[start][0] for start in scale.starts)
    reachable = tuple(  # whoever could do the best known could do the new best, as far as is known
        new if reach >= old else reach for reach, old, new in zip(scale.reachable, scale.best, raised, strict=True)
    )
    sources = dict.fromkeys(best[start][1] for start in scale.starts)
    return dataclasses.replace(scale, best=raised, reachable=reachable, source=", ".join(sources))


def _score(result: CellResult, returns: ArrayLike) -> Floats:
    return compute_score(returns, result.scale.worst, np.mean(result.scale.best))


def _summarise_room(instance: RoomInstance, runs: Sequence[Run]) -> RoomSummary:
    here = [(cell, result) for cell, result in runs if cell.instance_id == instance.id]
    if not here:
        return RoomSummary(instance, instance.name, math.nan, math.nan, "nothing")
    sources = dict.fromkeys(source for _, result in here for source in result.scale.source.split(", "))
    best = float(np.mean([np.mean(result.scale.best) for _, result in here]))
    return RoomSummary(instance, here[0][0].room, here[0][1].scale.worst, best, ", ".join(sources))


def _summarise_agent(comparison: Comparison, runs: Sequence[Run]) -> AgentSummary:
    budget, cell = max(result.budget for _, result in runs), runs[0][0]
    rooms = [[result for cell, result in runs if cell.instance_id == instance.id] for instance in comparison.instances]
    occupied = [room for room in rooms if room]
    results = [result for _, result in runs]

    def collect(read: Callable[[CellResult], float | Floats]) -> list[Floats]:
        return [np.array([read(result) for result in room], dtype=np.float64) for room in occupied]

    scores = collect(lambda result: _score(result, result.get_final("mean_return")))
    score = _estimate(compute_iqm, scores)
    reachable = _compute_mean(collect(lambda result: _score(result, np.mean(result.scale.reachable))))
    areas = collect(lambda result: compute_area(
        result.get_curve("primitives"), _score(result, result.get_curve("mean_return")), budget))
    filled = iter(scores)
    return AgentSummary(
        spec=cell.agent,
        settings=cell.settings,
        scores=tuple(next(filled) if room else np.zeros(0) for room in rooms),
        score=score,
        success=_estimate(_compute_mean, collect(lambda result: result.get_final("success_rate"))),
        length=_estimate(compute_iqm, collect(lambda result: result.get_final("mean_length"))),
        area=_estimate(compute_iqm, areas),
        stuck=float(np.mean([result.is_stuck for result in results])),
        gap=split_gap(score.value, float(reachable)),
        curve=_make_curve(occupied, budget),
        room_curves=tuple(_make_curve([room], budget) if room else None for room in rooms),
        profile=compute_profile(scores, PROFILE),
        failed=sum(failure.cell.number == cell.number for failure in comparison.failures),
        decisions=float(np.mean([result.decisions for result in results])),
        planner_calls=float(np.mean([result.planner_calls for result in results])),
        seconds=float(np.mean([result.seconds[-1] for result in results])),
        planner_seconds=float(np.mean([result.planner_seconds for result in results])),
    )


def _compute_mean(scores: Scores) -> Floats:
    """Mean of the rooms' means."""
    return np.mean([room.mean(axis=-1) for room in scores], axis=0)


def _make_rng() -> np.random.Generator:
    """The same draws for every statistic, so that a report says the same whenever it is written."""
    return np.random.default_rng(20_190_100)


def _estimate(statistic: Callable[..., Floats], *groups: Scores) -> Estimate:
    low, high = compute_interval(statistic, *groups, rng=_make_rng())
    return Estimate(float(statistic(*groups)), float(low), float(high))


def _estimate_improvement(first: AgentSummary, second: AgentSummary) -> Estimate:
    """Over the rooms where both have runs; without any, nothing is known."""
    both = [(x, y) for x, y in zip(first.scores, second.scores, strict=True) if len(x) and len(y)]
    if not both:
        return Estimate(0.5, 0.0, 1.0)
    if first is second:
        return Estimate(0.5, 0.5, 0.5)
    return _estimate(compute_improvement, [x for x, _ in both], [y for _, y in both])


def _make_curve(rooms: Sequence[Sequence[CellResult]], budget: int) -> Curve:
    """Every run's curve at common numbers of primitives, linear between its evaluations; then their middle."""
    grid = np.linspace(0, budget, CURVE_POINTS)

    def stack(read: Callable[[CellResult], Floats]) -> list[Floats]:
        """(points, runs) a room."""
        return [np.stack([np.interp(grid, result.get_curve("primitives"), read(result)) for result in room], axis=-1)
                for room in rooms]

    def compute_median(metric: str) -> Floats:
        return np.median(np.concatenate(stack(lambda result: result.get_curve(metric)), axis=-1), axis=-1)

    curves: dict[str, tuple[Callable[..., Floats], list[Floats]]] = {
        "score": (compute_iqm, stack(lambda result: _score(result, result.get_curve("mean_return")))),
        "success": (_compute_mean, stack(lambda result: result.get_curve("success_rate"))),
        "length": (compute_iqm, stack(lambda result: result.get_curve("mean_length"))),
    }
    metrics = {}
    for name, (statistic, values) in curves.items():
        low, high = compute_interval(statistic, values, rng=_make_rng(), resamples=CURVE_RESAMPLES)
        metrics[name] = (statistic(values), low, high)
    return Curve(grid, compute_median("decisions"), compute_median("seconds"), metrics)


def _join_versions(runs: Sequence[Run]) -> dict[str, str]:
    names = dict.fromkeys(name for _, result in runs for name in result.versions)
    return {name: ", ".join(sorted({result.versions.get(name, "unknown") for _, result in runs})) for name in names}
