"""Crossover by size: primitives to the first escape of the learner with all parts and of search with memory.

Ratios are of pairs in the same room. Their logarithms are normal with censoring (Tobin 1958): a run without an escape
within the budget took longer than the budget. Intervals are from the profile of the likelihood.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.agents.spec import SEARCH_MEMORY
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError
from studies.buttons.analysis import find_first_escape
from studies.figures import Theme, make_figure, mark_counts, write_label
from studies.parts.analysis import make_config
from studies.parts.answers import PartsRun
from studies.running import StudyArgs, make_missing
from studies.store import Line, Store
from studies.study import Findings, Study, find_study
from studies.tables import make_table

__all__ = ["LINES", "Args", "Ratio", "SearchRun", "analyse", "estimate_ratio", "list_jobs", "measure"]

FLOOR = math.log(0.02)
"""Logarithm of the smallest spread, which keeps the likelihood finite for equal ratios."""
MEANS, SPREADS = 801, 80
"""Points of the grid of the likelihood."""


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    minutes: float | None = None
    """Begin no run after so long; the same command continues."""


@dataclasses.dataclass(frozen=True)
class SearchRun(Line):
    """A run of search with memory until its first escape.

    Attributes:
        rule: effect of a press with unmet parents.
        buttons: number of buttons.
        seed: of room and episodes.
        budget: most primitives.
        first_escape: primitives at its end, or None if the budget ended first.
    """

    rule: str
    buttons: int
    seed: int
    budget: int
    first_escape: int | None

    PLACE = ("rule", "buttons", "seed")


LINES = (SearchRun,)


def list_jobs(data: Mapping[str, Any]) -> Iterator[SearchRun]:
    """Lines without results, from small rooms to large, in the rooms of the first and of the confirmation slice."""
    for size in data["sizes"]:
        for own in data["slices"].values():
            for seed in range(own["first_seed"], own["first_seed"] + own["runs"]):
                for rule in data["rules"]:
                    yield SearchRun(rule, size, seed, data["budget"], None)


def measure(study: Study, args: Args, store: Store) -> None:
    """Run what is missing, until the time is up."""
    data = find_study(study.data["parts"]).data

    def run(job: SearchRun) -> SearchRun:
        room = generate(make_config(data["room"], job.buttons, job.rule), job.seed)
        return dataclasses.replace(job, first_escape=find_first_escape(SEARCH_MEMORY, room, job.seed, job.budget))

    make_missing(list_jobs(data), run, store, args.minutes)


class Ratio(NamedTuple):
    """Ratio of primitives to the first escape, search over learner: below 1, search is faster.

    Attributes:
        value: median ratio; 0 or infinite where every pair is censored on one side.
        low: lower end of its interval.
        high: upper end.
        rooms: pairs.
        search: runs of search that escaped.
        learner: runs of the learner that escaped.
    """

    value: float
    low: float
    high: float
    rooms: int
    search: int
    learner: int


def estimate_ratio(search: Sequence[float | None], learner: Sequence[float | None], budget: float,
                   level: float = 0.95) -> Ratio:
    """Estimate the median ratio of pairs of first escapes, where None is longer than the budget.

    Pairs without any escape carry no information. Ends are 0 or infinite where the likelihood has no maximum.
    """
    pairs = [(one or budget, one is not None, other or budget, other is not None)
             for one, other in zip(search, learner, strict=True) if one is not None or other is not None]
    counts = len(search), sum(each is not None for each in search), sum(each is not None for each in learner)
    if not pairs:
        return Ratio(math.nan, 0.0, math.inf, *counts)
    logs = np.array([math.log(one / other) for one, _, other, _ in pairs])
    side = np.array([0 if first and second else 1 if second else -1 for _, first, _, second in pairs])

    means = np.linspace(logs.min() - 4, logs.max() + 4, MEANS)
    spreads = np.geomspace(math.exp(FLOOR), 10.0, SPREADS)[:, None]
    losses = np.full((SPREADS, MEANS), 0.0)
    for log, own in zip(logs, side, strict=True):
        standard = (log - means) / spreads
        losses -= (stats.norm.logpdf(standard) - np.log(spreads) if not own else
                   stats.norm.logsf(standard) if own > 0 else stats.norm.logcdf(standard))
    losses = losses.min(axis=0)  # the profile over spreads
    inside = np.flatnonzero(losses <= losses.min() + stats.chi2.ppf(level, 1) / 2)
    best = int(losses.argmin())
    ends = (0.0 if inside[0] == 0 else math.exp(means[inside[0]]),
            math.inf if inside[-1] == MEANS - 1 else math.exp(means[inside[-1]]))
    value = 0.0 if best == 0 else math.inf if best == MEANS - 1 else math.exp(means[best])
    return Ratio(value, *ends, *counts)


def analyse(study: Study, lines: Sequence[SearchRun]) -> Findings:
    """Ratios by number of buttons under each rule, in all rooms and in the rooms of each slice.

    Raises:
        ComparisonError: there are no runs.
    """
    if not lines:
        raise ComparisonError("there are no runs")
    parts = find_study(study.data["parts"])
    learned = {(run.rule, run.buttons, run.seed): run.first_escape
               for run in Store(parts.folder / "raw.jsonl", (PartsRun,)).load()
               if run.cell == study.data["learner"] and not run.failure}
    searched = {run.place: run.first_escape for run in lines}
    data, level = parts.data, study.data["level"]
    ratios: dict[str, dict[str, dict[int, Ratio]]] = {}
    for rule in data["rules"]:
        for name, seeds in _list_slices(data).items():
            for size in data["sizes"]:
                rooms = [(rule, size, seed) for seed in seeds
                         if (rule, size, seed) in searched and (rule, size, seed) in learned]
                if len(rooms) >= study.data["least"]:
                    ratios.setdefault(rule, {}).setdefault(name, {})[size] = estimate_ratio(
                        [searched[room] for room in rooms], [learned[room] for room in rooms], data["budget"], level)
    table = make_table(["rule", "rooms", *map(str, data["sizes"])], [
        [f"`{rule}`", name, *(_format(own.get(size)) for size in data["sizes"])]
        for rule, by_name in ratios.items() for name, own in by_name.items()])
    return Findings(SimpleNamespace(ratios=ratios, data=data), {"crossover": table},
                    {"crossover": lambda theme: draw(ratios, theme)})


def _list_slices(data: Mapping[str, Any]) -> dict[str, list[int]]:
    slices = {name: list(range(own["first_seed"], own["first_seed"] + own["runs"]))
              for name, own in data["slices"].items()}
    return {"all": sum(slices.values(), []), **slices}


def _format(ratio: Ratio | None) -> str:
    if ratio is None:
        return ""
    return (f"{_write(ratio.value)} ({_write(ratio.low)} to {_write(ratio.high)}); {ratio.search} and {ratio.learner} "
            f"of {ratio.rooms}")


def _write(value: float) -> str:
    return "∞" if math.isinf(value) else f"{value:.2g}"


def draw(ratios: Mapping[str, Mapping[str, Mapping[int, Ratio]]], theme: Theme) -> Figure:
    """Draw the ratio of all rooms against the number of buttons, a line for each rule."""
    def paint(axes: Any) -> None:
        axes.axhline(1, color=theme.muted, linewidth=0.8)
        for colour, (rule, by_name) in zip(theme.lines, ratios.items(), strict=False):
            own = {size: ratio for size, ratio in by_name["all"].items() if 0 < ratio.value < math.inf}
            middle = np.array([ratio.value for ratio in own.values()])
            low, high = (np.clip([getattr(ratio, end) for ratio in own.values()], middle / 10, middle * 10)
                         for end in ("low", "high"))
            axes.errorbar(list(own), middle, (middle - low, high - middle), color=colour, marker="o", capsize=3)
            write_label(axes, list(own)[-1], middle[-1], f" {rule}", colour)
        axes.set(xlabel="buttons", ylabel="primitives of search / of the learner", yscale="log")
        mark_counts(axes.yaxis)

    return make_figure(theme, paint)
