"""The verdict says what the runs show, no more."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pytest

from hrl_escape.benchmark.summary import summarise
from hrl_escape.benchmark.verdict import write_verdict
from tests.benchmark.made_up import BEST, WORST, compare, make_result


def judge(agents: dict, **how: int) -> dict[str, list[str]]:
    sentences = write_verdict(summarise(compare(agents, **how)))
    kinds: dict[str, list[str]] = {"headline": [], "finding": [], "caution": []}
    for sentence in sentences:
        kinds[sentence.kind].append(sentence.text)
    assert len(kinds["headline"]) == 1
    return kinds


def runs(*finals: float) -> Sequence[Sequence[float]]:
    return [[WORST, value] for value in finals]


NEVER = runs(*[WORST] * 10)
GOOD = runs(80, 81, 81, 82, 82, 82, 83, 83, 84, 85)
CHANCE = runs(10, 12, 13, 14, 15, 15, 16, 17, 18, 20)


@pytest.mark.nightly
def test_options_that_help_and_what_learners_make_of_them_are_told_apart():
    said = judge({"random": NEVER, "dqn": NEVER, "random-options": CHANCE, "smdp-dqn": GOOD})
    assert said["headline"] == ["`smdp-dqn` is best: it escapes every time, in 19 primitives."]
    assert said["finding"][:2] == [
        "Without options no agent escapes: `random` and `dqn` never do within 1,000 primitives. With options, "
        "`smdp-dqn` escapes every time, in 19 primitives.",
        "Random choice among the options (`random-options`) escapes every time, in 86 primitives: that much comes from "
        "their planners. `smdp-dqn` shortens that to 19.",
    ]


@pytest.mark.nightly
@pytest.mark.parametrize(("baseline", "adds"), [(CHANCE, True), (GOOD, False), (runs(*[90] * 10), False)])
def test_that_learning_adds_is_said_of_who_beats_the_search_baseline(baseline, adds):
    said = judge({"random-options": CHANCE, "smdp-dqn": GOOD, "search-nearest": baseline})
    assert any("Learning adds to it: `smdp-dqn`" in text for text in said["finding"]) == adds
    assert any("`smdp-dqn` shortens that to 19." in text for text in said["finding"])


def test_learning_that_adds_nothing_is_not_praised():
    said = judge({"dqn": NEVER, "random-options": CHANCE, "smdp-dqn": CHANCE})
    assert said["headline"][0].startswith("`random-options` and `smdp-dqn` tie at an efficiency of 0.01")
    assert any("Best learner against it: no significant difference; `smdp-dqn`" in text for text in said["finding"])


@pytest.mark.nightly
def test_a_learner_worse_than_chance_is_named():
    said = judge({"random-options": CHANCE, "smdp-dqn": GOOD, "smdp-sarsa": runs(*[-500] * 10)})
    assert "`smdp-sarsa` ends below choosing at random." in said["finding"]
    said = judge({"random-options": GOOD, "smdp-dqn": CHANCE})
    assert said["headline"] == ["No learner matches `random-options`, which escapes every time, in 19 primitives."]
    assert any("No learner matches it" in text for text in said["finding"])


@pytest.mark.nightly
def test_options_that_do_not_help_are_said_not_to():
    said = judge({"dqn": GOOD, "random-options": CHANCE, "smdp-dqn": CHANCE})
    assert said["finding"][0].startswith("Options do not help here: `dqn` is more efficient than `smdp-dqn` by 0.04 (")


def test_overlapping_runs_are_not_significantly_different():
    said = judge({"dqn": runs(90, 92, 94, 96, 98, 90, 92, 94, 96, 98), "random-options": NEVER,
                  "smdp-dqn": runs(96, 90, 98, 92, 94, 98, 95, 90, 96, 97)})
    assert said["headline"] == ["No significant difference between `smdp-dqn` and `dqn`; the first escapes every time, "
                                "in 6 primitives."]
    assert said["finding"][0].startswith("With options against without: no significant difference; `smdp-dqn` has an ")


@pytest.mark.nightly
def test_ties_are_called_ties():
    best = runs(*[90] * 10)
    tied = judge({"random-options": CHANCE, "smdp-q-learning": best, "smdp-dqn": best, "search-backtrack": best})
    tied = tied["headline"]
    assert tied == ["`smdp-q-learning`, `smdp-dqn` and `search-backtrack` tie at an efficiency of 0.09: "
                    "`smdp-q-learning` escapes every time, in 11 primitives."]
    near = runs(60, 98, *[90] * 8)  # the same interquartile mean, another mean
    more = {name: best for name in ("dqn", "ppo", "sarsa", "ddpg", "rainbow")}
    assert judge(more)["headline"][0].startswith("`dqn`, `ppo`, `sarsa` and two others tie at an efficiency of 0.09")
    wide = runs(20, 99, 99, 20, 85, 92, 20, 95, 20, 85)
    said = judge({"dqn": best, "ppo": near, "sarsa": wide})["headline"]
    assert said == ["`dqn` and `ppo` tie at an efficiency of 0.09, with no significant difference from `sarsa`."]


def test_with_fewer_than_ten_runs_there_are_estimates_and_no_verdict():
    said = judge({"random-options": CHANCE[:9], "smdp-dqn": GOOD[:9], "search-backtrack": CHANCE[:9], "dqn": NEVER[:9]})
    assert re.fullmatch(r"`smdp-dqn` has the highest efficiency, 0\.05 \(0\.0\d to 0\.\d\d\)\. Nine runs a room are "
                        r"too few for a verdict, which takes 10\.", said["headline"][0])
    assert not [text for text in said["finding"] for word in ("better", "shortens", "matches", "adds") if word in text]
    assert any("`smdp-dqn` has an efficiency of 0.05 (" in text for text in said["finding"])
    assert any("with `--runs 10` the same command continues these runs" in text for text in said["caution"])
    assert judge({"dqn": NEVER, "smdp-dqn": GOOD})["headline"][0].startswith("`smdp-dqn` is best")


@pytest.mark.nightly
def test_no_interval_without_width_is_printed():
    """Ten equal differences have no spread to estimate an interval from."""
    said = judge({"dqn": runs(*[50] * 10), "smdp-dqn": runs(*[90] * 10), "random-options": NEVER})
    assert "`smdp-dqn` is more efficient than `dqn` by 0.07 with the same room and seed" in said["finding"][0]
    assert not [text for kind in said.values() for text in kind if re.search(r"\((\S+) to \1\)", text)]


def test_nobody_who_escapes_is_said_so():
    assert judge({"dqn": NEVER, "ppo": NEVER})["headline"] == ["No agent escapes within 1,000 primitives of training."]


def test_one_agent_alone_is_described_not_ranked():
    assert judge({"dqn": GOOD})["headline"] == ["`dqn` escapes every time, in 19 primitives."]
    assert judge({"dqn": [*GOOD[:5], *NEVER[:5]]})["headline"] == ["`dqn` escapes in 50% of episodes."]


def test_what_is_missing_is_split():
    said = judge({"smdp-dqn": [make_result([WORST, 61.0], best=91.0, reachable=81.0)] * 6})  # 10, 20 and 40
    assert ("`smdp-dqn` has an efficiency of 0.250, where the best known escape has 1; of the rest, 0.500 is out of "
            "reach of its options and 0.250 is left to learn.") in said["finding"]
    best = judge({"dqn": runs(*[BEST] * 6)})["finding"]
    assert any("is as efficient as the best known escape" in text for text in best)


def test_stuck_runs_are_counted():
    said = judge({"random-options": CHANCE, "smdp-dqn": [*GOOD[:4], *NEVER[:2]]})
    assert "No escape in the last fifth of training: 2 of 6 runs of `smdp-dqn`." in said["finding"]


def test_speed_counts_runs_that_never_escape_at_the_budget():
    said = judge({"dqn": [*[[WORST, BEST, BEST]] * 3, [WORST] * 3]})  # 500 three times, and 1,000
    assert ("First escape in training, on average, with runs that never escape counted at the budget: `dqn` after 625 "
            "primitives (3 of 4 runs escape).") in said["finding"]


@pytest.mark.nightly
def test_who_is_told_how_rooms_are_drawn_is_no_bar():
    learned = runs(60, 61, 62, 62, 62, 62, 62, 63, 63, 64)
    agents = {"search-nearest": CHANCE, "bayes": GOOD, "smdp-dqn": learned}
    (told,) = [text for text in judge(agents)["finding"] if "search baseline" in text]
    assert "`search-nearest`, escapes" in told and told.endswith("`smdp-dqn`, trained in this room, is better.")


@pytest.mark.nightly
def test_learners_are_measured_against_the_best_search_baseline():
    start = "The best search baseline, `search-nearest`, escapes every time, in "
    rule = ("It presses buttons that are off and untried since a light last changed, the nearest first, and forgets "
            "everything after an episode")
    worse = {"sweep": runs(*[-500] * 10), "oracle": runs(*[BEST] * 10)}
    said = judge({**worse, "search-nearest": CHANCE, "smdp-dqn": GOOD})
    assert f"{start}86 primitives. {rule}; `smdp-dqn`, trained in this room, is better." in said["finding"]
    said = judge({**worse, "search-nearest": GOOD, "smdp-dqn": CHANCE})
    assert f"{start}19 primitives. {rule}; no learner matches that." in said["finding"]
    assert said["headline"][0].startswith("No learner matches `search-nearest`")
    said = judge({**worse, "search-nearest": CHANCE, "smdp-dqn": CHANCE})
    assert any(text.startswith(f"{start}86 primitives. {rule}. Best learner against it: no significant difference; ")
               for text in said["finding"])
    rounds = judge({"sweep": GOOD, "search-nearest": CHANCE, "smdp-dqn": CHANCE})["finding"]
    assert any("`sweep`" in text and "It presses all buttons in the order of their numbers" in text
               for text in rounds)


def test_the_planner_that_knows_the_room_is_no_contender():
    said = judge({"oracle": runs(*[BEST] * 10), "random-options": CHANCE, "smdp-dqn": GOOD})
    assert said["headline"] == ["`smdp-dqn` is best: it escapes every time, in 19 primitives."]
    assert not any("Options" in text for text in said["finding"]), "the planner is no learner without options"
    assert not any("better way" in text for text in said["finding"]), "nor does it beat itself"


@pytest.mark.parametrize(
    ("agents", "caution"),
    [
        ({"dqn": GOOD[:5]}, "Five runs a room: with `--runs 10` the same command"),
        ({"dqn": [*GOOD[:4], None, None]}, "Some runs have no result and count nowhere: `dqn` 2 of 6."),
        ({"dqn": GOOD, "ppo": [None] * 10}, "Some runs have no result and count nowhere: `ppo` all 10."),
        ({"smdp-dqn": GOOD}, "No random policy over the same options was run for `smdp-dqn`"),
        ({"smdp-dqn": GOOD, "sweep": GOOD}, "No search baseline such as `search-memory` was run"),
        ({"dqn": [make_result([80.0], source="ceiling")] * 6}, "No plan is known for paper-two-button"),
    ],
)
def test_cautions(agents: dict, caution: str):
    assert any(text.startswith(caution) for text in judge(agents)["caution"])


@pytest.mark.nightly
def test_ten_clean_runs_beside_chance_need_no_caution():
    ten = runs(*range(80, 90))
    assert judge({"random-options": ten, "search-random": ten, "smdp-dqn": ten})["caution"] == []


def test_a_better_way_than_the_planners_is_told():
    said = judge({"dqn": [make_result([WORST, 90.0], best=50.0)] * 6})
    assert any(text.startswith("In paper-two-button, `dqn` found a better way than the planners")
               and text.endswith("(11 primitives).") for text in said["finding"])


def test_too_few_runs_of_one_rival_are_too_few_whatever_the_others_have():
    """With one rival the leader shares ten seeds, with the other nine."""
    said = judge({"dqn": [*NEVER[:9], None], "ppo": NEVER, "smdp-dqn": GOOD})
    assert "too few for a verdict" in said["headline"][0]
