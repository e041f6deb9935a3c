"""References across rooms: jobs season by season, and normalised scores only where there is headroom."""

from __future__ import annotations

import copy
import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hrl_escape.benchmark.inference import Estimate
from hrl_escape.benchmark.references.count_cues import RoomOrder
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from studies.across.analysis import AcrossRun, analyse, list_jobs
from studies.across.attention import AttentionSettings, fit, weigh
from studies.across.candidates import count_wrong, list_candidates, run_candidate, search_room
from studies.pages.unseen_rooms import RULES
from studies.publishing import load_findings
from studies.study import find_study

STUDY = find_study("across")


def make_lines(search: float, counting: float, planner: float) -> list[AcrossRun]:
    rng, lines = np.random.default_rng(0), []
    for job in list_jobs(STUDY.data):
        if job.season < 6 and job.rung == "symbols":
            mean = planner if job.agent == "bayes" else counting if job.rooms else search
            lines.append(dataclasses.replace(job, efficiencies=tuple(np.clip(rng.normal(mean, 0.02, 8), 0, 1))))
    return lines


def test_jobs_go_season_by_season_and_name_each_cell_once():
    jobs = list(list_jobs(STUDY.data))
    assert [job.season for job in jobs] == sorted(job.season for job in jobs)
    assert len({job.place for job in jobs}) == len(jobs) == 13 * (20 * 5 + 10 * 2)


def test_scores_are_normalised_between_search_and_planner():
    found = analyse(STUDY, make_lines(0.6, 0.8, 0.9)).numbers.rungs["cues-1/symbols"]
    assert found.seasons == 6 and abs(found.normalised[16] - 2 / 3) < 0.1 and found.headroom.low > 0.1
    assert analyse(STUDY, make_lines(0.8, 0.85, 0.89)).numbers.rungs["cues-1/symbols"].normalised[16] is None


def test_learners_are_compared_with_counting_in_the_same_seasons():
    lines = [line for line in make_lines(0.6, 0.8, 0.9) if "press" not in line.agent or line.season < 5]
    own = analyse(STUDY, lines).numbers.rungs["cues-1/symbols"]
    assert own.seasons == 6 and own.learners[STUDY.data["learners"][0], 64].seasons == 4
    found = own.learners[STUDY.data["learners"][0], 16]
    assert found.minus_counting.low < 0 < found.minus_counting.high and abs(found.share - 2 / 3) < 0.1


def test_seasons_that_lack_a_cell_do_not_count():
    lines = make_lines(0.6, 0.8, 0.9)
    short = [line for line in lines if (line.season, line.agent) != (2, "bayes")]
    assert analyse(STUDY, short).numbers.rungs["cues-1/symbols"].seasons == 5


def test_attention_learns_an_order_that_only_a_lit_button_reveals():
    """The first button to light shows which of two orders of three symbols holds; counting symbols cannot know it."""
    rng, rooms = np.random.default_rng(0), []
    for number in range(60):
        cues = rng.permutation([1, 2, 3, 4]).tolist()
        first, rest = ([1], [3, 4, 2]) if number % 2 else ([2], [4, 3, 1])
        rooms.append(RoomOrder(tuple(cues), (0,) * 4, tuple(cues.index(symbol) for symbol in first + rest)))
    network = fit(rooms[:44], rooms[44:52], 0, AttentionSettings(width=16, heads=2, layers=1, epochs=80))
    right = 0
    for room in rooms[52:]:
        seen = room._replace(order=room.order[:1])
        off = [button for button in range(4) if button != room.order[0]]
        odds = weigh(network, seen, off)
        assert sum(odds) == pytest.approx(1, abs=1e-5)
        right += off[int(np.argmax(odds))] == room.order[1]
    assert right >= 7


def test_wrong_presses_are_counted_by_the_rules_of_the_puzzle():
    puzzle = ButtonsPuzzle(4, ((0, 1), (1, 2), (2, 3)), 3)
    assert count_wrong(lambda room, off: [-button for button in off], puzzle, np.random.default_rng(0)) == 0
    assert count_wrong(lambda room, off: list(off), puzzle, np.random.default_rng(0)) == 3 + 2 + 1
    mean = np.mean([count_wrong(lambda room, off: None, puzzle, np.random.default_rng(seed)) for seed in range(400)])
    assert mean == pytest.approx(1.5 + 1 + 0.5, abs=0.3), "half of the others at each step"
    found = [search_room(puzzle, np.random.default_rng(seed)) for seed in range(400)]
    assert np.mean([wrong for _, wrong in found]) == pytest.approx(1.5 + 1 + 0.5, abs=0.3)
    assert all(room.order == [0, 1, 2, 3] for room, _ in found)


def test_a_candidate_counts_in_training_rooms_and_is_tested_in_others():
    (job,) = [job for job in list_candidates(STUDY.data) if job.place == ("cues-1", 0, "colours", "counting", 16)]
    chance = dataclasses.replace(job, learner="random order", rooms=0)
    assert run_candidate(job).wrong < 0.5 < 3 < run_candidate(chance).wrong < 7


def make_page(**changes: float) -> SimpleNamespace:
    """Numbers of the page with the committed runs, and other gains of counting by name of the rung."""
    rungs = copy.deepcopy(load_findings("across").numbers.rungs)
    for name, gain in changes.items():
        own = rungs[f"cues-1/{name.replace('_', '-')}"]
        own.normalised[64], own.gains[64] = gain, Estimate(gain, gain - 0.02, gain + 0.02)
    return SimpleNamespace(across=SimpleNamespace(rungs=rungs))


def test_one_kind_of_cue_can_refute_what_counting_gains():
    assert RULES["counting-gains-half"](make_page()) and RULES["compare-with-counting"](make_page())
    assert not RULES["counting-gains-half"](make_page(latent_codes=0.45))
    assert not RULES["compare-with-counting"](make_page(noisy=0.01))


def test_a_gain_in_the_control_refutes_that_it_teaches_nothing():
    assert RULES["controls-teach-nothing"](make_page())
    assert not RULES["controls-teach-nothing"](make_page(symbols_control=0.05))


def test_a_family_where_counting_gains_refutes_that_they_are_hard():
    page = make_page()
    assert RULES["families-are-hard"](page)
    page.across.rungs["families-1/ignore-6"].gains[64] = Estimate(0.1, 0.05, 0.15)
    assert not RULES["families-are-hard"](page)


@pytest.mark.parametrize(("rung", "change", "rule"), [
    ("cues-1/noisy", {"share": 0.4}, "press-model-gains-half"),
    ("families-1/ignore-8", {"minus_counting": Estimate(0.05, -0.02, 0.12)}, "press-model-infers-graphs"),
    ("cues-1/symbols", {"minus_counting": Estimate(-0.06, -0.08, -0.04)}, "press-model-infers-codes"),
    ("cues-1/dependencies", {"minus_counting": Estimate(0.0, -0.02, 0.02)}, "press-model-falls-short")])
def test_other_results_of_the_press_model_refute_what_is_said_of_it(rung: str, change: dict[str, Any], rule: str):
    page = make_page()
    assert RULES[rule](page)
    vars(page.across.rungs[rung].learners["smdp-press-model+objects", 64]).update(change)
    assert not RULES[rule](page)
