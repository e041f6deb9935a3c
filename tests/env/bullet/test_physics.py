"""Physics dynamics: the same primitives by rigid bodies, what can be pushed and swung, and exact states."""

import dataclasses
import json
import math
import pickle

import numpy as np
import pybullet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.config import (
    DynamicsConfig,
    ExitConfig,
    ObstaclesConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
)
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.push_block import PushBlockConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import StateError
from tests.env.bullet_world import BulletWorld
from tests.env.pushing import solve
from tests.forks import run_fork

FORWARD, BACK, LEFT, RIGHT, TURN_LEFT, TURN_RIGHT = range(6)


def with_physics(config, **changes):
    return dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, kind="physics", **changes))


@pytest.fixture
def make_room():
    """Make rooms under physics that are closed after the test."""
    rooms = []

    def make(config, seed=0, **changes):
        rooms.append(BulletRoom(generate(with_physics(config, **changes), seed)))
        return rooms[-1]

    yield make
    for room in rooms:
        room.close()


def play(room, actions):
    return [room.step(int(action)) for action in actions]


# --- motion ----------------------------------------------------------------------------------

WIDE = RoomConfig(room=ShapeConfig(width=200, depth=200), start=StartConfig(place="fixed"))


@pytest.mark.nightly_for("arm", "kuka", "base", "rectangle")
@pytest.mark.parametrize("robot", [
    RobotConfig(), RobotConfig(joints=7, link_length=0.1), RobotConfig(kind="kuka-iiwa", joints=7),
    RobotConfig(move_step=0.3, turn_step_deg=45, joints=2, joint_step_deg=3),
    RobotConfig(footprint="rectangle", drive="differential"),
], ids=["base", "arm", "kuka", "small-steps", "rectangle"])
def test_free_moves_agree_with_kinematics(make_room, robot):
    room = make_room(dataclasses.replace(WIDE, robot=robot))
    rules = Kinematics(room.instance)
    ideal = rules.make_state(room.instance.starts[0])
    for action in np.random.default_rng(0).integers(len(rules.actions), size=40).tolist():
        ideal, real = rules.step(ideal, action).state, room.step(action).state
        assert (real.x, real.y) == pytest.approx((ideal.x, ideal.y), abs=1e-3)
        assert real.heading_steps == ideal.heading_steps
        assert real.heading_offset == pytest.approx(0.0, abs=1e-4)
        assert real.joint_steps == ideal.joint_steps
        assert real.joint_offsets == pytest.approx([0.0] * robot.joints, abs=5e-3)


@pytest.mark.parametrize(("slip", "slips"), [(0.3, range(3, 26)), (0.0, range(1))])
def test_noise_and_slip_are_those_of_kinematics(make_room, slip, slips):
    room = make_room(WIDE, noise=0.2, slip=slip)
    rules = Kinematics(room.instance)
    ideal = rules.make_state(room.instance.starts[0], 5)
    room.reset(room.instance.starts[0], 5)
    slipped = 0
    for action in [FORWARD, TURN_LEFT, LEFT, BACK, TURN_LEFT] * 8:
        after, real = rules.step(ideal, action).state, room.step(action).state
        slipped += after[:4] == ideal[:4]
        ideal = after
        assert (real.x, real.y) == pytest.approx((ideal.x, ideal.y), abs=1e-3)
        turned = room.rules.get_heading(real) - rules.get_heading(ideal)
        assert math.remainder(turned, math.tau) == pytest.approx(0.0, abs=1e-4)
    assert slipped in slips


def make_thin_room(seed: int, step: float) -> BulletRoom:
    """A room of thin walls, with a door, for long moves."""
    config = RoomConfig(room=ShapeConfig(width=12, depth=12, wall_thickness=0.02),
                        exit=ExitConfig(door=True, width=2.4),
                        robot=RobotConfig(body_radius=0.4, move_step=step, joints=2),
                        obstacles=ObstaclesConfig(count=4), puzzle=ButtonsConfig(count=1))
    return BulletRoom(generate(with_physics(config), seed))


def check_drive(seed: int, runs: list[tuple[int, int]], step: float) -> None:
    """Drive in a thin room, each action so many times: the robot stays within, and overlaps nothing by a centimetre."""
    room = make_thin_room(seed, step)
    world = BulletWorld(room.rules)
    try:
        for action, times in runs:
            for _ in range(times):
                at = room.step(action).state
                assert abs(at.x) <= room.instance.reach_x and abs(at.y) <= room.instance.reach_y
                assert world.compute_clearance(at) > -0.01
    finally:
        room.close()


@pytest.mark.nightly
@settings(max_examples=10)
@given(st.integers(0, 1000), st.lists(st.tuples(st.integers(0, 9), st.integers(1, 4)), max_size=8),
       st.sampled_from([0.7, 5.0]))
def test_nothing_tunnels_and_bodies_hardly_overlap(seed, runs, step):
    check_drive(seed, runs, step)


@pytest.mark.nightly
def test_a_body_wedged_into_a_gap_too_narrow_hardly_overlaps():
    check_drive(198, [(0, 1), (2, 1), (1, 3)], 5.0)


def test_a_body_deep_in_a_wall_drives_off(make_room):
    room = make_room(dataclasses.replace(get_preset("paper-one-button"), puzzle=ButtonsConfig()))
    room.set_state(room.state._replace(x=9.25 + 0.008, y=3.0))
    assert room.step(BACK).state.x == pytest.approx(9.258 - 1.0, abs=0.02)


@pytest.mark.nightly
def test_a_body_that_runs_into_the_far_wall_of_the_alcove_is_in_the_exit():
    room = make_thin_room(296, 5.0)  # where its second move ends against that wall
    try:
        assert not room.step(BACK).terminated
        last = room.step(BACK)
        assert last.terminated and last.state.y == room.instance.reach_y == room.instance.exit.y_max
        assert room.instance.exit.contains(last.state.x, last.state.y)
    finally:
        room.close()


def test_a_push_into_a_wall_stops_there_and_a_slanted_one_slides(make_room):
    room = make_room(dataclasses.replace(get_preset("paper-one-button"), puzzle=ButtonsConfig()))
    room.set_state(room.state._replace(x=8.9, y=3.0))
    straight = room.step(FORWARD).state
    assert (straight.x, straight.y) == pytest.approx((9.25, 3.0), abs=0.01)
    room.set_state(room.state._replace(heading_steps=3))  # 30 degrees: into the wall, and along it
    slanted = room.step(FORWARD).state
    assert slanted.x == pytest.approx(9.25, abs=0.01)
    assert 3.1 < slanted.y <= 3.0 + math.sin(math.radians(30)) + 0.05


def test_no_episode_begins_with_the_arm_in_a_wall_or_an_obstacle(make_room):
    config = RoomConfig(room=ShapeConfig(width=8, depth=8), robot=RobotConfig(body_radius=0.3, joints=3),
                        obstacles=ObstaclesConfig(count=4, size_max=1.0), puzzle=ButtonsConfig(count=1))
    for seed in range(12):
        room = make_room(config, seed=seed)
        world = room.physics
        world.write(room.state)
        for wall in world.scene.solids:
            assert not pybullet.getClosestPoints(world.scene.robot, wall, 0.0, physicsClientId=world.client)


def test_an_arm_is_blocked_by_a_wall(make_room):
    config = RoomConfig(robot=RobotConfig(body_radius=0.3, joints=1, link_length=2.0), start=StartConfig(place="fixed"))
    room = make_room(config)
    room.set_state(room.state._replace(x=9.0, heading_steps=9))  # the arm points along the wall, 1 m from it
    free = Kinematics(room.instance)
    ideal = room.state
    for _ in range(6):
        ideal, real = free.step(ideal, 7).state, room.step(7).state
    assert ideal.joint_steps == (-6,)
    reach = abs(room.rules.get_angles(real)[0])
    assert math.degrees(reach) == pytest.approx(math.degrees(math.asin(0.95 / 2.0)), abs=3)
    assert room.rules.get_hand(real)[0] < 10.05 < room.rules.get_hand(ideal)[0]


def test_joints_stop_at_their_limits(make_room):
    room = make_room(RoomConfig(robot=RobotConfig(joints=1, joint_limit_deg=25), start=StartConfig(place="fixed")))
    steps = [t.state.joint_steps for t in play(room, [6] * 4 + [7] * 6)]
    assert steps == [(1,), (2,), (2,), (2,), (1,), (0,), (-1,), (-2,), (-2,), (-2,)]


# --- presses ---------------------------------------------------------------------------------

BUTTON = RoomConfig(
    robot=RobotConfig(body_radius=0.5), start=StartConfig(place="fixed"),
    exit=ExitConfig(place="fixed", x=-8, y=-8),
    puzzle=ButtonsConfig(count=1, allow_off=True, buttons=Panels(places="paper")),
)


def test_a_button_is_pressed_by_force_and_only_when_contact_begins(make_room):
    room = make_room(BUTTON)  # its face is at y = 9.9
    room.set_state(room.state._replace(y=9.9 - 0.5 - 1.01))
    near = room.step(LEFT)  # ends within the press margin, 0.01 m away, without pushing
    assert near.state.y == pytest.approx(9.39, abs=2e-3)
    assert near.pressed == () and near.state.puzzle == 0
    pushed = room.step(LEFT)
    assert pushed.pressed == (0,) and pushed.state.puzzle == 1
    still = play(room, [LEFT, LEFT, TURN_LEFT])
    assert [t.pressed for t in still] == [(), (), ()]
    room.set_state(still[1].state)
    left = room.step(RIGHT)
    assert left.state.touching == 0
    again = play(room, [LEFT, LEFT])
    assert [t.pressed for t in again] == [(0,), ()] or [t.pressed for t in again] == [(), (0,)]
    assert again[-1].state.puzzle == 0  # allow_off: the second press


def test_the_hand_presses_and_other_links_do_not(make_room):
    config = RoomConfig(
        robot=RobotConfig(body_radius=0.3, body_height=0.6, joints=1, link_length=1.0),
        start=StartConfig(place="fixed"), exit=ExitConfig(place="fixed", x=-8, y=-8),
        dynamics=DynamicsConfig(press_with="hand"),
        puzzle=ButtonsConfig(count=1, buttons=Panels(places="paper", width=0.4, thickness=0.6, centre_height=0.6)),
    )
    room = make_room(config)  # the panel sticks out to y = 9.4 around x = 0
    rest = room.state._replace(heading_steps=9)  # the arm points at it
    room.set_state(rest._replace(y=9.4 - 1.0 - 0.5))
    assert [t.pressed for t in play(room, [FORWARD])] == [(0,)]
    # before the panel, pointing past its far edge: turning leans the link on the edge, the hand is in the air
    room.set_state(rest._replace(x=-0.6, y=9.25, heading_steps=0))
    turned = play(room, [TURN_LEFT] * 3)
    assert [t.pressed for t in turned] == [()] * 3
    scene, client = room.physics.scene, room.physics.client
    contacts = pybullet.getContactPoints(scene.robot, scene.targets[0], physicsClientId=client)
    assert any(point[3] == scene.joints[0] and point[9] > 0.0 for point in contacts)


# --- the door --------------------------------------------------------------------------------


def place_before_door(room, puzzle):
    """Put the robot before the door, facing the exit, and return its state."""
    door, (exit_x, exit_y) = room.instance.door, room.instance.exit.centre
    steps = round(math.atan2(exit_y - door.y, exit_x - door.x) / math.radians(10)) % 36
    cos, sin = math.cos(math.radians(10 * steps)), math.sin(math.radians(10 * steps))
    return room.state._replace(x=door.x - 1.2 * cos, y=door.y - 1.2 * sin, heading_steps=steps, puzzle=puzzle)


@pytest.mark.parametrize("seed", range(4))
def test_the_door_stays_shut_until_solved_and_then_swings_before_the_robot(make_room, seed):
    config = RoomConfig(exit=ExitConfig(door=True, width=2.2), robot=RobotConfig(body_radius=0.6),
                        puzzle=ButtonsConfig(count=1))
    room = make_room(config, seed=seed)
    room.set_state(place_before_door(room, puzzle=0))
    shut = play(room, [FORWARD] * 4)
    assert not any(t.terminated for t in shut)
    assert abs(shut[-1].state.physics.door[0]) < math.radians(2)
    room.set_state(place_before_door(room, puzzle=1))
    opened = []
    while not (opened and opened[-1].terminated) and len(opened) < 4:
        opened.append(room.step(FORWARD))
    assert opened[-1].terminated and opened[-1].reward == 99.0
    assert abs(opened[-1].state.physics.door[0]) > math.radians(30)


def test_a_door_left_open_closes_when_the_puzzle_is_undone(make_room):
    config = RoomConfig(exit=ExitConfig(door=True, width=2.2), puzzle=ButtonsConfig(count=1))
    room = make_room(config)
    physics = room.state.physics._replace(door=(math.radians(80), 0.0))
    room.set_state(room.state._replace(physics=physics))
    after = play(room, [TURN_LEFT] * 12)
    assert abs(after[-1].state.physics.door[0]) < math.radians(2)


# --- pushing ---------------------------------------------------------------------------------


@pytest.mark.nightly_for("4")
@pytest.mark.parametrize("seed", [1, 4])
def test_a_scripted_policy_pushes_the_block_onto_the_plate_and_leaves(make_room, seed):
    room = make_room(get_preset("push-block"), seed=seed)
    assert not room.instance.puzzle.is_solved(room.state.puzzle)
    driver = solve(room)
    assert driver.last.terminated and driver.last.reward == 99.0
    assert driver.total == 100.0 - room.state.primitives
    block, plate = room.state.physics.props[0], room.instance.props[1]
    assert max(abs(block[0] - plate.x), abs(block[1] - plate.y)) <= plate.prop.half_size
    assert block[2] == pytest.approx(0.2, abs=1e-3)  # it slid, it was not lifted or toppled


@pytest.mark.nightly
def test_a_block_that_nobody_touches_stays_where_it_is(make_room):
    room = make_room(get_preset("push-block"))
    first = room.state.physics.props
    for _ in range(200):
        assert room.step(4).state.physics.props == first  # turns on the spot


def test_a_block_is_moved_by_another_that_is_pushed_and_rests_again(make_room):
    room = make_room(dataclasses.replace(get_preset("push-block"), puzzle=PushBlockConfig(count=2)))
    (x, y), turn = (0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    height = room.state.physics.props[0][2]
    props = list(room.state.physics.props)
    for number, along in ((0, 1.0), (2, 1.61)):  # one behind the other, the robot behind both
        props[number] = (x + along, y, height, *turn, *(0.0,) * 6)
    room.set_state(room.state._replace(x=x, y=y, heading_steps=0, heading_offset=0.0,
                                       physics=room.state.physics._replace(props=tuple(props))))
    pushed = [room.step(0).state.physics.props for _ in range(2)][-1]
    assert pushed[0][0] > 1.2 and pushed[2][0] > 1.8
    room.step(1)
    rested = room.step(1).state.physics.props
    assert [room.step(4).state.physics.props for _ in range(5)] == [rested] * 5


def test_a_block_too_heavy_does_not_move(make_room):
    config = get_preset("push-block")
    light, heavy = (make_room(dataclasses.replace(config, puzzle=dataclasses.replace(config.puzzle, block_mass=mass)))
                    for mass in (5.0, 5000.0))
    for room in (light, heavy):
        block = room.instance.props[0]
        room.set_state(room.state._replace(x=block.x - 0.8, y=block.y, heading_steps=0))  # 0.1 m away
        room.step(FORWARD)  # 0.5 m
    moved = [room.state.physics.props[0][0] - room.instance.props[0].x for room in (light, heavy)]
    assert moved[0] == pytest.approx(0.4, abs=0.08)
    assert moved[1] == pytest.approx(0.0, abs=0.01)


# --- states ----------------------------------------------------------------------------------

ROOMS = {
    "push-block": get_preset("push-block"),
    "clutter": get_preset("clutter"),
    "arm": get_preset("arm-two-button"),
    "noisy-kuka": RoomConfig(robot=RobotConfig(kind="kuka-iiwa", joints=7), room=ShapeConfig(width=8, depth=8),
                             dynamics=DynamicsConfig(noise=0.1, slip=0.1), exit=ExitConfig(door=True, width=2.5),
                             puzzle=ButtonsConfig(count=1)),
}


def choose_actions(room, number):
    """Mostly moves, so that things meet."""
    count = len(room.rules.actions)
    chances = np.where(np.arange(count) < 4, 3.0, 1.0)
    return np.random.default_rng(7).choice(count, number, p=chances / chances.sum()).tolist()


@pytest.mark.nightly_for("clutter", "noisy-kuka", "arm")
@pytest.mark.parametrize("name", ROOMS)
def test_a_state_continues_bit_for_bit_in_its_room_and_in_another(make_room, name):
    room, other = make_room(ROOMS[name]), make_room(ROOMS[name])
    if name == "push-block":  # begin in touch with the block
        block = room.instance.props[0]
        room.set_state(room.state._replace(x=block.x - 0.71, y=block.y + 0.05, heading_steps=0))
    actions = choose_actions(room, 30)
    steps = play(room, actions)
    play(room, actions[:9])  # somewhere else
    room.set_state(steps[14].state)
    assert play(room, actions[15:]) == steps[15:]
    play(other, [TURN_LEFT] * 5)  # another history
    other.set_state(pickle.loads(pickle.dumps(steps[14].state)))
    assert play(other, actions[15:]) == steps[15:]
    assert hash(steps[14].state) == hash(pickle.loads(pickle.dumps(steps[14].state)))


PROGRAM = """
import json, sys
from tests.env.bullet.test_physics import ROOMS, choose_actions, play, with_physics
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.sampling.generation import generate
room = BulletRoom(generate(with_physics(ROOMS[sys.argv[1]]), 0))
room.reset(room.instance.starts[0], 11)
print(json.dumps([repr(t) for t in play(room, choose_actions(room, 25))]))
"""


@pytest.mark.nightly_for("noisy-kuka")
@pytest.mark.parametrize("name", ["push-block", "noisy-kuka"])
def test_another_process_runs_the_same_trajectory_bit_for_bit(make_room, name):
    room = make_room(ROOMS[name])
    play(room, choose_actions(room, 10))  # this process has a history
    room.reset(room.instance.starts[0], 11)
    done = run_fork(PROGRAM, name, check=True)
    assert json.loads(done.stdout) == [repr(t) for t in play(room, choose_actions(room, 25))]


def test_a_state_without_physics_is_at_rest_where_things_began(make_room):
    room = make_room(get_preset("push-block"))
    first = room.state
    block = room.instance.props[0]
    room.set_state(first._replace(x=block.x - 0.8, y=block.y, heading_steps=0))
    room.step(FORWARD)
    assert room.state.physics.props[0] != first.physics.props[0]
    room.set_state(first._replace(physics=None))
    assert room.step(TURN_LEFT).state.physics.props[0][:3] == pytest.approx(first.physics.props[0][:3], abs=1e-4)
    room.set_state(first)
    expected = room.step(TURN_LEFT)
    room.set_state(first._replace(physics=None))
    assert room.step(TURN_LEFT) == expected


def test_a_state_with_other_props_is_refused(make_room):
    room, other = make_room(get_preset("push-block")), make_room(BUTTON)
    state = other.state._replace(physics=room.state.physics)
    with pytest.raises(StateError, match="physics.*0 props"):
        other.set_state(state)


def test_the_world_is_put_into_any_state(make_room):
    room = make_room(get_preset("push-block"))
    states = [t.state for t in play(room, choose_actions(room, 6))]
    scene, client = room.physics.scene, room.physics.client
    for state in states:
        room.physics.write(state)
        link = pybullet.getLinkState(scene.robot, scene.base_link, computeForwardKinematics=True,
                                     physicsClientId=client)
        assert link[4][:2] == pytest.approx((state.x, state.y), abs=1e-6)
        block = pybullet.getBasePositionAndOrientation(scene.blocks[0][0], physicsClientId=client)
        assert block[0] == pytest.approx(state.physics.props[0][:3], abs=1e-9)
