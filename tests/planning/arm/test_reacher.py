"""Configurations against brute force through the room's own kinematics; collisions against Bullet."""

from __future__ import annotations

import dataclasses
import itertools
import math
import pickle
from collections.abc import Iterator
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
import pybullet
import pytest

from hrl_escape.env.config import CONTACT_SKIN, DynamicsConfig, RobotConfig
from hrl_escape.env.geometry import Solid, compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.presets import get_preset
from hrl_escape.env.robot import make_robot
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import UnsupportedError
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.planning.arm.joint_lattice import bound_costs
from hrl_escape.planning.arm.model import ArmKinematics
from hrl_escape.planning.arm.reacher import NEVER, UNLIMITED, Reacher

THREE = RobotConfig(joints=3, body_radius=0.4, body_height=0.8)
ARMS = {
    "1 joint": RobotConfig(joints=1, body_radius=0.4, body_height=0.9, link_length=0.9),
    "3 joints": THREE,
    "3 joints, mounted ahead": dataclasses.replace(THREE, mount_forward=0.25, turn_step_deg=15.0),
    "4 joints": dataclasses.replace(THREE, joints=4, joint_step_deg=20.0),
    "6 joints": dataclasses.replace(THREE, joints=6, link_length=0.3, joint_step_deg=20.0, joint_limit_deg=40),
    "7 joints": dataclasses.replace(THREE, joints=7, link_length=0.3, joint_step_deg=20.0, joint_limit_deg=40),
    "kuka-iiwa": RobotConfig(kind="kuka-iiwa", joints=7, body_radius=0.4, body_height=0.5, joint_step_deg=60.0),
    "franka-panda": RobotConfig(kind="franka-panda", joints=7, body_radius=0.4, body_height=0.5, joint_step_deg=50.0),
}
HEIGHTS = {"1 joint": 0.95, "kuka-iiwa": 1.3, "franka-panda": 1.2}


@lru_cache(maxsize=4)
def make_empty_room(seed: int) -> RoomInstance:
    return generate(get_preset("arm-two-button"), seed)


def make_room(robot: RobotConfig = THREE, seed: int = 1, other: dict | None = None, physics: bool = False,
              solids: tuple[Solid, ...] = (), **first: float) -> RoomInstance:
    """Two buttons; the first one's fields, and the other's, can be set. It hangs on the south wall, at y = -6."""
    room = make_empty_room(seed)
    targets = (dataclasses.replace(room.targets[0], **{"yaw": 0.0, "y": -5.95, "x": 0.0} | first),
               dataclasses.replace(room.targets[1], **other or {"x": 4.0}))
    headings = round(360 / robot.turn_step_deg)
    starts = tuple(dataclasses.replace(start, heading_steps=start.heading_steps % headings) for start in room.starts)
    return dataclasses.replace(room, robot=robot, targets=targets, starts=starts, solids=(*room.solids, *solids),
                               dynamics=DynamicsConfig(press_with="hand", kind="physics" if physics else "kinematic"))


@lru_cache(maxsize=16)
def list_configurations(robot: RobotConfig) -> np.ndarray:
    """The whole lattice, (n, joints)."""
    built = make_robot(robot)
    ranges = [range(a, b + 1) for a, b in zip(built.step_low, built.step_high, strict=True)]
    return np.array(list(itertools.product(*ranges)))


@lru_cache(maxsize=2)
def list_hands(robot: RobotConfig, joint_offsets: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The configurations that the limits allow, (n, joints), and their hands, (n, 3)."""
    built, configurations = make_robot(robot), list_configurations(robot)
    angles = np.array(built.home) + configurations * built.step + np.array(joint_offsets or (0.0,) * robot.joints)
    low, high = np.array(built.limits).T
    inside = ((angles >= low - 1e-9) & (angles <= high + 1e-9)).all(axis=1)
    return configurations[inside], built.compute_hand(angles[inside])


def find_fewest(room: RoomInstance, configurations: np.ndarray, hands: np.ndarray, state: RoomState,
                target: int) -> int | None:
    """Fewest joint steps from a state's configuration to one that touches, by trying every one of them."""
    t, kinematics = room.targets[target], Kinematics(room)
    near = np.flatnonzero(np.abs(hands[:, 2] - t.z) <= t.half_z + 0.071)
    cos, sin = kinematics.get_rotation(state.heading_steps, state.heading_offset)
    flat = hands[near, :2] @ np.array([[cos, sin], [-sin, cos]]) + (state.x, state.y)
    near = near[compute_distance_many(flat, stack_footprints([t.footprint])) <= 0.071]
    costs = np.abs(configurations[near] - state.joint_steps).sum(axis=1)
    for n in np.argsort(costs, kind="stable"):  # the room's own rule decides
        q = tuple(configurations[near[n]].tolist())
        if kinematics.compute_touching(*state[:4], q, state.joint_offsets) >> target & 1:
            return int(costs[n])
    return None


def make_state(room: RoomInstance, x: float, y: float, heading: int, joint_steps: tuple[int, ...],
               heading_offset: float = 0.0, joint_offsets: tuple[float, ...] = ()) -> RoomState:
    touching = Kinematics(room).compute_touching(x, y, heading, heading_offset, joint_steps, joint_offsets)
    puzzle = room.puzzle.make_state()
    return RoomState(x, y, heading, heading_offset, joint_steps, joint_offsets, puzzle, touching, 0, 0)


def list_within(joints: int, most: int) -> Iterator[tuple[int, ...]]:
    """All joint steps that are so many in sum at most."""
    if joints == 0:
        yield ()
        return
    for steps in range(-most, most + 1):
        for rest in list_within(joints - 1, most - abs(steps)):
            yield (steps, *rest)


def sample_steps(robot: RobotConfig, rng: np.random.Generator) -> tuple[int, ...]:
    built = make_robot(robot)
    return tuple(rng.integers(built.step_low, np.array(built.step_high) + 1).tolist())


def sample_poses(reacher: Reacher, table, count: int, rng: np.random.Generator) -> list[tuple[float, float, int]]:
    """Places and headings in cells that a table leaves open."""
    cells = np.argwhere(table.costs >= 0)
    picked = cells[rng.integers(len(cells), size=count)]
    places = table.low + (picked[:, :2] + rng.random((count, 2))) * table.cell
    return [(float(x), float(y), int(h)) for (x, y), h in zip(places, picked[:, 2], strict=True)]


# --- kinematics ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
def test_lattice_is_multiplied_together_from_pinocchio_as_the_robot_moves(name: str):
    robot = make_robot(ARMS[name])
    rng = np.random.default_rng(2)
    for offsets in ((), tuple(rng.uniform(-0.05, 0.05, len(robot.home)).tolist())):
        arm = ArmKinematics(robot)
        tables, hand = arm.compute_placements(offsets)
        low, high = arm.get_ranges(offsets)
        for _ in range(20):
            steps = tuple(rng.integers(low, np.array(high) + 1).tolist())
            place = np.eye(4)
            for joint, n in enumerate(steps):
                place = place @ tables[joint][n - low[joint]]
            own = robot.compute_hand(robot.compute_angles(steps, offsets))
            np.testing.assert_allclose(place[:3, :3] @ hand + place[:3, 3], own, atol=1e-9)


def test_inverse_kinematics_finds_the_points_that_a_hand_was_at():
    arm = ArmKinematics(make_robot(RobotConfig(kind="kuka-iiwa", joints=7)))
    rng = np.random.default_rng(0)
    low, high = np.array(arm.robot.limits).T
    found = 0
    for _ in range(40):
        point = arm.robot.compute_hand(rng.uniform(low, high))
        seeds = [arm.robot.home, *rng.uniform(low, high, size=(4, 7))]
        angles = next((one for seed in seeds if (one := arm.solve_ik(point, seed, 1e-3)) is not None), None)
        if angles is not None:
            assert np.linalg.norm(arm.robot.compute_hand(angles) - point) <= 1.001e-3
            assert (angles >= low - 1e-12).all() and (angles <= high + 1e-12).all()
            found += 1
    assert found >= 38
    assert arm.solve_ik((3.0, 0.0, 1.0), arm.robot.home, 1e-3) is None
    swing = ArmKinematics(make_robot(ARMS["1 joint"]))
    np.testing.assert_allclose(swing.solve_ik((0.45 * math.sqrt(3), 0.45, 0.9), (0.0,), 1e-6), math.pi / 6, atol=1e-5)


# --- single configurations -------------------------------------------------------------------


@pytest.mark.nightly_for("franka-panda", "7 joints", "kuka-iiwa", "6 joints")
@pytest.mark.parametrize("name", ARMS)
def test_configuration_has_the_fewest_joint_steps_of_the_whole_lattice(name: str):
    robot = ARMS[name]
    room = make_room(robot, z=HEIGHTS.get(name, 1.1), half_x=0.12, half_z=0.12)
    reacher = Reacher(room)
    rng = np.random.default_rng(3)
    found = none = 0
    for number in range(24):
        steps = (0,) * robot.joints if number % 3 == 0 else sample_steps(robot, rng)
        noise = {}
        if number % 4 == 3:
            noise = {"heading_offset": float(rng.uniform(-0.08, 0.08)),
                     "joint_offsets": tuple(rng.uniform(-0.05, 0.05, robot.joints).tolist())}
        table = reacher.make_table(0, steps, budget=UNLIMITED, **noise)
        listed = list_hands(robot, noise.get("joint_offsets", ()))
        for x, y, heading in sample_poses(reacher, table, 3, rng):
            state = make_state(room, x, y, heading, steps, **noise)
            fewest = find_fewest(room, *listed, state, 0)
            got = reacher.get_configuration(x, y, heading, steps, 0, **noise)
            if got is None:
                assert fewest is None
                none += 1
            else:
                assert Kinematics(room).compute_touching(*state[:4], got, state.joint_offsets) & 1
                assert sum(abs(a - b) for a, b in zip(got, steps, strict=True)) == fewest
                found += 1
            cost = table.get_cost(x, y, heading)
            assert 0 <= cost <= (NEVER if fewest is None else fewest)
    assert found >= 20 and none >= 1


@pytest.mark.nightly
@pytest.mark.nightly_for("franka-panda")
@pytest.mark.parametrize("robot", [
    RobotConfig(joints=7, body_radius=0.4, body_height=0.8, link_length=0.3),
    pytest.param(RobotConfig(kind="kuka-iiwa", joints=7, body_radius=0.4, body_height=0.5), marks=pytest.mark.slow),
    RobotConfig(kind="franka-panda", joints=7, body_radius=0.4, body_height=0.5),
], ids=["7 joints", "kuka-iiwa", "franka-panda"])
def test_no_configuration_within_four_steps_of_a_redundant_arm_is_missed(robot: RobotConfig):
    room = make_room(robot, z=1.1)
    built, rng = make_robot(robot), np.random.default_rng(4)
    around = np.array(list(list_within(7, 4)))
    assert len(around) == 2241  # lattice points of a seven-dimensional cross-polytope (Delannoy number)
    reacher = Reacher(room)
    near = 0
    for _ in range(25):
        steps = sample_steps(robot, rng)
        table = reacher.make_table(0, steps)
        inside = ((around + steps >= built.step_low) & (around + steps <= built.step_high)).all(axis=1)
        cheap = np.argwhere((table.costs >= 0) & (table.costs <= 4))
        if not len(cheap):
            continue
        i, j, heading = cheap[rng.integers(len(cheap))].tolist()
        x, y = (table.low + (np.array([i, j]) + 0.5) * table.cell).tolist()
        state = make_state(room, x, y, heading, steps)
        configurations = around[inside] + steps
        hands = built.compute_hand(np.array(built.home) + configurations * built.step)
        fewest = find_fewest(room, configurations, hands, state, 0)
        got = reacher.get_configuration(x, y, heading, steps, 0)
        cost = None if got is None else sum(abs(a - b) for a, b in zip(got, steps, strict=True))
        assert cost == fewest if fewest is not None else cost is None or cost > 4
        near += fewest is not None
    assert near >= 8


@pytest.mark.nightly
def test_configuration_that_touches_the_target_alone_goes_first():
    apart = make_room(z=1.1, half_x=0.3, other={"x": 4.0})
    beside = make_room(z=1.1, half_x=0.3, other={"x": 0.1, "y": -5.95, "z": 1.1, "yaw": 0.0, "half_x": 0.15})
    rng = np.random.default_rng(5)
    table = Reacher(apart).make_table(0, (0, 0, 0))
    chosen_otherwise = 0
    for x, y, heading in sample_poses(Reacher(apart), table, 300, rng):
        either = Reacher(apart).get_configuration(x, y, heading, (0, 0, 0), 0)
        alone = Reacher(beside).get_configuration(x, y, heading, (0, 0, 0), 0)
        assert (either is None) == (alone is None)
        if alone is not None and either != alone:
            both = Kinematics(beside).compute_touching(x, y, heading, 0.0, either, ())
            assert both == 3 and Kinematics(beside).compute_touching(x, y, heading, 0.0, alone, ()) == 1
            chosen_otherwise += 1
    assert chosen_otherwise >= 5


# --- tables ----------------------------------------------------------------------------------


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, -math.pi, 0.4])
def test_table_is_a_lower_bound_that_is_close(yaw: float):
    room = make_room(z=1.1, x=1.3, y=0.7, yaw=yaw)
    reacher, rng = Reacher(room), np.random.default_rng(6)
    steps = (2, -1, 3)
    table = reacher.make_table(0, steps)
    assert table.complete_to == NEVER and table.costs.dtype == np.int16
    equal = none = 0
    poses = sample_poses(reacher, table, 600, rng)
    for x, y, heading in poses:
        got = reacher.get_configuration(x, y, heading, steps, 0)
        cost = table.get_cost(x, y, heading)
        if got is None:
            none += 1
        else:
            exact = sum(abs(a - b) for a, b in zip(got, steps, strict=True))
            assert cost <= exact
            equal += cost == exact
    axis_aligned = yaw != 0.4
    assert none <= (0.2 if axis_aligned else 0.35) * len(poses)
    assert equal >= (0.4 if axis_aligned else 0.2) * len(poses)


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_where_a_table_has_no_cost_nothing_reaches(yaw: float):
    room = make_room(z=1.1, x=1.3, y=0.7, yaw=yaw)
    reacher, rng = Reacher(room), np.random.default_rng(7)
    table = reacher.make_table(0, (0, 0, 0))
    reached = table.costs >= 0
    beside = np.zeros_like(reached)
    for axis, step in itertools.product((0, 1), (-1, 1)):
        beside |= np.roll(reached, step, axis=axis)
    closed = np.argwhere(beside & ~reached)
    for i, j, heading in closed[rng.integers(len(closed), size=3000)].tolist():
        x, y = table.low + (np.array([i, j]) + rng.random(2)) * table.cell
        assert reacher.get_configuration(float(x), float(y), heading, (0, 0, 0), 0) is None


@pytest.mark.parametrize("yaw", [0.0, -math.pi / 2, 2.2])
def test_bound_holds_however_coarse_the_cells_are(yaw: float):
    rng = np.random.default_rng(13)
    hand_cell, cell, half_x, half_y = 0.3, 0.17, 0.5, 0.2
    headings = rng.uniform(-math.pi, math.pi, 8)
    hands, costs = rng.uniform(-1.2, 1.2, (40, 2)), rng.integers(0, 9, 40)
    cells = np.full((10, 10), NEVER, dtype=np.int16)
    np.minimum.at(cells, tuple((np.floor(hands / hand_cell) + 5).astype(int).T), costs.astype(np.int16))
    table = bound_costs(cells, hand_cell, headings, yaw, half_x, half_y, cell)
    touched = rng.uniform(-1, 1, (500, 2)) * (half_x, half_y) @ make_rotation(yaw).T
    for heading, (hand, cost) in itertools.product(range(8), zip(hands, costs, strict=True)):
        bases = touched - make_rotation(headings[heading]) @ hand
        i, j = (np.floor(bases / cell) + np.array(table.shape[:2]) // 2).astype(int).T
        assert (table[i, j, heading] >= 0).all() and (table[i, j, heading] <= cost).all()
    assert (table < 0).any()


def make_rotation(angle: float) -> np.ndarray:
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def test_table_outside_its_grid_and_centres():
    table = Reacher(make_room(z=1.1)).make_table(0, (0, 0, 0))
    assert table.get_cost(100.0, 0.0, 0) == -1
    centres = table.get_centres()
    for i, j in ((0, 0), (10, 40), (-1 % len(centres), 3)):
        assert [table.get_cost(*centres[i, j], h) for h in range(36)] == table.costs[i, j].tolist()


@pytest.mark.nightly
def test_small_budget_says_how_far_it_is_complete():
    reacher = Reacher(make_room(RobotConfig(joints=7, body_radius=0.4, body_height=0.8, link_length=0.3), z=1.1))
    home = (0,) * 7
    some, more, every = (reacher.make_table(0, home, budget=b) for b in (20_000, 500_000, UNLIMITED))
    assert 0 < some.complete_to < more.complete_to < every.complete_to == NEVER
    for table in (some, more):
        done = (every.costs >= 0) & (every.costs <= table.complete_to)
        np.testing.assert_array_equal(table.costs[done], every.costs[done])
    assert (some.costs >= 0).sum() < (every.costs >= 0).sum()


@pytest.mark.nightly
def test_fine_joint_steps_that_no_list_can_hold_are_still_reached():
    robot = RobotConfig(kind="kuka-iiwa", joints=7, body_radius=0.4, body_height=0.5, joint_step_deg=1.0)
    built, rng = make_robot(robot), np.random.default_rng(8)
    reached = 0
    for _ in range(12):
        steps = sample_steps(robot, rng)
        hand = built.compute_hand(built.compute_angles(steps))
        room = make_room(robot, z=float(hand[2]), half_x=0.05, half_z=0.05)
        x, y = -float(hand[0]), -5.95 - float(hand[1])  # heading 0: the hand is at the target's middle
        got = Reacher(room).get_configuration(x, y, 0, (0,) * 7, 0)
        assert got is None or Kinematics(room).compute_touching(x, y, 0, 0.0, got, ()) & 1
        reached += got is not None and sum(map(abs, got)) <= sum(map(abs, steps))
    assert reached == 12


# --- certified targets -----------------------------------------------------------------------


@pytest.mark.nightly_for("1-arm, 7 joints", "1-arm, 6 joints")
@pytest.mark.parametrize("robot", [
    THREE, dataclasses.replace(THREE, joints=4), dataclasses.replace(THREE, joints=6, link_length=0.3),
    dataclasses.replace(THREE, joints=7, link_length=0.3),
    pytest.param(RobotConfig(kind="kuka-iiwa", joints=7, body_radius=0.4, body_height=0.5), marks=pytest.mark.slow),
    pytest.param(RobotConfig(kind="franka-panda", joints=7, body_radius=0.4, body_height=0.5), marks=pytest.mark.slow),
], ids=lambda robot: f"{robot.kind}, {robot.joints} joints")
@pytest.mark.parametrize("rooms", [1, pytest.param(8, marks=pytest.mark.slow)])
def test_targets_of_generated_rooms_are_reached_on_the_lattice(robot: RobotConfig, rooms: int):
    config = dataclasses.replace(get_preset("arm-two-button"), robot=robot)
    for seed in range(rooms):
        room = generate(config, seed)
        reacher, home = Reacher(room), (0,) * robot.joints
        floor = CollisionMap(room, door_shut=False)
        solids = stack_footprints([s.footprint for s in room.solids])
        for target in range(len(room.targets)):
            table = reacher.make_table(target, home)
            centres = table.get_centres()
            free = compute_distance_many(centres.reshape(-1, 2), solids) > robot.body_radius + CONTACT_SKIN
            on_floor = (np.abs(centres) < (room.half_width, room.half_depth)).all(axis=2).ravel()
            stands = (free & on_floor).reshape(centres.shape[:2])
            cells = np.argwhere((table.costs >= 0) & stands[..., None])
            cells = cells[np.argsort(table.costs[tuple(cells.T)], kind="stable")]
            for i, j, heading in cells.tolist()[:200]:
                x, y = centres[i, j].tolist()
                got = reacher.get_configuration(x, y, heading, home, target)
                if got is not None:
                    break
            else:
                raise AssertionError(f"seed {seed}: {room.targets[target].name} is not reached")
            assert Kinematics(room).compute_touching(x, y, heading, 0.0, got, ()) >> target & 1
            assert not reacher.explain_unreachable(target, floor)


# --- reasons ---------------------------------------------------------------------------------

OUT_OF_REACH = [
    ("too high", {"z": 2.6}), ("too low", {"z": -0.7}), ("too far", {"y": -8.2}), ("too far", {"y": -30.0}),
    ("too high", {"z": 2.05}),
]


def explain(room: RoomInstance) -> str:
    return Reacher(room).explain_unreachable(0, CollisionMap(room, door_shut=False))


@pytest.mark.parametrize(("reason", "place"), OUT_OF_REACH)
def test_reason_is_named(reason: str, place: dict):
    said = explain(make_room(**{"z": 1.1} | place))
    assert said.startswith(f"{reason}: ") and "button-1" in said


@pytest.mark.parametrize("name", ["3 joints", "kuka-iiwa"])
def test_the_highest_and_lowest_hand_are_those_of_the_whole_lattice(name: str):
    _, hands = list_hands(ARMS[name], ())
    high, low = explain(make_room(ARMS[name], z=9.0)), explain(make_room(ARMS[name], z=-9.0))
    assert high.endswith(f"the hand gets to {hands[:, 2].max():.2f} m")
    assert low.endswith(f"the hand gets to {hands[:, 2].min():.2f} m")


def brute_force(room: RoomInstance, target: int) -> bool:
    """Test whether any configuration touches from any free place of a fine grid at any heading."""
    t, kinematics = room.targets[target], Kinematics(room)
    robot = make_robot(room.robot)
    hands = robot.compute_hand(np.array(robot.home) + list_configurations(room.robot) * robot.step)
    hands = hands[np.abs(hands[:, 2] - t.z) <= t.half_z + 0.07]
    if not len(hands):
        return False
    gaps = np.maximum(np.abs(hands[:, 2] - t.z) - t.half_z, 0.0)
    limits = np.sqrt(np.maximum(0.07**2 - gaps**2, 0.0))
    reach = np.hypot(hands[:, 0], hands[:, 1]).max() + 0.07
    ticks = np.arange(-reach - 0.3, reach + 0.3, 0.04)
    places = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2) + (t.x, t.y)
    places = places[(np.abs(places) <= (room.half_width, room.half_depth)).all(axis=1)]
    solids = stack_footprints([s.footprint for s in room.solids])
    places = places[compute_distance_many(places, solids) >= room.robot.body_radius + CONTACT_SKIN] if len(
        places) else places
    shape = stack_footprints([t.footprint])
    places = places[compute_distance_many(places, shape) <= reach] if len(places) else places
    for heading in range(kinematics.headings):
        cos, sin = kinematics.get_rotation(heading, 0.0)
        turned = hands[:, :2] @ np.array([[cos, sin], [-sin, cos]])
        for place in places:
            if (compute_distance_many(place + turned, shape) <= limits).any():
                return True
    return False


@pytest.mark.parametrize("place", [
    *(place for _, place in OUT_OF_REACH), {"z": 1.84}, {"z": 1.97}, {"z": -0.35}, {"z": -0.45}, {"y": -7.3},
    {"y": -7.6}, {"y": -7.75}, {"z": 1.8, "y": -6.6}, {"z": 0.2, "y": -7.0}, {"z": 1.1, "half_x": 0.02, "half_z": 0.02},
], ids=str)
def test_what_is_called_out_of_reach_is_not_found_by_brute_force_either(place: dict):
    room = make_room(dataclasses.replace(THREE, turn_step_deg=30.0), **{"z": 1.1} | place)
    said = explain(room)
    assert not (said and brute_force(room, 0)), said


# --- joint steps in order --------------------------------------------------------------------


def can_order(room: RoomInstance, begin: RoomState, goal: tuple[int, ...]) -> bool:
    """Test whether some order of the fewest joint steps presses button 1 only: every monotone path, by recursion."""
    kinematics = Kinematics(room)

    @cache
    def search(state: RoomState) -> bool:
        for joint, (a, b) in enumerate(zip(state.joint_steps, goal, strict=True)):
            if a != b:
                after = kinematics.step(state, kinematics.actions.joints[joint][b < a]).state._replace(primitives=0)
                begun = after.touching & ~state.touching
                if begun == 1 or (not begun and search(after)):
                    return True
        return False

    return search(begin)


@pytest.mark.nightly
def test_joint_steps_are_ordered_round_other_targets_wherever_that_can_be():
    # the other button hangs below the first, so that the arm may sweep over it on its way
    room = make_room(z=1.5, half_x=0.15, half_z=0.1, x=0.0,
                     other={"x": 0.25, "y": -5.9, "z": 1.1, "yaw": 0.0, "half_x": 0.1, "half_y": 0.15, "half_z": 0.1})
    reacher, kinematics, rng = Reacher(room), Kinematics(room), np.random.default_rng(9)
    orders = detours = hard = 0
    for _ in range(400):
        steps = sample_steps(THREE, rng)
        table = reacher.make_table(0, steps)
        x, y, heading = sample_poses(reacher, table, 1, rng)[0]
        goal = reacher.get_configuration(x, y, heading, steps, 0)
        state = make_state(room, x, y, heading, steps)
        if goal is None or state.touching or kinematics.compute_touching(x, y, heading, 0.0, goal, ()) != 1:
            continue
        actions = reacher.order_steps(state, (), goal, 0)
        fewest = sum(abs(a - b) for a, b in zip(goal, steps, strict=True))
        straight, here = [], state
        for joint, (a, b) in enumerate(zip(steps, goal, strict=True)):
            straight += [kinematics.actions.joints[joint][b < a]] * abs(b - a)
        for action in straight:
            transition = kinematics.step(here, action)
            here = transition.state
            hard += transition.pressed == (1,)
        orders += (possible := can_order(room, state, goal))
        assert not possible or (actions is not None and len(actions) <= fewest)
        if actions is not None:
            pressed = []
            here = state
            for action in actions:
                transition = kinematics.step(here, action)
                here, pressed = transition.state, [*pressed, *transition.pressed]
            assert pressed == [0] and transition.pressed == (0,)
            detours += not possible
    assert orders >= 200 and hard >= 10 and detours >= 1


def test_target_that_is_touched_already_is_left_and_touched_again():
    room = make_room(z=1.1)
    reacher, kinematics, rng = Reacher(room), Kinematics(room), np.random.default_rng(15)
    again = 0
    for x, y, heading in sample_poses(reacher, reacher.make_table(0, (0, 0, 0)), 60, rng):
        steps = reacher.get_configuration(x, y, heading, (0, 0, 0), 0)
        if steps is None:
            continue
        here = make_state(room, x, y, heading, steps)
        assert here.touching == 1 and reacher.get_configuration(x, y, heading, steps, 0) == steps
        actions = reacher.order_steps(here, (), steps, 0)
        assert actions is not None and len(actions) >= 2
        for action in actions:
            transition = kinematics.step(here, action)
            here = transition.state
        assert transition.pressed == (0,)
        again += 1
    assert again >= 30


def test_moves_of_the_base_keep_their_order_among_the_joint_steps():
    room = make_room(z=1.1)
    reacher, kinematics, rng = Reacher(room), Kinematics(room), np.random.default_rng(12)
    away, moves = (1, 1, 4, 3, 1), (0, 2, 5, 0, 0)  # a way off and the same way back
    checked = 0
    for x, y, heading in sample_poses(reacher, reacher.make_table(0, (1, 0, -1)), 60, rng):
        goal = reacher.get_configuration(x, y, heading, (1, 0, -1), 0)
        state = make_state(room, x, y, heading, (1, 0, -1))
        if goal is None or y < -5.6 or state.touching:
            continue
        for action in away:
            state = kinematics.step(state, action).state
        here = state
        for action in moves:
            here = kinematics.step(here, action).state
        if math.hypot(here.x - x, here.y - y) > 1e-9:
            continue  # a wall was in the way
        actions = reacher.order_steps(state, moves, goal, 0)
        assert actions is not None and [a for a in actions if a < 6] == list(moves)
        assert len(actions) == len(moves) + sum(abs(a - b) for a, b in zip(goal, (1, 0, -1), strict=True))
        checked += 1
    assert checked >= 10


# --- collisions ------------------------------------------------------------------------------


@pytest.mark.nightly_for("kuka-iiwa")
@pytest.mark.parametrize("robot", [THREE, RobotConfig(kind="kuka-iiwa", joints=7, body_radius=0.3, body_height=0.5)],
                         ids=["3 joints", "kuka-iiwa"])
def test_arms_collide_with_solids_as_in_bullet(robot: RobotConfig, tmp_path: Path):
    solids = (Solid(shape="box", x=1.0, y=0.3, half_x=0.3, half_y=0.2, yaw=0.5, height=1.1),
              Solid(shape="cylinder", x=-0.6, y=0.9, half_x=0.25, half_y=0.25, height=1.5))
    room = make_room(robot, z=1.1, physics=True, solids=solids)
    reacher, built = Reacher(room), make_robot(robot)
    client = pybullet.connect(pybullet.DIRECT)
    try:
        file = tmp_path / "robot.urdf"
        file.write_text(built.urdf)
        body = pybullet.loadURDF(str(file), physicsClientId=client)
        names = {pybullet.getJointInfo(body, i, physicsClientId=client)[1].decode(): i
                 for i in range(pybullet.getNumJoints(body, physicsClientId=client))}
        boxes = []
        for solid in (*room.solids,):
            kind = pybullet.GEOM_CYLINDER if solid.shape == "cylinder" else pybullet.GEOM_BOX
            shape = pybullet.createCollisionShape(
                kind, radius=solid.half_x, height=solid.height,
                halfExtents=(solid.half_x, solid.half_y, solid.height / 2), physicsClientId=client)
            boxes.append(pybullet.createMultiBody(
                0, shape, basePosition=(solid.x, solid.y, solid.height / 2),
                baseOrientation=pybullet.getQuaternionFromEuler((0, 0, solid.yaw)), physicsClientId=client))
        offset = pybullet.getDynamicsInfo(body, -1, physicsClientId=client)[3]
        rng = np.random.default_rng(10)
        low, high = np.array(built.limits).T
        free = hit = 0
        for _ in range(300):
            angles, heading = rng.uniform(low, high), float(rng.uniform(-math.pi, math.pi))
            x, y = rng.uniform(-1.5, 1.5, size=2).tolist()
            if not reacher.is_collision_free(50.0, 50.0, heading, angles.tolist()):
                continue  # the robot meets itself
            pybullet.resetBasePositionAndOrientation(
                body, (x, y, offset[2]), pybullet.getQuaternionFromEuler((0, 0, heading)), physicsClientId=client)
            for name, angle in zip(built.joint_names, angles, strict=True):
                pybullet.resetJointState(body, names[name], angle, physicsClientId=client)
            arm_gap = min((p[8] for box in boxes for p in pybullet.getClosestPoints(
                body, box, 0.2, physicsClientId=client) if p[3] >= 0), default=0.2)
            hand = built.compute_hand(angles)
            cos, sin = math.cos(heading), math.sin(heading)
            at = np.array([x + cos * hand[0] - sin * hand[1], y + sin * hand[0] + cos * hand[1]])
            for solid in room.solids:
                flat = compute_distance_many(at[None], stack_footprints([solid.footprint]))[0]
                gap = math.hypot(flat, max(hand[2] - solid.height, 0.0)) - robot.hand_radius
                arm_gap = min(arm_gap, gap)
            if abs(arm_gap) > 0.02:  # Bullet's margins, and the hulls of meshes
                assert reacher.is_collision_free(x, y, heading, angles.tolist()) == (arm_gap > 0)
                free, hit = free + (arm_gap > 0), hit + (arm_gap < 0)
    finally:
        pybullet.disconnect(client)
    assert free >= 40 and hit >= 25


def test_robot_meets_itself_and_is_clear_at_home():
    robot = RobotConfig(joints=6, body_radius=0.4, body_height=0.8, joint_limit_deg=170)
    reacher = Reacher(make_room(robot, z=1.1, physics=True))
    assert reacher.is_collision_free(0.0, 0.0, 0.0, (0.0,) * 6)
    folded = (0.0, math.radians(90), math.radians(-170), 0.0, 0.0, 0.0)
    assert not reacher.is_collision_free(0.0, 0.0, 0.0, folded)


@pytest.mark.nightly
def test_physics_takes_the_fewest_joint_steps_that_are_clear_of_obstacles():
    post = Solid(shape="box", x=0.35, y=-5.0, half_x=0.05, half_y=0.05, height=3.0)
    robot = dataclasses.replace(THREE, joints=5, link_length=0.35, joint_step_deg=20.0)
    kinematic, physics = (Reacher(make_room(robot, z=1.1, solids=(post,), physics=p)) for p in (False, True))
    rng = np.random.default_rng(11)
    home = (0,) * 5
    configurations, hands = list_hands(robot, ())
    button = physics.instance.targets[0]
    clear = blocked = dearer = 0
    for x, y, heading in sample_poses(physics, physics.make_table(0, home), 200, rng):
        if y < -5.95 + 0.4:
            continue
        got, loose = (r.get_configuration(x, y, heading, home, 0) for r in (physics, kinematic))
        cos, sin = physics.kinematics.get_rotation(heading, 0.0)
        angle, compute_angles = math.atan2(sin, cos), physics.kinematics.robot.compute_angles
        at = hands[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
        gaps = np.abs(np.column_stack([at - (button.x, button.y), hands[:, 2] - button.z]))
        away = np.linalg.norm(np.maximum(gaps - (button.half_x, button.half_y, button.half_z), 0.0), axis=1)
        pushing = configurations[away <= robot.hand_radius - 0.01]
        costs = [sum(map(abs, q)) for q in pushing.tolist()
                 if physics.is_collision_free(x, y, angle, compute_angles(tuple(q)))]
        assert (None if got is None else sum(map(abs, got))) == min(costs, default=None)
        clear += got is not None
        blocked += loose is not None and not physics.is_collision_free(x, y, angle, compute_angles(loose))
        dearer += got is not None and sum(map(abs, got)) > np.abs(pushing).sum(axis=1).min()
    assert clear >= 20 and blocked >= 20 and dearer >= 10


FORWARD, STRAFE_LEFT = 0, 2


@pytest.mark.parametrize(("y", "presses"), [(-3.4, True), (-3.355, False), (-3.55, False)],
                         ids=["pushed", "grazed", "through the wall"])
def test_a_move_presses_by_force_only_where_the_hand_pushes_and_meets_no_wall(y: float, presses: bool):
    reacher = Reacher(make_room(z=0.8, physics=True))
    state = make_state(reacher.instance, 0.0, y, 27, (0, 0, 0))  # the arm points straight at the target
    assert reacher.kinematics.step(state, FORWARD).state.touching & 1 or not presses
    assert reacher.is_push(state, [FORWARD], 0) == presses


def test_a_base_presses_no_target_on_its_way_that_it_must_not():
    reacher = Reacher(make_room(z=0.8, physics=True))
    state = make_state(reacher.instance, 0.0, -3.4, 27, (0, 0, 0))
    end = reacher.move_base(state, [FORWARD])
    assert end is not None and end.touching == 1
    assert reacher.move_base(state, [FORWARD], others=1) is None
    assert reacher.move_base(state, [FORWARD], others=2) == end


@pytest.mark.parametrize(("post", "presses"), [(None, True), (-1.0, False), (-2.0, True)],
                         ids=["nothing in the way", "a post in the way", "clear of it after the first move"])
def test_an_arm_is_not_swung_into_an_obstacle_but_may_come_out_of_one(post: float | None, presses: bool):
    solids = () if post is None else (Solid(shape="cylinder", x=post, y=-5.2, half_x=0.1, half_y=0.1, height=2.0),)
    reacher = Reacher(make_room(z=0.8, physics=True, solids=solids))
    state = make_state(reacher.instance, -2.0, -4.4, 27, (0, 0, 0))
    moves = [STRAFE_LEFT, STRAFE_LEFT]  # facing south, left is east
    assert reacher.is_push(state, moves, 0) == presses
    by_arm = reacher.order_steps(state, moves, (0, 0, 0), 0)
    assert (by_arm is not None and len(by_arm) == 2) == presses


# --- as a value ------------------------------------------------------------------------------


def test_reacher_can_be_pickled_and_answers_the_same():
    reacher = Reacher(make_room(z=1.1))
    table = reacher.make_table(0, (0, 0, 0))
    copy = pickle.loads(pickle.dumps(reacher))
    np.testing.assert_array_equal(copy.make_table(0, (0, 0, 0)).costs, table.costs)
    assert copy.get_configuration(0.0, -5.0, 27, (0, 0, 0), 0) == reacher.get_configuration(0.0, -5.0, 27, (0, 0, 0), 0)


def test_rooms_pressed_with_the_body_have_no_reacher():
    with pytest.raises(UnsupportedError, match="press_with = 'hand'"):
        Reacher(generate(get_preset("paper-two-button"), 0))
