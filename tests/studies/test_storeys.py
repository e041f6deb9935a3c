"""Room sequences: gains from data of other truths."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError
from studies.pages.unseen_rooms import RULES
from studies.statistics import compute_mean
from studies.storeys.analysis import FloorRun, analyse
from studies.study import find_study

STUDY = find_study("storeys")
DATA = STUDY.data


def make_lines(remembers: tuple[float, ...]) -> list[FloorRun]:
    """Forty sequences around these efficiencies by room; without memory, and when searching, they stay."""
    rng = np.random.default_rng(0)
    return [FloorRun(agent, repeats, floor, tuple(np.clip(mean + 0.05 * rng.normal(size=40), 0, 1).tolist()))
            for agent, repeats, means in ((DATA["ceiling"], True, remembers), (DATA["ceiling"], False, (0.8,) * 3),
                                          (DATA["searcher"], True, (0.7,) * 3))
            for floor, mean in enumerate(means, 1)]


@pytest.mark.parametrize(("remembers", "gain", "pays"), [
    ((0.8, 0.95, 0.96), 0.16, True), ((0.8, 0.8, 0.8), 0.0, False), ((0.9, 0.8, 0.7), -0.2, False)])
def test_memory_pays_only_where_efficiency_rises(remembers: tuple[float, ...], gain: float, pays: bool):
    numbers = analyse(STUDY, make_lines(remembers)).numbers
    assert numbers.remembering.mean == pytest.approx(gain, abs=0.02) and numbers.count == 40
    assert numbers.forgetting.low < 0 < numbers.forgetting.high
    assert RULES["memory-pays"](SimpleNamespace(storeys=numbers)) == pays


def test_a_rise_without_memory_refutes_the_finding():
    lines = make_lines((0.8, 0.95, 0.96))
    forgotten = [dataclasses.replace(line, repeats=False) for line in lines if line.repeats
                 and line.agent == DATA["ceiling"]]
    kept = [line for line in lines if line.repeats]
    assert not RULES["memory-pays"](SimpleNamespace(storeys=analyse(STUDY, [*kept, *forgotten]).numbers))


def test_one_lucky_sequence_is_no_gain():
    found = compute_mean(np.append(np.zeros(39), 0.2))
    assert found.low < 0 < found.mean < found.high


def test_a_room_that_was_not_played_is_missed():
    with pytest.raises(ComparisonError, match="not played in every room"):
        analyse(STUDY, make_lines((0.8, 0.9, 0.95))[1:])
