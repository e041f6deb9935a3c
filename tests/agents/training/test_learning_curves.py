"""The benchmark of learning curves: equal marks for all, and sentences that follow whatever the runs show."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from benchmarks.learning_curves import (
    LONGEST,
    OPTIONS,
    TASKS,
    VARIANTS,
    Contender,
    Marks,
    compare,
    describe,
    list_contenders,
    summarise,
)
from hrl_escape.agents import make_agent
from tests.forks import run_module

ROOT = Path(__file__).parents[3]


def make_runs(contender, curves):
    name, count = contender
    return [{"task": "CartPole-v1", "contender": name, "count": count, "seed": seed, "seconds": 1.0,
             "scores": [[at, float(score)] for at, score in enumerate(curve, 1)]} for seed, curve in enumerate(curves)]


def make_curves(first, last, own, seed=0):
    """Ten runs that go from one return to another in eight evaluations, each off by a number, 0 on average."""
    noise = np.random.default_rng(seed).normal(0, own, (10, 1))
    return np.linspace(first, last, 8) + noise - noise.mean()


def find_sentence(rows, first, second):
    (found,) = (each for each in compare(rows) if (each.first, each.second) == (first, second))
    return describe(found)


@pytest.mark.parametrize(("curves", "says"), [
    (make_curves(-300, 100, 5, 1), "`defaults` with 512 learns less than `defaults` with 1, by 200 ("),
    (make_curves(300, 100, 5, 1), "`defaults` with 512 learns more than `defaults` with 1, by 100 ("),
    (make_curves(100, 100, 60, 1), "Between `defaults` with 512 and `defaults` with 1 there is no significant"),
])
def test_the_sentence_tells_who_learned_more_over_the_run(curves, says):
    one, many = Contender("defaults", 1), Contender("defaults", 512)
    rows = make_runs(one, make_curves(100, 100, 5)) + make_runs(many, curves)
    assert find_sentence(rows, many, one).startswith(says)


@pytest.mark.parametrize(("last", "says"), [
    (100, "; at its end there is no significant difference ("), (20, "; it ends 80 ("), (180, "; it ends 80 (")])
def test_where_it_ends_is_told_apart_from_how_it_got_there(last, says):
    one, many = Contender("defaults", 1), Contender("defaults", 512)
    rows = make_runs(one, make_curves(100, 100, 5)) + make_runs(many, make_curves(-900, last, 5, 2))
    sentence = find_sentence(rows, many, one)
    assert "learns less" in sentence and says in sentence
    assert sentence.endswith({100: ").", 20: ") lower.", 180: ") higher."}[last])


def test_the_first_may_end_elsewhere_though_no_difference_is_shown_over_the_run():
    one, many = Contender("defaults", 1), Contender("defaults", 512)
    curves = make_curves(100, 100, 60, 3)
    curves[:, -1] = 0
    sentence = find_sentence(make_runs(one, make_curves(100, 100, 5)) + make_runs(many, curves), many, one)
    assert "there is no significant difference over the run" in sentence and "; the first ends 100 (" in sentence
    assert sentence.endswith(" lower.")


def test_more_comparisons_ask_for_more():
    """Holm: a gap that tells two apart may not tell ten."""
    names = [Contender("defaults", count) for count in (1, 8, 64, 512)] + [Contender(name, 512) for name in VARIANTS
                                                                           if name != "defaults"]
    rng = np.random.default_rng(0)
    gaps = np.linspace(-1.6, 0.4, 10)[:, None]  # p = 0.02
    two = make_runs(names[0], np.zeros((10, 8))) + make_runs(names[1], gaps + np.zeros(8))
    more = [row for name in names[2:] for row in make_runs(name, rng.normal(0, 1, (10, 8)))]
    alone, among = (next(each for each in compare(rows) if each.first == names[1]) for rows in (two, two + more))
    assert alone.whole.p < 0.05 < among.whole.p and alone.whole.difference == among.whole.difference


def test_pairs_have_the_seeds_that_both_ran_and_the_table_has_means_at_its_marks():
    one, many = Contender("defaults", 1), Contender("defaults", 8)
    rows = make_runs(one, [np.arange(8)] * 10) + make_runs(many, [np.arange(8) + 1] * 4)
    (found,) = compare(rows)
    assert found.whole.pairs == 4 and found.whole.difference == found.final.difference == 1
    assert summarise(rows).splitlines()[2:] == ["| defaults | 1 | 10 | 0 | 1 | 3 | 7 | 4 | 1.0 |",
                                                "| defaults | 8 | 4 | 1 | 2 | 4 | 8 | 4 | 1.0 |"]


def test_a_mark_is_scored_once_it_is_passed_and_marks_passed_together_by_the_same_learner():
    learners = []
    marks = Marks([10, 20, 30], lambda learner: float(learners.append(learner) or len(learners)))
    for primitives, learner in ((9, "a"), (10, "b"), (31, "c"), (40, "d")):
        marks.reach(primitives, learner)
    assert learners == ["b", "c", "c"] and marks.scores == [(10, 1.0), (20, 2.0), (30, 3.0)] and marks.is_over


def test_recommended_settings_keep_rollouts_and_minibatches_as_of_64_environments_and_one():
    env = gymnasium.make("CartPole-v1")
    for count in (64, 512, 2_048):
        settings = make_agent("ppo", env.observation_space, env.action_space, 0, **VARIANTS["both"](count)).settings
        decisions = max(settings.rollout, settings.rollout_per_env * count)
        assert decisions == LONGEST == 32 * 64
        assert max(settings.batch_size, decisions * settings.batch_size // settings.rollout) == 64


def test_stable_baselines3_learns_what_has_no_options():
    assert {str(each) for each in list_contenders(TASKS[OPTIONS])} == {
        "`defaults` with 1", "`defaults` with 64", "`defaults` with 512", "`both` with 512"}
    assert Contender("sb3-zoo", 8) in list_contenders(TASKS["CartPole-v1"])


@pytest.mark.slow
def test_the_benchmark_runs_and_goes_on_where_it_was_stopped(tmp_path):
    out = tmp_path / "runs.jsonl"

    def run():
        return run_module("benchmarks.learning_curves", "--quick", "--tasks", "CartPole-v1", "--out", out, cwd=ROOT,
                          check=True).stdout

    first = run()
    assert "| defaults | 512 | 1 |" in first and "| sb3-zoo | 8 | 1 |" in first
    lines = out.read_text().splitlines()
    assert len(lines) == len(list_contenders(TASKS["CartPole-v1"])) and "at the end" not in run()
    assert out.read_text().splitlines() == lines
