"""Answers to the registered questions: ratios room by room, growth, the exchange rate, and the abstract by rule."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]
from studies.price.words import tell_number

from hrl_escape.benchmark.inference import ALPHA, LEVEL, correct_by_holm
from hrl_escape.names import count_nouns, join_words
from studies.price.ratios import Middle, find_middle
from studies.statistics import choose_holm_levels, find_visible_difference, find_visible_shift

__all__ = ["Answer", "Exchange", "Law", "PartsRun", "answer", "choose_slope", "compute_power", "find_exchange",
           "find_reach", "fit_law", "is_given_up", "tell_abstract", "tell_again", "tell_bar", "tell_finding",
           "tell_law", "tell_ratio"]

RESAMPLES = 2_000
LEAST_SIZES = 3
SURE = 0.95
"""Share of resamples in which one law must fit better than the other to be told."""
Logs = dict[tuple[int, int], float]
"""Logarithm of a number by (buttons, seed)."""


@dataclasses.dataclass(frozen=True)
class PartsRun:
    """A run until its first escape, and near the best where that is waited for.

    Attributes:
        cell: what the agent has.
        rule: for presses whose parents are not lit.
        buttons: of the room.
        seed: of room and agent.
        failure: probability that a walk fails.
        first_escape: primitives at its end; None if none came within the budget.
        near_best: primitives from which on the frozen policy needs no more than the fewest / 0.9, twice in a row; None
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

    @property
    def place(self) -> tuple[str, str, int, int, float]:
        """Subject of the line."""
        return self.cell, self.rule, self.buttons, self.seed, self.failure


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
        rooms: in which one of the two escaped, or both.
        factor: geometric mean of the restricted primitives without it over those with it, above 1 where it pays.
        low: lower end of its interval, at the level of Holm's correction.
        high: upper end.
        p: two-sided, by flipped signs, corrected.
        slope: by how much it lowers the exponent, with its interval; None where too few sizes tell.
        visible: smallest factor that 80 % of such studies would have seen.
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
    visible: float = math.inf

    @property
    def verdict(self) -> str:
        """`pays`, `costs` or `open`."""
        return "open" if self.p >= ALPHA else "pays" if self.factor > 1 else "costs"

    @property
    def lowers_exponent(self) -> bool:
        """The exponent is shown to be lower with the part."""
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
    asked = [index for index, (one, _, _) in enumerate(found) if one.rooms >= data["least"]]
    p = [_find_middle(found[index][1]).p for index in asked]
    answers = [one._replace(slope=slope) for one, _, slope in found]
    for index, level, corrected in zip(asked, choose_holm_levels(p), correct_by_holm(p), strict=True):
        middle, gains = _find_middle(found[index][1], level), np.array(list(found[index][1].values()))
        answers[index] = answers[index]._replace(
            factor=middle.factor, low=middle.low, high=middle.high, p=corrected,
            visible=math.exp(find_visible_difference([gains], 1 - level)))
    return answers


def _list_logs(runs: Sequence[PartsRun], cell: str, rule: str, data: Mapping[str, Any], failure: float = 0.0) -> Logs:
    """Logarithms of restricted primitives of a cell in every room in which any cell was run; see `answer`."""
    own = [run for run in runs if (run.cell, run.rule, run.failure) == (cell, rule, failure)]
    logs = {(run.buttons, run.seed): math.log(min(run.first_escape or data["budget"], data["budget"])) for run in own}
    rooms = {(run.buttons, run.seed) for run in runs if run.rule == rule}
    given_up = {size: is_given_up(own, size, data["hopeless"]) for size in data["sizes"]}
    return logs | {room: math.log(data["budget"]) for room in rooms if room not in logs and given_up.get(room[0])}


def _find_middle(gains: Logs, level: float = LEVEL) -> Middle:
    return find_middle([(gain, gain) for gain in gains.values()], level)


def choose_slope(gains: Logs, with_it: Logs, without: Logs, limit: float, level: float
                 ) -> tuple[float, float, float] | None:
    """Slope of the gain against the logarithm of the buttons, with its interval by resampled rooms.

    Only sizes count in which half of the runs of both cells escape; None where these are fewer than `LEAST_SIZES`.
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


def compute_power(spread: float, rooms: int, tests: int) -> float:
    """Smallest factor that 80 % of studies see with so many rooms, by simulation.

    Args:
        spread: standard deviation of the logarithm of the ratio between rooms.
        rooms: that tell.
        tests: of the family; the level is that of the first step of Holm's.
    """
    normal = spread * stats.norm.ppf((np.arange(rooms) + 0.5) / rooms)
    return math.exp(find_visible_shift(normal, ALPHA / tests, draws=100))


# --- growth ----------------------------------------------------------------------------------


class Law(NamedTuple):
    """Growth of a cell's primitives to the first escape with the number of buttons, c n^k.

    Attributes:
        exponent: k.
        low: lower end of its 95 % interval.
        high: upper end.
        constant: c.
        constant_low: lower end of its interval.
        constant_high: upper end.
        power: share of resamples in which a power law fits better than an exponential.
        sizes: numbers of buttons with which half of the runs escape.
        medians: of the primitives, at these.
        band: (2, sizes), the interval of the law at these.
    """

    exponent: float
    low: float
    high: float
    constant: float
    constant_low: float
    constant_high: float
    power: float
    sizes: tuple[int, ...]
    medians: tuple[float, ...]
    band: NDArray[np.float64]


def fit_law(runs: Sequence[PartsRun]) -> Law | None:
    """Fit a cell's medians by least squares of logarithms, its runs resampled within each size.

    Returns:
        None with fewer than `LEAST_SIZES` numbers of buttons with which half of the runs escape.
    """
    times = {size: np.array([run.first_escape or math.inf for run in runs if run.buttons == size], float)
             for size in sorted({run.buttons for run in runs})}
    times = {size: own for size, own in times.items() if np.isfinite(np.median(own))}
    if len(times) < LEAST_SIZES:
        return None
    rng = np.random.default_rng(2019)
    first = [np.median(own) for own in times.values()]
    drawn = [np.median(rng.choice(own, (RESAMPLES, len(own))), axis=1) for own in times.values()]
    rows = np.log(np.vstack([first, np.stack(drawn, axis=1)]))
    rows = rows[np.isfinite(rows).all(axis=1)]
    sizes = np.array(list(times), float)
    (slopes, starts, errors), (_, _, others) = _fit(np.log(sizes), rows), _fit(sizes, rows)
    (low, high), (least, most) = (np.quantile(values[1:], [0.025, 0.975]) for values in (slopes, np.exp(starts)))
    band = np.quantile(np.exp(starts[1:, None] + slopes[1:, None] * np.log(sizes)), [0.025, 0.975], axis=0)
    return Law(float(slopes[0]), float(low), float(high), float(np.exp(starts[0])), float(least), float(most),
               float(np.mean(errors[1:] < others[1:])), tuple(times), tuple(map(float, first)), band)


def _fit(x: NDArray[np.float64], rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Slopes, heights at 0 and squared errors of lines through rows (n, len(x))."""
    design = np.stack([x, np.ones_like(x)], axis=1)
    found = np.linalg.lstsq(design, rows.T, rcond=None)[0]
    return found[0], found[1], ((design @ found - rows.T) ** 2).sum(axis=0)


def tell_law(law: Law | None) -> str:
    """Words on which law fits."""
    if law is None:
        return "too few sizes"
    if law.power >= SURE:
        return "power law"
    return "exponential" if law.power <= 1 - SURE else "not told apart"


# --- exchange rate ---------------------------------------------------------------------------


class Exchange(NamedTuple):
    """Share of failing walks at which a better manager needs what a plain one needs whose walks never fail.

    Attributes:
        rule: for violations.
        failure: the share; `nan` where too few rooms tell.
        low: lower end of its 95 % interval, by resampled rooms.
        high: upper end.
        most: largest share that was tried.
        rooms: that tell.
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
    """Share at which gains, made falling, reach 0: 0 where there is none, 1 where it is beyond the largest."""
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


# --- words -----------------------------------------------------------------------------------


def tell_finding(answers: Sequence[Answer]) -> str:
    """The finding in one breath: which parts pay, the largest factor first, and which are not shown to."""
    best: dict[str, float] = {}
    for one in answers:
        if one.part in PARTS:
            best.setdefault(one.part, 0.0)
            if one.verdict == "pays":
                best[one.part] = max(best[one.part], one.factor)
    paying = sorted((part for part in best if best[part]), key=lambda part: -best[part])
    idle = [part for part in PARTS if part in best and not best[part]]
    if not paying:
        return f"No part of a hierarchy is shown to pay: neither {', nor '.join(idle)}."
    first, *rest = paying
    told = [f"{first} (up to {tell_ratio(best[first])} times fewer primitives)",
            *(f"{part} ({tell_ratio(best[part])})" for part in rest)]
    return f"What pays is {join_words(told)}" + (
        f"; {join_words(idle)} {'is' if len(idle) == 1 else 'are'} not shown to." if idle else ".")


def tell_bar(answers: Sequence[Answer], runs: Sequence[PartsRun]) -> str:
    """The learner with all parts beside the best searcher, rule by rule, and who comes further where one does."""
    told = []
    for one in (one for one in answers if one.part == "learning"):
        words = (f"needs on average {tell_ratio(1 / one.factor)} times the primitives" if one.verdict == "costs" else
                 f"needs on average {tell_ratio(one.factor)} times fewer primitives" if one.verdict == "pays" else
                 "is not shown to need more or fewer")
        own, other = (find_reach(runs, cell, one.rule) for cell in (one.more, one.less))
        further = ("" if own == other else f", where half of its runs escape with up to {own} buttons and half of the "
                   f"searcher's with up to {other}")
        told.append(f"{words} under `{one.rule}`{further}")
    return f"Beside a searcher that learns nothing, the learner with all of these {', and '.join(told)}."


def find_reach(runs: Sequence[PartsRun], cell: str, rule: str) -> int:
    """Most buttons with which half of a cell's runs or more escape; 0 for none."""
    ends: dict[int, list[bool]] = defaultdict(list)
    for run in runs:
        if (run.cell, run.rule, run.failure) == (cell, rule, 0):
            ends[run.buttons].append(run.first_escape is not None)
    return max((size for size, found in ends.items() if 2 * sum(found) >= len(found)), default=0)


def tell_again(answers: Sequence[Answer], again: Sequence[Answer]) -> str:
    """Words on how many verdicts fresh rooms give again, and how many of the exponents that a part lowers.

    Args:
        answers: of the first rooms.
        again: of the fresh ones, in the same order.
    """
    both = list(zip(answers, again, strict=True))
    agree = sum(one.verdict == other.verdict for one, other in both)
    lower = [one for one in answers if one.part in PARTS and one.lowers_exponent]
    kept = count_kept(answers, again)
    new = [other for one, other in both if one.part in PARTS and other.lowers_exponent and not one.lowers_exponent]
    said = f"{agree} of {len(both)} answers are the same"
    if not lower and not new:
        return f"{said}."
    said += (f". Of {count_nouns(len(lower), 'exponent')} that a part lowered in the first rooms, "
             f"{kept or 'none'} {'is' if kept < 2 else 'are'} lowered again" if lower else
             ". In the first rooms no part lowered an exponent")
    return f"{said}{f'; here {_name_parts(new)} lowers it, which did not there' if new else ''}."


def count_kept(answers: Sequence[Answer], again: Sequence[Answer]) -> int:
    """Exponents that a part lowers in the first rooms and in the fresh ones."""
    return sum(one.lowers_exponent and other.lowers_exponent for one, other in zip(answers, again, strict=True)
               if one.part in PARTS)


def tell_ratio(value: float) -> str:
    """A ratio in words, with two decimals near 1."""
    return f"{value:.2f}" if 0.8 < value < 1.25 else tell_number(value)


PARTS = ("commitment", "geometry", "memory", "structure")


def tell_abstract(answers: Sequence[Answer], laws: Mapping[tuple[str, str], Law | None],
                  exchanges: Sequence[Exchange], runs: Sequence[PartsRun], data: Mapping[str, Any],
                  again: Sequence[Answer] = ()) -> list[str]:
    """Eight sentences, each by rule from the data; with answers of fresh rooms that on growth says if they agree."""
    cells = [cell["name"] for cell in data["cells"] if "reference" not in cell]
    seeds = len({run.seed for run in runs})
    of = defaultdict(list)
    for one in answers:
        of[one.part].append(one)
    return [
        f"Which part of a hierarchy pays is asked of one learner with {len(cells)} sets of parts in rooms of "
        f"{data['sizes'][0]} to {data['sizes'][-1]} buttons, {seeds} rooms a size, under two rules for a wrong press, "
        f"by the primitives until its first escape, {len(runs):,} runs in all.",
        tell_finding(answers),
        "Commitment, a primitive repeated for random lengths, " + _tell_verdicts(of["commitment"]) + ".",
        "Geometry, planned walks in place of committed primitives, " + _tell_verdicts(of["geometry"]) + ".",
        "Memory of what failed " + "; ".join(
            f"{words} {_tell_verdicts(chosen)}" for words, chosen in (
                ("in a flat learner", [one for one in of["memory"] if one.less == "flat"]),
                ("over options", [one for one in of["memory"] if one.less != "flat"]),
                ("beside structure", of["memory beside structure"]))) + ".",
        "Structure, a learned model of which press enables which, " + "; ".join(
            f"{words} {_tell_verdicts(chosen)}" for words, chosen in (
                ("over learned walks", [one for one in of["structure"] if one.less == "learned walks"]),
                ("over options", [one for one in of["structure"] if one.less != "learned walks"]))) + ".",
        _tell_growth(answers, laws, again),
        _tell_searchers(of["learning"], exchanges),
    ]


def _tell_verdicts(answers: Sequence[Answer]) -> str:
    """Words such as `saves a factor of 12 (8 to 20) under ignore and 2 (1.5 to 3) under reset`."""
    told, last = [], ""
    for one in answers:
        verb = {"open": "is not shown to matter", "pays": "saves a factor of",
                "costs": "costs a factor of"}[one.verdict]
        if math.isnan(one.factor):
            verb, words = "is not told", "too few rooms were escaped from"
        elif one.verdict == "open":
            words = f"{tell_ratio(one.low)} to {tell_ratio(one.high)}"
        else:
            low, middle, high = sorted((value if one.verdict == "pays" else 1 / value)
                                       for value in (one.low, one.factor, one.high))
            words = f"{tell_ratio(middle)} ({tell_ratio(low)} to {tell_ratio(high)})"
        words = words if words.endswith(")") else f"({words})"
        told.append(f"{'' if verb == last else f'{verb} '}{words} under `{one.rule}`")
        last = verb
    return " and ".join(told)


def _tell_growth(answers: Sequence[Answer], laws: Mapping[tuple[str, str], Law | None], again: Sequence[Answer]
                 ) -> str:
    """One sentence: which part changes the exponent, which only the constant, and what law is told."""
    asked = [one for one in answers if one.part in PARTS]
    lower = _name_parts([one for one in asked if one.lowers_exponent])
    only = _name_parts([one for one in asked if one.verdict == "pays" and not one.lowers_exponent
                        and one.slope is not None])
    untold = _name_parts([one for one in asked if one.verdict == "pays" and one.slope is None])
    known = [law for law in laws.values() if law is not None]
    power, steep = (sum(tell_law(law) == words for law in known) for words in ("power law", "exponential"))
    fresh = f", {count_kept(answers, again) or 'none'} of these again in fresh rooms" if again else ""
    parts = [f"the exponent is lowered by {lower}{fresh}" if lower else "no part is shown to lower the exponent"]
    if only:
        parts.append(f"only the constant is shown to fall with {only}")
    if untold:
        parts.append(f"too few sizes tell of {untold}")
    return (f"With the number of buttons, {'; '.join(parts)}; of {len(known)} growths {power} "
            f"{'is' if power == 1 else 'are'} best described by a power law and {steep} by an exponential.")


def _name_parts(answers: Sequence[Answer]) -> str:
    """Words such as `structure over options (ignore, reset)`."""
    rules: dict[str, list[str]] = defaultdict(list)
    for one in answers:
        over = "" if one.part in ("commitment", "geometry") else f" over {one.less}"
        rules[one.part + over].append(f"`{one.rule}`")
    return join_words([f"{name} ({', '.join(own)})" for name, own in rules.items()])


def _tell_searchers(answers: Sequence[Answer], exchanges: Sequence[Exchange]) -> str:
    """One sentence: the learner with all parts beside the best searcher, and the exchange rate."""
    beside = " and ".join(
        (f"needs {tell_ratio(one.factor)} times fewer primitives than {one.less}" if one.verdict == "pays" else
         f"needs {tell_ratio(1 / one.factor)} times the primitives of {one.less}" if one.verdict == "costs" else
         f"is not shown to need more or fewer primitives than {one.less}") + f" under `{one.rule}`" for one in answers)
    rates = " and ".join(f"{_tell_exchange(one)} under `{one.rule}`" for one in exchanges)
    return (f"Beside searchers that learn nothing, the learner with all parts {beside}; memory and structure together "
            f"make up for {rates}.")


def _tell_exchange(one: Exchange) -> str:
    if math.isnan(one.failure):
        return "walks that fail an unknown share of the time"
    if one.failure == 0:
        return "no failing walks"
    if one.failure == 1:
        return f"walks that fail more than {one.most:.0%} of the time"
    most = "more" if one.high == 1 else f"{one.high:.0%}"
    return f"walks that fail {one.failure:.0%} of the time ({one.low:.0%} to {most})"
