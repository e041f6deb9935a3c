"""Degraded options: each kind of degradation has the size that was asked for."""

from __future__ import annotations

import time

import pytest

from hrl_escape.checks import check_option
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.errors import ConfigError
from hrl_escape.options.degraded import OptionDegradation
from hrl_escape.options.options_env import OptionsEnv

MISSING = ["press-button-4", "press-button-5", "press-button-8", "press-button-9", "press-button-10", "go-to-exit"]
BEST = 9  # primitives of press-button-1 in the paper's rooms


def run_often(degradation: OptionDegradation, episodes: int = 200) -> list[dict]:
    env = OptionsEnv(EscapeRoomEnv("paper-two-button"), degradation, include_primitives=False)
    found = []
    for seed in range(episodes):
        env.reset(seed=seed)
        info = env.step(0)[4]
        seconds = env.planning_report.planner_seconds
        found.append(info["option"] | {"duration": info["duration"], "planner_seconds": seconds})
    return found


def test_no_degradation_changes_nothing():
    assert {(run["ended"], run["duration"]) for run in run_often(OptionDegradation(), 5)} == {("reached", BEST)}


def test_failures_come_as_often_as_set_and_cost_one_primitive():
    runs = run_often(OptionDegradation(failure=0.3))
    failed = [run for run in runs if run["ended"] == "planning-failed"]
    assert len(failed) == pytest.approx(60, abs=4 * (200 * 0.3 * 0.7) ** 0.5)
    assert {run["duration"] for run in failed} == {1}
    assert {run["duration"] for run in runs if run["ended"] == "reached"} == {BEST}


def test_early_stops_shorten_runs_geometrically():
    durations = [run["duration"] for run in run_often(OptionDegradation(early_stop=0.2), 300)]
    whole = sum(duration == BEST for duration in durations) / 300
    assert whole == pytest.approx(0.8 ** (BEST - 1), abs=0.09)
    assert sum(duration == 1 for duration in durations) / 300 == pytest.approx(0.2, abs=0.09)


@pytest.mark.parametrize("detour", [2, 6])
def test_a_detour_costs_what_it_is_set_to(detour):
    assert {run["duration"] for run in run_often(OptionDegradation(detour=detour), 3)} == {BEST + detour}


def test_latency_is_slept_and_told():
    began = time.perf_counter()
    (run,) = run_often(OptionDegradation(latency=0.2), 1)
    assert time.perf_counter() - began >= 0.2 and run["planner_seconds"] >= 0.2


def test_missing_options_are_masked_and_keep_their_number():
    env = OptionsEnv(EscapeRoomEnv("ten-button"), OptionDegradation(missing=0.5, seed=3))
    whole = OptionsEnv(EscapeRoomEnv("ten-button"))
    assert env.action_names == whole.action_names
    _, info = env.reset(seed=0)
    missing = [name for name, legal in zip(env.action_names, info["action_mask"], strict=True) if not legal]
    assert missing == MISSING, "draws go by the options' numbers, whatever they are called"
    _, again = env.reset(seed=9)
    assert (again["action_mask"] == info["action_mask"]).all(), "the same ones, for ever"


def test_draws_follow_the_seed_and_the_state_only():
    def outcomes(seed):
        return [(run["ended"], run["duration"]) for run in run_often(OptionDegradation(failure=0.5, seed=seed), 30)]

    assert outcomes(1) == outcomes(1) != outcomes(2)


def test_degraded_options_keep_the_contract():
    env = EscapeRoomEnv("paper-two-button")
    degradation = OptionDegradation(failure=0.2, early_stop=0.1, detour=3, option_set="press-with-ancestors")
    for option in degradation(env.instance):
        check_option(option, env)


def test_an_impossible_setting_is_refused():
    with pytest.raises(ConfigError, match="degradation.failure"):
        OptionDegradation(failure=1.2)
