"""The verdict says what the runs show, no more."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from hrl_escape.experiments.summary import summarise
from hrl_escape.experiments.verdict import write_verdict
from tests.experiments.made_up import BEST, WORST, compare, make_result


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
GOOD = runs(80, 81, 82, 83, 84, 85)
CHANCE = runs(10, 12, 14, 16, 18, 20)


def test_options_that_help_and_learning_that_adds_to_them_are_told_apart():
    said = judge({"random": NEVER, "dqn": NEVER, "smdp-random": CHANCE, "smdp-dqn": GOOD})
    assert said["headline"] == ["`smdp-dqn` is best: it escapes every time, in 18 primitives."]
    assert said["finding"][:2] == [
        "Without options nobody escapes: `random` and `dqn` never do within 1,000 primitives. With options, `smdp-dqn` "
        "escapes every time, in 18 primitives.",
        "Choosing among the options at random (`smdp-random`) already escapes every time, in 85 primitives: that much "
        "their planners know. Learning adds to it: `smdp-dqn` shortens that to 18.",
    ]


def test_learning_that_adds_nothing_is_not_praised():
    said = judge({"dqn": NEVER, "smdp-random": CHANCE, "smdp-dqn": CHANCE})
    assert "cannot be told apart" in said["headline"][0]
    assert any("That learning adds anything is not shown" in text for text in said["finding"])


def test_a_learner_worse_than_chance_is_named():
    said = judge({"smdp-random": CHANCE, "smdp-dqn": GOOD, "smdp-sarsa": runs(*[-500] * 6)})
    assert "`smdp-sarsa` ends below choosing at random." in said["finding"]
    said = judge({"smdp-random": GOOD, "smdp-dqn": CHANCE})
    assert said["headline"] == ["Nothing that learns beats `smdp-random`, which escapes every time, in 18 primitives."]
    assert any("No learner comes up to it" in text for text in said["finding"])


def test_options_that_do_not_help_are_said_not_to():
    said = judge({"dqn": GOOD, "smdp-random": CHANCE, "smdp-dqn": CHANCE})
    assert said["finding"][0].startswith("Options do not help here: a run of `dqn` beats one of `smdp-dqn` with proba")


def test_overlapping_runs_are_not_told_apart():
    said = judge({"dqn": runs(10, 30, 50, 70, 90), "smdp-dqn": runs(12, 31, 53, 71, 92), "smdp-random": NEVER[:5]})
    assert said["headline"][0].startswith("`smdp-dqn` and `dqn` cannot be told apart; the first escapes every time")
    assert said["finding"][0].startswith("Whether options help cannot be told from these runs")


def test_several_that_cannot_be_told_from_the_leader_are_counted():
    said = judge({"dqn": runs(10, 30, 50, 70, 90), "ppo": runs(12, 31, 53, 71, 92), "sarsa": runs(11, 29, 51, 69, 91)})
    assert said["headline"] == ["No clear winner: `ppo` is ahead, but not clearly of two others."]


def test_three_runs_are_too_few_even_if_cleanly_apart():
    """Three against three: 1 in 10 to be as cleanly apart by chance, in either order."""
    said = judge({"dqn": NEVER[:3], "smdp-dqn": GOOD[:3]})
    assert said["headline"] == ["`smdp-dqn` scores highest, but three runs a room are too few to be sure."]
    assert judge({"dqn": NEVER[:4], "smdp-dqn": GOOD[:4]})["headline"][0].startswith("`smdp-dqn` is best")


def test_nobody_who_escapes_is_said_so():
    assert judge({"dqn": NEVER, "ppo": NEVER})["headline"] == ["Nobody escapes within 1,000 primitives of training."]


def test_one_agent_alone_is_described_not_ranked():
    assert judge({"dqn": GOOD})["headline"] == ["`dqn` escapes every time, in 18 primitives."]
    assert judge({"dqn": [*GOOD[:3], *NEVER[:3]]})["headline"] == ["`dqn` escapes in 50% of episodes."]


def test_what_is_missing_is_split():
    said = judge({"smdp-dqn!": [make_result([WORST, -10.0], reachable=45.0)] * 6})
    assert ("Of the way to the best known return, 10.0% is missing to `smdp-dqn`: 5.0% that its options cannot do, "
            "5.0% that it has not learned.") in said["finding"]
    assert any("nothing is missing" in text for text in judge({"dqn": runs(*[BEST] * 6)})["finding"])


def test_stuck_runs_are_counted():
    said = judge({"smdp-random": CHANCE, "smdp-dqn": [*GOOD[:4], *NEVER[:2]]})
    assert "Stuck, without any escape in the last fifth of training: 2 of 6 runs of `smdp-dqn`." in said["finding"]


def test_speed_is_when_the_middle_curve_first_reaches_the_score():
    said = judge({"dqn": [[WORST, BEST, BEST]] * 4})  # 0 to 1 over the first 500 primitives: 0.95 at 475
    assert "A score of 0.95 is first reached by `dqn` after about 475 primitives of training." in said["finding"]


@pytest.mark.parametrize(
    ("agents", "caution"),
    [
        ({"dqn": GOOD[:5]}, "Five runs a room: large differences show"),
        ({"dqn": [*GOOD[:4], None, None]}, "Some runs have no result and count nowhere: `dqn` 2 of 6."),
        ({"dqn": GOOD, "ppo": [None] * 6}, "Some runs have no result and count nowhere: `ppo` all 6."),
        ({"smdp-dqn": GOOD}, "No random policy over the same options was run beside `smdp-dqn`"),
        ({"dqn": [make_result([80.0], source="ceiling")] * 6}, "No plan is known for paper-two-button"),
    ],
)
def test_cautions(agents: dict, caution: str):
    assert any(text.startswith(caution) for text in judge(agents)["caution"])


def test_ten_clean_runs_beside_chance_need_no_caution():
    ten = runs(*range(80, 90))
    assert judge({"smdp-random": ten, "smdp-dqn": ten})["caution"] == []


def test_a_better_way_than_the_planners_is_told():
    said = judge({"dqn": [make_result([WORST, 90.0], best=50.0)] * 6})
    assert any(text.startswith("In paper-two-button, `dqn` found a better way than the planners")
               and text.endswith("(90).") for text in said["finding"])
