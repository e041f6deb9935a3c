"""What cues teach: numbers and rules with data of other truths."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError
from studies.marks.analysis import Kind, MarksRun, gather
from studies.pages.unseen_rooms import RULES
from studies.study import find_study

STUDY = find_study("marks")
KIND = STUDY.data["kind"][0]
DATA = {**STUDY.data, "kind": [KIND]}
ONE = dataclasses.replace(STUDY, data=DATA)
SIZES = KIND["sizes"]


def make_lines(told: Sequence[float], control: float, searcher: float = 0.7, ceiling: float = 0.98,
               spread: float = 0.02, kind: Mapping[str, Any] = KIND) -> list[MarksRun]:
    """Ten runs a cell around these efficiencies, by numbers of training rooms; who does not learn has one."""
    rng = np.random.default_rng(4)

    def make(agent: str, rung: str, rooms: int, seed: int, value: float) -> MarksRun:
        return MarksRun(agent, rung, rooms, seed, 0, 64, value, 1.0)

    lines = [make(agent, rung, 0, 0, value) for rung in (kind["told"], kind["control"])
             for agent, value in ((DATA["searchers"][0], searcher), (DATA["searchers"][1], 0.5),
                                  (DATA["ceiling"], ceiling if rung == kind["told"] else searcher + 0.03))]
    for size, value in zip(kind["sizes"], told[-len(kind["sizes"]):], strict=True):
        lines += [make(kind["learner"], kind["told"], size, seed, value + spread * rng.normal()) for seed in range(10)]
    return lines + [make(kind["learner"], kind["control"], kind["sizes"][-1], seed, control + spread * rng.normal())
                    for seed in range(10)]


def find(*args: Any, **changes: Any) -> Kind:
    (found,) = gather(ONE, make_lines(*args, **changes)).values()
    return found


def test_cells_hold_what_was_measured():
    found = find((0.6, 0.75, 0.91), 0.68)
    assert [cell.mean for cell in found.told.values()] == pytest.approx([0.6, 0.75, 0.91], abs=0.02)
    assert found.most.low < 0.91 < found.most.high and found.control.mean == pytest.approx(0.68, abs=0.02)
    assert (found.searcher, found.control_searcher, found.ceiling) == (0.7, 0.7, 0.98)
    assert found.rise.mean == pytest.approx(0.16, abs=0.02) and found.rise.low > 0.1
    assert found.worth.mean == pytest.approx(0.23, abs=0.02) and found.worth.low > 0.2
    assert found.share == pytest.approx(0.75, abs=0.06) and found.less is None


def test_a_smaller_budget_stands_apart():
    kind = STUDY.data["kind"][2]
    study = dataclasses.replace(STUDY, data={**DATA, "kind": [kind]})
    lines = [*make_lines((0.5, 0.85), 0.6, kind=kind), *make_lines((0.5, 0.7), 0.6, kind={**kind, **kind["less"]})]
    (found,) = gather(study, lines).values()
    assert found.less is not None and found.less.high < found.most.low


def make_page(others: Mapping[str, Sequence[float]] | None = None, control: float = 0.68) -> Any:
    """Numbers of a page whose kinds are alike, but for some by the names of their sets."""
    told = {None: (0.5, 0.5, 0.9)} | dict(others or {})
    kinds = {kind["told"]: next(iter(gather(dataclasses.replace(STUDY, data={**DATA, "kind": [kind]}), [
        *make_lines(told.get(kind["told"].split("/")[1], told[None]), control, kind=kind),
        *(make_lines((0.5, 0.7), control, kind={**kind, **kind["less"]}) if "less" in kind else [])]).values()))
        for kind in STUDY.data["kind"]}
    return SimpleNamespace(marks=SimpleNamespace(kinds=kinds, shares=[kind.share for kind in kinds.values()]))


def test_one_kind_below_the_search_baseline_refutes_the_finding():
    assert RULES["all-beat-search"](make_page())
    assert not RULES["all-beat-search"](make_page({"wires": (0.5, 0.5, 0.69)}))


def test_rules_on_numbers_of_rooms_name_the_kinds():
    flat = {"told": (0.5, 0.9, 0.9), "places": (0.5, 0.6, 0.75), "wires": (0.5, 0.6, 0.75)}
    assert RULES["few-rooms-are-too-few"](make_page(flat))
    assert not RULES["few-rooms-are-too-few"](make_page({**flat, "words": (0.5, 0.8, 0.9)}))


def test_a_control_above_the_search_baseline_refutes_what_it_controls():
    assert RULES["ppo-gains-nothing-in-controls"](make_page())
    assert not RULES["ppo-gains-nothing-in-controls"](make_page(control=0.8))


def test_missing_cells_are_refused():
    lines = make_lines((0.6, 0.8, 0.9), 0.7)
    for field, value in (("rooms", 16), ("agent", DATA["ceiling"]), ("rung", KIND["control"])):
        with pytest.raises(ComparisonError, match="has no run of"):
            gather(ONE, [line for line in lines if getattr(line, field) != value])
