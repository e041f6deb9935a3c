"""What is learned in one season of a benchmark is worth nothing in another, and controls teach nothing at all."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.references.count_cues import CountTable
from hrl_escape.benchmark.room_intervals import compute_nested_interval
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.sampling.generation import sample_puzzle
from hrl_escape.sets.benchmark import load_benchmark
from studies.across.candidates import count_wrong, make_orders

SEASONS, TRAINED = 8, 64
RUNGS = [("cues-1", "colours"), ("cues-1", "symbols"), ("cues-1", "latent-codes"), ("cues-1", "noisy"),
         ("families-1", "ignore-6"), ("families-1", "ignore-8")]


def measure_gain(benchmark: str, rung: str, shift: int) -> Estimate:
    """Wrong presses that counting saves against a random order, with an interval over seasons.

    The table is learned `shift` seasons before the one in whose test rooms it is used. Nobody walks.
    """
    gains = []
    for season in range(SEASONS):
        taught = load_benchmark(f"{benchmark}@{(season - shift) % SEASONS}")[rung]
        tested = load_benchmark(f"{benchmark}@{season}")[rung]
        table, none = CountTable(make_orders(taught.train, TRAINED)), CountTable([])
        puzzles = [(sample_puzzle(tested.config, seed)[1], seed) for seed in tested.test.seeds]
        wrong = [[count_wrong(weigh, puzzle, np.random.default_rng(seed)) for puzzle, seed in puzzles
                  if isinstance(puzzle, ButtonsPuzzle)] for weigh in (none.weigh, table.weigh)]
        gains.append(np.array([np.mean(wrong[0]) - np.mean(wrong[1])]))
    return compute_nested_interval(gains)


@pytest.mark.nightly_for("colours", "latent-codes", "noisy", "ignore-8")
@pytest.mark.parametrize(("name", "rung"), RUNGS, ids=[rung for _, rung in RUNGS])
def test_counting_gains_in_its_own_season_and_not_in_another(name: str, rung: str):
    assert measure_gain(name, rung, 0).low > 0
    assert measure_gain(name, rung, 1).low <= 0


@pytest.mark.nightly_for("colours", "latent-codes", "noisy", "ignore-8")
@pytest.mark.parametrize(("name", "rung"), RUNGS, ids=[rung for _, rung in RUNGS])
def test_counting_gains_nothing_in_controls(name: str, rung: str):
    assert measure_gain(name, f"{rung}-control", 0).low <= 0
