"""Pages of studies made from simulated runs without any difference, and whether one reports a difference.

All agents are alike, no factor does anything, and so any difference or effect that a page shows is wrong. Where a page
places something on a scale, it is wrong if its interval leaves the truth out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from studies.baseline import BaselineRun
from studies.controls import compare_controls, group, list_questions
from studies.factorial.design import get_factors, make_label, make_screening_design, read_levels
from studies.factorial.effects import (
    SHARE,
    Screening,
    compute_effects,
    find_sufficient,
    measure_change,
)
from studies.factorial.mediation import compute_paths
from studies.factorial.words import Findings, tell_fresh_runs
from studies.generalisation.findings import tell_room_numbers
from studies.ladder.calibration import CHANCE, IN_ORDER, ROUND, tell_calibration
from studies.learned.dial import PLANNED, DialLine, conclude_dial
from studies.paper.analysis import list_claims
from studies.paper.claims import judge_claims
from studies.price.contestants import BUTTON_COUNTS
from studies.price.ratios import COSTS
from studies.price.runs import PriceRun
from studies.price.words import compare_with_chance, conclude_prices
from studies.raw import BINS, OPTIMAL_SCORE, RawRun
from studies.scaling.difficulty import tell_difficulty
from studies.scaling.findings import tell_replication
from studies.scaling.results import ScalingRun
from studies.scaling.rounds import AGENTS, BAR, BAR_AGENT, RULES, TOLD, TOLD_TASKS
from studies.scaling.told import compute_told_costs
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
    """The page of the paper answers a claim although all agents equal the random policy; 10 runs.

    These are the claims on differences between agents; shares of runs are compared with fixed levels.
    """
    study = find_study("paper")
    results = {grid.name: [make_run(agent.label, grid.name, seed, float(score)) for agent in grid.agents
                           if not agent.is_reference for seed, score in enumerate(draw(rng, RUNS))]
               for grid in study.grids}
    chosen = [claim for claim in list_claims(study) if "less that" in claim.measured]
    return any(verdict is not None for finding in judge_claims(chosen, results)
               for verdict in finding.verdicts.values())


def make_screening(draw: Draw, rng: np.random.Generator, rooms: str, seeds: int,
                   respond: Callable[[dict[str, bool]], float] | None = None) -> Screening:
    """Runs of the screening of SARSA, from what the factors do, given as corrected or not, and a tenth of a score."""
    factors = get_factors("sarsa")
    labels = [make_label("sarsa", row) for row in make_screening_design(len(factors)).tolist()]
    levels = [dict(zip(factors, (level > 0 for level in read_levels(label)), strict=True)) for label in labels]
    runs = [make_run(label, room, seed, float(value) if respond is None else respond(level) + 0.1 * float(value))
            for room in rooms for seed in range(seeds)
            for label, level, value in zip(labels, levels, draw(rng, len(labels)), strict=True)]
    return Screening.make("sarsa", runs)


def is_wrong_of_screening(draw: Draw, rng: np.random.Generator) -> bool:
    """The page on why SARSA worsens shows an effect of a factor, where none has any; 5 rooms, 2 seeds."""
    return any(effect.is_shown for effect in compute_effects(make_screening(draw, rng, "abcde", 2), measure_change))


def is_wrong_of_paths(draw: Draw, rng: np.random.Generator) -> bool:
    """The same page shows a path through the logs, where exploration moves a quantity that moves nothing else."""
    labels = [make_label("sarsa", row) for row in make_screening_design(len(get_factors("sarsa"))).tolist()]
    raised = [read_levels(label)[get_factors("sarsa").index("exploration")] for label in labels]
    runs = [replace(make_run(label, room, seed, float(value)), greedy=(0.5 + 0.1 * level + float(noise),) * BINS)
            for room in "abcde" for seed in range(5) for label, value, level, noise in
            zip(labels, draw(rng, len(labels)), raised, rng.normal(0, 0.1, len(labels)), strict=True)]
    return any(path.is_shown for path in
               compute_paths(Screening.make("sarsa", runs), ["exploration"], measure_change, rng, resamples=500))


def is_wrong_of_sufficiency(draw: Draw, rng: np.random.Generator) -> bool:
    """The same page decides whether one correction suffices, if each of two has exactly the limiting share."""
    first, second, *_ = get_factors("sarsa")

    def respond(corrected: dict[str, bool]) -> float:
        return (0.0, SHARE, 1.0)[corrected[first] + corrected[second]]

    screening = make_screening(draw, rng, "abcde", 5, respond)
    found = find_sufficient(screening, compute_effects(screening, measure_change), measure_change)
    return any(found.get(name) is not None for name in (first, second))


def is_wrong_of_fresh_effects(draw: Draw, rng: np.random.Generator) -> bool:
    """The same page reports that fresh runs without any effect repeat or reverse a published effect."""
    published = make_screening(draw, rng, "abcde", 5, lambda corrected: float(corrected["exploration"]))
    findings = Findings(published, compute_effects(published, measure_change), [], {}, [])
    told = tell_fresh_runs(make_screening(draw, rng, "fghij", 2), findings)
    return "the same conclusion" in told or "the contrary" in told


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


def tell_rungs(draw: Draw, rng: np.random.Generator) -> str:
    """Sentences of the ladder's page on eight rungs that are alike; 10 rooms a rung with 2 seeds, alike in a room."""
    cells = {(rung, agent): [BaselineRun("per-instance", rung, f"{rung}[{room}]", agent, seed, 0, float(value), None,
                                         float(value > 0.5), 1, float(value), None, "")
                             for room, value in enumerate(draw(rng, RUNS)) for seed in range(2)]
             for rung in RUNGS for agent in (CHANCE, IN_ORDER, ROUND)}
    return " ".join(tell_calibration(cells, RUNGS, ()))


def is_wrong_of_rungs(draw: Draw, rng: np.random.Generator) -> bool:
    """The ladder's page orders rungs by what chance reaches, which is the same on all."""
    told = tell_rungs(draw, rng)
    return "not in the order" in told or "it falls" in told


def is_wrong_of_numbers(draw: Draw, rng: np.random.Generator) -> bool:
    """The ladder's page reports that the numbers of buttons matter, although any order is as good."""
    return "numbers tell something" in tell_rungs(draw, rng)


def is_wrong_of_generalisation(draw: Draw, rng: np.random.Generator) -> bool:
    """The page on generalisation says that agents or numbers of training rooms differ; three of each, 10 seeds."""
    agents = ("one", "two", "three")
    cells = {(agent, count): [BaselineRun("sizes", "rung", "", agent, seed, BUDGET, float(value), None, 0.0, 1, 0.0,
                                          None, "") for seed, value in enumerate(draw(rng, RUNS))]
             for agent in (*agents, CHANCE) for count in (1, 10, 100)}
    return any(" reaches " in sentence for sentence in tell_room_numbers(cells, agents, dict.fromkeys(agents, CHANCE)))


@lru_cache(maxsize=8)
def _compute_mean(draw: Draw) -> float:
    return float(draw(np.random.default_rng(0), 1_000_000).mean())


def is_wrong_of_dial(draw: Draw, rng: np.random.Generator) -> bool:
    """Learned options that are worth a planned one that fails every other time are said to be worth more or less.

    Nine learners are alike after each of three budgets, 10 runs.
    """
    half, settings = _compute_mean(draw) / 2, find_study("learned").data["dial"]
    lines = [DialLine("room", PLANNED, 0, failure, 0, 2 * half * (1 - failure)) for failure in settings["failures"]]
    lines += [DialLine("room", agent, budget, None, seed, float(value) / 2) for agent in settings["algorithms"]
              for budget in (1, 2, 3) for seed, value in enumerate(draw(rng, RUNS))]
    told = conclude_dial(lines)
    placed = [(int(low), int(high)) for low, high in re.findall(r"\((\d+)% to (\d+)%\)", told)]
    return "Worth less" in told or any(not low <= 50 <= high for low, high in placed)


def make_price_runs(agent: str, scores: Sequence[float], buttons: int) -> list[PriceRun]:
    """Runs that get there sooner the more they score; below 0.1 they do not."""
    waits = [None if score < 0.1 else round(BUDGET * (1.1 - score)) for score in scores]
    return [PriceRun(agent, buttons, replicate, 30, BUDGET, wait or BUDGET, wait, wait, 1.0, 1, 1, 1.0, "")
            for replicate, wait in enumerate(waits)]


def is_wrong_of_price(draw: Draw, rng: np.random.Generator) -> bool:
    """The price of flatness is not 1, or grows with a button, where flat learners are as quick; 10 replicates."""
    runs = [run for buttons in BUTTON_COUNTS for agent in ("flat", "options")
            for run in make_price_runs(agent, draw(rng, RUNS).tolist(), buttons)]
    told = " ".join(conclude_prices(runs, [("flat", "options", cost) for cost in COSTS[:2]]))
    return " times the " in told or "multiplies the factor" in told


def is_wrong_of_chance(draw: Draw, rng: np.random.Generator) -> bool:
    """The same page distinguishes two random policies from the random policy; 10 runs each."""
    own, other, chance = (make_price_runs(agent, draw(rng, RUNS).tolist(), 1) for agent in ("one", "other", "random"))
    told = [compare_with_chance(learner, chance, "one", BUDGET // 2) for learner in (own, other)]
    return any("not told apart" not in words for words in told)


# --- from 2 to 20 buttons ----------------------------------------------------------------------


def make_scaling_run(agent: str, task: tuple[str, int, str], run: int, score: float) -> ScalingRun:
    """A run that is near the best with the whole graph the sooner the more it scores; below 0.1 it is not."""
    graph, buttons, rule = task
    wait = None if score < 0.1 else round(BUDGET * (1.1 - score))
    return ScalingRun(graph, buttons, rule, agent, run, "", 50.0, -1000.0, BUDGET, wait or BUDGET, 100, 1.0,
                      first_escape=wait, near_best=wait, edges=4, depth=3,
                      structure=((1, 1.0, 1.0),) if wait is not None else ())


def is_wrong_of_told(draw: Draw, rng: np.random.Generator) -> bool:
    """The page names a price of the knowledge of a structure agent, where it matters to none; 10 runs a label."""
    runs = [make_scaling_run(spec.label, task, run, float(score)) for task in TOLD_TASKS for spec in TOLD
            for run, score in enumerate(draw(rng, RUNS))]
    return any(cost.is_shown for cost in compute_told_costs(runs))


def is_wrong_of_difficulty(draw: Draw, rng: np.random.Generator) -> bool:
    """A measure orders rooms better than another, where each is a room's difficulty and its own error; 24 rooms."""
    runs = []
    for number, difficulty in enumerate(draw(rng, 24).tolist()):
        buttons, edges, depth = np.round(10 + 5 * (difficulty + rng.normal(0, 0.3, 3))).astype(int).tolist()
        score = 1.0 - min(1.0, max(0.0, difficulty))
        for agent, rule in ((agent, rule) for agent in AGENTS[:4] for rule in RULES):
            run = make_scaling_run(agent, ("layered", buttons, rule), number, score * rng.uniform(0.5, 1.0))
            runs.append(replace(run, edges=edges, depth=depth))
    told = " ".join(tell_difficulty(runs, rng))
    return "No measure is shown" not in told


def is_wrong_of_fresh_bar(draw: Draw, rng: np.random.Generator) -> bool:
    """Fresh runs of the bar do better or worse than the published ones, where all are alike; 10 and 10 runs."""
    fresh, published = ([make_scaling_run(BAR_AGENT, task, run, float(score)) for task in BAR
                         for run, score in enumerate(draw(rng, RUNS))] for _ in range(2))
    return any("than the published" in sentence for sentence in tell_replication(fresh, published))


PAGES: dict[str, Callable[[Draw, np.random.Generator], bool]] = {
    "claims of the paper": is_wrong_of_claims,
    "why it worsens": is_wrong_of_screening,
    "its paths": is_wrong_of_paths,
    "task hierarchies and their controls": lambda draw, rng: is_wrong_of_controls("hierarchies", draw, rng),
    "learned hierarchies and their controls": lambda draw, rng: is_wrong_of_controls("learned", draw, rng),
    "intra-option learning and its control": lambda draw, rng: is_wrong_of_controls("intra-option", draw, rng),
    "why it worsens: what suffices": is_wrong_of_sufficiency,
    "why it worsens: fresh runs": is_wrong_of_fresh_effects,
    "order of the ladder's rungs": is_wrong_of_rungs,
    "learned options on the dial": is_wrong_of_dial,
    "price of flatness": is_wrong_of_price,
    "price: escapes beside chance": is_wrong_of_chance,
    "what structure learners are told": is_wrong_of_told,
    "what makes rooms difficult": is_wrong_of_difficulty,
    "the bar with fresh runs": is_wrong_of_fresh_bar,
    "numbers of the ladder's buttons": is_wrong_of_numbers,
    "generalisation": is_wrong_of_generalisation,
}
"""Verdict -> whether one simulated page is wrong. New ones go to the end: the place in the list seeds the draws."""
