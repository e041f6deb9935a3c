"""Pages of studies made from simulated runs in which there is nothing to find, and whether one says that there is.

All agents are alike, no factor does anything, and so any difference or effect that a page shows is wrong. Where a page
places something on a scale, it is wrong if its interval leaves the truth out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.inference import ALPHA
from studies.baseline import BaselineRun
from studies.controls import compare_controls, group, list_questions
from studies.factorial.design import get_factors, make_label, make_screening_design
from studies.factorial.effects import Screening, compute_effects, measure_change, repeat_effects
from studies.generalisation.analysis import compare_cells
from studies.ladder.calibration import CHANCE, IN_ORDER, ROUND, Cells, compare_orders, compare_steps
from studies.learned.dial import PLANNED, DialLine, find_best_option
from studies.paper.analysis import list_claims
from studies.paper.claims import judge_claims
from studies.price.analysis import compare_pair
from studies.price.ratios import COSTS
from studies.price.runs import BUTTON_COUNTS, PriceRun
from studies.raw import BINS, OPTIMAL_SCORE, RawRun
from studies.scaling.analysis import compare_given
from studies.scaling.results import ScalingRun
from studies.scaling.rounds import GIVEN, GIVEN_TASKS
from studies.study import find_study

__all__ = ["PAGES", "Draw"]

Draw = Callable[[np.random.Generator, int], NDArray[np.float64]]
RUNS = 10
BUDGET = 1_000
RUNGS = tuple(f"rung-{number}" for number in range(8))


# --- the paper's page, and why it worsens ------------------------------------------------------


def make_run(agent: str, room: str, seed: int, value: float) -> RawRun:
    """A run whose score stays, and whose efficiency in training rises from half of it to one and a half."""
    evaluations = 11
    return RawRun(
        agent=agent, room=room, seed=seed, worst=-1000.0, best=0.0, axis="primitives", budget=BUDGET,
        primitives=tuple(range(0, 1001, 100)), decisions=tuple(range(0, 101, 10)),
        returns=(1000 * (value - 1),) * evaluations, successes=(float(value > 0.5),) * evaluations,
        episodes=(1,) * BINS, training_returns=(1000 * (value - 1),) * BINS,
        training_successes=(int(value > 0.5),) * BINS, training_optimal=(int(value >= OPTIMAL_SCORE),) * BINS,
        first_escape=50 if value > 0.5 else None, efficiencies=(value,) * evaluations,
        training_efficiencies=tuple((value * np.linspace(0.5, 1.5, BINS)).tolist()))


def is_wrong_of_claims(draw: Draw, rng: np.random.Generator) -> bool:
    """The page of the paper answers a claim on which learners and chance are alike; 10 runs.

    These are the claims on differences between agents; shares of runs are compared with fixed levels.
    """
    study = find_study("paper")
    results = {grid.name: [make_run(agent.label, grid.name, seed, float(score)) for agent in grid.agents
                           if not agent.is_reference for seed, score in enumerate(draw(rng, RUNS))]
               for grid in study.grids}
    chosen = [claim for claim in list_claims(study) if "less that" in claim.measured]
    return any(verdict is not None for finding in judge_claims(chosen, results)
               for verdict in finding.verdicts.values())


def make_screening(draw: Draw, rng: np.random.Generator, rooms: str, seeds: int) -> Screening:
    """Runs of the screening of SARSA, in which no factor has an effect."""
    labels = [make_label("sarsa", row) for row in make_screening_design(len(get_factors("sarsa"))).tolist()]
    runs = [make_run(label, room, seed, float(value)) for room in rooms for seed in range(seeds)
            for label, value in zip(labels, draw(rng, len(labels)), strict=True)]
    return Screening.make("sarsa", runs)


def is_wrong_of_screening(draw: Draw, rng: np.random.Generator) -> bool:
    """The page on why SARSA worsens shows an effect of a factor, where none has any; 5 rooms, 2 seeds."""
    return any(effect.is_shown for effect in compute_effects(make_screening(draw, rng, "abcde", 2), measure_change))


def is_wrong_of_fresh_effects(draw: Draw, rng: np.random.Generator) -> bool:
    """The same page repeats or reverses an effect in fresh runs, in which no factor has any; 5 rooms, 2 seeds."""
    return any(effect.is_shown for effect in repeat_effects(make_screening(draw, rng, "fghij", 2), ["exploration"]))


# --- pages of a line a run ---------------------------------------------------------------------


def is_wrong_of_controls(name: str, draw: Draw, rng: np.random.Generator) -> bool:
    """The page calls an agent better or worse than its control; 10 runs in each room of the study."""
    study = find_study(name)
    (grid,) = study.grids
    lines = [BaselineRun("per-instance", study.name, room.label, agent.label, seed, BUDGET, float(value), None,
                         float(value > 0.5), 1, float(value), round(BUDGET * (1 - float(value))) or None, "")
             for room in grid.rooms for agent in grid.agents if agent.learns
             for seed, value in enumerate(draw(rng, RUNS))]
    cells, rooms = group(lines), [room.label for room in grid.rooms]
    return any(contrast.is_better or contrast.is_worse
               for contrasts in compare_controls(list_questions(study), cells, rooms) for contrast in contrasts)


def make_rungs(draw: Draw, rng: np.random.Generator) -> Cells:
    """Eight rungs that are alike, 10 rooms a rung with 2 seeds, which are equal in a room."""
    return {(rung, agent): [BaselineRun("per-instance", rung, f"{rung}[{room}]", agent, seed, 0, float(value), None,
                                        float(value > 0.5), 1, float(value), None, "")
                            for room, value in enumerate(draw(rng, RUNS)) for seed in range(2)]
            for rung in RUNGS for agent in (CHANCE, IN_ORDER, ROUND)}


def is_wrong_of_rungs(draw: Draw, rng: np.random.Generator) -> bool:
    """Two neighbouring rungs of the ladder differ in what random options reach, which is the same on all."""
    return any(step.p < ALPHA for step in compare_steps(make_rungs(draw, rng), RUNGS))


def is_wrong_of_numbers(draw: Draw, rng: np.random.Generator) -> bool:
    """The order of the buttons' numbers is better than a random order on a rung, where any order is as good."""
    return any(p < ALPHA and gain > 0 for gain, p in compare_orders(make_rungs(draw, rng), RUNGS).values())


def is_wrong_of_generalisation(draw: Draw, rng: np.random.Generator) -> bool:
    """The page on generalisation says that memory or more training rooms help; two agents after two, 10 seeds."""
    cells = {(agent, count): dict(enumerate(draw(rng, RUNS).tolist())) for agent in ("one", "two") for count in (1, 2)}
    found = compare_cells(cells, {"memory": (("two", 2), ("one", 2)), "rooms": (("two", 2), ("two", 1))})
    return any(gain.sign for gain in found.values())


@lru_cache(maxsize=8)
def _compute_mean(draw: Draw) -> float:
    return float(draw(np.random.default_rng(0), 1_000_000).mean())


def is_wrong_of_dial(draw: Draw, rng: np.random.Generator) -> bool:
    """The best of learned options that are worth a planned one that fails every other time is said to be another.

    Nine learners are alike after each of three budgets, 10 runs.
    """
    half, settings = _compute_mean(draw) / 2, find_study("learned").data["dial"]
    lines = [DialLine("room", PLANNED, 0, failure, 0, 2 * half * (1 - failure)) for failure in settings["failures"]]
    lines += [DialLine("room", agent, budget, None, seed, float(value) / 2) for agent in settings["algorithms"]
              for budget in (1, 2, 3) for seed, value in enumerate(draw(rng, RUNS))]
    best = find_best_option(lines)
    return best is not None and not best.place.low <= 0.5 <= best.place.high


def make_price_runs(agent: str, scores: Sequence[float], buttons: int) -> list[PriceRun]:
    """Runs that get there sooner the more they score; below 0.1 they do not."""
    waits = [None if score < 0.1 else round(BUDGET * (1.1 - score)) for score in scores]
    return [PriceRun(agent, buttons, replicate, 30, BUDGET, wait or BUDGET, wait, wait, 1.0, 1, 1, 1.0, "")
            for replicate, wait in enumerate(waits)]


def is_wrong_of_price(draw: Draw, rng: np.random.Generator) -> bool:
    """A factor between flat learners and options is not 1, where flat learners are as quick; 10 replicates."""
    runs = [run for buttons in BUTTON_COUNTS for agent in ("flat", "options")
            for run in make_price_runs(agent, draw(rng, RUNS).tolist(), buttons)]
    ratios = compare_pair(runs, "flat", "options", COSTS[:2])
    return any(ratio.middle.low > 1 or ratio.middle.high < 1 for own in ratios.values() for ratio in own)


# --- from 2 to 20 buttons ----------------------------------------------------------------------


def make_scaling_run(agent: str, task: tuple[str, int, str], run: int, score: float) -> ScalingRun:
    """A run that is near the best with the whole graph the sooner the more it scores; below 0.1 it is not."""
    graph, buttons, rule = task
    wait = None if score < 0.1 else round(BUDGET * (1.1 - score))
    return ScalingRun(graph, buttons, rule, agent, run, "", 50.0, -1000.0, BUDGET, wait or BUDGET, 100, 1.0,
                      first_escape=wait, near_best=wait, edges=4, depth=3,
                      structure=((1, 1.0, 1.0),) if wait is not None else ())


def is_wrong_of_given(draw: Draw, rng: np.random.Generator) -> bool:
    """The page names a price of what a structure learner is given, where it matters to none; 10 runs a label."""
    runs = [make_scaling_run(spec.label, task, run, float(score)) for task in GIVEN_TASKS for spec in GIVEN
            for run, score in enumerate(draw(rng, RUNS))]
    return any(cost.sign for cost in compare_given(runs).values())


PAGES: dict[str, Callable[[Draw, np.random.Generator], bool]] = {
    "claims of the paper": is_wrong_of_claims,
    "why it worsens": is_wrong_of_screening,
    "task hierarchies and their controls": lambda draw, rng: is_wrong_of_controls("hierarchies", draw, rng),
    "learned hierarchies and their controls": lambda draw, rng: is_wrong_of_controls("learned", draw, rng),
    "intra-option learning and its control": lambda draw, rng: is_wrong_of_controls("intra-option", draw, rng),
    "why it worsens: fresh runs": is_wrong_of_fresh_effects,
    "order of the ladder's rungs": is_wrong_of_rungs,
    "learned options on the dial": is_wrong_of_dial,
    "do options help": is_wrong_of_price,
    "what structure learners are given": is_wrong_of_given,
    "numbers of the ladder's buttons": is_wrong_of_numbers,
    "generalisation": is_wrong_of_generalisation,
}
"""Verdict -> whether one simulated page is wrong. New ones go to the end: the place in the list seeds the draws."""
