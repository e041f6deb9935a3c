"""The study of data sets: numbers follow the lines, and the page's rules follow the numbers."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import trim_mean

from hrl_escape.errors import ConfigError
from studies.offline.analysis import (
    BEHAVIOUR,
    LINES,
    UNSEEN,
    Args,
    OfflineResult,
    analyse,
    measure,
    name_unseen,
    run_once,
    run_unseen,
)
from studies.pages.offline import CUT, RULES
from studies.statistics import compute_mean
from studies.store import Store
from studies.study import find_study

BEST = ("smdp-cql passes=20", "medium")


def make_lines(efficiency, unseen: Any = 0.3):
    """Lines of ten rooms and ten seeds from (agent, kind) -> mean efficiency, all differing by a little."""
    study = find_study("offline")
    spread = np.linspace(-0.02, 0.02, 10)
    agents = [BEHAVIOUR, *study.data["learners"]]
    lines = [OfflineResult(agent, kind, run, efficiency(agent, kind) + spread[(run * 3) % 10])
             for agent in agents for kind in study.data["kinds"] for run in range(10)]
    lines += [OfflineResult(name, "", run, efficiency(name, "")) for name in study.data["searchers"]
              for run in range(10)]
    lines += [OfflineResult(agent, name_unseen(kind), run, (unseen if isinstance(unseen, float) else
                                                            unseen(agent, kind)) + spread[run])
              for agent in study.data["unseen"]["learners"] for kind in study.data["unseen"]["kinds"]
              for run in range(10)]
    return study, lines + [OfflineResult(name, UNSEEN, 0, 0.6) for name in study.data["searchers"]]


def find(efficiency, unseen: Any = 0.3):
    return SimpleNamespace(offline=analyse(*make_lines(efficiency, unseen)).numbers)


@pytest.mark.parametrize(("options", "primitives", "sign"), [(0.9, 0.2, 1), (0.2, 0.9, -1), (0.5, 0.5, 0)])
def test_the_horizon_is_what_was_measured(options, primitives, sign):
    numbers = find(lambda agent, kind: options if agent.startswith("smdp-") else primitives)
    assert {gain.sign for gain in numbers.offline.horizon.values()} == {sign}
    assert numbers.offline.horizon["smdp-iql"].mean == pytest.approx(options - primitives)
    assert RULES["options-help"](numbers) == (sign > 0)


def test_stitching_is_what_was_measured_and_one_family():
    numbers = find(lambda agent, kind: 0.1 if kind == "stitch" and agent in CUT else 0.5)
    signs = {agent: gain.sign for agent, gain in numbers.offline.stitching.items()}
    assert len(signs) == 8 and not any(name.startswith(("fitted-q", "iql")) for name in signs)
    assert {agent for agent, sign in signs.items() if sign} == set(CUT) and RULES["values-stitch"](numbers)
    assert not RULES["values-stitch"](find(lambda agent, kind: 0.1 if kind == "stitch" else 0.5))
    lucky = find(lambda agent, kind: 0.5).offline.stitching
    assert all(gain.low <= 0 <= gain.high for gain in lucky.values())


def test_the_best_search_baseline_counts_and_no_planner_that_is_given_how_rooms_are_drawn():
    study, lines = make_lines(lambda agent, kind: 0.5)
    lines = [dataclasses.replace(line, efficiency={"search-backtrack": 0.7, "bayes": 0.9}.get(line.agent, 0.5))
             if line.kind == UNSEEN else line for line in lines]
    assert analyse(study, lines).numbers.unseen_search == pytest.approx(0.7)


def test_pieces_that_begin_anywhere_have_no_efficiency_of_their_own():
    found = analyse(*make_lines(lambda agent, kind: 1.5 if (agent, kind) == (BEHAVIOUR, "stitch") else 0.5))
    (row,) = [line for line in found.tables["rooms"].splitlines() if "recorded play" in line]
    assert row.split("|")[3:5] == [" 0.50 ", "  "]


@pytest.mark.parametrize(("unseen", "wins"), [(0.3, True), (0.9, False), (0.6, False)])
def test_search_wins_outside_only_beyond_the_interval_of_every_network(unseen, wins):
    assert RULES["search-wins-outside"](find(lambda agent, kind: 0.5, unseen)) == wins
    one = find(lambda agent, kind: 0.5, lambda agent, kind: 0.9 if (agent, kind) == BEST else 0.3)
    assert not RULES["search-wins-outside"](one) and one.offline.best.mean == pytest.approx(0.9)


def test_the_transformer_must_lead_with_every_data_set():
    leads = find(lambda agent, kind: 0.5, lambda agent, kind: 0.5 if "transformer" in agent else 0.3)
    assert RULES["the-transformer-leads"](leads)
    once = find(lambda agent, kind: 0.5, lambda agent, kind: 0.6 if (agent, kind) == BEST else
                0.5 if "transformer" in agent else 0.3)
    assert not RULES["the-transformer-leads"](once)


def test_intervals_of_the_best_of_many_networks_are_wider():
    values = np.array([0.4, 0.5, 0.6])
    alone, together = compute_mean(values), compute_mean(values, 1 - 0.05 / 24)
    assert alone.mean == together.mean and together.low < alone.low < alone.high < together.high


def test_rooms_that_settings_were_chosen_in_are_never_reported(tmp_path):
    study, store = find_study("offline"), Store(tmp_path / "raw.jsonl", LINES)
    assert study.data["runs"] <= study.data["tuned_rooms"][0]
    alone = {"learners": {}, "searchers": [], "unseen": {**study.data["unseen"], "learners": {}}}  # the data, rated
    small = dataclasses.replace(study, data={**study.data, **alone, "tuned_rooms": [1, 3]})
    with pytest.raises(ConfigError, match="runs = 2 .* at most 1, since settings were chosen in the rooms from 1 on"):
        measure(small, Args(runs=2), store)
    assert not store.load()
    measure(small, Args(runs=1), store)
    assert [line.run for line in store.load()] == [0]


@pytest.mark.slow
def test_tables_come_to_the_values_that_were_computed_elsewhere():
    """Random play in ten rooms of `pair`, some fourteen episodes each.

    After ten episodes an independent program gave interquartile means of 0.49 for the play itself, 0 for its clone,
    0.69 for a clone of its best tenth (0.92 after a hundred) and 0.93 for Q-iteration over its options.
    """
    found = {agent: trim_mean([run_once(agent, "play", "pair", room, 2).efficiency for room in range(10)], 0.25)
             for agent in (BEHAVIOUR, "smdp-behaviour-cloning", "smdp-behaviour-cloning best=0.1", "smdp-fitted-q")}
    assert found[BEHAVIOUR] == pytest.approx(0.49, abs=0.08)
    assert found["smdp-behaviour-cloning"] < 0.2
    assert 0.69 < found["smdp-behaviour-cloning best=0.1"] < 0.92  # after ten, and after a hundred episodes
    assert found["smdp-fitted-q"] == pytest.approx(0.93, abs=0.03)


@pytest.mark.slow
def test_a_network_learns_from_all_rooms_and_escapes_from_others():
    untrained, trained = (run_unseen(f"smdp-iql passes={passes}", "play", "pair", 0, 32) for passes in (1, 20))
    assert trained.efficiency > untrained.efficiency + 0.1
