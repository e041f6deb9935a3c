"""Measurements of learned options: durations, entropy, and the warning of a collapse."""

import math
import warnings

import pytest

from hrl_escape.agents.components.option_agent import WINDOW, OptionLog


def fill(log, *runs):
    for _ in range(WINDOW // len(runs)):
        for option, decisions in runs:
            log.add(option, decisions)


def test_durations_and_entropy_are_those_of_the_latest_runs():
    log = OptionLog(3, "test")
    assert log.measure() == {"option_duration": 0, "option_entropy": 0, "option_collapse": 0}
    log.add(2, 50)
    fill(log, (0, 3), (1, 1))
    assert log.compute_duration() == 2.0
    assert log.compute_entropy() == pytest.approx(-0.75 * math.log(0.75) - 0.25 * math.log(0.25))
    restored = OptionLog(3, "test")
    restored.load_state_dict(log.state_dict())
    restored.add(1, 5)
    log.add(1, 5)
    assert restored.measure() == log.measure()


@pytest.mark.parametrize(("runs", "words"), [
    (((0, 1), (1, 1)), "last 1.00 decisions"),
    (((0, 9), (0, 12)), "one of 2 makes almost every decision"),
])
def test_a_collapse_is_told_once(runs, words):
    log = OptionLog(2, "option-critic")
    with pytest.warns(UserWarning, match=f"option-critic: its options have collapsed: .*{words}"):
        fill(log, *runs)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fill(log, *runs)
    assert log.measure()["option_collapse"] == 1


def test_options_of_some_length_in_turns_have_not_collapsed():
    log = OptionLog(2, "test")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fill(log, (0, 4), (1, 3))
    assert log.find_collapse() is None
    alone = OptionLog(1, "test")
    alone.add(0, 1)
    assert alone.find_collapse() is None, "one option has nothing to collapse into"
