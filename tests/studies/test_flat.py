"""Flat learners in many copies of a room: repeated actions, runs, and what the pages on PPO and the league conclude."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from hrl_escape.agents.components.policy_gradient import compute_clipped_loss
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ComparisonError
from studies.__main__ import main
from studies.flat import ARCHIVE, CORNER, FlatLearner, FlatRun, RepeatedStreams, count_untrained, run_flat
from studies.flat_ppo.analysis import advise as advise_ppo
from studies.flat_ppo.analysis import tell_fall, tell_late, tell_learning, tell_remedies, tell_untrained
from studies.league.analysis import (
    Attempt,
    SearcherRun,
    advise,
    choose_candidate,
    choose_course,
    compare,
    find_longer,
    find_source,
    list_candidates,
    read_flat,
    read_price,
    tell_arrivals,
    tell_cheapest,
    tell_longer,
    tell_privileged,
    tell_quickest,
    tell_searcher,
)
from studies.league.analysis import tell_untrained as tell_untrained_league
from studies.price.runs import PriceRun
from studies.study import find_study
from tests.studies.pages import load, save, tell

LINE = FlatRun("ppo", 2, 0, 30, 1_000, 500, ((0, 0.0), (500, 0.0), (1_000, 0.0)), (0.1,) * 10, (0.2,) * 10, (1.7,) * 10,
               1.0, "a")
PPO, LEAGUE = find_study("flat-ppo"), find_study("league")


# --- streams and runs ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rooms() -> Any:
    env = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=3, config="paper-two-button", observation="features",
                             output="torch")
    env.reset(seed=0)
    return env


@pytest.mark.parametrize("repeat", [1, 4])
def test_repeated_actions_are_decisions_of_that_many_primitives(rooms: Any, repeat: int):
    streams = RepeatedStreams(rooms, repeat, 0.9)
    streams.reset(0)
    seen, ended = [], 0
    for step in range(2 * repeat):
        assert bool(streams.is_waiting.all()) == (step % repeat == 0)
        before = streams.observation.clone()
        done = streams.step(torch.full((3,), 4))  # turn left
        seen.append(before)
        if bool(done.where.any()):
            ended += 1
            assert bool(done.where.all()) and done.duration.tolist() == [repeat] * 3
            assert torch.equal(done.observation, seen[(ended - 1) * repeat]), "where it was chosen"
            assert torch.equal(done.next_observation, streams.observation)
            assert done.reward.tolist() == [-repeat] * 3
            assert done.discounted_reward.tolist() == pytest.approx([-sum(0.9**n for n in range(repeat))] * 3)
    assert ended == 2 and streams.primitives == 6 * repeat and len(streams.corners) == 2 * repeat


def test_an_action_that_is_given_between_decisions_changes_nothing(rooms: Any):
    streams, courses = RepeatedStreams(rooms, 3, 0.9), []
    for between in (0, 5):
        streams.reset(0)
        for action in (4, between, between):
            streams.step(torch.full((3,), action))
        courses.append(streams.observation.clone())
    assert torch.equal(*courses)


def test_a_decision_ends_with_its_episode_and_the_next_one_begins_anew():
    config = dataclasses.replace(get_preset("paper-two-button"), horizon=5)
    env: Any = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=2, config=config, observation="features",
                                  output="torch")
    env.reset(seed=0)
    streams = RepeatedStreams(env, 4, 0.9)
    streams.reset(0)
    durations = []
    for _ in range(12):
        done = streams.step(torch.zeros(2, dtype=torch.int64))
        durations += done.duration[done.where].tolist()[:1]
    assert durations == [4, 1, 4, 1], "five primitives an episode, and a reset between them"
    state = streams.state_dict()
    after = [streams.step(torch.full((2,), 4)).next_observation for _ in range(3)][-1]
    streams.reset(7)
    streams.load_state_dict(state)
    assert torch.equal([streams.step(torch.full((2,), 4)).next_observation for _ in range(3)][-1], after)


@pytest.mark.nightly
@pytest.mark.parametrize("repeat", [pytest.param(1, marks=pytest.mark.slow), 8])
def test_a_run_measures_escapes_corners_and_entropy(repeat: int):
    room = generate(get_preset("paper-one-button"), 0)
    learner = FlatLearner("x", "ppo", {"rollout": 64, "epochs": 1}, streams=4, repeat=repeat)
    run = run_flat(learner, room, 0, 2_000, 500)
    assert run.first_escape is not None and 0 < run.first_escape <= 2_000, "the first room is easy"
    assert len(run.corners) == len(run.escapes) == 10 and all(0 <= share <= 1 for share in run.corners)
    assert [at for at, _ in run.curve][0] == 0 and len(run.curve) == 2
    assert dataclasses.replace(run_flat(learner, room, 0, 2_000, 500), seconds=run.seconds) == run


def test_a_run_ends_once_it_is_efficient_or_has_escaped():
    room = generate(get_preset("paper-one-button"), 0)
    learner = FlatLearner("x", ARCHIVE, {"cell": 1.0, "headings": 1}, streams=0)
    whole, efficient, escaped = (run_flat(learner, room, 0, 10_000, 500, until) for until in (None, 0.4, 0.0))
    at = whole.find_threshold(0.4)
    assert whole.spent >= 10_000 > efficient.spent and at is not None and efficient.find_threshold(0.4) == at
    assert efficient.curve == whole.curve[: len(efficient.curve)] and efficient.curve[-2][1] >= 0.4
    assert escaped.first_escape == escaped.spent == whole.first_escape
    assert len({whole.key, efficient.key, escaped.key}) == 3


@pytest.mark.slow
def test_a_run_in_many_rooms_ends_with_the_first_evaluation_after_its_escape():
    room = generate(get_preset("paper-one-button"), 0)
    streams = FlatLearner("x", "ppo", {"rollout": 64, "epochs": 1}, streams=4)
    run = run_flat(streams, room, 0, 60_000, 500, 0.0)
    assert run.first_escape is not None and run.spent < 60_000


def test_advantages_as_they_are_make_the_loss_their_mean():
    """With a ratio of 1 the loss is -mean(A), which normalising makes 0; a ratio of 2 is clipped to 1.2 for A > 0."""
    advantage, log = torch.tensor([0.01, 0.03]), torch.zeros(2)
    assert float(compute_clipped_loss(log, log, advantage, 0.2, normalise=False)) == pytest.approx(-0.02)
    assert float(compute_clipped_loss(log, log, advantage, 0.2)) == pytest.approx(0.0, abs=1e-6)
    doubled = float(compute_clipped_loss(log + np.log(2), log, advantage, 0.2, normalise=False))
    assert doubled == pytest.approx(-1.2 * 0.02)


# --- why PPO falls ---------------------------------------------------------------------------


def make_runs(label: str, first: float, corners: float, runs: int = 10, **fields: Any) -> list[FlatRun]:
    return [dataclasses.replace(LINE, agent=label, seed=seed,
                                first_escape=round(first * (1 + 0.02 * ((7 * seed) % 10))),
                                corners=(corners + 0.001 * ((3 * seed) % 10),) * 10, **fields) for seed in range(runs)]


@pytest.mark.parametrize(("ppo", "words"), [
    ((400, 0.3), "Flat PPO falls below chance because it drifts into corners: `ppo` spends 30% of its time in corn"),
    ((400, 0.02), "Flat PPO falls below chance, and not by corners: until its first escape it takes 4.0 times"),
    ((100, 0.3), "Flat PPO drifts into corners: `ppo` spends 30% of its time in corners, where a policy that nev"),
    ((100, 0.02), "No fall is shown: until its first escape `ppo` takes 1.0 times the primitives of chance"),
    ((30, 0.02), "`ppo` beats chance: until its first escape it takes 0.3 times"),
])
def test_another_truth_about_the_fall_is_another_finding(ppo: tuple[float, float], words: str):
    chance = [dataclasses.replace(run, first_escape=run.first_escape + (-1) ** run.seed)
              for run in make_runs("chance", 100, 0.02)]
    lines = [*chance, *make_runs("ppo", *ppo)]
    if ppo[1] == 0.02:
        lines = [dataclasses.replace(run, corners=(0.02 + 0.001 * (-1) ** run.seed,) * 10) for run in lines]
    assert tell_fall(lines, "ppo", "chance").startswith(words), tell_fall(lines, "ppo", "chance")
    assert "Nothing is concluded" in tell_fall(lines[1:], "ppo", "chance")


def test_remedies_are_told_by_corners_escapes_and_chance():
    lines = [*make_runs("chance", 100, 0.02), *make_runs("ppo", 400, 0.3), *make_runs("good", 20, 0.05),
             *make_runs("bad", 900, 0.6), *make_runs("idle", 400, 0.3), *make_runs("few", 20, 0.05, runs=9)]
    lines = [dataclasses.replace(run, first_escape=run.first_escape + 9 * (-1) ** run.seed,
                                 corners=(run.corners[0] + 0.004 * (-1) ** run.seed,) * 10)
             if run.agent == "idle" else run for run in lines]
    good, bad, idle = tell_remedies(lines, ["good", "bad", "idle", "few"], "ppo", "chance")
    assert good.startswith("`good` keeps it out of corners (-0.25, -0.25 to -0.25), and its first escape comes soon")
    assert "it beats chance" in good and "drives it into corners" in bad and "comes later" in bad
    assert "stays behind chance" in bad and "is not shown to change its time" in idle and "not shown to come" in idle


@pytest.mark.parametrize(("remedy", "words"), [
    ((20, 0.05), "and begin with `good`: the first escape comes sooner."),
    ((400, 0.05), "first reward; `good` keeps it out of corners but is not shown to bring the first escape sooner."),
    ((400, 0.3), "first reward; none of the remedies tried here is shown to help."),
])
def test_advice_follows_the_remedies(remedy: tuple[float, float], words: str):
    lines = [dataclasses.replace(run, first_escape=run.first_escape + 9 * (-1) ** run.seed,
                                 corners=(run.corners[0] + 0.004 * (-1) ** run.seed,) * 10)
             for run in make_runs("good", *remedy)]
    assert advise_ppo([*lines, *make_runs("ppo", 400, 0.3)], ["good"], "ppo").endswith(words)


def test_escapes_before_the_first_update_are_not_called_learning():
    """Of 64 streams and 32 decisions a rollout, each of eight primitives, the first update comes after 16,384."""
    learners = {label: FlatLearner(label, "ppo", repeat=repeat)
                for label, repeat in (("chance", 1), ("a", 8), ("b", 8), ("c", 1))}
    plain = {1: "chance"}
    others = [*make_runs("chance", 20_000, 0.02), *make_runs("c", 20_000, 0.3)]
    told = tell_untrained([*others, *make_runs("a", 10_000, 0.1), *make_runs("b", 10_000, 0.2)], learners, plain)
    assert told == ("The 10 first escapes of `a` and `b`, the same in both run by run, come within 11,800 primitives, "
                    "and the first update only after 16,384: they are those of random moves, each repeated 8 times, "
                    "and not of learning. Chance with 8 repeats was not run.")
    apart = tell_untrained([*others, *make_runs("a", 10_000, 0.1), *make_runs("b", 9_000, 0.2)], learners, plain)
    assert "escapes of `a` come within 11,800" in apart and "escapes of `b` come within 10,620" in apart
    late = [*others, *make_runs("a", 15_000, 0.1), *make_runs("b", 16_000, 0.2)]
    assert tell_untrained(late, learners, plain) == "", "some come after it"
    never = [dataclasses.replace(run, first_escape=None) if run.seed == 3 else run for run in make_runs("a", 90, 0.1)]
    assert tell_untrained([*others, *never], learners, plain) == ""
    learners["control"] = dataclasses.replace(learners["a"], label="control")
    alike = [*others, *make_runs("a", 10_000, 0.1), *make_runs("control", 10_000, 0.1)]
    told = tell_untrained(alike, learners, {1: "chance", 8: "control"})
    assert told.startswith("The 10 first escapes of `a` and `control`, the same in both") and "not run" not in told
    assert tell_untrained(alike[10:], {"control": learners["control"]}, {8: "control"}) == "", "a control is no learner"
    lines = [*make_runs("good", 20, 0.05), *make_runs("chance", 100, 0.02), *make_runs("ppo", 400, 0.3)]
    assert advise_ppo(lines, ["good"], "ppo", ["good"]).endswith(
        "and try `good`: the first escape comes sooner, before anything is learned.")
    (remedy,) = tell_remedies(lines, ["good"], "ppo", "chance", ["good"])
    assert "beats chance" not in remedy and remedy.endswith("; all of its first escapes come before the first update.")


def test_a_learner_is_told_from_chance_with_as_many_repeats_by_its_late_escapes():
    learners = {label: FlatLearner(label, "ppo", repeat=repeat)
                for label, repeat in (("chance", 1), ("plain", 1), ("held", 8), ("a", 8), ("b", 8), ("c", 8))}

    def make(label: str, share: float) -> list[FlatRun]:
        return [dataclasses.replace(run, escapes=(None,) * 6 + (share + 0.01 * (-1) ** run.seed,) * 4)
                for run in make_runs(label, 100, 0.1)]

    lines = [*make("chance", 0.2), *make("plain", 0.1), *make("held", 0.5), *make("a", 0.7), *make("b", 0.5)]
    lines += [dataclasses.replace(run, escapes=(0.5 + 0.1 * (-1) ** (run.seed // 2),) * 10)
              for run in make_runs("c", 100, 0.1)]
    plain, held = tell_late(lines, learners, {1: "chance", 8: "held"})
    assert plain == ("In the last half of training `chance` escapes in 20% of its episodes; less often `plain` (10%; "
                     "-0.10, -0.10 to -0.10).")
    assert held.startswith("In the last half of training `held` escapes in 50% of its episodes; more often `a` (70%; +")
    assert "; no difference is shown for `b` (50%; " in held and " and `c` (5" in held
    assert tell_late([run for run in lines if run.seed < 9], learners, {1: "chance"}) == [], "too few pairs"


def test_the_first_update_is_where_a_run_s_settings_put_it():
    assert count_untrained(FlatLearner("x", "ppo", {"stream_rollout": 16}, streams=64, repeat=4)) == 4_096
    assert count_untrained(FlatLearner("x", "ppo", streams=4)) == 256, "no rollout is shorter"
    assert count_untrained(FlatLearner("x", "ppo", streams=0)) == count_untrained(FlatLearner("x", ARCHIVE)) == 0


def test_an_escape_in_training_is_not_called_learning():
    lines = [*make_runs("a", 100, 0.1), *make_runs("b", 100, 0.1)]
    assert "nothing was learned yet" in tell_learning(lines, ["a", "b"])
    some = [dataclasses.replace(run, curve=((0, 0.0), (1_000, 0.5))) if (run.agent, run.seed) == ("b", 3) else run
            for run in lines]
    said = "Greedy policies that escape at the end: `b` in 1 of 10 runs; those of the others in none."
    assert tell_learning(some, ["a", "b"]) == said


def test_the_page_on_ppo_follows_its_lines(tmp_path: Path):
    labels = [table["label"] for table in PPO.data["learners"]]
    lines = [run for number, label in enumerate(labels) for run in make_runs(label, 100 * (1 + number), 0.1)]
    page = tell("flat-ppo", lines, tmp_path)
    assert page.index("![Time") < page.index("**Flat PPO falls below chance") < page.index("<details>")
    assert page.count("\n- `ppo, ") == len(labels) - 3 and (tmp_path / "figures" / "flat-ppo.svg").exists()
    turned = [dataclasses.replace(run, first_escape=10) if run.agent == "ppo" else run for run in lines]
    assert "**`ppo` beats chance" in tell("flat-ppo", turned)


# --- the league ------------------------------------------------------------------------------


def make_cells(label: str, buttons: int, first: float | None, half: float | None, ninety: float | None, runs: int = 10,
               spent: int = 1_000_000) -> dict[tuple[str, int], list[Attempt]]:
    """A cell whose runs spread by 2 % about these waits; None for a level that none reaches."""
    def wait(time: float | None, seed: int) -> tuple[float, bool]:
        return (spent, False) if time is None else (time * (1 + 0.02 * ((7 * seed) % 10)), True)

    return {(label, buttons): [Attempt(label, buttons, seed, 20, spent, {
        0.0: wait(first, seed), 0.5: wait(half, seed), 0.9: wait(ninety, seed)}) for seed in range(runs)]}


GOOD, LATE = make_cells("a", 1, 100, 500, 900), make_cells("b", 1, 100, 900, 5_000)
LOST = make_cells("c", 1, 100, None, None)


def test_a_run_of_the_league_is_read_by_its_first_escape_and_pairs_of_evaluations():
    curve = ((0, 0.0), (500, 0.95), (900, 0.9), (950, 0.2))
    run = dataclasses.replace(LINE, first_escape=None, fewest=600, curve=curve)
    assert read_flat(run, (0.5, 0.9)).waits == {0.0: (950, False), 0.5: (600, True), 0.9: (600, True)}, "one escape"
    assert read_flat(dataclasses.replace(LINE, curve=((0, 0.0), (500, 0.95), (1_000, 0.8))), (0.5, 0.9)).waits == {
        0.0: (500, True), 0.5: (500, True), 0.9: (1_000, False)}
    price = PriceRun("dqn", 1, 3, 20, 60_000, 9_000, 400, 6_500, 0.9, 9, 9, 1.0, "a")
    told = read_price(price, "dqn, patient", (0.5, 0.9))
    assert told.waits == {0.0: (400, True), 0.9: (6_500, True)} and told.agent == "dqn, patient", "no curve, no 0.5"
    price = dataclasses.replace(price, curve=((0, 0.0), (500, 0.6), (750, 0.6)))
    assert read_price(price, "x", (0.5, 0.9)).waits[0.5] == (500, True)


def test_a_league_is_told_by_runs_that_stay_efficient():
    few = make_cells("b", 3, 1, 1, 1, 9)
    cells = {**LOST, **LATE, **GOOD, **make_cells("a", 2, 100, None, None), **few}
    told = tell_arrivals(cells, (1, 2, 3), 0.9, 1_000_000)
    assert told == ("Efficient in half of the runs or more within 1,000,000 primitives: with 1 button 2 of 3 learners "
                    "(`a` in 10 of 10 and `b` in 10 of 10); with 2 buttons none of 1 learner.")
    assert "Nothing is concluded" in tell_arrivals(make_cells("a", 1, 1, 1, 1, 9), (1,), 0.9, 1_000)


def test_the_quickest_is_told_apart_only_where_the_runs_do():
    apart = tell_quickest(tell_cheapest({**LATE, **GOOD}, (1, 2), 0.9))
    assert apart.startswith("Efficient after the fewest primitives: with 1 button `a`, where `b` needs 5.6 (5.6 to 5.6")
    near = make_cells("b", 1, 100, 900, 905)
    near["b", 1] = [run._replace(waits={**run.waits, 0.9: (run.waits[0.9][0] * (1 + 0.1 * (-1) ** run.seed), True)})
                    for run in near["b", 1]]
    assert "not shown to be quicker than" in tell_quickest(tell_cheapest({**near, **GOOD}, (1,), 0.9))
    assert tell_quickest(tell_cheapest(GOOD, (1,), 0.9)) == "", "nobody beside it"
    both = tell_cheapest({**near, **GOOD}, (1,), 0.9) * 2
    both[1] = (both[1][0], both[1][1]._replace(buttons=2), both[1][2])
    assert "with 1 and 2 buttons `a` by its median" in tell_quickest(both)


def test_who_has_a_privilege_is_said_apart():
    assert tell_privileged({**GOOD, **make_cells("a", 2, 1, None, None)}, ["a"], (1, 2, 3), 0.9) == (
        "With a privilege that no other learner has, `a` is efficient in 10 of 10 with 1 button and 0 of 10 with 2 "
        "buttons.")
    assert tell_privileged(GOOD, ["b"], (1,), 0.9) == ""


@pytest.mark.parametrize(("searched", "words"), [
    (20, "Every flat learner escapes later than `s`, which chooses among planned options and learns nothing: the "
         "soonest, `a`, after 5 (5 to 5) times its primitives, over 10 rooms."),
    (500, "Sooner than `s`, which chooses among planned options and learns nothing, escape `a` and `c`."),
])
def test_first_escapes_are_held_against_the_searcher(searched: int, words: str):
    others = {(1, seed): (searched * (1 + 0.02 * ((7 * seed) % 10)), True) for seed in range(10)}
    ratios = {label: compare(runs, others, 0.0) for (label, _), runs in {**GOOD, **LOST}.items()}
    assert tell_searcher(ratios, "s").startswith(words), tell_searcher(ratios, "s")
    level = {(1, seed): (100 * (1 + 0.3 * (-1) ** seed), True) for seed in range(10)}
    lost = [run._replace(waits={0.0: (10_000, run.seed > 2)}) for run in GOOD["a", 1]]
    assert compare(lost, level, 0.0).middle.knowledge == "bound", "three never escaped, so there is no upper end"
    same = {"a": compare(GOOD["a", 1], level, 0.0)}
    assert "No flat learner is shown to escape later or sooner" in tell_searcher(same, "s")


def test_advice_follows_how_far_learners_got():
    far = advise({**GOOD, **LATE, **LOST, **make_cells("a", 2, 100, None, None)}, (1, 2), (0.5, 0.9), 1_000_000)
    assert far == ("If you must learn over primitives, begin with `a`, the quickest to be efficient with 1 button; "
                   "with 2 buttons 1,000,000 primitives were not enough, so give it options. An escape in training is "
                   "not yet learning: `c` with 1 button and `a` with 2 buttons escaped in every run, and reached an "
                   "efficiency of 0.5 in none within 1,000,000 primitives.")
    assert advise(GOOD, (1,), (0.5, 0.9), 1_000_000) == (
        "If you must learn over primitives, begin with `a`, the quickest to be efficient with 1 button.")
    assert advise(LOST, (1,), (0.5, 0.9), 1_000_000).startswith("Give a learner options before you give it a lar")


def test_first_escapes_of_the_untrained_are_counted():
    cells = {**GOOD, **LATE, **make_cells("a", 2, 110, None, None)}
    assert tell_untrained_league(cells, {"a": 118, "b": 0}) == (
        "Of the 20 first escapes of `a` 14 come before its first update, after 118 primitives: they are those of an "
        "untrained policy.")
    assert tell_untrained_league(cells, {"a": 108, "b": 99}) == "", "less than half"


def test_hopeless_cells_are_not_run():
    data = {"sizes": [1, 2, 3], "runs": 10, "efficient": [0.5, 0.9]}
    assert choose_course(data, [], 1) == "whole" and choose_course(data, GOOD["a", 1][:9], 2) == "later"
    assert choose_course(data, GOOD["a", 1], 2) == "whole", "some reached 0.5"
    assert choose_course(data, LOST["c", 1], 2) == "first escape", "all escaped, none reached 0.5"
    never = make_cells("d", 1, None, None, None)["d", 1]
    assert choose_course(data, never, 2) == choose_course(data, never, 3) == "none"
    assert choose_course(data, [*LOST["c", 1], *make_cells("c", 2, 300, None, None)["c", 2]], 3) == "first escape"


def test_runs_that_are_longer_are_of_the_fewest_buttons_that_were_too_many():
    label, other, _ = LEAGUE.data["longer"]["agents"]
    done, half = make_cells(label, 1, 1, 2, 3), make_cells(label, 2, 1, 2, None)
    cells = {**done, **half, **make_cells(label, 3, 1, None, None), **make_cells(other, 1, 1, 2, 3),
             **make_cells(other, 2, 1, 2, None, runs=9)}
    assert find_longer(LEAGUE, cells) == {label: 2}, "the other has run too few"
    after = make_cells(label, 2, 1, 2, 3)[label, 2]
    after[:3] = half[label, 2][:3]
    assert tell_longer({label: half[label, 2]}, {label: after}, 0.9, 10_000_000) == (
        f"Within 10,000,000 primitives, efficient are `{label}` in 7 of 10 with 2 buttons (0 before).")
    assert tell_longer({label: half[label, 2]}, {label: after[:9]}, 0.9, 10_000_000) == ""


def test_settings_are_those_of_the_best_trials(tmp_path: Path):
    label = LEAGUE.data["learners"][0]["label"]
    assert {len(table["candidates"]) for table in LEAGUE.data["learners"]} == {3}, "all are tuned alike"
    assert min(LEAGUE.data["trials"]["seeds"]) >= LEAGUE.data["runs"], "in other rooms"
    names = [candidate.label for candidate in list_candidates(LEAGUE, label)]
    lines = [dataclasses.replace(LINE, agent=name, seed=seed, buttons=1, first_escape=900 - 100 * number)
             for number, name in enumerate(names) for seed in LEAGUE.data["trials"]["seeds"]]
    chosen = [choose_candidate(LEAGUE, lines, label).settings]
    assert find_source(LEAGUE, choose_candidate(LEAGUE, lines, label)) is None, "the price study has other settings"
    lines[2] = dataclasses.replace(lines[2], escapes=(0.1,) * 9 + (0.2,))
    chosen.append(choose_candidate(LEAGUE, lines, label).settings)
    lines[0] = dataclasses.replace(lines[0], curve=((0, 0.0), (1_000, 0.4)))
    chosen.append(choose_candidate(LEAGUE, lines, label).settings)
    assert chosen == [list(list_candidates(LEAGUE, label))[number].settings for number in (2, 1, 0)]
    assert find_source(LEAGUE, choose_candidate(LEAGUE, lines, label)) == "dqn", "the first's settings"
    with pytest.raises(ComparisonError, match="has 1 trial: run python -m studies league --trials"):
        choose_candidate(LEAGUE, lines[:-1], label)


@pytest.mark.nightly
def test_trials_and_runs_resume_and_make_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                  capsys: pytest.CaptureFixture[str]):
    (table,) = [{name: value for name, value in table.items() if name != "price"}
                for table in LEAGUE.data["learners"] if table["label"] == "q-learning, counts"]
    small = {**LEAGUE.data, "learners": [table], "budget": 400, "eval_every": 100, "runs": 1, "sizes": [1, 2],
             "trials": {"seeds": [100], "buttons": 1, "budget": 300, "eval_every": 100},
             "longer": {"budget": 800, "eval_every": 400, "agents": ["q-learning, counts"]}}
    monkeypatch.setattr("studies.study.read_toml", lambda *_: small)
    assert main(["league", "--trials", "--docs", str(tmp_path)]) == 0
    assert len(load("league", tmp_path)) == 3
    assert main(["league", "--docs", str(tmp_path)]) == 0
    runs = [line for line in load("league", tmp_path) if isinstance(line, FlatRun)]
    searched = {line.buttons: line.escaped_at for line in load("league", tmp_path) if isinstance(line, SearcherRun)}
    assert len(runs) == 4 and searched.keys() == {1, 2} and searched[1] <= searched[2] <= 400
    assert "q-learning, counts, 2 buttons: none" in capsys.readouterr().out, "no run escaped with one"
    assert main(["league", "--docs", str(tmp_path)]) == 0 and "first escape" not in capsys.readouterr().out
    page = (tmp_path / "league.md").read_text()
    assert "q-learning, counts / 3" in page and "Nothing is concluded, as no learner has 10 runs" in page
    assert "not run, as no run escaped with fewer: `q-learning, counts` with 2 buttons" in page
    assert main(["league", "--longer", "--docs", str(tmp_path)]) == 0
    longer = [line for line in load("league", tmp_path) if isinstance(line, FlatRun) and line.budget == 800]
    assert [(line.agent, line.buttons, line.seed) for line in longer] == [("q-learning, counts", 1, 0)]
    small["runs"] = 10
    save("league", [dataclasses.replace(run, curve=((0, 0.95), (100, 0.95)), first_escape=90, seed=seed, key=str(seed))
                    for run in runs if run.seed == 0 for seed in range(10)], tmp_path)
    assert main(["league", "--from-raw", "--docs", str(tmp_path)]) == 0
    assert "with 1 button 1 of 1 learner (`q-learning, counts` in 10 of 10)." in (tmp_path / "league.md").read_text()


def test_shares_are_of_the_floor():
    places = np.abs(np.linspace(-1, 1, 201)) >= CORNER
    corners = np.mean(places[:, np.newaxis] & places)
    assert corners == pytest.approx(0.04, abs=0.004), "as the page says"
