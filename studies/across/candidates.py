"""Candidates that learn across rooms, compared by their wrong presses in unseen rooms, without walking.

Orders and symbols come from the benchmark's rooms. A learner presses its likeliest button that is off and was not
tried since a light last changed; wrong presses have no effect. Positions are left out, so rungs that need them are not
measured here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch

from hrl_escape.agents.components.press_tables import PressTables, RoomPresses, TableSettings, fit_press_tables
from hrl_escape.benchmark.references.count_cues import CountTable, RoomOrder
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.sampling.generation import sample_puzzle
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.instance_set import InstanceSet
from studies.across.attention import fit, weigh
from studies.store import Line

__all__ = ["CandidateRun", "count_wrong", "list_candidates", "make_orders", "run_candidate",
           "search_room"]

CHANCE, COUNTING, ATTENTION, ONE_TASK, PRESSES = (
    "random order", "counting", "attention", "press model, one task", "press model")
Weigh = Callable[[RoomOrder, Sequence[int]], Sequence[float] | None]
CUES = ("symbol", "plug", "number")
"""Kinds of tables without positions."""


@dataclasses.dataclass(frozen=True)
class CandidateRun(Line):
    """Wrong presses of a learner in the test rooms of a season.

    Attributes:
        benchmark: name.
        season: number.
        rung: name.
        learner: name.
        rooms: training rooms.
        wrong: mean wrong presses in a test room.
    """

    benchmark: str
    season: int
    rung: str
    learner: str
    rooms: int
    wrong: float

    PLACE = ("benchmark", "season", "rung", "learner", "rooms")


def list_candidates(data: Mapping[str, Any]) -> Iterator[CandidateRun]:
    """Lines without results, season by season."""
    for season in range(data["seasons"]):
        for benchmark, rungs in data["candidates"].items():
            for rung in rungs:
                yield CandidateRun(benchmark, season, rung, CHANCE, 0, 0.0)
                for rooms in data["train_sizes"]:
                    for learner in (COUNTING, ATTENTION, ONE_TASK, PRESSES):
                        yield CandidateRun(benchmark, season, rung, learner, rooms, 0.0)


def run_candidate(job: CandidateRun) -> CandidateRun:
    """Train a learner on orders of training rooms, and count its wrong presses in all test rooms."""
    rung = load_benchmark(f"{job.benchmark}@{job.season}")[job.rung]
    tested = [(_sample(rung.config, seed), seed) for seed in rung.test.seeds]
    if job.learner in (ONE_TASK, PRESSES):
        torch.set_num_threads(1)
        settings = TableSettings(tasks=1) if job.learner == ONE_TASK else TableSettings()
        searched = [search_room(_sample(rung.config, seed), np.random.default_rng(seed))[0]
                    for seed in rung.train.seeds[: job.rooms]]
        tables = fit_press_tables(searched, settings, len(searched[0].sectors), job.season, CUES)
        presses = [search_room(puzzle, np.random.default_rng(seed), tables)[1] for puzzle, seed in tested]
        return dataclasses.replace(job, wrong=round(float(np.mean(presses)), 4))
    weigh_by: Weigh = CountTable([]).weigh  # no odds, so a random order
    if job.learner == COUNTING:
        weigh_by = CountTable(make_orders(rung.train, job.rooms)).weigh
    elif job.learner == ATTENTION:
        torch.set_num_threads(1)
        network = fit(make_orders(rung.train, job.rooms), make_orders(rung.valid, len(rung.valid)), job.season)
        weigh_by = partial(weigh, network)
    wrong = [count_wrong(weigh_by, puzzle, np.random.default_rng(seed)) for puzzle, seed in tested]
    return dataclasses.replace(job, wrong=round(float(np.mean(wrong)), 4))


def search_room(puzzle: ButtonsPuzzle, rng: np.random.Generator, tables: PressTables | None = None
                ) -> tuple[RoomPresses, int]:
    """Press the likeliest button until the goal is on, and return the presses and the number of wrong ones.

    Without tables every button that is not known to fail is as likely.
    """
    room, off, wrong = RoomPresses.begin(puzzle.cues, (0,) * puzzle.count), np.ones(puzzle.count, dtype=bool), 0
    while off[puzzle.goal]:
        odds = off.astype(np.float64) if tables is None else np.prod(tables.predict(room, off), axis=0)
        odds += rng.random(puzzle.count) * 1e-9
        button = max((int(each) for each in np.flatnonzero(off) if not room.fails(int(each), off)),
                     key=lambda each: odds[each])
        has_lit = not any(puzzle.parent_masks[button] >> int(other) & 1 for other in np.flatnonzero(off))
        room.note(button, off, has_lit, has_lit and button == puzzle.goal)
        off[button], wrong = not has_lit, wrong + (not has_lit)
    return room, wrong


def make_orders(rooms: InstanceSet, count: int) -> list[RoomOrder]:
    """Draw the order that search finds in each of the first rooms of a set: at random among buttons that can light."""
    return [_draw_order(_sample(rooms.config, seed), np.random.default_rng(seed)) for seed in rooms.seeds[:count]]


def _sample(config: RoomConfig, seed: int) -> ButtonsPuzzle:
    puzzle = sample_puzzle(config, seed)[1]
    assert isinstance(puzzle, ButtonsPuzzle)
    return puzzle


def _draw_order(puzzle: ButtonsPuzzle, rng: np.random.Generator) -> RoomOrder:
    order: list[int] = []
    while puzzle.goal not in order:
        lit = sum(1 << button for button in order)
        order.append(int(rng.choice([button for button in range(puzzle.count) if button not in order
                                     and not puzzle.parent_masks[button] & ~lit])))
    return RoomOrder(tuple(puzzle.cues), (0,) * puzzle.count, tuple(order))


def count_wrong(weigh_by: Weigh, puzzle: ButtonsPuzzle, rng: np.random.Generator) -> int:
    """Wrong presses until the goal is on; ties and missing odds are broken at random."""
    order: list[int] = []
    wrong = 0
    while puzzle.goal not in order:
        off = [button for button in range(puzzle.count) if button not in order]
        odds = weigh_by(RoomOrder(tuple(puzzle.cues), (0,) * puzzle.count, tuple(order)), off)
        ranks = rng.random(len(off)) * 1e-9 + (np.zeros(len(off)) if odds is None else np.array(odds))
        lit = sum(1 << button for button in order)
        for number in np.argsort(-ranks):
            if not puzzle.parent_masks[off[number]] & ~lit:
                order.append(off[number])
                break
            wrong += 1
    return wrong
