"""Sweeps bit for bit those of the kinematics; prices of fields against the near-exact reference."""

import math
import time

import numpy as np
import pytest

from benchmarks.planner_contenders import make_queries
from benchmarks.reference_search import find_fewest_primitives
from hrl_escape.env.config import ExitConfig, ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.floor import cost_to_go
from hrl_escape.floor.cost_to_go import FieldMaker
from hrl_escape.floor.sweeps import measure_clearance, sweep_body
from hrl_escape.kernels import kernel
from hrl_escape.planning.areas import compute_goal_area
from hrl_escape.planning.goals import ExitGoal, PressGoal


@kernel
def sweep(scene, x, y, dx, dy):
    return sweep_body(scene, x, y, (1.0, 0.0), dx, dy, math.hypot(dx, dy))


@kernel
def find_clearance(scene, x, y):
    return measure_clearance(scene, x, y)


def make_maker(config, seed=0, *, door_shut=True, refinement=0):
    rules = Kinematics(generate(config, seed))
    return rules, FieldMaker(rules.instance, rules, door_shut=door_shut, refinement=refinement)


def sample_places(rules, maker, count, seed=0):
    """Places the body can be at, half of them in touch with something."""
    rng = np.random.default_rng(seed)
    state = rules.make_state(rules.instance.starts[0])
    places = []
    for number in range(count):
        cell = rng.choice(np.flatnonzero(maker.standing))
        x, y = maker.points[cell].tolist()
        here = state._replace(x=x, y=y, heading_steps=int(rng.integers(rules.headings)))
        for _ in range(number % 2 * 3):
            here = rules.step(here, 0).state
        places.append((here.x, here.y))
    return places


# --- sweeps ----------------------------------------------------------------------------------


@pytest.mark.nightly  # `test_dijkstra.py` compares sweeps of a rectangle, and compiles less
@pytest.mark.parametrize("shut", [True, False])
@pytest.mark.parametrize("config", [
    get_preset("clutter"),
    RoomConfig(robot=RobotConfig(move_step=3.7, body_radius=0.3), obstacles=ObstaclesConfig(count=25),
               exit=ExitConfig(door=True, width=2)),
    get_preset("larg-2019"),
], ids=lambda config: config.name)
def test_compiled_sweeps_are_bit_for_bit_those_of_the_kinematics(config, shut):
    rules, maker = make_maker(config, 1, door_shut=shut)
    puzzle = rules.instance.puzzle.make_state() if shut else 2 ** len(rules.instance.targets) - 1
    assert rules.instance.puzzle.is_solved(puzzle) != shut
    rng = np.random.default_rng(0)
    cut = 0
    for x, y in sample_places(rules, maker, 3000):
        angle = rng.uniform(-np.pi, np.pi) if rng.random() < 0.5 else np.pi / 2 * rng.integers(4)
        length = rules.instance.robot.move_step * rng.uniform(0.1, 1.0)
        dx, dy = float(length * np.cos(angle)), float(length * np.sin(angle))
        fraction = rules.compute_free_fraction(x, y, dx, dy, puzzle)
        assert sweep(maker.scene, x, y, dx, dy) == fraction
        cut += fraction < 1.0
    assert cut > 150


@pytest.mark.nightly
def test_a_shut_door_holds_nobody_who_stands_in_it():
    rules, shut = make_maker(get_preset("clutter"), 1)
    door, puzzle = rules.instance.door, rules.instance.puzzle.make_state()
    rng = np.random.default_rng(0)
    held = []
    for _ in range(2000):
        x, y = float(door.x + rng.uniform(-2, 2)), float(door.y + rng.uniform(-2, 2))
        dx, dy = rng.uniform(-0.7, 0.7, 2).tolist()
        fraction = rules.compute_free_fraction(x, y, dx, dy, puzzle)
        assert sweep(shut.scene, x, y, dx, dy) == fraction
        held.append(rules.is_door_shut(x, y, puzzle))
    assert 200 < sum(held) < 1800


@pytest.mark.nightly
def test_representative_places_are_free_and_doorways_are_not_lost():
    config = RoomConfig(room=ShapeConfig(rooms=4, doorway_width=1.6), robot=RobotConfig(body_radius=0.5))
    rules, maker = make_maker(config, 2)
    assert maker.collision.are_free(maker.points[maker.standing]).all()
    clearance = [find_clearance(maker.scene, x, y) for x, y in maker.points.tolist()]
    assert ((np.array(clearance) >= maker.collision.radius) == maker.standing).all()
    for target in range(len(rules.instance.targets)):
        field = maker.make_field(maker.find_seeds(*compute_goal_area(PressGoal(target), rules.instance)))
        assert maker.get_cost(field, rules.make_state(rules.instance.starts[0])) > 0


# --- prices ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("floor", "count"), [
    ("interior walls", 2),
    *(pytest.param(floor, 6, marks=pytest.mark.slow) for floor in ("empty", "40 obstacles", "interior walls"))])
def test_prices_are_near_the_fewest_primitives(floor, count):
    errors = []
    for query in make_queries(floor, range(1), count):
        maker = query.search.get_maker(True)
        field = maker.make_field(maker.find_seeds(*compute_goal_area(query.goal, query.search.instance)))
        price = maker.get_cost(field, query.state)
        assert price > 0
        errors.append(price - query.fewest)
    assert abs(np.mean(errors)) < 1
    assert np.abs(errors).max() <= 4


def test_prices_with_a_direction_count_the_turns():
    rules, maker = make_maker(RoomConfig(robot=RobotConfig(body_radius=0.5)))
    area = compute_goal_area(ExitGoal(), rules.instance)
    facing = np.zeros(rules.headings, dtype=bool)
    facing[9] = True
    field = maker.make_field(maker.find_seeds(*area, facing)).reshape(-1, rules.headings)
    anyhow = maker.make_field(maker.find_seeds(*area)).reshape(-1, maker.classes)
    inside = maker.collision.get_parts(np.array(rules.instance.exit.centre))[0]
    assert inside > 0
    x, y = rules.instance.exit.centre
    i, j = np.floor((np.array([x, y]) - maker.low) / maker.size).astype(int)
    cell = i * maker.shape[1] + j
    assert field[cell].tolist() == [min(abs(h - 9), 36 - abs(h - 9)) for h in range(36)]
    state = rules.make_state(rules.instance.starts[0])._replace(x=x, y=y)
    for steps, offset in ((0, 0.0), (9, 0.0), (20, 0.0), (20, 0.08), (20, 0.1), (0, -0.1)):
        there = state._replace(heading_steps=steps, heading_offset=offset)
        nearest = (steps + round(offset / rules.turn_step)) % 36
        assert maker.get_cost(field.ravel(), there) == field[cell, nearest]
    known = anyhow.min(axis=1) >= 0
    assert (field[known].min(axis=1) >= anyhow[known].min(axis=1)).all()


def test_a_shut_door_is_in_the_way_and_an_open_one_is_not():
    rules, shut = make_maker(get_preset("clutter"), 0)
    _, opened = make_maker(get_preset("clutter"), 0, door_shut=False)
    state = rules.make_state(rules.instance.starts[0])
    area = compute_goal_area(ExitGoal(), rules.instance)
    assert shut.door_shut and not opened.door_shut
    assert shut.get_cost(shut.make_field(shut.find_seeds(*area)), state) == -1
    assert opened.get_cost(opened.make_field(opened.find_seeds(*area)), state) > 0


def test_cells_that_are_not_allowed_are_not_used():
    rules, maker = make_maker(RoomConfig(robot=RobotConfig(body_radius=0.5)))
    area = compute_goal_area(PressGoal(0), rules.instance)
    whole = maker.make_field(maker.find_seeds(*area))
    allowed = maker.points[:, 0] < 0
    half = maker.make_field(maker.find_seeds(*area), allowed)
    either = (whole >= 0) & (half >= 0) & np.repeat(allowed, maker.classes)
    assert (half[either] >= whole[either]).all()
    away = np.repeat(maker.points[:, 0] > maker.size, maker.classes)
    assert (half[away] == -1).all() and (whole[away] >= 0).any()


@pytest.mark.parametrize(("degrees", "classes"), [(10, 9), (15, 6), (8, 45), (90, 1), (180, 1), (120, 3), (1, 90)])
def test_headings_are_told_apart_as_far_as_strafing_needs(degrees, classes):
    config = RoomConfig(room=ShapeConfig(width=6, depth=6), robot=RobotConfig(turn_step_deg=degrees, body_radius=0.3))
    _, maker = make_maker(config)
    assert maker.classes == classes


def test_refinement_halves_the_cells_and_keeps_the_prices():
    config = RoomConfig(room=ShapeConfig(width=10, depth=10), robot=RobotConfig(body_radius=0.4))
    rules, coarse = make_maker(config)
    _, fine = make_maker(config, refinement=1)
    assert fine.size == coarse.size / 2
    state = rules.make_state(rules.instance.starts[0])
    area = compute_goal_area(PressGoal(0), rules.instance)
    prices = [maker.get_cost(maker.make_field(maker.find_seeds(*area)), state) for maker in (coarse, fine)]
    fewest = find_fewest_primitives(rules, state, PressGoal(0), *area)
    assert fewest is not None
    assert all(abs(price - len(fewest)) <= 1 for price in prices)


# --- keeping fields --------------------------------------------------------------------------


def test_fields_are_made_once_and_the_oldest_go_when_they_are_too_many(monkeypatch):
    rules, maker = make_maker(RoomConfig(room=ShapeConfig(width=6, depth=6), robot=RobotConfig(body_radius=0.3)))
    area, made = compute_goal_area(PressGoal(0), rules.instance), []

    def find_seeds(number):
        made.append(number)
        return maker.find_seeds(*area)

    size = maker.make_field(maker.find_seeds(*area)).nbytes
    monkeypatch.setattr(cost_to_go, "CACHE_BYTES", 4 * size)
    for number in (0, 1, 2, 3, 0, 4, 0, 1):
        field = maker.get_field(number, lambda _, number=number: find_seeds(number))
        assert field is maker.get_field(number, lambda _: pytest.fail("it was just made"))
    assert made == [0, 1, 2, 3, 4, 1]


@pytest.mark.nightly
def test_vast_rooms_are_prepared_in_seconds_and_bounded_memory():
    config = RoomConfig(room=ShapeConfig(width=200, depth=200), obstacles=ObstaclesConfig(count=20))
    instance = generate(config, 0)
    rules = Kinematics(instance)
    FieldMaker(generate(get_preset("clutter"), 0), rules, door_shut=True)  # compiles
    began = time.process_time()
    maker = FieldMaker(instance, rules, door_shut=True)
    field = maker.make_field(maker.find_seeds(*compute_goal_area(PressGoal(0), instance)))
    assert time.process_time() - began < 30.0
    assert maker.states < 1.6e6 and field.nbytes < 4e6
    assert maker.macro == 2 and maker.size < 0.5
    assert maker.get_cost(field, rules.make_state(instance.starts[0])) > 50
