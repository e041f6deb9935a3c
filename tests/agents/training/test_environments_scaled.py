"""Curves against the number of environments: the rule that is chosen, and the sentences, follow the runs."""

from pathlib import Path

import gymnasium
import pytest

from benchmarks.environments_scaled import (
    CHOICE_COUNTS,
    COUNTS,
    RULES,
    choose_rule,
    compare,
    describe,
    list_pairs,
    list_runs,
    summarise,
)
from hrl_escape.agents import make_agent
from tests.forks import run_module

ROOT = Path(__file__).parents[3]


def make_rows(returns, counts, seeds=10):
    """Runs of rules whose mean returns are (rule, environments) -> number."""
    return [{"contender": rule, "count": count, "seed": seed, "seconds": [1.0, 2.0],
             "scores": [(100, returns(rule, count) + seed), (200, returns(rule, count) + seed + seed % 3)]}
            for seed in range(seeds) for count in counts for rule in RULES]


@pytest.mark.parametrize("best", RULES)
def test_the_rule_of_the_highest_mean_over_all_numbers_of_environments_is_chosen(best):
    tempting = next(rule for rule in RULES if rule != best)

    def rate(rule, count):  # another rule is the best with 64 environments alone
        return 120 if rule == best else 200 if (rule, count) == (tempting, 64) else 10

    assert choose_rule(make_rows(rate, CHOICE_COUNTS, 3)) == best


@pytest.mark.parametrize(("gain", "says"), [(0, "there is no significant difference"), (50, "learns more than"),
                                            (-50, "learns less than")])
def test_what_is_said_of_the_rule_follows_the_returns(gain, says):
    rows = make_rows(lambda rule, count: gain if rule == "one step" else 0, COUNTS)
    said = [describe(found) for found in compare(rows, list_pairs("one step"))]
    about = [words for words in said if "one step" in words and "`defaults` with 512" in words]
    assert len(about) == 1 and says in about[0]
    assert "| one step | 4,096 | 10 |" in summarise(rows)


def test_every_line_has_as_many_runs_and_below_64_environments_there_is_one_rule():
    runs = list_runs("report", "one step", [0, 1])
    assert len(runs) == 2 * (len(COUNTS) + 3) and {count for _, rule, count, _ in runs if rule == "one step"} == {
        64, 512, 4096}
    env = gymnasium.make("CartPole-v1")
    for count in (1, 64, 4096):
        for rule, make in RULES.items():
            settings = make_agent("ppo", env.observation_space, env.action_space, 0, **make(count)).settings
            decisions = max(settings.rollout, settings.rollout_per_env * count)
            batch = max(settings.batch_size, decisions * settings.batch_size // settings.rollout)
            if rule != "defaults" and count >= 64:
                assert batch == (256 if rule == "eight steps" else 64) and decisions == settings.rollout


@pytest.mark.slow
def test_the_benchmark_runs_and_goes_on_where_it_was_stopped(tmp_path):
    out, arguments = tmp_path / "runs.jsonl", ("--quick", "--out", tmp_path / "runs.jsonl")
    first = run_module("benchmarks.environments_scaled", *arguments, "--draw", tmp_path / "curves.svg", cwd=ROOT,
                       check=True).stdout
    assert "| eight steps | 4,096 | 1 |" in first and (tmp_path / "curves.svg").read_bytes().startswith(b"<?xml")
    lines = out.read_text().splitlines()
    assert len(lines) == 8
    assert "over the run\n" not in run_module("benchmarks.environments_scaled", *arguments, cwd=ROOT, check=True).stdout
