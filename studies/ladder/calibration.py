"""Sentences on whether a ladder is calibrated, by rule from the lines of its baselines.

Chance stays below half the efficiency and falls from rung to rung, the planner reaches all of it, numbers of buttons
tell nothing, and learners fall off step by step. Only cells of `LEAST_RUNS` runs or more count. Runs in one room are
much alike, so that tests are over rooms.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

from hrl_escape.benchmark.inference import ALPHA, compare_pairs, correct_by_holm
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.names import count_nouns, join_words
from studies.baseline import BaselineRun, compute_run_efficiency

__all__ = ["CHANCE", "IN_ORDER", "KNOWN", "ROUND", "average_rooms", "find_miscalibration", "find_steps",
           "tell_calibration"]

CHANCE, ROUND = "random-options", "sweep-random"
PERMUTATIONS = 2_000
STEP = 0.9, 0.1
"""A learner steps between two neighbouring rungs where it falls from above the first efficiency to below the second."""
MOST_CHANCE = 0.5
"""Efficiency that random choices among the options must stay below."""
IN_ORDER, KNOWN = "sweep", "oracle"


def tell_calibration(cells: Mapping[tuple[str, str], Sequence[BaselineRun]], rungs: Sequence[str],
                     noisy: Collection[str]) -> list[str]:
    """Sentences on chance, the planner, orders of rungs and numbers, and steps; none about what was not measured.

    Args:
        cells: runs by rung and agent, all of one budget in each.
        rungs: names of the rungs, in order.
        noisy: rungs in which moves err, where the planner is measured by its own expectation.
    """
    enough = {place: runs for place, runs in cells.items() if len(runs) >= LEAST_RUNS}
    curves: dict[str, dict[str, float]] = {}
    for rung in rungs:
        for agent in (agent for place, agent in enough if place == rung):
            curves.setdefault(agent, {})[rung] = compute_run_efficiency(enough[rung, agent])
    told = []
    chance = curves.get(CHANCE, {})
    if chance:
        above = [rung for rung, value in chance.items() if find_miscalibration(value, 1.0)]
        told.append(f"Random choices among the options stay below an efficiency of {MOST_CHANCE:g} "
                    f"{_count(above, chance)}.")
    if len(chance) > 1:
        told.append(_tell_chance_order({rung: average_rooms(enough[rung, CHANCE]) for rung in chance}))
    if known := curves.get(KNOWN):
        below = [rung for rung, value in known.items() if find_miscalibration(0.0, value, rung in noisy)]
        told.append(f"The planner, which knows the graph, is as efficient as possible {_count(below, known)}.")
    if order := _tell_order(enough, rungs):
        told.append(order)
    learners = {agent: curve for agent, curve in curves.items()
                if len(curve) > 1 and any(run.primitives for rung in curve for run in enough[rung, agent])}
    steps = {agent: [f"{fault} on {after}" for after, faults in find_steps(
                {rung: {agent: value} for rung, value in curve.items()}, [agent]).items() for fault in faults]
             for agent, curve in learners.items()}
    if smooth := [f"`{agent}`" for agent, found in steps.items() if not found]:
        those, it = ("No learner falls", "it was") if len(smooth) == len(steps) else (
            f"Of {count_nouns(len(steps), 'learner')} {len(smooth)} never fall", "they were")
        told.append(f"{those} from above {STEP[0]:g} on one rung to below {STEP[1]:g} on the next that {it} run on: "
                    f"{join_words(smooth)}.")
    if falls := list(itertools.chain.from_iterable(steps.values())):
        told.append(f"The fall is not smooth: {'; '.join(falls)}.")
    open_rungs = [f"`{rung}`" for rung in rungs if rung not in chance]
    if told and open_rungs:
        told.append(f"Open, for want of runs: {join_words(open_rungs)}.")
    return told


def average_rooms(runs: Sequence[BaselineRun]) -> dict[str, float]:
    """Mean efficiency in each room."""
    rooms: dict[str, list[float]] = {}
    for run in runs:
        rooms.setdefault(run.rooms, []).append(run.efficiency)
    return {room: float(np.mean(values)) for room, values in rooms.items()}


def _tell_chance_order(chance: Mapping[str, Mapping[str, float]]) -> str:
    """Sentence on whether chance falls from each rung to the next, which is what rungs are in order of.

    Two rungs are compared by what chance reaches in the rooms of each, tried with rooms that change places; all steps
    are one family (Holm).

    Args:
        chance: rung -> its rooms' mean efficiencies, the rungs in order.
    """
    steps = list(itertools.pairwise((rung, list(rooms.values())) for rung, rooms in chance.items()))
    p = correct_by_holm([_compare_rooms(before, after) for (_, before), (_, after) in steps])
    shown = [(before, after) for (before, after), corrected in zip(steps, p, strict=True) if corrected < ALPHA]
    rises = [f"`{after}` ({np.mean(high):.2f}) after `{before}` ({np.mean(low):.2f})"
             for (before, low), (after, high) in shown if np.mean(high) > np.mean(low)]
    if rises:
        return f"The rungs are not in the order of what chance reaches: {join_words(rises)}."
    if len(shown) == len(steps):
        return "The rungs are in the order of what chance reaches: it falls from each to the next."
    falls = join_words(f"from `{before}` to `{after}`" for (before, _), (after, _) in shown)
    also = f"it falls {falls}, and " if shown else ""
    return (f"No rung is shown to be out of the order of what chance reaches: {also}no difference is shown on "
            f"{len(steps) - len(shown)} of {count_nouns(len(steps), 'step')} (permutations of rooms, Holm).")


def _compare_rooms(one: Sequence[float], other: Sequence[float]) -> float:
    """Two-sided p-value of the difference of two means, by permutations of the rooms; the same every time."""
    if min(len(one), len(other)) < 2:
        return 1.0
    test = stats.permutation_test(
        (one, other), lambda x, y, axis: np.mean(x, axis=axis) - np.mean(y, axis=axis), vectorized=True,
        n_resamples=PERMUTATIONS, rng=np.random.default_rng(2019))
    return float(test.pvalue)


def _tell_order(enough: Mapping[tuple[str, str], Sequence[BaselineRun]], rungs: Sequence[str]) -> str:
    """Sentence on whether rounds in the order of the numbers beat rounds in an order drawn for the episode."""
    tests = {}
    for rung in (rung for rung in rungs if (rung, IN_ORDER) in enough and (rung, ROUND) in enough):
        ours, theirs = (average_rooms(enough[rung, agent]) for agent in (IN_ORDER, ROUND))
        differences = [ours[place] - theirs[place] for place in ours.keys() & theirs.keys()]
        tests[rung] = compare_pairs([np.array(sorted(differences))])
    if not tests:
        return ""
    adjusted = correct_by_holm([test.p for test in tests.values()])
    better = [f"`{rung}` (by {test.difference:.2f})"
              for (rung, test), p in zip(tests.items(), adjusted, strict=True) if p < ALPHA and test.difference > 0]
    begins = "Rounds in the order of the buttons' numbers are more efficient than rounds in a random order on"
    if better:
        return f"{begins} {join_words(better)}, so numbers say something of the graph there."
    return (f"{begins} none of {len(tests)} rungs (paired by room, Holm): these runs do not show that numbers say "
            "anything of the graph.")


def _count(exceptions: Collection[str], curve: Mapping[str, float]) -> str:
    """Number of rungs without an exception, and the exceptions."""
    but = f", but not on {join_words(f'`{rung}` ({curve[rung]:.2f})' for rung in exceptions)}" if exceptions else ""
    return f"on {len(curve) - len(exceptions)} of {len(curve)} rungs{but}"


def find_miscalibration(chance: float, planner: float, is_stochastic: bool = False) -> list[str]:
    """Faults of a rung, in words, by the efficiency of random choices among its options and of the planner.

    Where moves err the planner is measured by its own expectation, from which a few episodes stray by 0.05 or less.
    """
    faults = [f"chance reaches {chance:.2f}, not below {MOST_CHANCE:g}"] if chance >= MOST_CHANCE else []
    least = 0.95 if is_stochastic else 1.0
    return faults + ([f"the planner reaches {planner:.2f}, not 1"] if planner < least else [])


def find_steps(rows: Mapping[str, Mapping[str, float]], learners: Iterable[str]) -> dict[str, list[str]]:
    """Find learners that fall from mastery to nothing from one rung to the next; the rungs between are missing.

    Args:
        rows: efficiency of each agent on each rung, the rungs in order.
        learners: agents to look at.

    Returns:
        Faults of each rung, in words.
    """
    faults: dict[str, list[str]] = {rung: [] for rung in rows}
    for (before, high), (after, low) in itertools.pairwise(rows.items()):
        faults[after] += [f"{agent} falls from {high[agent]:.2f} on {before} to {low[agent]:.2f}"
                          for agent in learners if high[agent] > STEP[0] and low[agent] < STEP[1]]
    return faults
