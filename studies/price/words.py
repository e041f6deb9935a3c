"""Sentences of the price of flatness, by rule from the ratios: nothing is concluded that they do not show."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hrl_escape.benchmark.inference import ALPHA, compute_wilson_interval
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.names import count_nouns, join_words
from studies.price.ratios import (
    CostRatio,
    Growth,
    Middle,
    RunCost,
    compare_costs,
    correct_prices,
    measure_growth,
)
from studies.price.runs import PriceRun
from studies.statistics import find_visible_shift, tell_power

__all__ = ["advise", "compare_with_chance", "conclude_prices", "conclude_variants", "tell_factor",
           "tell_longest", "tell_number", "tell_ready", "tell_visible"]


def tell_number(value: float) -> str:
    """Two digits, and all before the decimal point: 0.52, 3.4, 26, 1,340."""
    if not np.isfinite(value):
        return "-"
    rounded = float(f"{value:.2g}") if value < 1_000 else float(f"{value:.3g}")
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.2g}"


def tell_factor(middle: Middle) -> str:
    """Words such as `26 (19 to 36)`, or `> 19 (mean at least 26)` of a bound, or `-`."""
    if middle.knowledge == "unknown":
        return "-"
    if middle.knowledge == "bound":
        return f"> {tell_number(middle.low)} (mean at least {tell_number(middle.factor)})"
    return f"{tell_number(middle.factor)} ({tell_number(middle.low)} to {tell_number(middle.high)})"


def conclude_prices(runs: Sequence[PriceRun], claims: Sequence[tuple[str, str, RunCost]]) -> list[str]:
    """The price in a few sentences a claim: size by size, then how it grows.

    All that they conclude is one family (Holm).

    Args:
        runs: of all learners, and of others.
        claims: label of a learner over primitives, label of one over options, and a cost, in their order.
    """
    ratios = [_compare(runs, flat, options, [cost])[0] for flat, options, cost in claims]
    ratios, growths = correct_prices(ratios, [measure_growth(own) for own in ratios])
    told = [_conclude(own, *claim) for own, claim in zip(ratios, claims, strict=True)]
    return [f"{words} {_tell_growth(growth)}" if words.startswith("Until") else words
            for words, growth in zip(told, growths, strict=True)]


def conclude_variants(runs: Sequence[PriceRun], one: str, other: str, costs: Sequence[RunCost]) -> list[str]:
    """One learner's price beside another's, a sentence a cost, size by size; all that they conclude is one family.

    Args:
        runs: of both learners, and of others.
        one: label of the learner that pays.
        other: label of the one beside it.
        costs: in their order.
    """
    ratios, _ = correct_prices(_compare(runs, one, other, costs))
    return [_conclude(own, one, other, cost) for own, cost in zip(ratios, costs, strict=True)]


def advise(runs: Sequence[PriceRun], flat: str, options: str, chance: str, costs: Sequence[RunCost]) -> str:
    """Advice to a user: from the first escape beside a random walk, the price, and rooms that chance solves.

    Args:
        runs: of all learners.
        flat: label of a learner over primitives.
        options: label of the same over options.
        chance: label of the random walk over primitives.
        costs: of efficiency, and of the first escape.
    """
    walk, price = ({_classify(ratio.middle) for ratio in correct_prices(_compare(runs, flat, other, [cost]))[0][0]
                    if not ratio.is_short} for other, cost in ((chance, costs[1]), (options, costs[0])))
    said = ["A flat learner that waits longer for its first escape than a random walk does wants more exploration first"
            if walk & {"dearer", "beyond"} else
            "This learner finds the exit sooner than a random walk, so keep its exploration"
            if walk & {"cheaper", "below"} else
            "A flat learner's first escape is not shown to come sooner than a random walk's, and what it pays "
            "afterwards is the price of learning to repeat it: give it a long exploration and a large budget"]
    if price & {"dearer", "beyond"}:
        said[0] += ", or give it options, which cost a fraction"
    if tell_ready(runs, flat, options, costs[0]):
        said.append("A room that chance over options escapes from efficiently says nothing about learning, so test in "
                    "rooms with more buttons")
    return "".join(f"{sentence}. " for sentence in said).strip()


def tell_visible(runs: Sequence[PriceRun], flat: str, options: str, costs: Sequence[RunCost]) -> str:
    """A sentence: the factors that these costs' tests would have seen, of sizes in which every run got there."""
    ratios = [ratio for own in _compare(runs, flat, options, costs) for ratio in own if not ratio.is_short
              and len(ratio.logs) >= LEAST_RUNS]
    logs = [[low for low, _ in ratio.logs.values()] for ratio in ratios if ratio.middle.knowledge == "measured"
            and all(low == high for low, high in ratio.logs.values())]
    return tell_power([float(np.exp(find_visible_shift(own, ALPHA / len(ratios)))) for own in logs], "a factor of",
                      "{:.1f}".format)


def _compare(runs: Sequence[PriceRun], one: str, other: str, costs: Sequence[RunCost]) -> list[list[CostRatio]]:
    paid, others = ([run for run in runs if run.agent == label] for label in (one, other))
    return [compare_costs(paid, others, cost) for cost in costs]


def _conclude(ratios: Sequence[CostRatio], one: str, other: str, cost: RunCost) -> str:
    groups: dict[str, list[CostRatio]] = {name: [] for name in ("dearer", "beyond", "cheaper", "below", "equal",
                                                                "unknown", "short")}
    for ratio in ratios:
        groups["short" if ratio.is_short else _classify(ratio.middle)].append(ratio)
    parts, unit = [], f"{cost.unit} of `{other}`"
    if dearer := groups["dearer"]:
        parts.append(f"pays {_list_times(dearer, unit, tell_factor)}")
    if beyond := groups["beyond"]:
        parts.append(f"pays more than {_list_times(beyond, unit, lambda middle: tell_number(middle.low))} (too few "
                     "of its runs get there to say how much more)")
    if cheaper := groups["cheaper"]:
        parts.append(f"pays only {_list_times(cheaper, unit, tell_factor)}")
    if below := groups["below"]:
        parts.append(f"pays less than {_list_times(below, unit, lambda middle: tell_number(middle.high))} (too few "
                     f"runs of `{other}` get there to say how much less)")
    if equal := groups["equal"]:
        parts.append(f"is not shown to pay more or fewer {cost.unit} than `{other}` with {_name_sizes(equal)}")
    if not parts:
        return (f"How much `{one}` pays until {cost.event} could not be estimated in rooms of any size: too few runs "
                f"of it and of `{other}` were made, or got there.")
    unknown = groups["unknown"]
    left_out = f"; with {_name_sizes(unknown)} the price could not be estimated" if unknown else ""
    if short := groups["short"]:
        left_out += f"; with {_name_sizes(short)} its budget was smaller, so no price is given"
    return f"Until {cost.event}, `{one}` {'; it '.join(parts)}{left_out}."


def _classify(middle: Middle) -> str:
    is_measured = middle.knowledge == "measured"
    if middle.p >= ALPHA:
        return "equal" if is_measured else "unknown"
    if middle.low > 1:
        return "dearer" if is_measured else "beyond"
    if middle.high < 1:
        return "cheaper" if is_measured else "below"
    return "unknown"


def _list_times(ratios: Sequence[CostRatio], unit: str, tell: Callable[[Middle], str]) -> str:
    words = [f"{tell(ratio.middle)} times with {_name_sizes([ratio])}" for ratio in ratios]
    return join_words([words[0].replace(" times ", f" times the {unit} ", 1), *words[1:]])


def _name_sizes(ratios: Sequence[CostRatio]) -> str:
    words = join_words([str(ratio.buttons) for ratio in ratios], "or")
    return f"{words} button{'' if words == '1' else 's'}"


def _tell_growth(growth: Growth) -> str:
    if growth.middle.knowledge == "unknown":
        return "How the factor grows with each button could not be estimated."
    span, factor = f"from {growth.smallest} to {growth.largest}", tell_factor(growth.middle)
    if growth.middle.p < ALPHA and growth.middle.low > 1:
        more = factor if growth.middle.knowledge == "measured" else f"more than {tell_number(growth.middle.low)}"
        return f"Each button {span} multiplies the factor by {more}."
    if growth.middle.p < ALPHA and growth.middle.high < 1:
        return f"Each button {span} multiplies the factor by {factor}, so that it falls."
    return (f"These runs do not show that the factor grows with the number of buttons: {span}, each multiplies it by "
            f"{factor}.")


def tell_ready(runs: Sequence[PriceRun], flat: str, options: str, cost: RunCost) -> str:
    """Sentences on rooms in which the untrained learner over options is efficient; empty where there are none.

    Where too few rooms are left for a test, the median price in them is told as what it is.
    """
    parts, rest = [], []
    for ratio in _compare(runs, flat, options, [cost])[0]:
        total = ratio.ready + len(ratio.logs)
        if ratio.ready:
            buttons = count_nouns(ratio.buttons, "button")
            parts.append(f"{ratio.ready} of {count_nouns(total, 'room')} with {buttons}")
            if 0 < len(ratio.logs) < LEAST_RUNS:
                middle = float(np.exp(np.median([low for low, _ in ratio.logs.values()])))
                rest.append(f" In the {len(ratio.logs)} others with {buttons} `{flat}` pays {tell_number(middle)} "
                            "times as much (median; too few rooms for a test).")
    return (f"In {join_words(parts)} the untrained `{options}` is efficient already: chance over options is all it "
            f"takes there, so these rooms are left out of every price of learning.{''.join(rest)}") if parts else ""


def compare_with_chance(learner: Sequence[PriceRun], chance: Sequence[PriceRun], label: str, horizon: int) -> str:
    """A clause: runs that escape by a number of primitives, of a learner in rooms of one size and of chance."""
    (own, own_runs), (other, other_runs) = (
        (sum(run.first_escape is not None and run.first_escape <= horizon for run in runs), len(runs))
        for runs in (learner, chance))
    ends = [compute_wilson_interval(hits / runs, runs) for hits, runs in ((own, own_runs), (other, other_runs))]
    verdict = ("fewer than by chance" if ends[0][1] < ends[1][0] else "more than by chance" if ends[0][0] > ends[1][1]
               else "not told apart from chance")
    return f"`{label}` escapes in {own} of {own_runs} runs, `random` in {other} of {other_runs}, {verdict}"


def tell_longest(runs: Sequence[PriceRun]) -> str:
    """A sentence that counts, and concludes nothing: the runs of the largest budget that became efficient."""
    budget = max(run.budget for run in runs)
    longest = [run for run in runs if run.budget == budget]
    parts = []
    for label, buttons in dict.fromkeys((run.agent, run.buttons) for run in longest):
        own = [run for run in longest if (run.agent, run.buttons) == (label, buttons)]
        waits = sorted(run.efficient_at for run in own if run.efficient_at is not None)
        told = f"{waits[0]:,} to {waits[-1]:,}" if len(waits) > 2 else join_words([f"{wait:,}" for wait in waits])
        after = f", after {told}" if waits else ""
        parts.append(f"`{label}` in {len(waits)} of {len(own)} with {count_nouns(buttons, 'button')}{after}")
    return f"Runs of the largest budget, {budget:,} primitives, that became efficient: {'; '.join(parts)}."
