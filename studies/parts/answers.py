"""Answers to the registered questions: ratios room by room, growth, and the exchange rate."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.inference import ALPHA
from studies.statistics import compare_signs
from studies.store import Line

__all__ = ["Answer", "Exchange", "Law", "PartsRun", "answer", "choose_slope", "find_exchange", "fit_law", "is_given_up"]

RESAMPLES = 2_000
LEAST_SIZES = 3
SURE = 0.95
"""Share of resamples where one law must fit better than the other to be named."""
Logs = dict[tuple[int, int], float]
"""Logarithm of a number by (buttons, seed)."""


@dataclasses.dataclass(frozen=True)
class PartsRun(Line):
    """A run until its first escape, and near the best where that is waited for.

    Attributes:
        cell: what the agent has.
        rule: for presses whose parents are not lit.
        buttons: of the room.
        seed: of room and agent.
        failure: probability that a walk fails.
        first_escape: primitives at its end; None if none came within the budget.
        near_best: primitives after which the frozen policy needs no more than the fewest / 0.9, twice in a row; None
            if it did not, or was not waited for.
        design: hash of the registered files.
    """

    cell: str
    rule: str
    buttons: int
    seed: int
    failure: float
    first_escape: int | None
    near_best: int | None
    design: str

    PLACE = ("cell", "rule", "buttons", "seed", "failure")


def is_given_up(runs: Sequence[PartsRun], buttons: int, hopeless: int) -> bool:
    """With so many buttons or fewer, all runs of a cell failed, `hopeless` or more of them."""
    ends: dict[int, list[int | None]] = defaultdict(list)
    for run in runs:
        ends[run.buttons].append(run.first_escape)
    return any(size <= buttons and len(found) >= hopeless and not any(found) for size, found in ends.items())


# --- questions -------------------------------------------------------------------------------


class Answer(NamedTuple):
    """Answer to a question under one rule.

    Attributes:
        part: that is asked about.
        more: cell that has it.
        less: cell that lacks it.
        rule: for violations.
        rooms: where one of the two escaped, or both.
        factor: geometric mean of the restricted primitives without it over those with it, above 1 where it pays.
        low: lower end of its interval, at the level of Holm's correction.
        high: upper end.
        p: two-sided, by flipped signs, corrected.
        slope: by how much it lowers the exponent, with its interval; None with too few sizes.
    """

    part: str
    more: str
    less: str
    rule: str
    rooms: int
    factor: float = math.nan
    low: float = 0.0
    high: float = math.inf
    p: float = 1.0
    slope: tuple[float, float, float] | None = None

    @property
    def verdict(self) -> str:
        """`pays`, `costs` or `open`."""
        return "open" if self.p >= ALPHA else "pays" if self.factor > 1 else "costs"

    @property
    def lowers_exponent(self) -> bool:
        """The exponent is significantly lower with the part."""
        return self.slope is not None and self.slope[1] > 0


def answer(runs: Sequence[PartsRun], data: Mapping[str, Any]) -> list[Answer]:
    """Answer all registered questions under each rule, as one family (Holm).

    A room counts where one of the two escaped. A run that gave up, or was not made as its cell had been given up,
    counts with the budget, which makes the ratio smaller than it is.
    """
    found = []
    for question in data["questions"]:
        for rule in data["rules"]:
            less = data["searchers"][rule] if question["less"] == "the best searcher" else question["less"]
            with_it, without = (_list_logs(runs, cell, rule, data) for cell in (question["more"], less))
            ends = {key: (with_it[key], without[key]) for key in with_it.keys() & without.keys()}
            limit = math.log(data["budget"])
            gains = {key: b - a for key, (a, b) in sorted(ends.items()) if min(a, b) < limit}
            found.append((Answer(question["part"], question["more"], less, rule, len(gains)), gains,
                          choose_slope(gains, with_it, without, limit, 1 - ALPHA / (2 * len(data["questions"])))))
    asked = {str(index): list(gains.values()) for index, (one, gains, _) in enumerate(found)
             if one.rooms >= data["least"]}
    answers = [one._replace(slope=slope) for one, _, slope in found]
    for index, gain in compare_signs(asked).items():
        answers[int(index)] = answers[int(index)]._replace(factor=math.exp(gain.mean), low=math.exp(gain.low),
                                                           high=math.exp(gain.high), p=gain.p)
    return answers


def _list_logs(runs: Sequence[PartsRun], cell: str, rule: str, data: Mapping[str, Any], failure: float = 0.0) -> Logs:
    """Logarithms of restricted primitives of a cell in every room where any cell was run; see `answer`."""
    own = [run for run in runs if (run.cell, run.rule, run.failure) == (cell, rule, failure)]
    logs = {(run.buttons, run.seed): math.log(min(run.first_escape or data["budget"], data["budget"])) for run in own}
    rooms = {(run.buttons, run.seed) for run in runs if run.rule == rule}
    given_up = {size: is_given_up(own, size, data["hopeless"]) for size in data["sizes"]}
    return logs | {room: math.log(data["budget"]) for room in rooms if room not in logs and given_up.get(room[0])}


def choose_slope(gains: Logs, with_it: Logs, without: Logs, limit: float, level: float
                 ) -> tuple[float, float, float] | None:
    """Slope of the gain against the logarithm of the buttons, with its interval by resampled rooms.

    Only sizes count where half of the runs of both cells escape; None where these are fewer than `LEAST_SIZES`.
    """
    by_size: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for key in gains:
        by_size[key[0]].append(key)
    sizes = [size for size, keys in sorted(by_size.items())
             if len(keys) > 1 and all(np.median([logs[key] for key in keys]) < limit for logs in (with_it, without))]
    if len(sizes) < LEAST_SIZES:
        return None
    rng = np.random.default_rng(2019)
    x = np.log(sizes)
    away = (x - x.mean()) / np.sum((x - x.mean()) ** 2)
    values = [np.array([gains[key] for key in by_size[size]]) for size in sizes]
    means = np.stack([rng.choice(own, (RESAMPLES, len(own))).mean(axis=1) for own in values], axis=1)
    low, high = np.quantile(means @ away, [(1 - level) / 2, (1 + level) / 2])
    return float(np.array([own.mean() for own in values]) @ away), float(low), float(high)


# --- growth ----------------------------------------------------------------------------------


class Law(NamedTuple):
    """Growth of a cell's primitives to the first escape with the number of buttons, c n^k.

    Attributes:
        exponent: k.
        low: lower end of its 95 % interval.
        high: upper end.
        constant: c.
        power: share of resamples where a power law fits better than an exponential.
    """

    exponent: float
    low: float
    high: float
    constant: float
    power: float

    @property
    def shape(self) -> str:
        """The law that fits better in 95 % of the resamples, `power law` or `exponential`; else `either`."""
        return "power law" if self.power >= SURE else "exponential" if self.power <= 1 - SURE else "either"


def fit_law(runs: Sequence[PartsRun]) -> Law | None:
    """Fit a cell's medians by least squares of logarithms, its runs resampled within each size.

    Returns:
        None with fewer than `LEAST_SIZES` numbers of buttons where half of the runs escape.
    """
    times = {size: np.array([run.first_escape or math.inf for run in runs if run.buttons == size], float)
             for size in sorted({run.buttons for run in runs})}
    times = {size: own for size, own in times.items() if np.isfinite(np.median(own))}
    if len(times) < LEAST_SIZES:
        return None
    rng = np.random.default_rng(2019)
    drawn = [np.median(rng.choice(own, (RESAMPLES, len(own))), axis=1) for own in times.values()]
    rows = np.log(np.vstack([[np.median(own) for own in times.values()], np.stack(drawn, axis=1)]))
    rows = rows[np.isfinite(rows).all(axis=1)]
    sizes = np.array(list(times), float)
    (slopes, starts, errors), (_, _, others) = _fit(np.log(sizes), rows), _fit(sizes, rows)
    low, high = np.quantile(slopes[1:], [0.025, 0.975])
    return Law(float(slopes[0]), float(low), float(high), float(np.exp(starts[0])),
               float(np.mean(errors[1:] < others[1:])))


def _fit(x: NDArray[np.float64], rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Slopes, heights at 0 and squared errors of lines through rows (n, len(x))."""
    design = np.stack([x, np.ones_like(x)], axis=1)
    found = np.linalg.lstsq(design, rows.T, rcond=None)[0]
    return found[0], found[1], ((design @ found - rows.T) ** 2).sum(axis=0)


# --- exchange rate ---------------------------------------------------------------------------


class Exchange(NamedTuple):
    """Share of failing walks that makes a better manager need as much as a plain one whose walks never fail.

    Attributes:
        rule: for violations.
        failure: the share; `nan` with too few rooms.
        low: lower end of its 95 % interval, by resampled rooms.
        high: upper end.
        most: largest share that was tried.
        rooms: that count.
    """

    rule: str
    failure: float
    low: float
    high: float
    most: float
    rooms: int


def find_exchange(runs: Sequence[PartsRun], data: Mapping[str, Any], rule: str) -> Exchange:
    """Find where the better manager's gain over the plain one is gone, between the shares that were tried.

    Gains are linear in the logarithm of the tries that a walk needs, 1 / (1 - failure), between two shares.
    """
    dial = data["dial"]
    failures = [0.0, *dial["failures"]]
    plain, *better = ({seed: log for (size, seed), log in _list_logs(runs, cell, rule, data, failure).items()
                       if size == dial["buttons"]}
                      for cell, failure in ((dial["plain"], 0.0), *((dial["better"], each) for each in failures)))
    seeds = [seed for seed in sorted(plain) if all(seed in logs for logs in better)]
    if len(seeds) < data["least"]:
        return Exchange(rule, math.nan, 0.0, 1.0, failures[-1], len(seeds))
    gains = np.array([[plain[seed] - logs[seed] for logs in better] for seed in seeds])
    rng = np.random.default_rng(2019)
    drawn = gains[rng.integers(len(seeds), size=(RESAMPLES, len(seeds)))].mean(axis=1)
    crossings = [_find_crossing(row, failures) for row in drawn]
    low, high = np.quantile(crossings, [0.025, 0.975], method="nearest")
    return Exchange(rule, _find_crossing(gains.mean(axis=0), failures), float(low), float(high), failures[-1],
                    len(seeds))


def _find_crossing(gains: NDArray[np.float64], failures: Sequence[float]) -> float:
    """Share where gains, made falling, reach 0: 0 where there is none, 1 where it is beyond the largest."""
    falling = np.minimum.accumulate(gains)
    if falling[0] <= 0:
        return 0.0
    below = np.flatnonzero(falling <= 0)
    if not len(below):
        return 1.0
    after = int(below[0])
    tries = -np.log1p(-np.array(failures))
    share = falling[after - 1] / (falling[after - 1] - falling[after])
    return float(-np.expm1(-(tries[after - 1] + share * (tries[after] - tries[after - 1]))))
