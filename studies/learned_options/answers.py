"""The registered answers: learners compared by size and budget, room by room, and what a comparison would see.

A comparison needs the same rooms in both cells, at least as many as registered; otherwise there is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from hrl_escape.benchmark.inference import ALPHA
from studies.crossover.analysis import Ratio, estimate_ratio
from studies.learned_options.runs import ScaleRun
from studies.statistics import Difference, compare_signs

__all__ = ["Cells", "Gain", "Times", "Verdict", "choose_flat", "compare_times", "compare_to_flat", "find_crossover",
           "find_half", "gather_cells", "simulate_gain", "simulate_ratio"]

HALF = 0.5
"""Mean efficiency of training episodes that counts as learning a room, in two parts in a row."""

Cells: TypeAlias = Mapping[str, Mapping[int, ScaleRun]]
"""Runs of a size and a budget: label -> room -> run."""
Verdict: TypeAlias = Literal["open", "pays", "costs"]


class Times(NamedTuple):
    """Ratios of primitives of two learners in the same rooms.

    Attributes:
        first: to the first escape.
        credit: from the first escape until the room is learned.
    """

    first: Ratio
    credit: Ratio


class Gain(NamedTuple):
    """An agent that learns its options against the best flat learner of a size.

    Attributes:
        flat: label of the best flat learner.
        rooms: pairs.
        late: difference in efficiency in the last fifth of the budget; p is corrected over learners and sizes (Holm).
        times: agent with learned options over flat agent.
    """

    flat: str
    rooms: int
    late: Difference
    times: Times

    @property
    def verdict(self) -> Verdict:
        """Registered answer."""
        return ("open", "pays", "costs")[self.late.sign]


def gather_cells(lines: Sequence[ScaleRun], part: str, buttons: int, rooms: range, budgets: Mapping[str, int],
                 rule: str = "ignore") -> Cells:
    """Runs of a part of the study, by learner and room.

    Args:
        lines: all runs.
        part: of the study.
        buttons: number of them.
        rooms: seeds.
        budgets: label -> primitives of its runs.
        rule: effect of a wrong press.
    """
    found: dict[str, dict[int, ScaleRun]] = {}
    for line in lines:
        if ((line.part, line.buttons, line.rule) == (part, buttons, rule) and line.seed in rooms
                and line.budget == budgets.get(line.agent)):
            found.setdefault(line.agent, {})[line.seed] = line
    return found


def choose_flat(cells: Cells, flat: Sequence[str], least: int) -> str | None:
    """Flat learner of the highest mean late efficiency in a size, or None before all of them have enough rooms."""
    if any(len(cells.get(label, ())) < least for label in flat):
        return None
    return max(flat, key=lambda label: float(np.mean([run.late for run in cells[label].values()])))


def find_half(run: ScaleRun) -> int | None:
    """Primitives at the end of the first of two parts in a row of the budget with half efficiency or more."""
    worth = [0.0 if value is None else value for value in run.curve]
    size = run.budget / len(worth)
    return next((round((at + 1) * size) for at in range(len(worth) - 1) if min(worth[at:at + 2]) >= HALF), None)


def compare_to_flat(sizes: Mapping[int, Cells], flat: Sequence[str], options: Sequence[str], least: int
                    ) -> dict[tuple[int, str], Gain]:
    """Compare each agent that learns options with the best flat learner of each size, as one family.

    Args:
        sizes: number of buttons -> its cells, of one budget.
        flat: labels of flat learners.
        options: labels of agents that learn their options.
        least: fewest rooms of a comparison.

    Returns:
        (buttons, label) -> comparison, of those with enough rooms.
    """
    pairs: dict[tuple[int, str], tuple[str, list[tuple[ScaleRun, ScaleRun]]]] = {}
    for buttons, cells in sizes.items():
        best = choose_flat(cells, flat, least)
        for label in options:
            rooms = sorted(cells.get(label, {}).keys() & (cells[best].keys() if best else set()))
            if best is not None and len(rooms) >= least:
                pairs[buttons, label] = best, [(cells[label][room], cells[best][room]) for room in rooms]
    late = compare_signs({f"{buttons}, {label}": np.array([one.late - other.late for one, other in own])
                          for (buttons, label), (_, own) in pairs.items()})
    return {(buttons, label): Gain(best, len(own), late[f"{buttons}, {label}"], compare_times(own))
            for (buttons, label), (best, own) in pairs.items()}


def compare_times(pairs: Sequence[tuple[ScaleRun, ScaleRun]]) -> Times:
    """Compare the primitives of runs in the same rooms; runs that do not get there are censored at the budget."""
    budget = pairs[0][0].budget
    return Times(*(estimate_ratio([measure(one) for one, _ in pairs], [measure(other) for _, other in pairs], budget)
                   for measure in (lambda run: run.first_escape, _wait)))


def _wait(run: ScaleRun) -> float | None:
    """Primitives from the first escape until the room is learned, at least a part of the budget."""
    half, least = find_half(run), run.budget / len(run.curve)
    return None if half is None or run.first_escape is None else max(half - run.first_escape, least)


def find_crossover(gains: Mapping[tuple[int, str], Gain]) -> int | None:
    """Smallest number of buttons such that learned options pay at this and every larger size compared, or None."""
    sizes = sorted({buttons for buttons, _ in gains})
    paying = {buttons for (buttons, _), gain in gains.items() if gain.verdict == "pays"}
    beyond = [size for at, size in enumerate(sizes) if paying.issuperset(sizes[at:])]
    return beyond[0] if beyond else None


# --- power ------------------------------------------------------------------------------------


def simulate_gain(effect: float, spread: float, rooms: int, family: int, draws: int, seed: int = 0) -> float:
    """Power of the test of late efficiency: share of draws that find one true difference in a family.

    Args:
        effect: true mean difference of the first comparison; the others have 0.
        spread: standard deviation of a difference over rooms, normal.
        rooms: pairs.
        family: comparisons that are corrected together.
        draws: simulated studies.
        seed: of the draws.
    """
    rng, found = np.random.default_rng(seed), 0
    for _ in range(draws):
        drawn = spread * rng.normal(size=(family, rooms))
        drawn[0] += effect
        found += compare_signs({str(number): row for number, row in enumerate(drawn)})["0"].p < ALPHA
    return found / draws


def simulate_ratio(ratio: float, spread: float, escaping: float, rooms: int, draws: int, seed: int = 0) -> float:
    """Share of draws whose interval of a ratio of first escapes leaves out 1: its power, or with 1 its error.

    Args:
        ratio: true median ratio.
        spread: standard deviation of the logarithm of a first escape, within a room.
        escaping: share of the slower learner's runs that escape within the budget.
        rooms: pairs.
        draws: simulated studies.
        seed: of the draws.
    """
    rng, found = np.random.default_rng(seed), 0
    for _ in range(draws):
        one, other = np.exp(spread * rng.normal(size=(2, rooms)))
        slow = other * ratio
        budget = float(np.quantile(np.exp(spread * rng.normal(size=4_000)) * max(ratio, 1.0), escaping))
        cut = [[value if value <= budget else None for value in times.tolist()] for times in (slow, one)]
        seen = estimate_ratio(cut[0], cut[1], budget)
        found += seen.low > 1 or seen.high < 1
    return found / draws
