"""The verdict says what the runs show, no more."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from hrl_escape.comparison.summary import summarise
from hrl_escape.comparison.verdict import write_verdict
from tests.comparison.made_up import BEST, WORST, compare, make_result


def judge(agents: dict, **how: int) -> dict[str, list[str]]:
    sentences = write_verdict(summarise(compare(agents, **how)))
    kinds: dict[str, list[str]] = {"headline": [], "finding": [], "caution": []}
    for sentence in sentences:
        kinds[sentence.kind].append(sentence.text)
    assert len(kinds["headline"]) == 1
    return kinds


def runs(*finals: float) -> Sequence[Sequence[float]]:
    return [[WORST, value] for value in finals]


NEVER = runs(*[WORST] * 6)
GOOD = runs(80, 81, 82, 82, 84, 85)
CHANCE = runs(10, 12, 14, 16, 18, 20)


@pytest.mark.in_turn
def test_options_that_help_and_what_learners_make_of_them_are_told_apart():
    said = judge({"random": NEVER, "dqn": NEVER, "smdp-random": CHANCE, "smdp-dqn": GOOD})
    assert said["headline"] == ["`smdp-dqn` is best: it escapes every time, in 19 primitives."]
    assert said["finding"][:2] == [
        "Without options nobody escapes: `random` and `dqn` never do within 1,000 primitives. With options, `smdp-dqn` "
        "escapes every time, in 19 primitives.",
        "Choosing among the options at random (`smdp-random`) already escapes every time, in 86 primitives: that much "
        "comes from their planners. `smdp-dqn` shortens that to 19.",
    ]


@pytest.mark.parametrize(("searcher", "adds"), [(CHANCE, True), (GOOD, False), (runs(*[90] * 6), False)])
def test_that_learning_adds_is_said_of_who_beats_the_searcher(searcher, adds):
    said = judge({"smdp-random": CHANCE, "smdp-dqn": GOOD, "smdp-untried-nearest": searcher})
    assert any("Learning adds to it: `smdp-dqn`" in text for text in said["finding"]) == adds
    assert any("`smdp-dqn` shortens that to 19." in text for text in said["finding"])


def test_learning_that_adds_nothing_is_not_praised():
    said = judge({"dqn": NEVER, "smdp-random": CHANCE, "smdp-dqn": CHANCE})
    assert "cannot be told apart" in said["headline"][0]
    assert any("These runs do not show that learning adds anything" in text for text in said["finding"])


def test_a_learner_worse_than_chance_is_named():
    said = judge({"smdp-random": CHANCE, "smdp-dqn": GOOD, "smdp-sarsa": runs(*[-500] * 6)})
    assert "`smdp-sarsa` ends below choosing at random." in said["finding"]
    said = judge({"smdp-random": GOOD, "smdp-dqn": CHANCE})
    assert said["headline"] == ["Nothing that learns beats `smdp-random`, which escapes every time, in 19 primitives."]
    assert any("No learner matches it" in text for text in said["finding"])


def test_options_that_do_not_help_are_said_not_to():
    said = judge({"dqn": GOOD, "smdp-random": CHANCE, "smdp-dqn": CHANCE})
    assert said["finding"][0].startswith("Options do not help here: `dqn` is more efficient than `smdp-dqn` by 0.04 (")


def test_overlapping_runs_are_not_told_apart():
    said = judge({"dqn": runs(80, 82, 84, 86, 88), "smdp-dqn": runs(86, 80, 89, 82, 84), "smdp-random": NEVER[:5]})
    assert said["headline"][0].startswith("`dqn` and `smdp-dqn` cannot be told apart; the first escapes every time")
    assert said["finding"][0].startswith("Whether options help cannot be told from these runs")


def test_several_that_cannot_be_told_from_the_leader_are_counted():
    said = judge({"dqn": runs(10, 30, 50, 70, 90), "ppo": runs(71, 12, 92, 31, 53), "sarsa": runs(51, 69, 11, 91, 29)})
    assert said["headline"] == ["No clear winner: `ppo` is ahead, but not clearly of two others."]


def test_four_runs_are_too_few_even_if_cleanly_apart():
    said = judge({"dqn": NEVER[:4], "smdp-dqn": GOOD[:4]})
    assert said["headline"] == ["`smdp-dqn` is most efficient, but four runs a room are too few to be sure."]
    assert judge({"dqn": NEVER[:5], "smdp-dqn": GOOD[:5]})["headline"][0].startswith("`smdp-dqn` is best")


def test_nobody_who_escapes_is_said_so():
    assert judge({"dqn": NEVER, "ppo": NEVER})["headline"] == ["Nobody escapes within 1,000 primitives of training."]


def test_one_agent_alone_is_described_not_ranked():
    assert judge({"dqn": GOOD})["headline"] == ["`dqn` escapes every time, in 19 primitives."]
    assert judge({"dqn": [*GOOD[:3], *NEVER[:3]]})["headline"] == ["`dqn` escapes in 50% of episodes."]


def test_what_is_missing_is_split():
    said = judge({"smdp-dqn!": [make_result([WORST, 61.0], best=91.0, reachable=81.0)] * 6})  # 10, 20 and 40
    assert ("`smdp-dqn` has an efficiency of 0.250, where the best known escape has 1; of the rest, 0.500 is out of "
            "reach of its options and 0.250 is left to learn.") in said["finding"]
    assert any("nothing is missing" in text for text in judge({"dqn": runs(*[BEST] * 6)})["finding"])


def test_stuck_runs_are_counted():
    said = judge({"smdp-random": CHANCE, "smdp-dqn": [*GOOD[:4], *NEVER[:2]]})
    assert "No escape in the last fifth of training: 2 of 6 runs of `smdp-dqn`." in said["finding"]


def test_speed_counts_runs_that_never_escape_at_the_budget():
    said = judge({"dqn": [*[[WORST, BEST, BEST]] * 3, [WORST] * 3]})  # 500 three times, and 1,000
    assert ("First escape in training, on average, with runs that never escape counted at the budget: `dqn` after 625 "
            "primitives (3 of 4 runs escape).") in said["finding"]


def test_who_is_told_how_rooms_are_drawn_is_no_bar():
    agents = {"smdp-untried-nearest": CHANCE, "smdp-bayes": GOOD, "smdp-dqn": runs(60, 61, 62, 62, 63, 64)}
    (told,) = [text for text in judge(agents)["finding"] if "best searcher" in text]
    assert "(`smdp-untried-nearest`, which" in told and told.endswith("`smdp-dqn` is better.")


@pytest.mark.in_turn
def test_learners_are_measured_against_the_best_searcher_that_learns_nothing():
    start = ("The best searcher that learns nothing (`smdp-untried-nearest`, which presses what is unlit and untried "
             "since the lights last changed, the nearest first) escapes every time, in ")
    worse = {"smdp-index-order": runs(*[-500] * 6), "planner": runs(*[BEST] * 6)}
    said = judge({**worse, "smdp-untried-nearest": CHANCE, "smdp-dqn": GOOD})
    assert start + "86 primitives; `smdp-dqn` is better." in said["finding"]
    said = judge({**worse, "smdp-untried-nearest": GOOD, "smdp-dqn": CHANCE})
    assert start + "19 primitives; no learner matches that." in said["finding"]
    assert said["headline"][0].startswith("Nothing that learns beats `smdp-untried-nearest`")
    said = judge({**worse, "smdp-untried-nearest": CHANCE, "smdp-dqn": CHANCE})
    assert start + "86 primitives; these runs do not show that any learner does better." in said["finding"]
    rounds = judge({"smdp-index-order": GOOD, "smdp-untried-nearest": CHANCE, "smdp-dqn": CHANCE})["finding"]
    assert any("`smdp-index-order`, which presses all buttons in the order of their numbers" in text for text in rounds)


def test_the_planner_that_knows_the_room_is_no_contender():
    said = judge({"planner": runs(*[BEST] * 6), "smdp-random": CHANCE, "smdp-dqn": GOOD})
    assert said["headline"] == ["`smdp-dqn` is best: it escapes every time, in 19 primitives."]
    assert not any("Options" in text for text in said["finding"]), "the planner is no learner without options"
    assert not any("better way" in text for text in said["finding"]), "nor does it beat itself"


@pytest.mark.parametrize(
    ("agents", "caution"),
    [
        ({"dqn": GOOD[:5]}, "Five runs a room: large differences show"),
        ({"dqn": [*GOOD[:4], None, None]}, "Some runs have no result and count nowhere: `dqn` 2 of 6."),
        ({"dqn": GOOD, "ppo": [None] * 6}, "Some runs have no result and count nowhere: `ppo` all 6."),
        ({"smdp-dqn": GOOD}, "No random policy over the same options was run beside `smdp-dqn`"),
        ({"smdp-dqn": GOOD, "smdp-index-order": GOOD}, "No searcher such as `smdp-untried-nearest` was run beside the"),
        ({"dqn": [make_result([80.0], source="ceiling")] * 6}, "No plan is known for paper-two-button"),
    ],
)
def test_cautions(agents: dict, caution: str):
    assert any(text.startswith(caution) for text in judge(agents)["caution"])


def test_ten_clean_runs_beside_chance_need_no_caution():
    ten = runs(*range(80, 90))
    assert judge({"smdp-random": ten, "smdp-untried": ten, "smdp-dqn": ten})["caution"] == []


def test_a_better_way_than_the_planners_is_told():
    said = judge({"dqn": [make_result([WORST, 90.0], best=50.0)] * 6})
    assert any(text.startswith("In paper-two-button, `dqn` found a better way than the planners")
               and text.endswith("(11 primitives).") for text in said["finding"])


def test_too_few_runs_of_one_rival_are_too_few_whatever_the_others_have():
    """With one rival the leader shares ten seeds, with the other four."""
    said = judge({"dqn": NEVER[:4], "ppo": [*NEVER, *NEVER][:10], "smdp-dqn": [*GOOD, *GOOD][:10]})
    assert said["headline"][0].endswith("too few to be sure.")
