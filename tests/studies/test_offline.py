"""The study of data sets: what it says follows from the numbers, whichever way they fall."""

from __future__ import annotations

import dataclasses

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
    tell_difference,
    tell_stitching,
    tell_unseen,
)
from studies.page import render
from studies.store import Store
from studies.study import find_study


def make_lines(efficiency, unseen=0.3):
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


def test_the_sentence_follows_the_sign_of_the_differences_and_their_certainty():
    rng = np.random.default_rng(0)
    low, high = 0.4 + 0.05 * rng.random(10), 0.7 + 0.05 * rng.random(10)
    assert tell_difference(high, low, "up", "down", "same").startswith("up (0.7")
    assert tell_difference(low, high, "up", "down", "same").startswith("down (0.4")
    assert tell_difference(low, low[::-1], "up", "down", "same").startswith("same")


@pytest.mark.parametrize(("options", "primitives", "words"), [
    (0.9, 0.2, "Q-iteration over options does better"), (0.2, 0.9, "Q-iteration over primitives does better"),
    (0.5, 0.5, "cannot be told apart")])
def test_the_horizon_is_told_by_what_was_measured(options, primitives, words):
    page = analyse(*make_lines(lambda agent, kind: options if agent.startswith("smdp-") else primitives))
    (sentence,) = [text for text in page.conclusions if "Horizon" in text and "Q-iteration" in text]
    assert words in sentence


@pytest.mark.parametrize(("cut", "words"), [
    (0.1, "cost some: "), (0.9, "help some: "), (0.5, "cost nothing that shows: ")])
def test_stitching_is_told_by_what_was_measured(cut, words):
    (told,) = list_stitching(lambda agent, kind: cut if kind == "stitch" else 0.5)
    assert words in told and told.count(f"(0.50 against {cut:.2f}, 10 rooms)") == 8
    assert "HIQL (" in told and "over primitives" not in told


def list_stitching(efficiency):
    return [text for text in analyse(*make_lines(efficiency)).conclusions if "Stitching" in text]


def test_learners_of_different_verdicts_on_stitching_are_told_apart():
    told = list_stitching(lambda agent, kind: 0.1 if kind == "stitch" and "best" in agent else
                          0.04 if "hiql" in agent else 0.5)
    assert told[0] == ("**Stitching.** Cut trajectories cost some: a clone of the best tenth (0.50 against 0.10, "
                       "10 rooms).")
    assert "cost nothing that shows: a clone of options (0.50 against 0.50, 10 rooms)," in told[1]
    assert told[2:] == ["**Stitching.** Too little is learned from whole trajectories to lose anything: HIQL (0.04 "
                        "against 0.04, 10 rooms)."]


def test_eight_questions_on_stitching_share_their_level():
    """Six rooms of six are worse when cut: p is 1/64, below the level of one question and above that of eight."""
    whole, cut = np.full(6, 0.6), np.array([0.5, 0.4, 0.5, 0.4, 0.5, 0.4])
    (alone,) = tell_stitching({"a": (whole, cut)})
    (together,) = tell_stitching({name: (whole, cut) for name in "abcdefgh"})
    assert "cost some" in alone and "cost nothing that shows" in together


@pytest.mark.nightly_for("0.99-The best searcher that learns nothing does better")
@pytest.mark.parametrize(("searcher", "words"), [(0.1, "than the best searcher finds out"),
                                                 (0.99, "The best searcher that learns nothing does better"),
                                                 (0.5, "cannot be told apart from the best searcher")])
def test_the_headline_asks_whether_the_best_learner_beats_the_best_searcher(searcher, words):
    page = analyse(*make_lines(lambda agent, kind: 0.5 if kind else searcher))
    assert words in page.conclusions[0]


@pytest.mark.nightly
def test_the_best_of_several_learners_is_held_against_the_best_of_several_searchers():
    def efficiency(agent, kind):
        return {"search-backtrack": 0.9, "smdp-fitted-q": 0.7}.get(agent, 0.5)

    page = analyse(*make_lines(efficiency))
    assert page.conclusions[0].startswith("The best searcher that learns nothing does better than Q-iteration over op")
    lucky = 0.5 + 0.1 * np.array([-1] + [1] * 9)  # by chance in 11 of 1,024 signs
    once, of_ten = (tell_difference(lucky, np.full(10, 0.5), "up", "down", "same", choices) for choices in (1, 10))
    assert once.startswith("up") and of_ten.startswith("same")


def test_pieces_that_begin_anywhere_are_given_no_efficiency():
    page = analyse(*make_lines(lambda agent, kind: 1.5 if (agent, kind) == (BEHAVIOUR, "stitch") else 0.5))
    (row,) = [line for line in page.values["table"].splitlines() if "(`behaviour`)" in line]
    assert row.split("|")[2:4] == [" 0.50 ", "  "]


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


def test_the_page_says_which_rooms_settings_were_chosen_in():
    study, lines = make_lines(lambda agent, kind: 0.5)
    other = dataclasses.replace(study, data={**study.data, "tuned_rooms": [70, 75]})
    assert "in rooms 70 to 74 of the data, which are not reported" in render(other, analyse(other, lines))


@pytest.mark.parametrize(("unseen", "words"), [(0.3, "does worse than"), (0.9, "does better than"),
                                               (0.6, "cannot be told apart from")])
def test_unseen_rooms_are_told_by_the_interval_of_the_best_network(unseen, words):
    assert words in analyse(*make_lines(lambda agent, kind: 0.5, unseen)).conclusions[-2]


def test_each_kind_of_data_has_its_best_network_in_unseen_rooms():
    def efficiency(agent, kind):
        best = {("smdp-iql passes=20", "expert"): 0.7, ("smdp-cql passes=20", "play"): 0.5,
                ("smdp-sharsa passes=20", "medium"): 0.4, ("smdp-cql passes=20", "noisy"): 0.6}
        return best.get((agent, kind), 0.3)

    *_, unseen, kinds = analyse(*make_lines(lambda agent, kind: 0.5, efficiency)).conclusions
    assert "IQL over options from `expert`, does better than the best searcher (0.70," in unseen
    assert kinds.startswith("**Which data.** In unseen rooms the best of each kind of data: CQL over options from "
                            "`play` (0.50), IQL over options from `expert` (0.70), SHARSA over options from "
                            "`medium` (0.40) and CQL over options from `noisy` (0.60).")


def test_one_network_that_is_best_of_all_kinds_of_data_is_said_to_be():
    levels = {"play": 0.5, "expert": 0.7, "medium": 0.6, "noisy": 0.4}
    *_, told = analyse(*make_lines(lambda agent, kind: 0.5, lambda agent, kind:
                                   levels[kind] if agent == "smdp-cql passes=20" else 0.3)).conclusions
    assert told == ("**Which data.** In unseen rooms one learner is the best of every kind of data: CQL over options, "
                    "0.70 from `expert`, 0.60 from `medium`, 0.50 from `play` and 0.40 from `noisy`.")


def test_the_best_of_many_networks_must_be_clearer_than_one_alone():
    """Ten seeds whose mean is 0.014 above the searcher: enough for one question, and not for twenty at once."""
    found = 0.5 + np.linspace(-0.02, 0.02, 10) + 0.014
    words = {f"learner {number}": f"learner {number}" for number in range(20)}
    alone = tell_unseen({("learner 0", "play"): found}, words, 0.5)[0]
    together = tell_unseen({(name, "play"): found - 0.1 * (name != "learner 0") for name in words}, words, 0.5)[0]
    assert "does better" in alone and "cannot be told apart" in together


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
