"""Calibration of all verdicts on simulated runs: how often they are wrong, and intervals miss.

    python benchmarks/calibration.py            # the tables of docs/metrics.md; some minutes
    python benchmarks/calibration.py --pages    # the second alone

Agents are identical, so any agent called better than another is an error, whatever sentence says so; the best of
several is picked by the same data. In the second table no claim and no factor has anything to it, and a page is wrong
if it answers or shows one. An interval misses where the truth lies outside.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hrl_escape.experiments.baselines.lines import BaselineRun
from hrl_escape.experiments.baselines.twin_studies import GIVEN_HIERARCHIES
from hrl_escape.experiments.baselines.twins import compare_twins
from hrl_escape.experiments.inference import compute_interval
from hrl_escape.experiments.pairs import compare_agents, is_better
from hrl_escape.experiments.presets import get_grid
from hrl_escape.experiments.statistics import compute_iqm, compute_mean
from hrl_escape.experiments.studies.claims import CLAIMS, FIGURES, judge_claims
from hrl_escape.experiments.studies.contrasts import make_screening_design
from hrl_escape.experiments.studies.factorial import get_factors, make_label, read_levels
from hrl_escape.experiments.studies.factorial_effects import Screening, compute_effects, measure_area
from hrl_escape.experiments.studies.mediation import compute_paths
from hrl_escape.experiments.studies.raw import BINS, OPTIMAL_SCORE, RawRun

Draw = Callable[[np.random.Generator, int], NDArray[np.float64]]


def make_bimodal(share: float) -> Draw:
    """Runs that end near 0.9 with this probability, near 0.05 otherwise."""

    def draw(rng: np.random.Generator, runs: int) -> NDArray[np.float64]:
        middle = np.where(rng.random(runs) < share, 0.9, 0.05)
        return np.clip(middle + rng.normal(0, 0.03, runs), 0, 1)

    return draw


SHAPES: dict[str, Draw] = {
    "all or nothing, 1 in 2": lambda rng, runs: (rng.random(runs) < 0.5).astype(np.float64),
    "bimodal, 1 in 2": make_bimodal(0.5),
    "bimodal, 7 in 10": make_bimodal(0.7),
    "bimodal, 9 in 10": make_bimodal(0.9),
    "skewed": lambda rng, runs: rng.beta(0.5, 3, runs),
    "narrow": lambda rng, runs: np.clip(rng.normal(0.9, 0.02, runs), 0, 1),
}


def count_false_verdicts(draw: Draw, agents: int, rooms: int, runs: int, trials: int, rng: np.random.Generator
                         ) -> float:
    """Share of comparisons of identical agents in which some agent is called better than another."""
    wrong = 0
    for _ in range(trials):
        finals = [{(str(room), seed): float(value) for room in range(rooms) for seed, value in
                   enumerate(draw(rng, runs))} for _ in range(agents)]
        pairs = compare_agents(finals, [True] * agents, rng, resamples=1)
        wrong += any(is_better(pair) for pair in itertools.chain.from_iterable(pairs))
    return wrong / trials


def measure_coverage(draw: Draw, rooms: int, runs: int, trials: int, rng: np.random.Generator) -> tuple[float, float]:
    """Share of intervals that hold the truth: of the interquartile mean, and of the mean."""
    found = []
    for statistic in (compute_iqm, compute_mean):
        truth = float(statistic([draw(rng, 400_000)]))
        hits = 0
        for _ in range(trials):
            low, high = compute_interval(statistic, [draw(rng, runs) for _ in range(rooms)], (0.0, 1.0), rng, 500)
            hits += bool(low <= truth <= high)
        found.append(hits / trials)
    return found[0], found[1]


# --- pages of studies ------------------------------------------------------------------------


def make_run(agent: str, room: str, seed: int, value: float) -> RawRun:
    """A run that scores the same from beginning to end."""
    evaluations = 11
    return RawRun(
        agent=agent, room=room, seed=seed, worst=-1000.0, best=0.0, axis="primitives", budget=1000,
        primitives=tuple(range(0, 1001, 100)), decisions=tuple(range(0, 101, 10)),
        returns=(1000 * (value - 1),) * evaluations, successes=(float(value > 0.5),) * evaluations,
        episodes=(1,) * BINS, training_returns=(1000 * (value - 1),) * BINS,
        training_successes=(int(value > 0.5),) * BINS, training_optimal=(int(value >= OPTIMAL_SCORE),) * BINS,
        first_escape=50 if value > 0.5 else None, efficiencies=(value,) * evaluations,
        training_efficiencies=(value,) * BINS)


def is_wrong_of_claims(draw: Draw, rng: np.random.Generator) -> bool:
    """The page of the paper answers a claim on which learners and chance are alike; 10 runs.

    These are the claims on differences between agents; shares of runs are compared with fixed levels.
    """
    results = {name: [make_run(agent.label, name, seed, float(score)) for agent in get_grid(name).agents
                      if not agent.is_reference for seed, score in enumerate(draw(rng, 10))] for name in FIGURES}
    chosen = [claim for claim in CLAIMS if "less that" in claim.measured]
    return any(verdict is not None for finding in judge_claims(chosen, results)
               for verdict in finding.verdicts.values())


def is_wrong_of_screening(draw: Draw, rng: np.random.Generator) -> bool:
    """The page on why SARSA worsens shows an effect of a factor, where none has any; 5 rooms, 2 seeds."""
    labels = [make_label("sarsa", row) for row in make_screening_design(len(get_factors("sarsa"))).tolist()]
    runs = [make_run(label, room, seed, float(value)) for room in "abcde" for seed in range(2)
            for label, value in zip(labels, draw(rng, len(labels)), strict=True)]
    return any(effect.is_shown for effect in compute_effects(Screening.make("sarsa", runs), measure_area))


def is_wrong_of_paths(draw: Draw, rng: np.random.Generator) -> bool:
    """The same page shows a path through the logs, where exploration moves a quantity that moves nothing else."""
    labels = [make_label("sarsa", row) for row in make_screening_design(len(get_factors("sarsa"))).tolist()]
    raised = [read_levels(label)[get_factors("sarsa").index("exploration")] for label in labels]
    runs = [replace(make_run(label, room, seed, float(value)), greedy=(0.5 + 0.1 * level + float(noise),) * BINS)
            for room in "abcde" for seed in range(5) for label, value, level, noise in
            zip(labels, draw(rng, len(labels)), raised, rng.normal(0, 0.1, len(labels)), strict=True)]
    return any(path.is_shown for path in
               compute_paths(Screening.make("sarsa", runs), ["exploration"], measure_area, rng, resamples=500))


def is_wrong_of_twins(draw: Draw, rng: np.random.Generator) -> bool:
    """The page of given hierarchies calls an agent better or worse than its twin; 10 runs in each of 4 rooms."""
    study, grid = GIVEN_HIERARCHIES, get_grid(GIVEN_HIERARCHIES.name)
    lines = [BaselineRun("per-instance", study.name, room.label, agent.label, seed, 1000, float(value), None,
                         float(value > 0.5), 1, float(value), round(1000 * (1 - float(value))) or None, "")
             for room in grid.rooms for agent in grid.agents if agent.learns
             for seed, value in enumerate(draw(rng, 10))]
    return any(contrast.is_shown for contrast in compare_twins(study, lines))


PAGES: dict[str, Callable[[Draw, np.random.Generator], bool]] = {
    "claims of the paper": is_wrong_of_claims,
    "why it worsens": is_wrong_of_screening,
    "its paths": is_wrong_of_paths,
    "hierarchies and their twins": is_wrong_of_twins,
}
"""Verdict -> whether one simulated page is wrong."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables as Markdown."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--trials", type=int, default=2_000)
    parser.add_argument("--pages", action="store_true", help="print the table of pages alone")
    chosen = parser.parse_args(arguments)
    if not chosen.pages:
        print_comparisons(chosen.trials, np.random.default_rng(15))
    print_pages(chosen.trials // 4)


def print_comparisons(trials: int, rng: np.random.Generator) -> None:
    """Print wrong verdicts and coverage."""
    print("| scores | wrong verdicts, 5 agents, 5, 8 and 10 runs | 7 agents, 2 rooms of 8 | IQM interval holds, 8 runs "
          "| in 3 rooms | mean's, 8 runs |\n|---|---|---|---|---|---|")
    for name, draw in SHAPES.items():
        wrong = " / ".join(f"{count_false_verdicts(draw, 5, 1, runs, trials, rng):.1%}" for runs in (5, 8, 10))
        more = count_false_verdicts(draw, 7, 2, 8, trials, rng)
        one, mean = measure_coverage(draw, 1, 8, trials // 4, rng)
        three, _ = measure_coverage(draw, 3, 8, trials // 4, rng)
        print(f"| {name} | {wrong} | {more:.1%} | {one:.1%} | {three:.1%} | {mean:.1%} |", flush=True)
    print()


def print_pages(trials: int) -> None:
    """Print the share of wrong pages; every number has draws of its own."""
    print(f"| scores | {' | '.join(PAGES)} |\n|---{'|---' * len(PAGES)}|")
    for row, (name, draw) in enumerate(SHAPES.items()):
        rngs = [np.random.default_rng([16, row, column]) for column in range(len(PAGES))]
        shares = [np.mean([is_wrong(draw, rng) for _ in range(trials)])
                  for is_wrong, rng in zip(PAGES.values(), rngs, strict=True)]
        print(f"| {name} | {' | '.join(f'{share:.1%}' for share in shares)} |", flush=True)


if __name__ == "__main__":
    main()
