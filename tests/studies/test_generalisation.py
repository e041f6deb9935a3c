"""Generalisation: rules with data of other truths."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import pytest

from hrl_escape.benchmark.inference import Estimate
from hrl_escape.errors import ComparisonError
from studies.baseline import BaselineRun
from studies.generalisation.analysis import (
    AT_ONCE,
    CEILING,
    DEPTHS,
    FLAT,
    MEMORY,
    OBJECTS,
    SEARCH_BASELINES,
    TRANSFER,
    VECTORS,
    analyse,
    compare_cells,
    prefer_at_once,
)
from studies.pages.generalisation import RULES
from studies.study import find_study

STUDY = find_study("generalisation")
LINE = BaselineRun("sizes", "pair", "x/train#0..1 > x/test", VECTORS, 0, 500, 0.2, 1.0, 0.5, 3, 0.5, 70, "abc")


def test_learners_from_many_rooms_at_once_take_the_place_of_those_from_one():
    many = dataclasses.replace(LINE, agent=MEMORY + AT_ONCE, primitives=1_000_000, efficiency=0.8)
    alone = dataclasses.replace(LINE, agent=MEMORY, efficiency=0.4)
    assert prefer_at_once([alone, LINE, many]) == [LINE, dataclasses.replace(many, agent=MEMORY)]
    other = dataclasses.replace(alone, rung="chain-3")
    assert other in prefer_at_once([many, other]), "of another set"


def make_seeds(agent: str, rooms: int, efficiency: float, shift: int, **fields: Any) -> list[BaselineRun]:
    """Lines of ten seeds around an efficiency, by amounts that are shifted from seed to seed."""
    return [dataclasses.replace(LINE, agent=agent, rung="chain-3", rooms=f"x/train#0..{rooms} > x/test", seed=seed,
                                efficiency=efficiency + 0.01 * ((3 * seed + shift) % 10 - 4.5), **fields)
            for seed in range(10)]


def make_lines(memory: tuple[float, float] = (0.6, 0.8), objects: float = 0.2, flat: float = 0.0, bayes: float = 0.82,
               deep: float = 0.75) -> list[BaselineRun]:
    """Lines of all parts: with one room and with a thousand; search has 0.8 everywhere."""
    searcher = next(iter(SEARCH_BASELINES))
    lines = [line for number, (agent, rooms, value) in enumerate((
        (MEMORY, 1, memory[0]), (MEMORY, 1000, memory[1]), (OBJECTS, 1, objects), (OBJECTS, 1000, objects)))
        for line in make_seeds(agent, rooms, value, 3 * number)]
    lines += [dataclasses.replace(line, efficiency=flat) for line in make_seeds(FLAT, 1000, 0.0, 0)]
    lines += make_seeds(searcher, 1, 0.8, 0, primitives=0, seen=None)
    lines += [dataclasses.replace(LINE, protocol="depth", rung=kind, agent=agent, seed=seed, efficiency=value)
              for kind in DEPTHS
              for agent, value in ((MEMORY, deep), (OBJECTS, 0.0), *((name, 0.8) for name in SEARCH_BASELINES))
              for seed in range(2)]
    known = [*((name, 0.8) for name in SEARCH_BASELINES), *((name, bayes) for name in CEILING)]
    lines += [dataclasses.replace(LINE, protocol="transfer", rung=rung, agent=name, primitives=0, efficiency=value)
              for rung in TRANSFER for name, value in known]
    return lines + [
        dataclasses.replace(LINE, protocol="transfer", rung=target, agent=MEMORY + AT_ONCE,
                            rooms=f"ladder-1/{source}/train#0..8 > ladder-1/{target}/test#0..4",
                            efficiency=0.7 if source == target else 0.5) for source in TRANSFER for target in TRANSFER]


def find(doors: tuple[float, float, float] = (0.05, 0.02, 0.09), **truth: Any) -> SimpleNamespace:
    connected = SimpleNamespace(rungs={"doors": SimpleNamespace(headroom=Estimate(*doors))})
    return SimpleNamespace(generalisation=analyse(STUDY, make_lines(**truth)).numbers, connected_rooms=connected)


def test_gains_are_those_of_the_lines():
    numbers = find().generalisation
    assert numbers.gains["memory"].mean == pytest.approx(0.6, abs=0.01) and numbers.gains["memory"].sign == 1
    assert numbers.gains["rooms"].mean == pytest.approx(0.2, abs=0.01) and numbers.most == 1000
    assert numbers.depths[MEMORY, "8 buttons, layered"] == 0.75 and set(numbers.search.values()) == {0.8}
    assert all(rule(find()) for rule in RULES.values())


@pytest.mark.parametrize(("truth", "broken"), [
    ({"objects": 0.8}, {"memory-helps", "memory-before-rooms"}),
    ({"memory": (0.1, 0.8)}, {"memory-before-rooms"}),
    ({"memory": (0.6, 0.7)}, {"learner-matches-search"}),
    ({"bayes": 0.9}, {"little-headroom"}),
    ({"deep": 0.6}, {"depth-needs-memory"}),
    ({"flat": 0.1}, {"primitives-fail"}),
    ({"doors": (0.05, -0.01, 0.11)}, {"doors-headroom"}),
    ({"doors": (0.2, 0.15, 0.25)}, {"doors-headroom"}),
])
def test_other_truths_break_the_rules(truth: dict[str, Any], broken: set[str]):
    numbers = find(**truth)
    assert {name for name, rule in RULES.items() if not rule(numbers)} == broken


def test_two_questions_share_a_correction():
    """One question of p = 0.03 is answered; of two, Holm's correction leaves both open."""
    gains = [0.12, -0.02, 0.1, 0.03, -0.04, 0.14, 0.07, -0.03, 0.05, 0.06]
    cells = {("one", 1): dict.fromkeys(range(10), 0.5), ("two", 1): dict(enumerate(0.5 + gain for gain in gains))}
    question = (("two", 1), ("one", 1))
    assert compare_cells(cells, {"a": question})["a"].sign == 1
    assert {gain.sign for gain in compare_cells(cells, {"a": question, "b": question}).values()} == {0}


def test_missing_cells_are_refused():
    with pytest.raises(ComparisonError, match="there is no run of"):
        analyse(STUDY, [line for line in make_lines() if line.agent != OBJECTS])
