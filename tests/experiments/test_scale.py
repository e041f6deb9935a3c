"""Scales: what is best, reachable and worst from each start."""

from __future__ import annotations

import dataclasses
import itertools

from hrl_escape.env.generation import generate
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.experiments.cell import make_env
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


def test_options_alone_reach_what_their_best_sequence_earns():
    """All sequences of three of the three options, run in the environment; primitives between them could do better."""
    room = generate(get_preset("paper-two-button"), 0)
    only = AgentSpec("smdp-dqn", options=OptionsView(include_primitives=False))
    env, recorder = make_env(only, room, "state")
    earned = []
    for sequence in itertools.product(range(3), repeat=3):
        env.reset(seed=0)
        total, terminated = 0.0, False
        for action in sequence:
            if not terminated:
                _, reward, terminated, _, _ = env.step(action)
                total += float(reward)
        earned += [total] if terminated else []
    scale = measure_scale(room, only, recorder.states[:1])
    assert scale.reachable == (max(earned),) and scale.reachable < scale.best
    both = measure_scale(room, AgentSpec("smdp-dqn"), recorder.states[:1])
    assert both.reachable == both.best == scale.best


def test_a_puzzle_that_planners_cannot_do_is_measured_by_an_escape_at_once():
    room = generate(get_preset("push-block"), 0)
    scale = measure_scale(room, AgentSpec("dqn"), [Kinematics(room).make_state(room.starts[0])] * 2)
    assert (scale.source, scale.best, scale.worst) == (CEILING, (99.0, 99.0), -room.horizon)


def test_a_room_that_never_opens_in_time_is_measured_so_too():
    short = dataclasses.replace(ROOM, horizon=2)
    assert measure_scale(short, AgentSpec("dqn"), STATES[:1]).source == CEILING
