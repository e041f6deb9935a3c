"""Standings: results of agents on rungs, which rungs they passed, and the ladder score.

The ladder score of an agent is the mean over rungs of the interquartile mean of efficiency. Rungs are strata of equal
weight, as tasks are in Agarwal et al. (2021). Within a rung, bootstrap resamples draw whole rooms, because runs in the
same room are correlated.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from hrl_escape.agents.spec import BAYES, SEARCH_MEMORY
from hrl_escape.benchmark.inference import LEVEL, RESAMPLES, Estimate, compute_wilson_interval, draw_weights
from hrl_escape.benchmark.references.registry import SEARCH_METHODS
from hrl_escape.benchmark.room_intervals import compute_nested_interval
from hrl_escape.benchmark.statistics import Floats, Scores, compute_iqm
from hrl_escape.benchmark.summary import AgentSummary, Summary
from hrl_escape.sets.room_sequence import list_sets

PASSED_RATE, PASSED_EFFICIENCY = 0.9, 0.5
"""A rung is passed with a success rate above the first, by the lower end of Wilson's interval, and efficiency above the
second."""
LEAST_HEADROOM = 0.10
"""Smallest lower bound of the headroom, the efficiency of the Bayes planner minus the best search baseline's, for a
normalised score."""


def compute_headroom(search: Floats, bayes: Floats) -> Estimate:
    """Estimate the headroom of a rung, with an interval for unseen rooms.

    Args:
        search: mean efficiency of the best search baseline with equal information in each room, (rooms,).
        bayes: of the Bayes planner in the same rooms, (rooms,).
    """
    return compute_nested_interval([np.array([gap]) for gap in bayes - search])


def normalise(efficiency: float, search: Floats, bayes: Floats) -> float | None:
    """Normalise an efficiency: 0 is the best search baseline and 1 the Bayes planner, by means over rooms.

    The Bayes planner is given how rooms are drawn and what cues mean, and discovers the graph. The baseline is given
    neither.

    Args:
        efficiency: mean efficiency of the agent over the rooms.
        search: mean efficiency of the best search baseline in each room, (rooms,).
        bayes: of the Bayes planner in the same rooms, (rooms,).

    Returns:
        Score: negative below the baseline, above 1 beyond the Bayes planner, or None if the lower bound of the
        headroom is not above `LEAST_HEADROOM`.
    """
    headroom = compute_headroom(search, bayes)
    return (efficiency - float(search.mean())) / headroom.value if headroom.low > LEAST_HEADROOM else None


def compute_ladder_score(rungs: Sequence[Scores], rng: np.random.Generator, resamples: int = RESAMPLES) -> Estimate:
    """Compute the mean over rungs of the interquartile mean of efficiency, with its 95 % interval.

    Args:
        rungs: efficiencies from 0 to 1 of each rung, one array (runs,) for each unit that is resampled as a whole: a
            training room, or a run that was tested in unseen rooms.
        rng: of the bootstrap.
        resamples: of the bootstrap.
    """
    def draw_ends(units: Scores) -> tuple[Floats, Floats]:
        """Draws (resamples,) of a rung's interquartile mean with the lowest efficiency added, and with the highest."""
        drawn = draw_weights(len(units), resamples, rng)
        shares = [np.repeat(drawn[:, [number]] / len(unit), len(unit), axis=-1) for number, unit in enumerate(units)]
        weights = np.concatenate([*shares, drawn[:, -1:]], axis=-1)
        lower, upper = (compute_iqm([np.concatenate([*units, [bound]])], [weights]) for bound in (0.0, 1.0))
        return lower, upper

    value = float(np.mean([compute_iqm(units) for units in rungs]))
    lower, upper = (np.mean(ends, axis=0) for ends in zip(*map(draw_ends, rungs), strict=True))
    return Estimate(value, float(np.quantile(lower, (1 - LEVEL) / 2)), float(np.quantile(upper, (1 + LEVEL) / 2)))


class RungStanding(NamedTuple):
    """Result of one agent on one rung."""

    rung: str  # name of the rung
    agent: AgentSummary  # its summary
    success_rate: Estimate
    """Success rate of the final test episodes, with Wilson's interval."""
    is_passed: bool  # the rung is passed, see `judge`
    units: Scores
    """Efficiencies (runs,) of each training room, or of each run that was tested in other rooms."""
    parts: int = 1  # number of rooms in a sequence; the success rate is a share of them
    normalised: float | None = None
    """See `normalise`, or None without runs of a search baseline and `bayes` on the rung."""


def judge(agent: AgentSummary, episodes: int) -> tuple[Estimate, bool]:
    """Return the success rate with Wilson's interval over the episodes, and whether the rung is passed.

    A rung is passed if the interval's lower end is at least `PASSED_RATE` and the interquartile mean of efficiency at
    least `PASSED_EFFICIENCY`.
    """
    rate = Estimate(agent.success.value, *compute_wilson_interval(agent.success.value, episodes))
    return rate, rate.low >= PASSED_RATE and agent.efficiency.value >= PASSED_EFFICIENCY


def list_standings(rung: str, summary: Summary) -> list[RungStanding]:
    """Return the standing of every agent of a comparison on a rung."""
    found, has_sets = [], bool(summary.grid.train_rooms)
    parts = max(1 if room.place.split is None else len(list_sets(room.place.split.test)) for room in summary.rooms)
    for agent in summary.agents:
        rooms = summary.grid.eval_episodes if has_sets else 1  # episodes in one room are correlated
        efficiencies = [room for room in agent.efficiencies if len(room)]
        units = [run for room in efficiencies for run in np.split(room, len(room))] if has_sets else efficiencies
        found.append(RungStanding(rung, agent, *judge(agent, agent.runs * rooms), units, parts))
    room_means = [_list_room_means(own.agent, summary) for own in found]
    by_room = {own.agent.spec.name: means for own, means in zip(found, room_means, strict=True)
               if own.agent.spec.name in (*SEARCH_METHODS, SEARCH_MEMORY, BAYES) and means is not None}
    known = by_room.pop(BAYES, None)
    searched = [means for means in by_room.values() if known is not None and len(means) == len(known)]
    if known is None or not searched:
        return found
    best = max(searched, key=np.mean)
    return [own._replace(normalised=None if means is None else normalise(float(means.mean()), best, known))
            for own, means in zip(found, room_means, strict=True)]


def _list_room_means(agent: AgentSummary, summary: Summary) -> Floats | None:
    """Return the mean efficiency of an agent in each room, (rooms,); None if some room has no run."""
    if not summary.grid.train_rooms:
        return None if not all(map(len, agent.efficiencies)) else np.array([room.mean() for room in agent.efficiencies])
    tested = [result.room_efficiencies for run, result in summary.runs if run.agent.label == agent.label]
    return np.mean(tested, axis=0) if len(set(map(len, tested))) == 1 else None


def score_standings(standings: Iterable[RungStanding]) -> tuple[list[str], dict[str, Estimate]]:
    """Return the rungs that every agent was run on, in order, and the ladder score of each agent over them."""
    by_rung: dict[str, dict[str, Scores]] = {}
    for standing in standings:
        by_rung.setdefault(standing.rung, {})[standing.agent.label] = standing.units
    labels = list(dict.fromkeys(label for agents in by_rung.values() for label in agents))
    common = [rung for rung, agents in by_rung.items() if len(agents) == len(labels)]
    return common, {label: compute_ladder_score([by_rung[rung][label] for rung in common], np.random.default_rng(0))
                    for label in labels if common}
