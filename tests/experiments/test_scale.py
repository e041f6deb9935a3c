"""Scales: what is best, reachable and worst from each start."""

from __future__ import annotations

import dataclasses

from hrl_escape.env.generation import generate
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.experiments.grid import AgentSpec, OptionsView
from hrl_escape.experiments.scale import CEILING, PLANNER, measure_scale
from hrl_escape.options.planner import RoomPlanner
from tests.experiments.small import SCHEMATIC

ROOM = generate(SCHEMATIC, 0)
STATES = [Kinematics(ROOM).make_state(start) for start in ROOM.starts[:3]]


def run_plan(state) -> float:
    """Return of the planner's way out, stepped through the room's own kinematics."""
    rules, total = Kinematics(ROOM), 0.0
    for primitive in RoomPlanner(ROOM).solve(state).primitives:
        step = rules.step(state, primitive)
        state, total = step.state, total + step.reward
    assert step.terminated
    return total


def test_the_best_known_is_at_least_what_a_plan_really_earns_and_at_most_what_distance_allows():
    scale = measure_scale(ROOM, AgentSpec("dqn"), STATES)
    assert scale.worst == -ROOM.horizon and scale.source == PLANNER
    assert scale.reachable == scale.best
    for state, best in zip(STATES, scale.best, strict=True):
        assert run_plan(state) <= best < 100


def test_options_alone_reach_no_more_than_primitives_do():
    only = AgentSpec("smdp-dqn", options=OptionsView(include_primitives=False))
    scale = measure_scale(ROOM, only, STATES)
    assert all(reach <= best for reach, best in zip(scale.reachable, scale.best, strict=True))
    assert all(reach > scale.worst for reach in scale.reachable)
    both = measure_scale(ROOM, AgentSpec("smdp-dqn"), STATES)
    assert both.reachable == both.best == scale.best


def test_a_puzzle_that_planners_cannot_do_is_measured_by_an_escape_at_once():
    room = generate(get_preset("push-block"), 0)
    scale = measure_scale(room, AgentSpec("dqn"), [Kinematics(room).make_state(room.starts[0])] * 2)
    assert (scale.source, scale.best, scale.worst) == (CEILING, (99.0, 99.0), -room.horizon)


def test_a_room_that_never_opens_in_time_is_measured_so_too():
    short = dataclasses.replace(ROOM, horizon=2)
    assert measure_scale(short, AgentSpec("dqn"), STATES[:1]).source == CEILING
