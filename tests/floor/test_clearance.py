"""Clearances and free places against the exact geometry and against Bullet; proofs against plans that exist."""

import math
import pickle

import numpy as np
import pytest

from hrl_escape.env.config import CONTACT_SKIN, ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.geometry import Solid, compute_distance, compute_distance_many, make_footprint, stack_footprints
from hrl_escape.env.instance import Rectangle, RoomInstance, Start, Target
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.sampling.generation import generate
from hrl_escape.floor.clearance import CollisionMap
from tests.covering import thin
from tests.env.bullet_world import BulletWorld


def make_room(*solids: Solid, radius: float = 0.5) -> RoomInstance:
    """A room of 10 x 10 m with a button on its north wall."""
    walls = [Solid(x=x, y=y, half_x=w, half_y=h, role="wall")
             for x, y, w, h in ((0, 5.1, 5.2, 0.1), (0, -5.1, 5.2, 0.1), (5.1, 0, 0.1, 5.2), (-5.1, 0, 0.1, 5.2))]
    return RoomInstance(
        half_width=5, half_depth=5, solids=(*walls, *solids), targets=(Target("button-1", 0, 4.95, half_x=1.0),),
        exit=Rectangle(3, 4.5, -4.5, -3), starts=(Start(),), robot=RobotConfig(body_radius=radius),
        puzzle=ButtonsPuzzle(1),
    )


def sample_near_surfaces(collision: CollisionMap, rng: np.random.Generator, count: int) -> np.ndarray:
    """Places all over the floor, and as many within a hand's breadth of where the body starts to fit."""
    size = collision.resolution * np.array(collision.distance.shape)
    points = collision.low + rng.random((20 * count, 2)) * size
    distance = compute_distance_many(points, collision.solids)
    near = points[np.abs(distance - collision.radius) < 0.1]
    return np.concatenate([points[:count], near[:count]])


@pytest.mark.nightly_for("True-clutter", "False-clutter")
@pytest.mark.parametrize("name", ["clutter", "paper-two-button", "twenty-button"])
@pytest.mark.parametrize("shut", [True, False])
def test_free_places_are_those_of_the_exact_geometry(name, shut):
    instance = generate(get_preset(name), 3)
    collision = CollisionMap(instance, door_shut=shut)
    solids = [s.footprint for s in instance.solids] + ([instance.door.footprint] if instance.door and shut else [])
    points = sample_near_surfaces(collision, np.random.default_rng(0), 1500)
    for x, y in points.tolist():
        clearance = min(compute_distance(x, y, footprint) for footprint in solids)
        assert collision.is_free(x, y) == (clearance >= instance.robot.body_radius + CONTACT_SKIN - 1e-9)


def test_free_places_are_those_of_bullet():
    rules = Kinematics(generate(get_preset("clutter"), 1))
    instance, world = rules.instance, BulletWorld(rules)
    collision, state, checked = CollisionMap(instance, door_shut=True), rules.make_state(instance.starts[0]), 0
    for x, y in sample_near_surfaces(collision, np.random.default_rng(1), 300).tolist():
        clearance = world.compute_clearance(state._replace(x=x, y=y))
        in_doorway = compute_distance(x, y, instance.door.footprint) < collision.radius  # no door shuts there
        if abs(clearance - CONTACT_SKIN) > 1e-5 and not in_doorway:  # Bullet's own accuracy
            assert collision.is_free(x, y) == (clearance > CONTACT_SKIN)
            checked += 1
    assert checked > 400


@pytest.mark.nightly
def test_moves_are_free_as_a_fine_walk_along_them_says():
    instance = generate(get_preset("clutter"), 2)
    collision = CollisionMap(instance, door_shut=True)
    rng = np.random.default_rng(2)
    points = sample_near_surfaces(collision, rng, 600)
    points = points[collision.are_free(points)]
    answers = []
    for x, y in points[:300].tolist():
        to_x, to_y = x + rng.normal(0, 2), y + rng.normal(0, 2)
        walk = np.linspace((x, y), (to_x, to_y), 400)
        least = compute_distance_many(walk, collision.solids).min()
        if abs(least - collision.radius) > 1e-4:  # the walk's own accuracy
            inside = abs(to_x) < instance.reach_x and abs(to_y) < instance.reach_y
            answers.append(collision.is_move_free(x, y, to_x, to_y))
            assert answers[-1] == (least > collision.radius and inside)
    assert 30 < sum(answers) < len(answers) - 30


def test_a_move_does_not_jump_over_a_thin_wall():
    collision = CollisionMap(make_room(Solid(half_x=3, half_y=1e-4)), door_shut=True)
    assert collision.is_free(0, 2) and collision.is_free(0, -2)
    assert not collision.is_move_free(0, 2, 0, -2)
    assert collision.is_move_free(0, 2, 4, 2)


@pytest.mark.parametrize(("x", "y"), [(0.3, 0.0), (3.4, 0.0), (0.0, 0.3), (0.0, 3.4)])
def test_a_thin_post_near_either_end_of_a_long_move_is_in_the_way(x, y):
    collision = CollisionMap(make_room(Solid("cylinder", x, y, 0.05, 0.05)), door_shut=True)
    begin, end, beside = np.array([[-0.5, 0.0], [4.2, 0.0], [0.0, 0.7]])[:, :: 1 if y == 0.0 else -1]
    assert not collision.is_move_free(*begin.tolist(), *end.tolist())
    assert not collision.is_move_free(*end.tolist(), *begin.tolist())
    assert collision.is_move_free(*(begin + beside).tolist(), *(end + beside).tolist())


def test_places_off_the_floor_are_not_free():
    collision = CollisionMap(make_room(), door_shut=True)
    assert not any(collision.is_free(x, y) for x, y in ((7, 0), (-7, 0), (0, 7), (0, -7), (math.inf, 0), (1e9, 1e9)))


GOAL = make_footprint(0, 4, 0.5, 0.5)


def test_a_wall_across_the_room_is_a_proof_that_there_is_no_way():
    whole = CollisionMap(make_room(Solid(y=1, half_x=5, half_y=0.1)), door_shut=True)
    assert whole.find_proof(0, -3, GOAL, 0.0) == "apart"
    assert whole.find_proof(0, 3, GOAL, 0.0) is None
    gap = CollisionMap(make_room(Solid(x=-1, y=1, half_x=4, half_y=0.1)), door_shut=True)
    assert gap.find_proof(0, -3, GOAL, 0.0) is None


def test_a_goal_inside_a_solid_is_a_proof_that_the_body_never_fits_there():
    collision = CollisionMap(make_room(Solid(y=4, half_x=1.5, half_y=0.5)), door_shut=True)
    assert collision.find_proof(0, -3, make_footprint(0, 4, 0.1, 0.1), 0.0) == "solid"
    assert collision.find_proof(0, -3, make_footprint(0, 4, 0.1, 0.1), 1.5) is None
    assert collision.find_proof(0, -3, make_footprint(90, 4, 0.1, 0.1), 1.5) == "solid"


@pytest.mark.parametrize("seed", thin(range(6), 3))
def test_nothing_that_the_room_is_certified_for_is_proven_impossible(seed):
    config = RoomConfig(room=ShapeConfig(rooms=4), robot=RobotConfig(body_radius=0.4),
                        obstacles=ObstaclesConfig(count=25, size_max=1.5))
    instance = generate(config, seed)
    collision = CollisionMap(instance, door_shut=True)
    start = instance.starts[0]
    for target in instance.targets:
        reach = instance.compute_press_reach(target)
        assert collision.find_proof(start.x, start.y, target.footprint, reach) is None


@pytest.mark.nightly
def test_vast_rooms_keep_a_bounded_grid():
    config = RoomConfig(room=ShapeConfig(width=200, depth=200), obstacles=ObstaclesConfig(count=30))
    collision = CollisionMap(generate(config, 0), door_shut=True, reach=1.0)
    assert collision.distance.size < 1.01e6
    rng = np.random.default_rng(0)
    points = rng.uniform(-99, 99, (500, 2))
    exact = compute_distance_many(points, stack_footprints(collision.footprints)) >= collision.radius
    assert collision.are_free(points).tolist() == exact.tolist()


def test_a_map_survives_pickling():
    collision = CollisionMap(make_room(Solid()), door_shut=True)
    copy = pickle.loads(pickle.dumps(collision))
    points = np.random.default_rng(0).uniform(-5, 5, (200, 2))
    assert copy.are_free(points).tolist() == collision.are_free(points).tolist()
