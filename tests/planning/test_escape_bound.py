"""Bounds of whole escapes: below what exhaustive searches and plans need, and above what legs one by one allow."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.best_known import list_start_states
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.lower_bounds import LegBounds, bound_escape
from hrl_escape.planning.planner import RoomPlanner

SMALL = {"width": 10.0, "depth": 10.0}


def make_small_room(preset: str, seed: int) -> RoomInstance:
    config = get_preset(preset)
    return generate(dataclasses.replace(config, room=dataclasses.replace(config.room, **SMALL)), seed)


def add_legs(room: RoomInstance, state: RoomState) -> int:
    """Least sum of the bounds of single legs, over all orders in which every target is pressed once."""
    bounds, operators = LegBounds(room), room.symbolic_model.operators
    sums = []
    for order in itertools.permutations(operators):
        lit = room.puzzle.symbolic.get_facts(state.puzzle)
        for op in order:
            if not op.preconditions <= lit:
                break
            lit = (lit | op.add) - op.delete
        else:
            sums.append(bounds.bound_start(state, order[0]) + bounds.bound_leg(order[-1], None)
                        + sum(map(bounds.bound_leg, order, order[1:])))
    return min(sums)


def test_no_plan_is_below_its_bound_and_joint_bounds_are_above_sums_of_legs():
    gains = []
    for preset, seed in itertools.product(("four-button-chain", "paper-two-button", "bit-flip"), range(10)):
        room = make_small_room(preset, seed)
        state = list_start_states(room)[0]
        bound = bound_escape(room, state)
        assert bound <= RoomPlanner(room).solve(state).cost
        if preset != "bit-flip":
            gains.append(bound - add_legs(room, state))
    assert min(gains) >= 0 and np.mean(gains) > 0.1


def find_double_press(rules: Kinematics, room: RoomInstance) -> tuple[RoomState, tuple[int, ...]] | None:
    """A state, and two targets that one primitive presses from there."""
    begin = rules.make_state(room.starts[0])
    for one, other in itertools.combinations(room.targets, 2):
        x, y = (one.footprint.x + other.footprint.x) / 2, (one.footprint.y + other.footprint.y) / 2
        if math.dist((one.footprint.x, one.footprint.y), (other.footprint.x, other.footprint.y)) > 2.5:
            continue
        for dx, dy in itertools.product(np.arange(-1.6, 1.7, 0.1), repeat=2):
            state = begin._replace(x=x + dx, y=y + dy)
            if rules.compute_touching(state.x, state.y, state.heading_steps, state.heading_offset, state.joint_steps,
                                      state.joint_offsets):
                continue
            for action in range(len(rules.actions)):
                step = rules.step(state, action)
                if len(step.pressed) > 1:
                    return state, step.pressed
    return None


def test_targets_that_one_primitive_presses_are_not_counted_twice():
    found = 0
    for seed in range(40):
        room = generate(get_preset("ten-button"), seed)
        rules = Kinematics(room)
        if (both := find_double_press(rules, room)) is None:
            continue
        state, pressed = both
        goals = [PressGoal(index) for index in pressed]
        assert LegBounds(room).bound_goals(state, goals) <= 1, (seed, pressed)
        found += 1
        if found == 3:
            return
    pytest.fail("no room in which one primitive presses two targets")
