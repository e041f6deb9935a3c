"""The kinematic MDP: the rules of motion, pressing, reward and end, through `Kinematics`."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrl_escape.env.config import DynamicsConfig, RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.geometry import compute_distance
from hrl_escape.env.instance import Rectangle, Start
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from tests.env.rooms import all_configs

QUICK = sorted(set(all_configs()) - {"largest", "push-block"})
FORWARD, BACK, LEFT, RIGHT, TURN_LEFT, TURN_RIGHT = range(6)


def play(kinematics, state, actions):
    """Yield the transitions of a sequence of primitives."""
    for action in actions:
        transition = kinematics.step(state, action)
        state = transition.state
        yield transition


@pytest.mark.nightly
@settings(max_examples=20)
@given(st.sampled_from(QUICK), st.integers(0, 5), st.integers(0, 2**32))
def test_the_body_keeps_its_clearance_whatever_it_does(name, seed, episode):
    instance = generate(all_configs()[name], seed)
    kinematics = Kinematics(instance)
    rng = np.random.default_rng(episode)
    state = kinematics.make_state(instance.starts[0], episode)
    for transition in play(kinematics, state, rng.integers(len(kinematics.actions), size=60).tolist()):
        at = transition.state
        clearance = min(compute_distance(at.x, at.y, f) for f in kinematics.footprints) - instance.robot.body_radius
        assert clearance >= 1e-3 - 1e-6
        assert abs(at.x) <= instance.reach_x
        assert abs(at.y) <= instance.reach_y
        if transition.terminated:
            break


def test_nine_strafes_left_solve_the_papers_one_button_room():
    instance = generate(get_preset("paper-one-button"), 0)
    kinematics = Kinematics(instance)
    steps = list(play(kinematics, kinematics.make_state(instance.starts[0]), [LEFT] * 9))
    assert [s.terminated for s in steps] == [False] * 8 + [True]
    assert sum(s.reward for s in steps) == 91
    assert steps[-1].pressed == (0,)
    assert steps[-1].state[:2] == (0.0, 9.0)


def test_scripted_play_of_the_published_room_returns_what_was_measured():
    instance = generate(get_preset("larg-2019", size=1, seed=0, handicap=10.0), 0)
    kinematics = Kinematics(instance)
    steps = list(play(kinematics, kinematics.make_state(instance.starts[0]), [LEFT] * 11))
    assert [s.terminated for s in steps] == [False] * 10 + [True]
    assert sum(s.reward for s in steps) == 90
    assert abs(steps[-1].state.y - 8.249) < 1e-12  # solid from 9, body radius 0.75, clearance
    small = Kinematics(generate(get_preset("larg-2019", size=1, seed=0, handicap=6.0), 0))
    steps = list(play(small, small.make_state(small.instance.starts[0]), [LEFT] * 11 + [FORWARD] * 5))
    assert steps[-1].terminated
    assert sum(s.reward for s in steps) == 85


def test_the_published_rule_turns_all_lights_off():
    instance = generate(get_preset("larg-2019", size=2, seed=14, handicap=6.0), 0)
    assert instance.puzzle.edges == ((0, 1),)
    kinematics = Kinematics(instance)
    go = [LEFT] * 11 + [RIGHT] * 11 + [BACK] * 11  # light 1, then light 2
    steps = list(play(kinematics, kinematics.make_state(instance.starts[0]), go))
    assert steps[10].pressed == (0,)
    assert steps[-1].state.puzzle == 3
    wrong = [BACK] * 11 + [FORWARD] * 11 + [LEFT] * 11  # light 2 first
    steps = list(play(kinematics, kinematics.make_state(instance.starts[0]), wrong))
    assert (steps[10].pressed, steps[10].state.puzzle) == ((1,), 0)
    assert steps[-1].state.puzzle == 1


@pytest.mark.nightly
@given(st.sampled_from([1, 5, 10, 15, 36, 45, 120]), st.integers(-5, 5), st.floats(-0.1, 0.1))
def test_a_full_circle_of_turns_gives_the_same_float(step, laps, offset):
    config = RoomConfig(robot=RobotConfig(turn_step_deg=step))
    instance = generate(config, 0)
    kinematics = Kinematics(instance)
    state = kinematics.make_state(Start(0, 0, 2, offset))
    turns = [TURN_LEFT if laps > 0 else TURN_RIGHT] * (abs(laps) * 360 // step)
    end = [*play(kinematics, state, turns)][-1].state if turns else state
    assert kinematics.get_heading(end) == kinematics.get_heading(state)
    assert math.isclose(Kinematics.compute_heading(3, 0, math.radians(10)), math.radians(30))


def test_a_press_is_the_beginning_of_touching():
    config = RoomConfig(
        start=StartConfig(place="fixed"), room=ShapeConfig(width=8, depth=20), robot=RobotConfig(body_radius=0.5),
        puzzle=ButtonsConfig(count=1, allow_off=True, buttons=Panels(places="paper")),
    )
    instance = dataclasses.replace(generate(config, 0), exit=Rectangle(-3, -2, -3, -2))
    kinematics = Kinematics(instance)
    away = play(kinematics, kinematics.make_state(Start(0, 9, 0)), [LEFT, LEFT, RIGHT, LEFT, TURN_LEFT])
    assert [(s.pressed, s.state.puzzle) for s in away] == [((0,), 1), ((), 1), ((), 1), ((0,), 0), ((), 0)]
    resting = kinematics.make_state(Start(0, 9.4, 0))  # an episode that begins in touch has not pressed
    assert resting.touching == 1
    assert [s.pressed for s in play(kinematics, resting, [LEFT, RIGHT, LEFT])] == [(), (), (0,)]


def test_touching_is_within_the_margin_of_the_box_in_three_dimensions():
    high = Panels(height=0.5, centre_height=1.26, places="paper")
    room = RoomConfig(puzzle=ButtonsConfig(count=1, buttons=high), dynamics=DynamicsConfig(press_margin=0.05))
    kinematics = Kinematics(generate(room, 0))  # the box hangs 0.01 m above the body's top, 0.05 m thick from y = 9.9
    gap = math.sqrt(0.05**2 - 0.01**2)
    assert kinematics.compute_touching(0, 9.9 - 0.75 - gap + 1e-9, 0, 0, (), ()) == 1
    assert kinematics.compute_touching(0, 9.9 - 0.75 - gap - 1e-6, 0, 0, (), ()) == 0


def test_the_hand_touches_where_brute_force_over_its_sphere_says():
    instance = generate(get_preset("arm-two-button"), 0)
    kinematics = Kinematics(instance)
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(3000):
        target = instance.targets[int(rng.integers(2))]
        joints = tuple(int(v) for v in rng.integers(-6, 7, 3))
        heading = int(rng.integers(36))
        hand = kinematics.get_hand_in_base(joints)
        cos, sin = kinematics.get_rotation(heading, 0.0)
        aim = rng.normal(0, 0.12, 2)
        x = target.x + aim[0] - cos * hand[0] + sin * hand[1]
        y = target.y + aim[1] - sin * hand[0] - cos * hand[1]
        at = np.array([x + cos * hand[0] - sin * hand[1], y + sin * hand[0] + cos * hand[1], hand[2]])
        c, s = math.cos(target.yaw), math.sin(target.yaw)
        spin = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        own = spin @ (at - (target.x, target.y, target.z))
        half = np.array([target.half_x, target.half_y, target.half_z])
        distance = np.linalg.norm(own - np.clip(own, -half, half))
        index = instance.targets.index(target)
        touched = bool(kinematics.compute_touching(x, y, heading, 0.0, joints, ()) >> index & 1)
        if abs(distance - 0.07) > 1e-9:
            assert touched == (distance <= 0.07)
        hits += touched
    assert hits > 50


def test_joints_stop_at_their_limits_and_count_in_whole_steps():
    instance = generate(get_preset("arm-two-button"), 0)
    kinematics = Kinematics(instance)
    state = kinematics.make_state(instance.starts[0])
    ends = [s.state.joint_steps for s in play(kinematics, state, [8] * 8)]
    assert [e[1] for e in ends] == [1, 2, 3, 4, 5, 6, 6, 6]
    assert [s.state.joint_steps[1] for s in play(kinematics, state, [9] * 8)][-1] == -6
    assert math.isclose(kinematics.get_angles([*play(kinematics, state, [8] * 8)][-1].state)[1], math.radians(60))


def test_the_horizon_truncates_and_exit_terminates_never_both():
    instance = dataclasses.replace(generate(get_preset("paper-one-button"), 0), horizon=9)
    kinematics = Kinematics(instance)
    state = kinematics.make_state(instance.starts[0])
    last = [*play(kinematics, state, [LEFT] * 9)][-1]
    assert (last.terminated, last.truncated) == (True, False)
    last = [*play(kinematics, state, [TURN_LEFT] * 9)][-1]
    assert (last.terminated, last.truncated, last.reward) == (False, True, -1)


def test_slip_does_nothing_with_its_probability_and_noise_has_its_size():
    config = get_preset("paper-one-button")
    instance = generate(dataclasses.replace(config, dynamics=DynamicsConfig(slip=0.3, noise=0.1)), 0)
    kinematics = Kinematics(instance)
    state = kinematics.make_state(instance.starts[0], noise_key=77)
    moves = []
    for n in range(4000):
        moves.append(kinematics.step(state._replace(primitives=n), FORWARD).state.x)
    moves = np.array(moves)
    assert abs((moves == 0).mean() - 0.3) < 0.03
    assert abs(moves[moves != 0].mean() - 1) < 0.01
    assert abs(moves[moves != 0].std() - 0.1) < 0.01
    turned = [kinematics.step(state._replace(primitives=n), TURN_LEFT).state for n in range(2000)]
    angles = np.array([kinematics.get_heading(s) for s in turned])
    assert abs(angles[angles != 0].std() - math.radians(10) * 0.1) < math.radians(0.1)


def test_the_door_blocks_until_the_puzzle_is_solved():
    instance = generate(all_configs()["door"], 1)
    kinematics = Kinematics(instance)
    door = instance.door
    solved = (1 << instance.puzzle.count) - 1
    inward = math.atan2(door.y - instance.exit.centre[1], door.x - instance.exit.centre[0])
    x, y = door.x + 1.5 * math.cos(inward), door.y + 1.5 * math.sin(inward)
    push = (-3 * math.cos(inward), -3 * math.sin(inward))
    assert kinematics.compute_free_fraction(x, y, *push, 0) < 0.3
    through = kinematics.compute_free_fraction(x, y, *push, solved)
    assert instance.exit.contains(x + through * push[0], y + through * push[1])
    # a door cannot close on the robot standing in it
    assert kinematics.compute_free_fraction(door.x, door.y, -0.1 * push[0], -0.1 * push[1], 0) == 1


@pytest.mark.nightly
@settings(max_examples=20)
@given(st.sampled_from(QUICK), st.integers(0, 3), st.integers(0, 2**32))
def test_kinematics_are_a_pure_function_of_state_and_action(name, seed, episode):
    instance = generate(all_configs()[name], seed)
    kinematics = Kinematics(instance)
    rng = np.random.default_rng(episode)
    actions = rng.integers(len(kinematics.actions), size=30).tolist()
    state = kinematics.make_state(instance.starts[-1], episode)
    first = list(play(kinematics, state, actions))
    assert list(play(Kinematics(instance), state, actions)) == first

