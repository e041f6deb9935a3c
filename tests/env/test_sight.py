"""Rays and lines of sight: against walks along them, and through the observation that shows them."""

import copy
import dataclasses
import math

import gymnasium
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import Solid, compute_distance, compute_distance_many, make_footprint, stack_footprints
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.observations.base import make_observer
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.sight import Scanner

numbers = st.floats(-5, 5, allow_nan=False)
sizes = st.floats(0.05, 3)
shapes = st.builds(make_footprint, numbers, numbers, sizes, sizes, st.floats(-4, 4), st.booleans())


@pytest.mark.nightly
@given(st.lists(shapes, min_size=1, max_size=5), numbers, numbers)
def test_rays_end_on_the_first_outline_they_meet(some, px, py):
    assume(all(compute_distance(px, py, shape) > 1e-3 for shape in some))
    angles = np.linspace(0, math.tau, 16, endpoint=False)
    ranges = np.minimum(Scanner(some, angles).measure(px, py, 1.0, 0.0), 30.0)
    steps = np.linspace(0, 30, 6001)
    inner = stack_footprints([shape._replace(half_x=shape.half_x - 1e-6, half_y=shape.half_y - 1e-6) for shape in some])
    for angle, found in zip(angles, ranges, strict=True):
        path = np.stack([px + steps * math.cos(angle), py + steps * math.sin(angle)], axis=1)
        distances = compute_distance_many(path, inner)
        assert distances[steps < found - 1e-9].min(initial=1.0) > 0  # nothing before it; an edge may be grazed
        if found < 30:
            end = np.array([[px + found * math.cos(angle), py + found * math.sin(angle)]])
            assert compute_distance_many(end, stack_footprints(some))[0] < 1e-6


@pytest.mark.nightly
@given(st.lists(shapes, min_size=1, max_size=5), numbers, numbers, numbers, numbers)
def test_a_point_is_in_sight_if_nothing_lies_on_the_way(some, x, y, to_x, to_y):
    assume(all(compute_distance(*at, shape) > 1e-3 for shape in some for at in ((x, y), (to_x, to_y))))
    share = np.linspace(0, 1, 3001)[:, None]
    path = np.array([x, y]) * (1 - share) + np.array([to_x, to_y]) * share
    nearest = compute_distance_many(path, stack_footprints(some)).min()
    assume(nearest == 0.0 or nearest > 0.01)  # neither grazes nor slips between two steps
    seen = Scanner(some, np.zeros(1)).see(x, y, np.array([[to_x, to_y]]), np.zeros(1))
    assert seen.tolist() == [nearest > 0.0]


def look(instance, state=None):
    rules = Kinematics(instance)
    observer = make_observer("egocentric", rules)
    return dict(zip(observer.names, observer.observe(state or rules.make_state(instance.starts[0])), strict=True))


def test_what_stands_behind_an_obstacle_is_absent_and_the_rest_is_not():
    instance = generate(get_preset("paper-two-button"), 0)
    seen = look(instance)
    assert seen["button-1-range"] == pytest.approx(9 / math.hypot(20, 20)) and seen["button-1-sin"] == 1.0
    pillar = Solid("cylinder", x=0.0, y=4.0, half_x=0.5, half_y=0.5)
    hidden = look(dataclasses.replace(instance, solids=(*instance.solids, pillar)))
    assert [hidden[f"button-1-{word}"] for word in ("range", "sin", "cos", "lit")] == [0.0] * 4
    assert {name: value for name, value in hidden.items() if "button-2" in name or "exit" in name} == {
        name: value for name, value in seen.items() if "button-2" in name or "exit" in name}


def test_the_exit_behind_a_shut_door_is_out_of_sight_until_the_door_opens():
    instance = generate(get_preset("clutter"), 0)
    door, rules = instance.door, Kinematics(instance)
    inward = -np.sign(door.x) * (abs(door.x) > abs(door.y)), -np.sign(door.y) * (abs(door.y) > abs(door.x))
    state = rules.make_state(instance.starts[0])._replace(x=door.x + 0.8 * inward[0], y=door.y + 0.8 * inward[1])
    assert look(instance, state)["exit-range"] == 0.0
    assert look(instance, state._replace(puzzle=15))["exit-range"] > 0.0


def test_joints_and_blocks_are_seen():
    arm = generate(get_preset("arm-two-button"), 0)
    state = Kinematics(arm).make_state(arm.starts[0])
    seen = look(arm, state._replace(joint_steps=(3, 0, -6)))
    assert [seen[f"joint-{i}"] for i in (1, 2, 3)] == pytest.approx([0.5, 0.0, -1.0])
    env = gymnasium.make("hrl_escape/PushBlock-v1", observation="egocentric")
    env.reset(seed=0)
    state = env.unwrapped.get_state()
    names = env.unwrapped._observer.names
    for number, (x, y) in enumerate([(state.x + 2, state.y), (state.x, state.y - 1)]):
        props = [list(numbers) for numbers in state.physics.props]
        props[0][:2] = x, y
        moved = state._replace(heading_steps=0, physics=state.physics._replace(props=tuple(map(tuple, props))))
        block = dict(zip(names, env.unwrapped._observer.observe(moved), strict=True))
        diagonal = 2 * math.hypot(5, 5)
        assert block["block-1-range"] == pytest.approx((2, 1)[number] / diagonal)
        assert (block["block-1-sin"], block["block-1-cos"]) == pytest.approx([(0, 1), (-1, 0)][number], abs=1e-6)
        assert block["plate-1-range"] > 0.0
    env.close()


@pytest.mark.nightly_for("push-block")
@pytest.mark.parametrize("name", ["paper-two-button", "push-block", "clutter"])
def test_a_deep_copy_goes_on_with_the_same_episode(name):
    env = gymnasium.make(f"hrl_escape/{''.join(word.capitalize() for word in name.split('-'))}-v1")
    env.reset(seed=3)
    actions = np.random.default_rng(0).integers(env.action_space.n, size=30)
    for action in actions[:15]:
        env.step(action)
    other = copy.deepcopy(env)
    assert other.unwrapped.room is not env.unwrapped.room
    for action in actions[15:]:
        mine, its = env.step(action), other.step(action)
        assert (mine[0] == its[0]).all() and mine[1:4] == its[1:4]
    assert env.unwrapped.get_state() == other.unwrapped.get_state()
    for both in (env, other):
        both.reset()
    assert env.unwrapped.get_state() == other.unwrapped.get_state()
    closed = EscapeRoomEnv(name)
    closed.close()
    assert copy.deepcopy(closed).room is None
    env.close()
    other.close()
