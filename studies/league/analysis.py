"""The league of flat learners: settings chosen by equal trials, then who gets where at which price.

A run ends as soon as it is efficient, since what is asked is the price. `dqn` and hindsight have their runs from the
price of flatness, which are such runs in the same rooms.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeAlias

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from hrl_escape.benchmark.inference import ALPHA
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.env.pictures import palette
from hrl_escape.errors import ComparisonError
from hrl_escape.names import count_nouns, join_words
from hrl_escape.settings import read_record
from studies.buttons.analysis import find_first_escape
from studies.figures import FIGURE_STYLE, finish_axes
from studies.flat import (
    FlatArgs,
    FlatJob,
    FlatLearner,
    FlatRun,
    count_untrained,
    list_learners,
    measure_flat_runs,
)
from studies.page import make_table
from studies.price.contestants import CONTESTANTS, sample_replicate_room
from studies.price.ratios import COSTS, CostRatio, correct_prices, find_middle
from studies.price.runs import PriceRun
from studies.price.words import tell_factor, tell_number
from studies.running import open_store
from studies.statistics import compute_median_interval
from studies.store import Store
from studies.study import Page, Study, find_study

__all__ = ["LINES", "Args", "Attempt", "SearcherRun", "advise", "analyse", "choose_candidate", "choose_course",
           "find_longer", "measure", "read_flat", "read_price", "tell_arrivals", "tell_cheapest", "tell_longer",
           "tell_privileged", "tell_quickest", "tell_searcher", "tell_untrained"]

FIELDS = {field.name for field in dataclasses.fields(FlatLearner)}
ESCAPE = 0.0
"""The level that the first escape stands for, among efficiencies."""
Course: TypeAlias = Literal["whole", "first escape", "none", "later"]
"""Extent to which a learner is followed with some number of buttons."""


@dataclasses.dataclass(frozen=True)
class Args(FlatArgs):
    """Options of the league."""

    sizes: tuple[int, ...] = ()
    """Numbers of buttons; those of `study.toml` by default."""
    trials: bool = False
    """Run the trials of all candidate settings instead of the league; it takes its settings from them."""
    longer: bool = False
    """Run learners ten times as long instead of the league, once that is whole for them."""


@dataclasses.dataclass(frozen=True)
class SearcherRun:
    """First escape of the searcher that learns nothing.

    Attributes:
        searcher: name.
        buttons: of the room.
        seed: chooses the room.
        escaped_at: primitives at its end; None if it took more than the league's budget.
    """

    searcher: str
    buttons: int
    seed: int
    escaped_at: int | None

    @property
    def place(self) -> tuple[str, int, int]:
        """Subject of the line."""
        return self.searcher, self.buttons, self.seed


LINES = (FlatRun, SearcherRun)


# --- runs ------------------------------------------------------------------------------------


def measure(study: Study, args: Args, store: Store) -> None:
    """Make trials, or the runs of the league that are missing, size by size.

    Raises:
        ComparisonError: a learner's trials were not made.
    """
    data, plan = study.data, study.data["trials"]
    if args.trials:
        measure_flat_runs(store, [
            FlatJob(candidate, sample_replicate_room(plan["buttons"], seed), seed, plan["budget"], plan["eval_every"])
            for seed in plan["seeds"] for learner in list_learners(study, args)
            for candidate in list_candidates(study, learner.label)], args.minutes)
        return
    end = math.inf if args.minutes is None else time.monotonic() + 60 * args.minutes
    seeds = range(args.first_seed, args.first_seed + (args.runs or data["runs"]))
    if args.longer:
        measure_flat_runs(store, [
            FlatJob(choose_candidate(study, store.load(), label), sample_replicate_room(size, seed), seed,
                    data["longer"]["budget"], data["longer"]["eval_every"], data["efficient"][-1])
            for label, size in find_longer(study, gather(study, store.load())).items()
            if not args.agents or label in args.agents for seed in seeds], args.minutes)
        return
    chosen = [choose_candidate(study, store.load(), learner.label) for learner in list_learners(study, args)]
    for size in args.sizes or data["sizes"]:
        rooms = {seed: sample_replicate_room(size, seed) for seed in seeds}
        known = {line.place for line in store.load()}
        store.add(SearcherRun(data["searcher"], size, seed,
                              find_first_escape(data["searcher"], room, seed, data["budget"]))
                  for seed, room in rooms.items() if (data["searcher"], size, seed) not in known)
        courses: dict[str, Course] = {}
        for learner in chosen:
            if find_source(study, learner) is None:
                own = list_own(study, store.load(), learner.label)
                courses[learner.label] = choose_course(data, [read_flat(run, data["efficient"]) for run in own], size)
                if courses[learner.label] != "whole":
                    print(f"{learner.label}, {count_nouns(size, 'button')}: {courses[learner.label]}")
        measure_flat_runs(store, [
            FlatJob(learner, room, seed, data["budget"], data["eval_every"],
                    data["efficient"][-1] if courses[learner.label] == "whole" else ESCAPE)
            for seed, room in rooms.items() for learner in chosen
            if courses.get(learner.label) in ("whole", "first escape")],
            None if math.isinf(end) else max(0.0, end - time.monotonic()) / 60)


def list_own(study: Study, lines: Sequence[Any], label: str, budget: int | None = None) -> list[FlatRun]:
    """Runs of a learner with a budget, by default that of the league."""
    return [run for run in lines if isinstance(run, FlatRun) and run.agent == label
            and run.budget == (budget or study.data["budget"])]


def find_longer(study: Study, cells: Cells) -> dict[str, int]:
    """Learners that are run longer, and the fewest buttons with which less than half of their runs are efficient."""
    data, level = study.data, study.data["efficient"][-1]
    short = {label: [size for size in data["sizes"] if len(runs := cells.get((label, size), ())) >= data["runs"]
                     and 2 * count_arrived(runs, level) < len(runs)] for label in data["longer"]["agents"]}
    return {label: sizes[0] for label, sizes in short.items() if sizes}


def list_candidates(study: Study, label: str) -> Iterator[FlatLearner]:
    """Candidates of a learner, labelled by their number."""
    (table,) = (table for table in study.data["learners"] if table["label"] == label)
    for number, candidate in enumerate(table["candidates"], 1):
        yield read_record(FlatLearner, {name: table[name] for name in table.keys() & FIELDS} |
                          {"label": f"{label} / {number}", "settings": table["settings"] | candidate})


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
            raise ComparisonError(f"{candidate.label} has {made}: run {study.command} --trials")
        late = [share for run in own for share in run.escapes[-2:] if share is not None]
        return (-float(np.mean([run.efficiency for run in own])), -float(np.mean(late or [0.0])),
                float(np.mean([run.first_escape or run.budget for run in own])))

    return dataclasses.replace(min(list_candidates(study, label), key=rate), label=label)


def find_source(study: Study, learner: FlatLearner) -> str | None:
    """Label in the price of flatness of the runs that are a learner's with its chosen settings; None without such."""
    (table,) = (table for table in study.data["learners"] if table["label"] == learner.label)
    return next((contestant.label for contestant in CONTESTANTS if contestant.label == table.get("price")
                 and (contestant.agent, contestant.settings) == (learner.agent, learner.settings)), None)


# --- what a run tells ------------------------------------------------------------------------


class Attempt(NamedTuple):
    """A run as the league reads it.

    Attributes:
        agent: label.
        buttons: of the room.
        seed: chooses the room.
        fewest: primitives of the best known escape.
        spent: primitives that it trained for.
        waits: level -> primitives until it was reached, and True; what was spent without it, and False; `ESCAPE` is
            the first escape, other levels are efficiencies at two evaluations in a row. Levels that the line does not
            tell are missing.
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
    costs = {cost.name: cost for cost in COSTS}
    names = {ESCAPE: "primitives to the first escape", levels[-1]: "primitives to efficiency",
             **{level: f"primitives to an efficiency of {level:g}" for level in levels[:-1]}}
    return Attempt(label, run.buttons, run.replicate, run.fewest, run.primitives, {
        level: wait for level, name in names.items() if (wait := costs[name].read(run)) is not None})


def choose_course(data: Mapping[str, Any], own: Sequence[Attempt], size: int) -> Course:
    """Extent to which a learner is followed, by its runs with the next smaller number of buttons.

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


# --- sentences -------------------------------------------------------------------------------


def is_followed(runs: Sequence[Attempt], level: float, budget: int) -> bool:
    """True if `LEAST_RUNS` runs or more tell of a level, and none ended short of the budget without it."""
    waits = [run.waits[level] for run in runs if level in run.waits]
    return len(waits) >= LEAST_RUNS and all(arrived or spent >= budget for spent, arrived in waits)


def list_arrived(cells: Cells, size: int, level: float) -> dict[str, int]:
    """Learners at least half of whose runs reached a level, and in how many they did, the quickest by median first."""
    found = {label: runs for (label, buttons), runs in cells.items() if buttons == size and len(runs) >= LEAST_RUNS
             and 2 * count_arrived(runs, level) >= len(runs)}
    return {label: count_arrived(runs, level) for label, runs in
            sorted(found.items(), key=lambda item: list_times(item[1], level)[len(item[1]) // 2])}


def count_arrived(runs: Sequence[Attempt], level: float) -> int:
    """Runs that reached a level."""
    return sum(run.waits[level][1] for run in runs if level in run.waits)


def list_times(runs: Sequence[Attempt], level: float) -> list[float]:
    """Primitives until a level, ascending; infinite where it was not reached."""
    return sorted(run.waits[level][0] if run.waits[level][1] else math.inf for run in runs if level in run.waits)


def tell_arrivals(cells: Cells, sizes: Sequence[int], level: float, budget: int) -> str:
    """The finding: which learners are efficient in half of their runs or more, by number of buttons."""
    parts = []
    for size in sizes:
        asked = sum(buttons == size and len(runs) >= LEAST_RUNS for (_, buttons), runs in cells.items())
        arrived = [f"`{label}` in {count} of {len(cells[label, size])}"
                   for label, count in list_arrived(cells, size, level).items()]
        if asked:
            parts.append(f"with {count_nouns(size, 'button')} "
                         + (f"{len(arrived)} of {count_nouns(asked, 'learner')} ({join_words(arrived)})" if arrived else
                            f"none of {count_nouns(asked, 'learner')}"))
    if not parts:
        return f"Nothing is concluded, as no learner has {LEAST_RUNS} runs with any number of buttons."
    return f"Efficient in half of the runs or more within {budget:,} primitives: {'; '.join(parts)}."


def tell_cheapest(cells: Cells, sizes: Sequence[int], level: float) -> list[tuple[str, CostRatio, str]]:
    """By number of buttons the quickest to be efficient, its ratio to the next one, and that one's label."""
    found = []
    for size in sizes:
        arrived = list(list_arrived(cells, size, level))
        if len(arrived) > 1:
            first, second = arrived[:2]
            found.append((first, compare(cells[second, size], list_waits(cells[first, size], level), level), second))
    return found


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


def list_waits(runs: Sequence[Attempt], level: float) -> dict[tuple[int, int], tuple[float, bool]]:
    """Waits by buttons and seed."""
    return {(run.buttons, run.seed): run.waits[level] for run in runs if level in run.waits}


def tell_quickest(found: Sequence[tuple[str, CostRatio, str]]) -> str:
    """A sentence: who is efficient first, and whether that is shown; empty where nobody can be compared."""
    said: dict[str, list[str]] = {}
    for first, ratio, second in found:
        middle = ratio.middle
        by = "" if math.isinf(middle.high) else f" ({tell_number(middle.low)} to {tell_number(middle.high)})"
        words = (f"`{first}`, where `{second}` needs {tell_number(middle.factor)}{by} times as many"
                 if middle.p < ALPHA and middle.low > 1 else
                 f"`{first}` by its median, which is not shown to be quicker than `{second}`")
        said.setdefault(words, []).append(str(ratio.buttons))
    parts = [f"with {join_words(sizes)} button{'' if sizes == ['1'] else 's'} {words}" for words, sizes in said.items()]
    return f"Efficient after the fewest primitives: {'; '.join(parts)}." if parts else ""


def tell_privileged(cells: Cells, labels: Sequence[str], sizes: Sequence[int], level: float) -> str:
    """A sentence a learner that may do what no other may: in how many runs it is efficient."""
    told = []
    for label in labels:
        shares = [f"{count_arrived(runs, level)} of {len(runs)} with {count_nouns(size, 'button')}" for size in sizes
                  if (runs := cells.get((label, size), ()))]
        if shares:
            told.append(f"With a privilege that no other learner has, `{label}` is efficient in {join_words(shares)}.")
    return " ".join(told)


def tell_searcher(ratios: Mapping[str, CostRatio], searcher: str) -> str:
    """A sentence: who escapes later or sooner than the searcher, over all rooms that both were run in."""
    every = {label: ratio for label, ratio in ratios.items() if len(ratio.logs) >= LEAST_RUNS}
    shown = {label: ratio.middle for label, ratio in every.items() if ratio.middle.p < ALPHA}
    later, sooner = ([label for label, middle in shown.items() if is_on_side(middle)]
                     for is_on_side in (lambda middle: middle.low > 1, lambda middle: middle.high < 1))
    name = f"`{searcher}`, which chooses among planned options and learns nothing"
    if sooner:
        verb = "escapes" if len(sooner) == 1 else "escape"
        return f"Sooner than {name}, {verb} {join_words(f'`{label}`' for label in sooner)}."
    if not later:
        return f"No flat learner is shown to escape later or sooner than {name}." if every else ""
    rooms = max(len(every[label].logs) for label in later)
    least = min((label for label in later if len(every[label].logs) == rooms),
                key=lambda label: every[label].middle.factor)
    middle = every[least].middle
    who = ("Every flat learner escapes" if len(later) == len(every) else
           f"{len(later)} of {len(every)} flat learners escape")
    return (f"{who} later than {name}: the soonest, `{least}`, after {tell_number(middle.factor)} "
            f"({tell_number(middle.low)} to {tell_number(middle.high)}) times its primitives, over {rooms} rooms.")


def tell_untrained(cells: Cells, updates: Mapping[str, int]) -> str:
    """Sentences on learners half of whose first escapes or more come before their first update.

    Args:
        cells: all runs.
        updates: label -> primitives before its first update; 0 where that is soon.
    """
    told = []
    for label, update in updates.items():
        ends = [run.waits[ESCAPE][0] for (name, _), runs in cells.items() if name == label for run in runs
                if run.waits.get(ESCAPE, (0.0, False))[1]]
        early = sum(end <= update for end in ends)
        if ends and 2 * early >= len(ends):
            told.append(f"Of the {len(ends)} first escapes of `{label}` {early} come before its first update, after "
                        f"{update:,} primitives: they are those of an untrained policy.")
    return " ".join(told)


def tell_longer(before: Mapping[str, Sequence[Attempt]], after: Mapping[str, Sequence[Attempt]], level: float,
                budget: int) -> str:
    """A sentence: how many runs are efficient with more primitives, of learners that were not.

    Args:
        before: runs of each learner within the league's budget, with some number of buttons.
        after: runs in the same rooms with `budget`; too few of a learner are left out.
        level: efficiency.
        budget: primitives.
    """
    told = [f"`{label}` in {count_arrived(runs, level)} of {len(runs)} with "
            f"{count_nouns(runs[0].buttons, 'button')} ({count_arrived(before[label], level)} before)"
            for label, runs in after.items() if len(runs) >= LEAST_RUNS]
    return f"Within {budget:,} primitives, efficient are {join_words(told)}." if told else ""


def advise(cells: Cells, sizes: Sequence[int], levels: Sequence[float], budget: int) -> str:
    """Advice to a user, by how far flat learners got."""
    by_size = {size: list_arrived(cells, size, levels[-1]) for size in sizes
               if any(buttons == size for _, buttons in cells)}
    far = [size for size, arrived in by_size.items() if arrived]
    idle: dict[int, list[str]] = {}
    for (label, size), runs in sorted(cells.items()):
        if (len(runs) >= LEAST_RUNS and count_arrived(runs, ESCAPE) == len(runs)
                and is_followed(runs, levels[0], budget) and not count_arrived(runs, levels[0])):
            idle.setdefault(size, []).append(f"`{label}`")
    said = []
    if far:
        best = next(iter(by_size[far[-1]]))
        said.append(f"If you must learn over primitives, begin with `{best}`, the quickest to be efficient with "
                    f"{count_nouns(far[-1], 'button')}")
        if beyond := [size for size in by_size if size > far[-1]]:
            said[-1] += f"; with {count_nouns(beyond[0], 'button')} {budget:,} primitives were not enough, so give "
            said[-1] += "it options"
    elif by_size:
        said.append("Give a learner options before you give it a larger budget: none over primitives became efficient")
    if idle:
        who = join_words([f"{join_words(labels)} with {count_nouns(size, 'button')}"
                          for size, labels in sorted(idle.items())])
        said.append(f"An escape in training is not yet learning: {who} escaped in every run, and reached an efficiency "
                    f"of {levels[0]:g} in none within {budget:,} primitives")
    return " ".join(f"{sentence}." for sentence in said)


# --- page ------------------------------------------------------------------------------------


def gather(study: Study, lines: Sequence[Any]) -> dict[tuple[str, int], list[Attempt]]:
    """All runs by learner and number of buttons; those of learners whose trials are missing are left out."""
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


def analyse(study: Study, lines: Sequence[Any]) -> Page:
    """Sentences, tables and figure of the league's runs, and the record of the trials."""
    data = study.data
    sizes, budget, levels, searcher = data["sizes"], data["budget"], data["efficient"], data["searcher"]
    labels = [table["label"] for table in data["learners"]]
    privileged = [table["label"] for table in data["learners"] if table.get("privileged")]
    cells = gather(study, lines)
    plain = {place: runs for place, runs in cells.items() if place[0] not in privileged}
    searched = {(line.buttons, line.seed): (float(line.escaped_at or budget), line.escaped_at is not None)
                for line in lines if isinstance(line, SearcherRun) and line.searcher == searcher}
    followed = {label: own for label in labels if (own := [
        run for size in sizes if is_followed(cells.get((label, size), ()), ESCAPE, budget)
        for run in cells[label, size]])}
    ratios = {label: compare(own, searched, ESCAPE) for label, own in followed.items()}
    quickest = tell_cheapest(plain, sizes, levels[-1])
    (pooled, first), _ = correct_prices([list(ratios.values()), [ratio for _, ratio, _ in quickest]])
    ratios = dict(zip(ratios, pooled, strict=True))
    quickest = [(label, ratio, second) for (label, _, second), ratio in zip(quickest, first, strict=True)]
    chosen = {label: choose_candidate(study, lines, label) for label in dict.fromkeys(name for name, _ in cells)}
    headline = tell_arrivals(plain, sizes, levels[-1], budget)
    trials = [run for run in lines if isinstance(run, FlatRun) and run.agent not in labels]
    events = {ESCAPE: "the first escape", **{level: f"an efficiency of {level:g}" for level in levels}}
    longer = {label: (size, [read_flat(run, levels) for run in list_own(study, lines, label, data["longer"]["budget"])])
              for label, size in find_longer(study, cells).items()}
    sentences = list(filter(None, [
        tell_quickest(quickest), tell_privileged(cells, privileged, sizes, levels[-1]),
        tell_searcher({label: ratio for label, ratio in ratios.items() if label not in privileged}, searcher),
        tell_untrained(cells, {label: count_untrained(learner) for label, learner in chosen.items()}),
        tell_longer({label: cells[label, size] for label, (size, _) in longer.items()},
                    {label: runs for label, (_, runs) in longer.items()}, levels[-1], data["longer"]["budget"])]))
    return Page({
        "headline": headline, "sentences": sentences, "advice": advise(plain, sizes, levels, budget),
        "tables": [make_table([f"primitives to {event}", *(count_nouns(size, "button") for size in sizes)], [
            *([f"`{label}`", *(_describe(cells.get((label, size), ()), level, budget) for size in sizes)]
              for label in labels if any((label, size) in cells for size in sizes)),
            *([[f"`{searcher}`", *(_describe_times([at for (buttons, _), (at, _) in searched.items()
                                                    if buttons == size]) for size in sizes)]]
              if level == ESCAPE else []),
            *([["the planner", *(_describe_times(sorted(find_fewest(cells, size).values())) for size in sizes)]]
              if level == ESCAPE else [])]) for level, event in events.items()],
        "prices": make_table(["learner", "rooms", "all rooms", *(count_nouns(size, "button") for size in sizes)], [
            [f"`{label}`", len(ratios[label].logs), tell_factor(ratios[label].middle),
             *(tell_factor(compare(own, searched, ESCAPE).middle) if (own := [
                 run for run in followed[label] if run.buttons == size]) else "-" for size in sizes)]
            for label in followed]),
        "left": tell_left(study, cells), "budget": budget, "trials": make_table(
            ["candidate", "settings", "first escape, mean", "late episodes that escape", "efficiency at the end"],
            [_describe_trial(candidate, [run for run in trials if run.agent == candidate.label])
             for label in labels for candidate in list_candidates(study, label)
             if any(run.agent == candidate.label for run in trials)]),
        "count": len(trials), "seconds": sum(run.seconds for run in lines if isinstance(run, FlatRun)),
        "notes": {table["label"]: table["note"] for table in data["learners"] if "note" in table},
    }, {"league": draw(cells, searched, labels, searcher, sizes, budget, levels[-1])}, [headline, *sentences])


def tell_left(study: Study, cells: Cells) -> list[str]:
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
            found.setdefault(reason, []).append(f"`{label}` with {join_words(sizes, 'or')} {buttons}")
    return [f"{reason}: {join_words(names)}" for reason, names in found.items() if reason]


def find_fewest(cells: Cells, size: int) -> dict[int, float]:
    """Primitives of the best known escape, by room."""
    return {run.seed: run.fewest for (_, buttons), runs in cells.items() if buttons == size for run in runs}


def _describe(runs: Sequence[Attempt], level: float, budget: int) -> str:
    told = [run for run in runs if level in run.waits]
    if not told:
        return "not run" if not runs else "not told"
    if not is_followed(told, level, budget):
        most = max(spent for spent, arrived in (run.waits[level] for run in told) if not arrived) if any(
            not run.waits[level][1] for run in told) else 0
        return f"{count_arrived(told, level)} of {len(told)}" + (f" within {most:,.0f}" if most else "")
    share = f"{count_arrived(told, level)} of {len(told)}"
    return f"{share}; {_describe_times(list_times(told, level))}" if count_arrived(told, level) else share


def _describe_times(times: Sequence[float]) -> str:
    if not times:
        return "not run"
    return "{} ({} to {})".format(*("never" if math.isinf(end) else f"{end:,.0f}"
                                    for end in compute_median_interval(times)))


def _describe_trial(candidate: FlatLearner, runs: Sequence[FlatRun]) -> list[Any]:
    settings = ", ".join(f"{name} = {value}" for name, value in candidate.settings.items())
    late = [share for run in runs for share in run.escapes[-2:] if share is not None]
    return [candidate.label, settings, f"{np.mean([run.first_escape or run.budget for run in runs]):,.0f}",
            f"{np.mean(late):.0%}" if late else "", f"{np.mean([run.efficiency for run in runs]):.2f}"]


def draw(cells: Cells, searched: Mapping[tuple[int, int], tuple[float, bool]], labels: Sequence[str], searcher: str,
         sizes: Sequence[int], budget: int, level: float) -> Figure:
    """First escapes (dots) and efficiency (diamonds) of every run, above searcher and planner; a panel a size."""
    rows = [*labels, searcher, "planner"]
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(9.6, 1.2 + 0.42 * len(rows)), facecolor=palette.BACKGROUND, layout="constrained")
        for axes, size in zip(figure.subplots(1, len(sizes), sharey=True, squeeze=False)[0], sizes, strict=True):
            for at, label in enumerate(rows[::-1]):
                own = cells.get((label, size), ())
                known = {searcher: [at for (buttons, _), (at, out) in searched.items() if out and buttons == size],
                         "planner": list(find_fewest(cells, size).values())}.get(label)
                marks = [("o", 0.14, list_times(own, ESCAPE)), ("D", -0.14, list_times(own, level))]
                colour = palette.LINES[at % len(palette.LINES)] if label in labels else palette.INK
                for mark, shift, times in marks if known is None else [("|", 0.0, known)]:
                    shown = [time for time in times if math.isfinite(time)]
                    axes.plot(shown, [at + shift] * len(shown), mark, markersize=4.5 if known is None else 9, alpha=0.6,
                              markeredgewidth=0 if known is None else 1.2, color=colour)
                if known is None and not own:
                    axes.text(0.5, at, "not run", transform=axes.get_yaxis_transform(), color=palette.MUTED,
                              ha="center", va="center", fontsize=8)
            finish_axes(axes)
            axes.set_xscale("log")
            axes.set_xlim(10, 1.5 * budget)
            axes.axvline(budget, color=palette.MUTED, linestyle=":", linewidth=1)
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
            axes.set_yticks(range(len(rows)), rows[::-1])
            axes.set_title(count_nouns(size, "button"), fontsize=9, loc="left", color=palette.INK)
            axes.set_xlabel("primitives", color=palette.INK)
    return figure
