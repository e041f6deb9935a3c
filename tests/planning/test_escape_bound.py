"""Bounds of whole escapes: below what exhaustive searches and plans need, and above what legs one by one allow."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from hrl_escape.env.config import RewardConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.mini_grid import MiniGridConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning import PlanningRequest, find_best_known
from hrl_escape.planning.best_known import list_start_states
from hrl_escape.planning.goals import PressGoal, parse_goal
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


@pytest.mark.nightly
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


@pytest.mark.parametrize("gap", [0.3, 0.9, 2.9])
def test_straight_lines_are_counted_from_the_edge_of_the_reach_to_the_edge_of_the_exit(gap: float):
    """In the paper's room with one button moves of 1 m lead straight to it, and into the exit, which is all round it.

    So nothing is better than the metres to the touch of the body, or to the exit for its middle, rounded up.
    """
    room = generate(get_preset("paper-one-button"), 0)
    state = list_start_states(room)[0]
    (button,), exit_, dynamics = room.targets, room.exit, room.dynamics
    touch = button.y - button.half_y - room.robot.outer_radius - dynamics.press_margin
    assert exit_.contains(0.0, touch) and exit_.x_min < 0
    pressed = room.puzzle.update(state.puzzle, Contacts((0,)))
    for begin in (state._replace(y=touch - gap), state._replace(x=exit_.x_min - gap, puzzle=pressed)):
        known = find_best_known(room, begin)
        assert known.upper_bound == known.value == 100 - math.ceil(gap)


def test_a_thing_that_was_put_down_elsewhere_is_not_bounded_by_its_first_place():
    """A key at the far end of a corridor, then beside the start, where the door is."""
    config = get_preset("door-key")
    room = generate(dataclasses.replace(
        config, puzzle=MiniGridConfig("rows", rows=(">      k", " D######", " G######")),
        room=dataclasses.replace(config.room, width=16.0, depth=6.0), reward=RewardConfig(step=-1.0)), 0)
    planner, puzzle, cells = RoomPlanner(room), room.puzzle, room.puzzle.blockable_cells
    state = planner.rules.make_state(room.starts[0])
    held = puzzle.update(state.puzzle, Contacts((), ahead=cells.index(puzzle.target_cells[1]), grip=1))
    near = state._replace(puzzle=puzzle.update(held, Contacts((), ahead=cells.index(0), grip=-1)))
    assert puzzle.list_cells(near.puzzle, "grip", 1) == (cells.index(0),)
    far, close = (find_best_known(room, each) for each in (state, near))
    assert far.value <= far.upper_bound < close.value <= close.upper_bound
    goals = tuple(parse_goal(goal, room) for goal in ("grip-key-1", "use-door-1"))
    bounds, costs = ([count(each) for each in (state, near)] for count in (
        lambda each: LegBounds(room).bound_goals(each, goals),
        lambda each: planner.answer(PlanningRequest(each, goals)).cost))
    assert bounds[1] <= costs[1] < bounds[0] <= costs[0]
