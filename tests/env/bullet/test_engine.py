"""The Bullet engine: its body keeps its distance, its rooms stay independent, and it frees everything."""

import dataclasses
import gc
import math
import os
import sys

import numpy as np
import pybullet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrl_escape.env.bullet.cameras import Stage
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.bullet.physics import PhysicsDynamics
from hrl_escape.env.config import DynamicsConfig, ExitConfig, ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.geometry import compute_distance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ClosedError, StateError, UnsupportedError
from tests.covering import thin
from tests.env.bullet_world import BulletWorld
from tests.env.rooms import all_configs
from tests.forks import run_fork

KINEMATIC = sorted(set(all_configs()) - {"largest", "push-block"})
SKIN = 1e-3


@pytest.fixture
def make_room():
    """Make rooms that are closed after the test."""
    rooms = []

    def make(config, seed=0, **changes):
        rooms.append(BulletRoom(generate(dataclasses.replace(config, **changes), seed)))
        return rooms[-1]

    yield make
    for room in rooms:
        room.close()


# --- the body keeps its distance, asked of Bullet --------------------------------------------

floors = st.builds(
    RoomConfig,
    room=st.builds(ShapeConfig, width=st.floats(12, 25), depth=st.floats(12, 25), rooms=st.integers(1, 3)),
    robot=st.builds(RobotConfig, body_radius=st.floats(0.2, 0.8), move_step=st.floats(0.2, 3),
                    turn_step_deg=st.sampled_from([7.5, 10.0, 45.0])),
    obstacles=st.builds(ObstaclesConfig, count=st.integers(0, 8), cylinder_share=st.floats(0, 1)),
    exit=st.builds(ExitConfig, door=st.booleans(), width=st.just(2.4)),
    puzzle=st.builds(ButtonsConfig, count=st.integers(1, 3), allow_off=st.booleans()),
    dynamics=st.builds(DynamicsConfig, noise=st.sampled_from([0.0, 0.3]), slip=st.sampled_from([0.0, 0.1])),
)


@pytest.mark.nightly
@settings(max_examples=40)
@given(floors, st.integers(0, 1000), st.lists(st.tuples(st.integers(0, 5), st.integers(1, 4)), max_size=12))
def test_body_is_inside_and_keeps_its_skin_whatever_it_does_asked_of_bullet(config, seed, runs):
    instance = generate(config, seed)
    room = BulletRoom(instance)
    world = BulletWorld(room.rules)
    for action, times in runs:
        for _ in range(times):
            room.step(action)
            assert world.compute_clearance(room.state) >= SKIN - 1e-6
            assert abs(room.state.x) <= instance.reach_x
            assert abs(room.state.y) <= instance.reach_y


@pytest.mark.nightly
@given(st.integers(0, 20), st.lists(st.integers(0, 3), min_size=5, max_size=25), st.data())
@settings(max_examples=25)
def test_body_keeps_its_skin_through_the_doorway_while_the_door_opens_and_shuts(seed, actions, data):
    config = RoomConfig(exit=ExitConfig(door=True, width=2.2), robot=RobotConfig(body_radius=0.6, move_step=0.4),
                        puzzle=ButtonsConfig(count=1, allow_off=True))
    instance = generate(config, seed)
    room = BulletRoom(instance)
    world = BulletWorld(room.rules)
    door, (exit_x, exit_y) = instance.door, instance.exit.centre
    across, along = math.cos(door.yaw), math.sin(door.yaw)
    inwards = -math.copysign(1.0, across * (exit_y - door.y) - along * (exit_x - door.x))
    beside = 0.1 + 0.6 + 0.4  # before the door, facing it
    x, y = door.x - along * inwards * beside, door.y + across * inwards * beside
    heading = round((math.atan2(exit_y - y, exit_x - x) % math.tau) / math.radians(10)) % 36
    room.set_state(room.state._replace(x=x, y=y, heading_steps=heading))
    for action in actions:
        room.set_state(room.state._replace(puzzle=data.draw(st.integers(0, 1))))
        assert world.compute_clearance(room.state) >= SKIN - 1e-6
        room.step(action)
        assert world.compute_clearance(room.state) >= SKIN - 1e-6


def test_clearance_of_bullet_agrees_with_the_exact_distance(make_room):
    room = make_room(get_preset("clutter"), seed=3)
    rng, instance, world = np.random.default_rng(0), room.instance, BulletWorld(room.rules)
    shapes = [solid.footprint for solid in (*instance.solids, instance.door)]
    for _ in range(200):
        x, y = rng.uniform(-9, 9, 2)
        exact = min(compute_distance(x, y, shape) for shape in shapes) - instance.robot.body_radius
        if exact > 0.0:
            room.set_state(room.state._replace(x=float(x), y=float(y)))
            assert world.compute_clearance(room.state) == pytest.approx(exact, abs=2e-6)


def test_clearance_notices_a_body_put_too_near(make_room):
    room = make_room(get_preset("paper-one-button"))
    world = BulletWorld(room.rules)
    assert world.compute_clearance(room.state._replace(x=10.0 - 0.75 - 0.0005)) == pytest.approx(0.0005, abs=1e-6)
    assert world.compute_clearance(room.state._replace(x=9.5)) < 0.0


# --- bodies stand where the state says -------------------------------------------------------


@pytest.mark.parametrize("name", ["arm-two-button", "seven-joints", "noisy"])
def test_base_and_hand_stand_in_bullet_where_the_state_says(make_room, name):
    room = make_room(all_configs()[name])
    world, rng = PhysicsDynamics(room.rules), np.random.default_rng(0)
    for action in rng.integers(len(room.rules.actions), size=80).tolist():
        room.step(action)
        world.write(room.state)
        base, hand = (pybullet.getLinkState(world.scene.robot, link, computeForwardKinematics=True,
                                            physicsClientId=world.client)
                      for link in (world.scene.base_link, world.scene.hand_link))
        assert base[4][:2] == pytest.approx((room.state.x, room.state.y), abs=1e-6)
        yaw = pybullet.getEulerFromQuaternion(base[5])[2]
        assert math.remainder(yaw - room.rules.get_heading(room.state), math.tau) == pytest.approx(0, abs=1e-6)
        assert hand[4] == pytest.approx(room.rules.get_hand(room.state), abs=1e-6)


@pytest.mark.nightly
def test_an_open_door_swings_out_of_the_room(make_room):
    for seed in range(6):  # doors in all four walls
        room = make_room(all_configs()["door"], seed=seed)
        stage, door, area = Stage(room.instance), room.instance.door, room.instance.exit
        stage.follow(room.state._replace(puzzle=1 << room.instance.puzzle.goal))
        (x, y, _), turn = pybullet.getBasePositionAndOrientation(stage._leaf.whole[0], physicsClientId=stage.client)
        yaw = pybullet.getEulerFromQuaternion(turn)[2]
        leaf = x + door.half_x * math.cos(yaw), y + door.half_x * math.sin(yaw)  # its middle, from the hinge
        outwards = (area.centre[0] - door.x, area.centre[1] - door.y)
        assert (leaf[0] - door.x) * outwards[0] + (leaf[1] - door.y) * outwards[1] > 0.5 * door.half_x, seed


# --- states ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", thin(KINEMATIC, 3, 2))
def test_set_state_continues_exactly(make_room, name):
    room = make_room(all_configs()[name])
    rng = np.random.default_rng(1)
    actions = rng.integers(len(room.rules.actions), size=60).tolist()
    steps = [room.step(action) for action in actions]
    room.reset(room.instance.starts[0], noise_key=99)
    room.set_state(steps[19].state)
    assert [room.step(action) for action in actions[20:]] == steps[20:]


def test_a_state_of_another_robot_is_refused(make_room):
    room, other = make_room(get_preset("arm-two-button")), make_room(get_preset("clutter"))
    with pytest.raises(StateError, match="joint_steps.*0 numbers"):
        other.set_state(room.state)
    with pytest.raises(StateError, match="heading_steps = 36"):
        room.set_state(room.state._replace(heading_steps=36))


# --- clients ---------------------------------------------------------------------------------


def count_clients():
    return sum(pybullet.isConnected(client) for client in range(64))


def test_rooms_in_one_process_are_independent(make_room):
    rooms = [make_room(get_preset(name)) for name in ("clutter", "arm-two-button", "clutter")]
    before = rooms[2].state
    rooms[0].step(0)
    rooms[1].close()
    assert rooms[2].state == before
    assert rooms[2].step(0).state == rooms[0].state


def test_a_closed_room_says_so_and_closing_again_is_no_error():
    room = BulletRoom(generate(get_preset("paper-one-button"), 0))
    state = room.state
    room.close()
    room.close()
    for use in (lambda: room.step(0), lambda: room.reset(room.instance.starts[0]), lambda: room.set_state(state),
                lambda: room.show(10)):
        with pytest.raises(ClosedError, match="closed"):
            use()


def make_physics_room():
    config = get_preset("paper-one-button")
    return BulletRoom(generate(dataclasses.replace(config, dynamics=DynamicsConfig(kind="physics")), 0))


@pytest.mark.nightly
def test_a_forgotten_room_frees_its_client():
    before = count_clients()
    room = BulletRoom(generate(get_preset("paper-one-button"), 0))
    assert room.step(0).state == room.state and room.is_open and count_clients() == before, "kinematics needs none"
    room = make_physics_room()
    assert pybullet.isConnected(room.physics.client) and count_clients() == before + 1
    del room
    gc.collect()
    assert count_clients() == before


def test_a_room_whose_client_is_gone_is_closed():
    room = make_physics_room()
    pybullet.disconnect(room.physics.client)
    assert not room.is_open
    with pytest.raises(ClosedError, match="window"):
        room.step(0)
    room.close()


def read_resident_mib():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


@pytest.mark.nightly_for("physics")
@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="reads Linux's /proc")
@pytest.mark.parametrize("kind", ["kinematic", "physics"])
def test_opening_and_closing_leaves_no_memory_behind(kind):
    config = get_preset("arm-two-button")
    instance = generate(dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, kind=kind)), 0)

    def cycle(times):
        for _ in range(times):
            room = BulletRoom(instance)
            room.step(0)
            room.close()

    cycle(10)
    before = read_resident_mib()
    cycle(40)
    assert read_resident_mib() - before < 20.0  # one client is about 28 MiB; forty would be 1,100


def test_a_window_without_a_display_is_refused(monkeypatch):
    if not sys.platform.startswith("linux"):
        pytest.skip("only Linux names its display in the environment")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(UnsupportedError, match="display.*rgb_array"):
        BulletRoom(generate(get_preset("paper-one-button"), 0), window=True)


def test_bullet_says_nothing_on_standard_output():
    code = (
        "from hrl_escape.env.bullet.engine import BulletRoom\n"
        "from hrl_escape.env.sampling.generation import generate\n"
        "from hrl_escape.env.presets import get_preset\n"
        "for name in ('arm-two-button', 'push-block'):\n"
        "    room = BulletRoom(generate(get_preset(name), 0))\n"
        "    room.step(0)\n"
        "    room.close()\n"
    )
    done = run_fork(code, check=True)
    assert done.stdout == ""
