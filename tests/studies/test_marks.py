"""What marks teach: sentences from data of other truths, and real runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hrl_escape.errors import ComparisonError
from studies.marks.analysis import Args, MarksRun, gather, measure, run_once, tell, tell_all
from studies.running import open_store
from studies.study import find_study
from tests.studies.pages import tell as write_page

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


def say(*args, **changes) -> list[str]:
    return tell(*gather(ONE, make_lines(*args, **changes)).values())


def test_a_learner_above_the_searcher_has_learned_and_its_share_is_told():
    headline, *rest = say((0.6, 0.75, 0.91), 0.68)
    assert headline.startswith("What marks mean is learned across rooms. Trained in 1,000 rooms")
    assert "the best search baseline (0.70); the Bayes planner has 0.98, so its learned share is 7" in headline
    assert rest[0].startswith("From 1 to 1,000 training rooms efficiency rises by +0.3")
    assert rest[1].startswith("Trained in 1 room it is worse than the searcher, with 0.6")
    assert rest[2].startswith("From 16 to 1,000 training rooms efficiency rises by +0.1")
    assert rest[-1].startswith("True marks are worth +0.2")
    assert rest[-2].endswith("learner has 0.68, where the searcher has 0.70: at the searcher's level.")


def test_other_truths_give_other_sentences():
    assert say((0.5, 0.5, 0.5), 0.5)[0].startswith("What marks mean is not shown to be learned.")
    assert say((0.3, 0.4, 0.6), 0.5)[0].startswith("Some of what marks mean is learned, not enough to beat searching.")
    assert "as good" in say((0.5, 0.6, 0.7), 0.7, spread=0.1)[0]
    assert "From 16 to 1,000 training rooms no change is shown" in say((0.8, 0.9, 0.9), 0.7)[2]
    assert "From 16 to 1,000 training rooms efficiency falls by -0.1" in say((0.8, 0.9, 0.8), 0.7)[2]
    assert "something else carries over" in say((0.6, 0.8, 0.9), 0.85)[-2]
    assert say((0.6, 0.8, 0.9), 0.4)[-2].endswith("below the searcher.")
    assert "reaches above the Bayes planner" in say((0.6, 0.8, 0.99), 0.7, ceiling=0.9)[-3]
    assert say((0.6, 0.6, 0.6), 0.7)[-1].startswith("True marks are worth -0.1")
    assert "learned share" not in say((0.6, 0.8, 0.9), 0.7, ceiling=0.72)[0], "nothing lies between the two"


def test_what_a_larger_budget_is_worth_is_told_where_there_is_a_smaller_one():
    kind = STUDY.data["kind"][2]
    study = dataclasses.replace(STUDY, data={**DATA, "kind": [kind]})

    def compare(more: float, less: float) -> str:
        lines = make_lines((0.5, more), 0.6, kind=kind)
        small = make_lines((0.5, less), 0.6, kind={**kind, **kind["less"]})
        assert say((0.5, 0.6, more), 0.6)[-1].startswith("True marks"), "where there is one budget, none is compared"
        return tell(gather(study, [*lines, *small])[kind["title"]])[-1]

    larger, smaller = (f"`{learner}` with {rooms}" for learner, rooms in (
        (kind["learner"], "2,000,000 primitives in 256 rooms at once"),
        (kind["less"]["learner"], "30,000 primitives in one room at a time")))
    assert compare(0.85, 0.7).startswith(f"{larger} gains +0.1")
    assert f" over {smaller}, which reached 0.7" in compare(0.85, 0.7)
    assert compare(0.7, 0.7).startswith(f"{larger} is not shown to gain over {smaller}: ")


def test_where_places_tell_of_the_order_no_marks_are_spoken_of():
    (kind,) = (kind for kind in STUDY.data["kind"] if kind["title"] == "Places")
    study = dataclasses.replace(STUDY, data={**DATA, "kind": [kind]})
    for truth, begun in (((0.5, 0.9), "What places mean is learned"), ((0.5, 0.5), "What places mean is not shown"),
                         ((0.4, 0.66), "Some of what places mean is learned")):
        for control in (0.5, 0.9):
            said = " ".join(tell(gather(study, make_lines(truth, control, kind=kind))["Places"]))
            assert begun in said or control > truth[-1]
            assert "With places scattered the" in said and "True places are worth" in said
            assert "against scattered ones." in said and "marks" not in said.replace("marks-", "")


def test_the_headline_names_the_kinds_in_which_more_rooms_teach_more():
    def summarise(*truths: tuple[float, ...]) -> str:
        return tell_all({f"Kind {number}": gather(ONE, make_lines(truth, 0.7))[KIND["title"]]
                         for number, truth in enumerate(truths)}, 48)

    learned, flat = (0.5, 0.6, 0.9), (0.5, 0.9, 0.9)
    assert summarise(learned, learned, learned) == (
        "In these 48 unseen rooms the learner is above the best search baseline in 3 of 3 kinds. Intervals are over "
        "training seeds, so they do not cover other rooms. With kind 0, kind 1 and kind 2 efficiency rises "
        "by 0.2 or more from 16 to 1,000 training rooms, to above the searcher and below the Bayes planner.")
    two = summarise(flat, learned)
    assert "baseline in 2 of 2 kinds" in two and "With kind 1 efficiency" in two
    assert two.endswith("; with kind 0 this is not shown.")
    for truth, above in ((flat, 1), ((0.5, 0.75, 0.9), 1), ((0.1, 0.3, 0.65), 0), ((0.5, 0.6, 0.99), 1)):
        said = summarise(truth)
        assert f"baseline in {above} of 1 kinds" in said and "In none is it shown that efficiency rises" in said, (
            "no rise, too little, not above the searcher, not below the Bayes planner")


def test_missing_cells_are_refused():
    lines = make_lines((0.6, 0.8, 0.9), 0.7)
    for field, value in (("rooms", 16), ("agent", DATA["ceiling"]), ("rung", KIND["control"])):
        kept = [line for line in lines if getattr(line, field) != value]
        with pytest.raises(ComparisonError, match="are needed"):
            gather(ONE, kept)
    other = {**KIND, "title": "Another", "told": "marks-2/words"}
    both = dataclasses.replace(STUDY, data={**DATA, "kind": [KIND, other]})
    assert list(gather(both, lines)) == [KIND["title"]], "what is there is told of"


@pytest.mark.nightly
def test_a_page_of_another_truth_says_another_thing(tmp_path: Path):
    lines = {line.place: line for kind in STUDY.data["kind"] for line in make_lines((0.5, 0.5, 0.5), 0.5, kind=kind)}
    page = write_page("marks", list(lines.values()), tmp_path)
    assert f"the learner is above the best search baseline in 0 of {len(STUDY.data['kind'])} kinds" in page
    assert (tmp_path / "figures/marks.svg").stat().st_size > 10_000
    assert [page.count(f"What {clue} mean is not shown to be learned.") for clue in ("marks", "places")] == [
        len(STUDY.data["kind"]) - 1, 1]
    assert all(f"## {kind['title']}" in page for kind in STUDY.data["kind"])


def test_a_searcher_is_no_better_than_the_ceiling():
    searcher, ceiling = (run_once(agent, KIND["told"], 0, 0, 0, 3)
                         for agent in (DATA["searchers"][0], DATA["ceiling"]))
    assert 0 < searcher.efficiency < ceiling.efficiency <= 1 and searcher.escapes == 1


@pytest.mark.slow
def test_runs_are_made_once_and_to_the_bit(tmp_path: Path):
    kind = {**KIND, "sizes": [2], "primitives": 300}
    small = dataclasses.replace(STUDY, data={**DATA, "kind": [kind], "tested": 3, "runs": 1})
    store = open_store(small, tmp_path)
    for _ in range(2):
        measure(small, Args(), store)
        runs = {run.place: run for run in store.load()}
        assert len(runs) == 10 and store.path.read_text().count("\n") == 11
    learner = runs[KIND["learner"], KIND["told"], 2, 0]
    assert learner == run_once(KIND["learner"], KIND["told"], 2, 0, 300, 3)
    many = [run_once(KIND["learner"], KIND["told"], 2, 0, 300, 3, streams) for streams in (4, 4, 0)]
    assert many[0] == many[1] and many[2] == learner
