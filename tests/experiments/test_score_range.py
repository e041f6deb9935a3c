"""Scales: what is best, reachable and worst from each start."""

from __future__ import annotations

import dataclasses
import itertools

from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.experiments.grid import AgentSpec, OptionsView
from hrl_escape.experiments.runs import make_env
from hrl_escape.experiments.score_range import CEILING, PLANNER, compute_score_range
from hrl_escape.planning.room_planner import RoomPlanner
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
    score_range = compute_score_range(ROOM, AgentSpec("dqn"), STATES)
    assert score_range.worst == -ROOM.horizon and score_range.source == PLANNER
    assert score_range.reachable == score_range.best and score_range.fewest_reachable == score_range.fewest
    for state, best, fewest in zip(STATES, score_range.best, score_range.fewest, strict=True):
        assert run_plan(state) <= best < 100
        assert best == ROOM.reward.exit - fewest, "each primitive costs 1"


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
    score_range = compute_score_range(room, only, recorder.states[:1])
    assert score_range.reachable == (max(earned),) and score_range.reachable < score_range.best
    assert score_range.fewest_reachable == (room.reward.exit - max(earned),) > score_range.fewest
    both = compute_score_range(room, AgentSpec("smdp-dqn"), recorder.states[:1])
    assert both.reachable == both.best == score_range.best


def test_a_puzzle_that_planners_cannot_do_is_measured_by_an_escape_at_once():
    room = generate(get_preset("push-block"), 0)
    score_range = compute_score_range(room, AgentSpec("dqn"), [Kinematics(room).make_state(room.starts[0])] * 2)
    assert (score_range.source, score_range.best, score_range.worst) == (CEILING, (99.0, 99.0), -room.horizon)


def test_a_room_that_never_opens_in_time_is_measured_so_too():
    short = dataclasses.replace(ROOM, horizon=2)
    assert compute_score_range(short, AgentSpec("dqn"), STATES[:1]).source == CEILING
