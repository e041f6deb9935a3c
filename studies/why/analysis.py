"""Parts of what options give a learner: exploration with them, credit of their lengths, planning, and all."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from hrl_escape.env.pictures import palette
from hrl_escape.errors import ComparisonError
from hrl_escape.names import count_nouns, join_words
from hrl_escape.settings import read_record
from studies.figures import FIGURE_STYLE
from studies.league.analysis import SearcherRun
from studies.page import make_table
from studies.price.contestants import Contestant
from studies.price.ratios import COSTS, CostRatio, compare_costs, correct_prices, measure_growth
from studies.price.runs import PriceRun, measure_price_runs
from studies.price.words import conclude_prices, tell_factor
from studies.running import StudyArgs, open_store
from studies.store import Store
from studies.study import Page, Study, find_study

__all__ = ["ESCAPE", "HALF", "LINES", "Args", "Pair", "advise", "analyse", "compare", "list_pairs",
           "list_families", "measure", "tell_headline", "tell_pairs", "tell_planning", "tell_rooms", "tell_searcher"]

LINES = (PriceRun,)
ESCAPE, HALF = COSTS[1], COSTS[3]
"""The two costs that are told: until the first escape, and until a greedy policy of half the efficiency."""
EXPLORES, REPEATS = "options explore", "repeats explore"
AHEAD, RANDOM_AHEAD = "options ahead", ("random ways ahead", "primitives ahead")
EVENTS = {ESCAPE.name: "its first escape", HALF.name: "a greedy policy of half the efficiency"}


@dataclasses.dataclass(frozen=True)
class Args(StudyArgs):
    """Options of the study."""

    runs: int = 10
    """Rooms of each size, each with a training seed of its own."""
    minutes: float | None = None
    """Minutes after which no further run is begun."""


class Pair(NamedTuple):
    """Two learners whose costs are compared, both by label."""

    one: str
    other: str


def read_learners(study: Study) -> tuple[Contestant, ...]:
    """Learners that the study runs."""
    fields = {field.name for field in dataclasses.fields(Contestant)}
    return tuple(read_record(Contestant, {name: value for name, value in learner.items() if name in fields})
                 for learner in study.data["learners"])


def measure(study: Study, args: Args, store: Store) -> None:
    """Make the runs that are missing."""
    for made in measure_price_runs(store, 0, args.runs, args.minutes, read_learners(study)):
        print(f"{made.agent}, {count_nouns(made.buttons, 'button')}, replicate {made.replicate}: first escape "
              f"{made.first_escape}, efficient at {made.efficient_at}, at last {made.efficiency:.2f}")


def list_families(study: Study) -> tuple[tuple[Pair, ...], ...]:
    """Questions: exploration by options, all beyond it, and where they lead; then planning, and along what."""
    flat, whole = study.data["flat"], study.data["whole"]
    return ((Pair(flat, EXPLORES), Pair(EXPLORES, whole), Pair(REPEATS, EXPLORES)),
            (Pair(flat, AHEAD), *(Pair(control, AHEAD) for control in RANDOM_AHEAD)))


def list_pairs(study: Study) -> tuple[Pair, ...]:
    """Pairs of the table: the questions, then the other parts and whole options with the flat learner."""
    asked = [pair for family in list_families(study) for pair in family]
    labels = [*(learner["label"] for learner in study.data["learners"]), study.data["whole"]]
    pairs = (Pair(study.data["flat"], label) for label in labels)
    return *asked, *(pair for pair in pairs if pair not in asked)


Found: TypeAlias = Mapping[tuple[Pair, str], Sequence[CostRatio]]
"""Ratios, a number of buttons each, by pair and cost."""


def compare(study: Study, runs: Sequence[PriceRun]) -> dict[tuple[Pair, str], list[CostRatio]]:
    """Ratios of all pairs and both costs, those of the questions corrected by family, by pair and cost."""
    own = {label: [run for run in runs if run.agent == label] for pair in list_pairs(study) for label in pair}
    found = {(pair, cost.name): compare_costs(own[pair.one], own[pair.other], cost)
             for pair in list_pairs(study) for cost in (ESCAPE, HALF)}
    for family in list_families(study):
        asked = [key for key in found if key[0] in family]
        own = [found[key] for key in asked]
        corrected, _ = correct_prices(own, [measure_growth(ratios) for ratios in own])  # as `conclude_prices` does
        found |= dict(zip(asked, corrected, strict=True))
    return found


def find_gains(found: Found, one: str, other: str, cost: str) -> set[int]:
    """Numbers of buttons with which one learner is shown to pay more than another."""
    return {ratio.buttons for ratio in found[Pair(one, other), cost] if ratio.middle.low > 1}


def find_losses(found: Found, one: str, other: str, cost: str) -> set[int]:
    """Numbers of buttons with which one learner is shown to pay less than another."""
    return {ratio.buttons for ratio in found[Pair(one, other), cost] if ratio.middle.high < 1}


def count_alike(found: Found, pair: Pair, cost: str) -> tuple[int, int]:
    """Rooms in which two learners pay as much to the primitive, and rooms in which both were run."""
    logs = [ends for ratio in found[pair, cost] for ends in ratio.logs.values()]
    return sum(ends == (0.0, 0.0) for ends in logs), len(logs)


def is_alike(found: Found, pair: Pair, cost: str) -> bool:
    """True if two learners pay as much in most rooms, so that they were one until then."""
    alike, rooms = count_alike(found, pair, cost)
    return 2 * alike > rooms


def find_better_than_random(found: Found, cost: str) -> set[int]:
    """Numbers of buttons with which looking ahead along options is shown to help more than along random primitives."""
    return set.intersection(*(find_gains(found, control, AHEAD, cost) for control in RANDOM_AHEAD))


def find_planned(found: Found, cost: str, flat: str) -> set[int]:
    """Those of them with which it is shown to help at all."""
    return find_gains(found, flat, AHEAD, cost) & find_better_than_random(found, cost)


def tell_sizes(sizes: set[int]) -> str:
    """Numbers of buttons in words: "2 buttons", "1 and 2 buttons"."""
    return f"{join_words(map(str, sorted(sizes)))} button{'' if sizes == {1} else 's'}"


def tell_events(sizes: Mapping[str, set[int]], when: str) -> str:
    """Events reached sooner or later, with how many buttons, by cost; empty for none."""
    return " and ".join(f"{EVENTS[cost]} {when} with {tell_sizes(there)}" for cost, there in sizes.items() if there)


def tell_headline(study: Study, found: Found) -> str:
    """The finding: what exploration by options brings alone, and what is left."""
    flat, whole = study.data["flat"], study.data["whole"]

    def tell(cost: str, event: str) -> str:
        sooner, left = find_gains(found, flat, EXPLORES, cost), find_gains(found, EXPLORES, whole, cost)
        claim = (f"brings {event} sooner with {tell_sizes(sooner)}" if sooner else
                 f"is not shown to bring {event} sooner")
        if left:
            return f"{claim}, and whole options bring it sooner still with {join_words(map(str, sorted(left)))}"
        if sooner and is_alike(found, Pair(EXPLORES, whole), cost):
            alike, rooms = count_alike(found, Pair(EXPLORES, whole), cost)
            return (f"{claim}, and until then {alike} of {rooms} runs are the same with whole options, as both choose "
                    "random options before they learn")
        return f"{claim}; whole options are not shown to bring it sooner still" if sooner else claim

    control = (" Repeats that last as long do less, so what helps is where options lead, not that they last."
               if find_gains(found, REPEATS, EXPLORES, ESCAPE.name) else
               " Repeats that last as long are not shown to do less.")
    return ("Exploration by planned options, with values of primitives alone, "
            f"{tell(ESCAPE.name, 'the first escape')}; "
            f"it {tell(HALF.name, 'a greedy policy of half the efficiency')}.{control}")


def tell_planning(study: Study, found: Found) -> str:
    """The finding on planning: what looking ahead along options brings, and whether random ways do as well.

    Empty where no run looked ahead.
    """
    flat = study.data["flat"]
    if not found[Pair(flat, AHEAD), ESCAPE.name]:
        return ""
    begun = "A learner that imagines options, and runs none,"
    gains, losses = ({cost: find(found, flat, AHEAD, cost) for cost in EVENTS} for find in (find_gains, find_losses))
    if not any(gains.values()):
        harm = tell_events(losses, f"later than `{flat}`")
        better = tell_events({cost: find_better_than_random(found, cost) for cost in EVENTS}, "later")
        return (f"{begun} {f'reaches {harm}' if harm else f'is not shown to reach anything sooner than `{flat}`'}."
                f"{f' As many random primitives in their place bring {better}.' if better else ''}")
    kept = tell_events({cost: find_planned(found, cost, flat) for cost in EVENTS}, "later")
    helped = any(find_gains(found, flat, control, cost) for control in RANDOM_AHEAD for cost in EVENTS)
    control = (f"As many random primitives, as long or three at a time, bring {kept}: where options lead is what helps"
               f"{', beside imagining at all' if helped else ''}." if kept else
               "As many random primitives are not shown to do less.")
    return f"{begun} reaches {tell_events(gains, f'sooner than `{flat}`')}. {control}"


def tell_pairs(study: Study, found: Found, runs: Sequence[PriceRun]) -> list[str]:
    """Sentences on all questions, a pair and cost each; of two learners that are alike until then, that they are."""
    told = []
    for family in list_families(study):
        claims = [(pair, cost) for pair in family for cost in (ESCAPE, HALF)]
        for (pair, cost), sentence in zip(claims, conclude_prices(
                runs, [(pair.one, pair.other, cost) for pair, cost in claims]), strict=True):
            alike, rooms = count_alike(found, pair, cost.name)
            told.append(f"Until {cost.event}, `{pair.one}` and `{pair.other}` pay as much in {alike} of {rooms} runs, "
                        "so the factor does not change with the number of buttons."
                        if is_alike(found, pair, cost.name) else sentence)
    return told


def tell_rooms(lines: Sequence[PriceRun], price: Sequence[PriceRun]) -> str:
    """A sentence: of which sizes the price of flatness has more rooms; empty if of none."""
    parts = []
    for size in sorted({run.buttons for run in lines}):
        own, all_of = (len({run.replicate for run in runs if run.buttons == size}) for runs in (lines, price))
        if all_of > own:
            parts.append(f"{all_of} rooms with {count_nouns(size, 'button')}, of which {own} are here")
    return f"That page has {join_words(parts)}, so that its factors differ." if parts else ""


def tell_searcher(study: Study, runs: Sequence[PriceRun], searched: Sequence[SearcherRun]) -> str:
    """A sentence: when the best searcher, which learns nothing, first escapes, and how many learners do so later.

    What it says of learners is one family (Holm). Empty where the searcher was not run.
    """
    sizes, least = study.data["sizes"], {(run.buttons, run.replicate): run.fewest for run in runs}
    places = {(line.buttons, line.seed): line.escaped_at for line in searched
              if line.searcher == study.data["searcher"] and (line.buttons, line.seed) in least}
    if None in places.values() or {buttons for buttons, _ in places} != set(sizes):
        return ""
    own = [PriceRun(study.data["searcher"], *place, fewest=least[place], budget=at, primitives=at, first_escape=at,
                    efficient_at=None, efficiency=least[place] / at, episodes=1, escapes=1, seconds=0.0, key="")
           for place, at in places.items() if at is not None]
    labels = dict.fromkeys(run.agent for run in runs)
    ratios, _ = correct_prices([compare_costs([run for run in runs if run.agent == label], own, ESCAPE)
                                for label in labels])
    parts = []
    for size in sizes:
        middles = [ratio.middle for of_label in ratios for ratio in of_label if ratio.buttons == size]
        there = [run for run in own if run.buttons == size]
        sooner = sum(middle.high < 1 for middle in middles)
        parts.append(f"with {count_nouns(size, 'button')} after {np.median([run.primitives for run in there]):.0f} "
                     f"primitives, at an efficiency of {np.mean([run.efficiency for run in there]):.2f}, and "
                     f"{sum(middle.low > 1 for middle in middles)} of {len(middles)} learners later"
                     f"{f', {sooner} sooner' if sooner else ''}")
    return (f"`{study.data['searcher']}`, which chooses among planned options and learns nothing, first escapes "
            f"{'; '.join(parts)}.")


def advise(study: Study, found: Found) -> str:
    """Advice to a user, by what each part brings."""
    flat, whole = study.data["flat"], study.data["whole"]
    acts = any(find_gains(found, EXPLORES, whole, cost) for cost in EVENTS)
    plans = any(find_planned(found, cost, flat) for cost in EVENTS)
    if any(find_gains(found, flat, EXPLORES, cost) for cost in EVENTS):
        advice = ["Let planned options explore even for a learner that must act in primitives."]
        if acts:
            advice.append("Let it act by them too where it may: that is what makes it efficient soon.")
        advice.append("Planning along them helps, too." if plans else "" if acts else
                      "That is all that they were shown to give.")
        return " ".join(filter(None, advice))
    if acts:
        return ("Let a learner act by planned options: exploration by them alone was not shown to help."
                f"{' Planning along them helps, too.' if plans else ''}")
    if plans:
        return "Let a learner look ahead along planned options: exploration by them alone was not shown to help."
    return "Planned options were not shown to help this learner in these rooms."


def analyse(study: Study, lines: Sequence[PriceRun]) -> Page:
    """Sentences, the table and the figure of lines, beside the runs of the price of flatness in the same rooms."""
    replicates = {line.replicate for line in lines}
    known = open_store(find_study("price"), None).load()
    every = [run for run in known if isinstance(run, PriceRun) and run.buttons in study.data["sizes"]
             and run.agent in (study.data["flat"], study.data["whole"])]
    price = [run for run in every if run.replicate in replicates]
    if not lines or not price:
        raise ComparisonError("runs of this study and of the price of flatness are needed to tell why options help")
    runs = sorted([*lines, *price], key=lambda run: run.place)
    found = compare(study, runs)
    headline, planning = tell_headline(study, found), tell_planning(study, found)
    searcher = tell_searcher(study, runs, [line for line in open_store(find_study("league"), None).load()
                                           if isinstance(line, SearcherRun)])
    return Page({"headline": headline, "planning": planning, "beside": searcher,
                 "told": tell_pairs(study, found, runs), "rooms": tell_rooms(lines, every),
                 "advice": advise(study, found), "table": tabulate(study, found),
                 "minutes": sum(line.seconds for line in lines) / 60, **study.data},
                {"why": draw(study, found)}, [*filter(None, (headline, planning, searcher))])


def tabulate(study: Study, found: Found) -> str:
    """Factors, a row a pair and cost."""
    rows = [[f"`{pair.one}` to `{pair.other}`", cost.event,
             *(next((tell_factor(ratio.middle) for ratio in found[pair, cost.name] if ratio.buttons == size), "-")
               for size in study.data["sizes"])] for pair in list_pairs(study) for cost in (ESCAPE, HALF)]
    return make_table(["primitives of", "until", *(count_nouns(size, "button") for size in study.data["sizes"])], rows)


def draw(study: Study, found: Found) -> Figure:
    """Factors saved against the flat learner, a panel a cost; an arrow where only a bound is known."""
    flat, sizes = study.data["flat"], study.data["sizes"]
    labels = [*(learner["label"] for learner in study.data["learners"]), study.data["whole"]]
    with matplotlib.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(8.6, 3.4), facecolor=palette.BACKGROUND, layout="constrained")
        for axes, cost in zip(figure.subplots(1, 2, sharey=True), (ESCAPE, HALF), strict=True):
            for row, label in enumerate(labels):
                for number, size in enumerate(sizes):
                    middle = next((ratio.middle for ratio in found[Pair(flat, label), cost.name]
                                   if ratio.buttons == size), None)
                    if middle is None or middle.knowledge == "unknown":
                        continue
                    high = middle.high if np.isfinite(middle.high) else 30 * middle.low
                    at, colour = row + 0.22 * (number - (len(sizes) - 1) / 2), palette.LINES[number]
                    axes.plot([middle.low, high], [at, at], color=colour,
                              linestyle="-" if middle.knowledge == "measured" else ":")
                    axes.plot([middle.factor], [at], "o" if middle.knowledge == "measured" else ">", color=colour,
                              label=count_nouns(size, "button") if not row else None)
            axes.axvline(1, color=palette.MUTED, linewidth=0.8)
            axes.set(xscale="log", title=f"until {cost.event}", xlabel=f"times fewer primitives than {flat}")
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axes.set_yticks(range(len(labels)), labels)
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
        figure.axes[0].invert_yaxis()  # both, as they share it
        figure.axes[1].legend(frameon=False, loc="upper right")
    return figure
