"""Calibration of all verdicts on simulated runs: how often they are wrong, and intervals miss.

    python -m benchmarks.calibration                                # the tables of docs/metrics.md
    python -m benchmarks.calibration --pages                        # the second alone
    python -m benchmarks.calibration --pages "price of flatness"    # one row of it

Agents are identical, so any agent called better than another is an error, in any sentence; the best of
several is picked by the same data. The second table is of pages about runs without any difference
(`simulated_pages.py`). An interval misses where the truth lies outside.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.simulated_pages import PAGES, Draw
from hrl_escape.benchmark.inference import compare_agents, compute_interval, is_better
from hrl_escape.benchmark.statistics import compute_iqm, compute_mean


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
    """Share of comparisons of identical agents that call some agent better than another."""
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables as Markdown."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--trials", type=int, default=2_000)
    parser.add_argument("--pages", nargs="*", choices=PAGES, metavar="VERDICT",
                        help="print the table of pages alone, of all verdicts or of these")
    chosen = parser.parse_args(arguments)
    if chosen.pages is None:
        print_comparisons(chosen.trials, np.random.default_rng(15))
    print_pages(chosen.pages or list(PAGES), chosen.trials // 4)


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


def print_pages(names: Sequence[str], trials: int) -> None:
    """Print the share of wrong pages, a verdict a row; every number has draws of its own."""
    print(f"| verdict | {' | '.join(SHAPES)} |\n|---{'|---' * len(SHAPES)}|")
    for name in names:
        rngs = [np.random.default_rng([16, number, list(PAGES).index(name)]) for number in range(len(SHAPES))]
        shares = [np.mean([PAGES[name](draw, rng) for _ in range(trials)])
                  for draw, rng in zip(SHAPES.values(), rngs, strict=True)]
        print(f"| {name} | {' | '.join(f'{share:.1%}' for share in shares)} |", flush=True)


if __name__ == "__main__":
    main()
