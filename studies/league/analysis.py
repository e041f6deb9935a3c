"""Flat learners with settings chosen by equal trials: primitives to the first escape and to efficient escapes.

A run ends as soon as it is efficient, since what is asked is the price. `dqn` and hindsight have their runs from the
price of flatness, which are such runs in the same rooms.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.errors import ComparisonError
from hrl_escape.names import count_nouns, join_words
from studies.figures import Theme, make_figure, mark_counts, write_label
from studies.flat import FlatLearner, FlatRun, read_learner
from studies.price.ratios import COSTS, CostRatio, correct_prices, find_middle
from studies.price.runs import CONTESTANTS, PriceRun
from studies.running import open_store
from studies.statistics import compute_median_interval
from studies.store import Line
from studies.study import Findings, Study, find_study
from studies.tables import make_table
from studies.titles import find_title

__all__ = ["LINES", "Attempt", "SearcherRun", "analyse", "choose_candidate", "choose_course", "compare",
           "find_longer", "list_candidates", "read_flat", "read_price"]

ESCAPE = 0.0
"""Level of the first escape, among efficiencies."""
Course: TypeAlias = Literal["whole", "first escape", "none", "later"]
"""Course of a learner with some number of buttons."""


@dataclasses.dataclass(frozen=True)
class SearcherRun(Line):
    """First escape of the search baseline.

    Attributes:
        searcher: name of the search baseline.
        buttons: of the room.
        seed: chooses the room.
        escaped_at: primitives at its end; None if it took more than the league's budget.
    """

    searcher: str
    buttons: int
    seed: int
    escaped_at: int | None

    PLACE = ("searcher", "buttons", "seed")


LINES = (FlatRun, SearcherRun)


# --- runs ------------------------------------------------------------------------------------


def list_own(study: Study, lines: Sequence[Any], label: str, budget: int | None = None) -> list[FlatRun]:
    """Runs of a learner with a budget, by default the budget of the league."""
    return [run for run in lines if isinstance(run, FlatRun) and run.agent == label
            and run.budget == (budget or study.data["budget"])]


def find_longer(study: Study, cells: Cells) -> dict[str, int]:
    """Learners that are run longer, and the fewest buttons where less than half of their runs are efficient."""
    data, level = study.data, study.data["efficient"][-1]
    short = {label: [size for size in data["sizes"] if len(runs := cells.get((label, size), ())) >= data["runs"]
                     and 2 * count_arrived(runs, level) < len(runs)] for label in data["longer"]["agents"]}
    return {label: sizes[0] for label, sizes in short.items() if sizes}


def list_candidates(study: Study, label: str) -> Iterator[FlatLearner]:
    """Candidates of a learner, labelled by their number."""
    (table,) = (table for table in study.data["learners"] if table["label"] == label)
    for number, candidate in enumerate(table["candidates"], 1):
        yield read_learner(table, label=f"{label} / {number}", settings=table["settings"] | candidate)


def choose_candidate(study: Study, lines: Sequence[Any], label: str) -> FlatLearner:
    """The candidate that was most efficient in the trials, under its own label.

    Of equals it is the one whose last training episodes escaped most often, then the one that escaped first.

    Raises:
        ComparisonError: a trial is missing.
    """
    def rate(candidate: FlatLearner) -> tuple[float, float, float]:
        own = [run for run in lines if isinstance(run, FlatRun) and run.agent == candidate.label]
        if len(own) < len(study.data["trials"]["seeds"]):
            made = count_nouns(len(own), "trial")
            raise ComparisonError(f"{candidate.label} has {made}")
        late = [share for run in own for share in run.escapes[-2:] if share is not None]
        return (-float(np.mean([run.efficiency for run in own])), -float(np.mean(late or [0.0])),
                float(np.mean([run.first_escape or run.budget for run in own])))

    return dataclasses.replace(min(list_candidates(study, label), key=rate), label=label)


def find_source(study: Study, learner: FlatLearner) -> str | None:
    """Label in the price of flatness of the runs that are a learner's with its chosen settings; None without such."""
    (table,) = (table for table in study.data["learners"] if table["label"] == learner.label)
    return next((own["label"] for own in CONTESTANTS if own["label"] == table.get("price")
                 and (own["agent"], own.get("settings", {})) == (learner.agent, learner.settings)), None)


# --- runs as attempts ------------------------------------------------------------------------


class Attempt(NamedTuple):
    """A run as the league reads it.

    Attributes:
        agent: label.
        buttons: of the room.
        seed: chooses the room.
        fewest: primitives of the best known escape.
        spent: primitives that it trained for.
        waits: level -> primitives until it was reached, and True; what was spent without it, and False; `ESCAPE` is
            the first escape, other levels are efficiencies at two evaluations in a row. Levels that the line lacks
            are missing.
    """

    agent: str
    buttons: int
    seed: int
    fewest: int
    spent: int
    waits: Mapping[float, tuple[float, bool]]


Cells: TypeAlias = Mapping[tuple[str, int], Sequence[Attempt]]
"""By label and number of buttons."""


def read_flat(run: FlatRun, levels: Sequence[float]) -> Attempt:
    """A run of the league."""
    waits = {ESCAPE: (run.spent, False) if run.first_escape is None else (run.first_escape, True)}
    for level in levels:
        at = run.find_threshold(level)
        waits[level] = (run.spent, False) if at is None else (max(at, run.fewest), True)
    return Attempt(run.agent, run.buttons, run.seed, run.fewest, run.spent, waits)


def read_price(run: PriceRun, label: str, levels: Sequence[float]) -> Attempt:
    """A run of the price of flatness, by another label."""
    costs = {cost.key: cost for cost in COSTS}
    keys = {ESCAPE: "escape", levels[0]: "half", levels[-1]: "efficient"}
    return Attempt(label, run.buttons, run.replicate, run.fewest, run.primitives, {
        level: wait for level, key in keys.items() if (wait := costs[key].read(run)) is not None})


def choose_course(data: Mapping[str, Any], own: Sequence[Attempt], size: int) -> Course:
    """Choose the course of a learner by its runs with the next smaller number of buttons.

    Who never escaped there is not run; who never reached the lower efficiency is followed to its first escape; while
    runs are missing there, nothing is begun.
    """
    smaller = [other for other in data["sizes"] if other < size]
    if not smaller:
        return "whole"
    before = [run for run in own if run.buttons == smaller[-1]]
    if len(before) < data["runs"]:
        return "none" if choose_course(data, own, smaller[-1]) == "none" else "later"
    if not any(run.waits[ESCAPE][1] for run in before):
        return "none"
    return "whole" if any(run.waits[data["efficient"][0]][1] for run in before) else "first escape"


# --- comparisons -----------------------------------------------------------------------------


def is_followed(runs: Sequence[Attempt], level: float, budget: int) -> bool:
    """True if `LEAST_RUNS` runs or more have a level, and none ended short of the budget without it."""
    waits = [run.waits[level] for run in runs if level in run.waits]
    return len(waits) >= LEAST_RUNS and all(arrived or spent >= budget for spent, arrived in waits)


def count_arrived(runs: Sequence[Attempt], level: float) -> int:
    """Runs that reached a level."""
    return sum(run.waits[level][1] for run in runs if level in run.waits)


def list_times(runs: Sequence[Attempt], level: float) -> list[float]:
    """Primitives until a level, ascending; infinite where it was not reached."""
    return sorted(run.waits[level][0] if run.waits[level][1] else math.inf for run in runs if level in run.waits)


def compare(runs: Sequence[Attempt], others: Mapping[tuple[int, int], tuple[float, bool]], level: float) -> CostRatio:
    """Ratios of what runs wait to what others do in the same rooms, with their middle.

    Args:
        runs: of one learner.
        others: (buttons, seed) -> primitives that another waits for the level, and whether it reached it.
        level: that is waited for.
    """
    logs = []
    for run in runs:
        if level in run.waits and (run.buttons, run.seed) in others:
            (low, high), (least, most) = ((math.log(max(spent, 1)), math.log(max(spent, 1)) if arrived else math.inf)
                                          for spent, arrived in (run.waits[level], others[run.buttons, run.seed]))
            logs.append((low - most, high - least))
    return CostRatio(runs[0].buttons, dict(enumerate(logs)), find_middle(logs))


# --- page ------------------------------------------------------------------------------------


def gather(study: Study, lines: Sequence[Any]) -> dict[tuple[str, int], list[Attempt]]:
    """All runs by learner and number of buttons, without learners whose trials are missing."""
    data, cells, price = study.data, {}, open_store(find_study("price"), None).load()
    for table in data["learners"]:
        label = table["label"]
        own = [read_flat(run, data["efficient"]) for run in list_own(study, lines, label)]
        try:
            source = find_source(study, choose_candidate(study, lines, label))
        except ComparisonError:
            continue
        if source is not None:
            own += [read_price(run, label, data["efficient"]) for run in price if run.agent == source]
        for size in data["sizes"]:
            if found := sorted((run for run in own if run.buttons == size and run.seed < data["runs"]),
                               key=lambda run: run.seed):
                cells[label, size] = found
    return cells


def analyse(study: Study, lines: Sequence[Any]) -> Findings:
    """Counts of efficient runs, first escapes against the search baseline as one family, tables and the figure."""
    data = study.data
    sizes, budget, levels, searcher = data["sizes"], data["budget"], data["efficient"], data["searcher"]
    labels = [table["label"] for table in data["learners"]]
    privileged = [table["label"] for table in data["learners"] if table.get("privileged")]
    cells = gather(study, lines)
    searched = {(line.buttons, line.seed): (float(line.escaped_at or budget), line.escaped_at is not None)
                for line in lines if isinstance(line, SearcherRun) and line.searcher == searcher}
    followed = {label: own for label in labels if (own := [
        run for size in sizes if is_followed(cells.get((label, size), ()), ESCAPE, budget)
        for run in cells[label, size]])}
    (pooled,) = correct_prices([[compare(own, searched, ESCAPE) for own in followed.values()]])
    ratios = dict(zip(followed, pooled, strict=True))
    trials = [run for run in lines if isinstance(run, FlatRun) and run.agent not in labels]
    longer = {label: [read_flat(run, levels) for run in list_own(study, lines, label, data["longer"]["budget"])]
              for label in find_longer(study, cells)}
    numbers = SimpleNamespace(
        minutes=sum(run.seconds for run in lines if isinstance(run, FlatRun)) / 60,
        efficient={place: (count_arrived(runs, levels[-1]), len(runs)) for place, runs in cells.items()
                   if place[0] not in privileged},
        searched={size: float(np.median([at for (buttons, _), (at, _) in searched.items() if buttons == size]))
                  for size in sizes if any(buttons == size for buttons, _ in searched)},
        later={label: ratio.middle for label, ratio in ratios.items() if label not in privileged},
        longer={label: (count_arrived(runs, levels[-1]), len(runs)) for label, runs in longer.items() if runs})
    buttons = [count_nouns(size, "button") for size in sizes]
    events = [("escape", ESCAPE, "the first escape"), *((key, level, f"an efficiency of {level:g}") for key, level in
              zip(("half", "efficient"), levels, strict=True))]
    return Findings(numbers, {
        **{f"league_{key}": make_table([f"primitives to {event}", *buttons], [
            *([find_title(label), *(_describe(cells.get((label, size), ()), level, budget) for size in sizes)]
              for label in labels if any((label, size) in cells for size in sizes)),
            *([[find_title(searcher), *(_describe_times([at for (buttons, _), (at, _) in searched.items()
                                                         if buttons == size]) for size in sizes)],
               ["best known plan", *(_describe_times(list({
                   run.seed: float(run.fewest) for (_, buttons), runs in cells.items() if buttons == size
                   for run in runs}.values())) for size in sizes)]]
              if level == ESCAPE else [])]) for key, level, event in events},
        "league_later": make_table(["learner", "rooms", "all rooms", *buttons], [
            [find_title(label), len(ratios[label].logs), ratios[label].middle,
             *(compare(own, searched, ESCAPE).middle if (own := [
                 run for run in followed[label] if run.buttons == size]) else "-" for size in sizes)]
            for label in followed]),
        "league_left": make_table(["not whole runs", "learners"], list_left(study, cells)),
        "league_learners": make_table(["learner", "label", "how it learns"], [
            [find_title(table["label"]), f"`{table['label']}`", table.get("note", "")] for table in data["learners"]]),
        "league_trials": make_table(
            ["candidate", "settings", "first escape, mean", "late episodes that escape", "efficiency at the end"],
            [_describe_trial(candidate, [run for run in trials if run.agent == candidate.label])
             for label in labels for candidate in list_candidates(study, label)
             if any(run.agent == candidate.label for run in trials)]),
    }, {"league": partial(draw, cells, searched, searcher, sizes, levels[-1])})


def list_left(study: Study, cells: Cells) -> list[list[str]]:
    """Cells that are not whole runs, by reason: by rule, of another study with less budget, or not made yet."""
    data, found = study.data, {}
    for table in data["learners"]:
        label = table["label"]
        own = [run for (name, _), runs in cells.items() if name == label for run in runs]
        reasons: dict[str, list[str]] = {}
        for size in data["sizes"]:
            runs = cells.get((label, size), ())
            course = choose_course(data, own, size) if "price" not in table else "whole"
            short = [run.spent for run in runs
                     if run.spent < data["budget"] and not run.waits[data["efficient"][-1]][1]]
            reason = ("not run, as no run escaped with fewer" if course == "none" else
                      f"{len(runs)} of {data['runs']} runs made" if len(runs) < data["runs"] else
                      f"followed to the first escape, as none reached {data['efficient'][0]:g} with fewer"
                      if course == "first escape" else
                      f"runs given up after {max(short):,} primitives" if short else "")
            reasons.setdefault(reason, []).append(str(size))
        for reason, sizes in reasons.items():
            buttons = "button" if sizes == ["1"] else "buttons"
            found.setdefault(reason, []).append(f"{find_title(label)} with {join_words(sizes, 'or')} {buttons}")
    return [[reason, "; ".join(names)] for reason, names in found.items() if reason]


def _describe(runs: Sequence[Attempt], level: float, budget: int) -> str:
    known = [run for run in runs if level in run.waits]
    if not known:
        return "not run" if not runs else "not recorded"
    share = f"{count_arrived(known, level)} of {len(known)}"
    if not is_followed(known, level, budget):
        most = max((spent for spent, arrived in (run.waits[level] for run in known) if not arrived), default=0)
        return share + (f" within {most:,.0f}" if most else "")
    return f"{share}; {_describe_times(list_times(known, level))}" if count_arrived(known, level) else share


def _describe_times(times: Sequence[float]) -> str:
    if not times:
        return "not run"
    return "{} ({} to {})".format(*("never" if math.isinf(end) else f"{end:,.0f}"
                                    for end in compute_median_interval(times)))


def _describe_trial(candidate: FlatLearner, runs: Sequence[FlatRun]) -> list[Any]:
    label, _, number = candidate.label.partition(" / ")
    settings = ", ".join(f"{name} = {value}" for name, value in candidate.settings.items())
    late = [share for run in runs for share in run.escapes[-2:] if share is not None]
    first = np.mean([run.first_escape or run.budget for run in runs])
    return [f"{find_title(label)}, {number}", settings, f"{first:,.0f}",
            f"{np.mean(late):.0%}" if late else "", f"{np.mean([run.efficiency for run in runs]):.2f}"]


def draw(cells: Cells, searched: Mapping[tuple[int, int], tuple[float, bool]], searcher: str, sizes: Sequence[int],
         level: float, theme: Theme) -> Figure:
    """First escapes (lines through circles) and efficient evaluations (diamonds) of every run, against buttons."""
    shown = {"dqn, patient": (theme.lines[2], 0.02, 1_100), "ppo, novelty": (theme.lines[3], 0.3, 2e6),
             "archive, moves": (theme.lines[1], 1.2, 9_000), searcher: (theme.lines[0], 0.75, 110)}

    def paint(axes: Axes) -> None:
        for number, (label, (colour, x, y)) in enumerate(shown.items()):
            medians = {}
            for place, size in enumerate(sizes):
                at = place + 0.1 * (number - 1.5)
                own = cells.get((label, size), ())
                escapes = list_times(own, ESCAPE) if label != searcher else sorted(
                    end for (buttons, _), (end, _) in searched.items() if buttons == size)
                for mark, fill, times in (("o", "none", escapes), ("D", colour, list_times(own, level))):
                    known = [time for time in times if math.isfinite(time)]
                    axes.plot([at] * len(known), known, mark, markersize=3.5, markerfacecolor=fill,
                              markeredgecolor=colour, markeredgewidth=0.8, alpha=0.7)
                if math.isfinite(middle := float(np.median(escapes))):
                    medians[at] = middle
            axes.plot(list(medians), list(medians.values()), color=colour, linewidth=2)
            write_label(axes, x, y, find_title(label), colour)
        axes.set(yscale="log", ylim=(10, 4e6), xlim=(-0.4, len(sizes) - 0.4), xlabel="buttons in the room",
                 ylabel="primitives")
        axes.set_xticks(range(len(sizes)), [str(size) for size in sizes])
        mark_counts(axes.yaxis)
        axes.yaxis.set_minor_locator(NullLocator())

    return make_figure(theme, paint, height=3.9)
