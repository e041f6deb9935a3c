"""Closed-loop execution: it gives up after failures in a row, not after arrivals."""

from __future__ import annotations

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.options.closed_loop import MOST_FAILURES, pursue


def test_an_escape_of_many_options_is_not_cut_short():
    env = EscapeRoomEnv("ten-button", instance_seed=1)
    env.reset(seed=0)
    run = pursue(env)
    assert run.is_reached and len(run.decisions) > MOST_FAILURES
    assert all(decision["ended"] == "reached" for decision in run.decisions)
