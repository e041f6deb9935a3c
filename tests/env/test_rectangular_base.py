"""A base with the footprint of a rectangle: both engines, the certificate, the planner, drawings."""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import math

import numpy as np
import pytest
import torch
from matplotlib.patches import Polygon

from benchmarks.conformance import compare
from hrl_escape.env.batched.engine import TensorRoom
from hrl_escape.env.batched.rooms import Rooms
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.config import DynamicsConfig, ExitConfig, ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import RoomInstance, Start
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.pictures.maps import make_map
from hrl_escape.env.pictures.meshes import compute_base_outline, make_base_column
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.sampling.primitive_proof import find_unmet_constraint
from hrl_escape.errors import ConfigError, InstanceFileError, StateError, UnsupportedError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.areas import compute_goal_area, get_presser
from hrl_escape.planning.goals import ExitGoal, PoseGoal, PressGoal, is_reached, parse_goal
from hrl_escape.planning.lower_bounds import LegBounds
from hrl_escape.planning.motion.trajectory import make_trajectory
from hrl_escape.planning.paths import planners
from hrl_escape.planning.paths.navigator import Navigator
from hrl_escape.planning.planner import RoomPlanner
from tests.env.rooms import RECTANGLE

SMALL = RECTANGLE
ROBOT = SMALL.robot
NARROW = RoomConfig(room=ShapeConfig(width=10, depth=8, rooms=2, doorway_width=1.2), robot=dataclasses.replace(
    ROBOT, move_step=0.5), puzzle=ButtonsConfig(count=2, buttons=Panels(width=1.0)))
"""With seed 2 a wall along x, at y = -1.5, lies between the start and the exit."""


def change(config: RoomConfig, **robot) -> RoomConfig:
    return dataclasses.replace(config, robot=dataclasses.replace(config.robot, **robot))


def with_physics(config: RoomConfig) -> RoomConfig:
    return dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, kind="physics"))


def measure_gap(rules: Kinematics, state: RoomState) -> float:
    """Least gap of the true base, without its clearance, to a solid."""
    base = rules.instance.robot.base
    assert base is not None
    return base.measure_gap(state.x, state.y, rules.get_rotation(state.heading_steps, state.heading_offset),
                            rules.footprints)


def make_corridor(robot: RobotConfig, width: float) -> RoomInstance:
    """A room whose start lies in a corridor along x, open at its east end; everything else is beyond."""
    room = generate(RoomConfig(room=ShapeConfig(width=8, depth=8), robot=robot, puzzle=ButtonsConfig(count=1)), 0)
    sides = [Solid(x=-1.0, y=sign * (width / 2 + 0.1), half_x=3.0, half_y=0.1) for sign in (-1, 1)]
    return dataclasses.replace(room, solids=(*room.solids, *sides), starts=(Start(-2.0, 0.0, 0),))


# --- the robot ------------------------------------------------------------------------------


def test_a_footprint_is_part_of_a_room_and_a_disc_changes_no_id():
    assert not {"footprint", "body_length", "body_width"} & RobotConfig().to_dict().keys()
    room = generate(SMALL, 0)
    assert RoomInstance.from_dict(room.to_dict()) == room
    assert room.id != dataclasses.replace(room, robot=dataclasses.replace(room.robot, body_length=1.1)).id


def test_what_a_rectangle_does_not_do_is_refused_in_one_message(request):
    with pytest.raises(ConfigError, match="inner doors or props"):
        generate(change(get_preset("door-key"), footprint="rectangle", body_length=0.8, body_width=0.6), 0)
    with pytest.raises(ConfigError, match="body_length / 2 = 0.6"):
        dataclasses.replace(ROBOT, mount_forward=0.7)
    planners.register_planner("of-places", lambda collision: lambda problem: None)
    request.addfinalizer(lambda: planners.path_planners.unregister("of-places"))
    with pytest.raises(UnsupportedError, match="poses of a rectangular base are planned by"):
        Navigator(generate(SMALL, 0)).plan((0.0, 0.0), ExitGoal(), "of-places")


def test_starts_and_states_inside_a_solid_are_refused_at_the_heading_that_they_have():
    room = make_corridor(ROBOT, 0.9)
    across = dataclasses.replace(room, starts=(Start(-2.0, 0.0, 9),))
    with pytest.raises(InstanceFileError, match="a base of 1.2 x 0.6 m is clear of every solid"):
        RoomInstance.from_dict(across.to_dict())
    env = EscapeRoomEnv(instance=RoomInstance.from_dict(room.to_dict()))
    env.reset(seed=0)
    state = env.get_state()
    env.set_state(state)
    with pytest.raises(StateError, match="the body overlaps the"):
        env.set_state(state._replace(heading_steps=9))
    env.close()


# --- physics --------------------------------------------------------------------------------


@pytest.mark.nightly_for("differential", "strafing")
@pytest.mark.parametrize("drive", ["strafing", "differential"])
def test_rigid_rectangles_stop_at_walls_turn_as_far_as_they_can_and_states_can_be_set(drive):
    env = EscapeRoomEnv(instance=generate(with_physics(change(SMALL, drive=drive)), 3))
    rules, rng = Kinematics(env.instance), np.random.default_rng(0)
    env.reset(seed=0)
    touched = 0
    for action in rng.choice(len(rules.actions), size=60, p=np.array([5, *[1] * (len(rules.actions) - 1)])
                             / (4 + len(rules.actions))).tolist():
        env.step(action)
        state = env.get_state()
        gap = measure_gap(rules, state)
        assert gap > -0.01
        touched += gap < 0.005
        env.set_state(state)
    assert touched >= 10
    env.close()
    corridor = make_corridor(dataclasses.replace(ROBOT, drive=drive), 0.9)
    env = EscapeRoomEnv(instance=dataclasses.replace(corridor, dynamics=DynamicsConfig(kind="physics")))
    env.reset(seed=0)
    for _ in range(12):
        env.step(rules.actions.turns[0])
    state = env.get_state()
    turned = abs(math.remainder(rules.get_heading(state), math.tau))
    limit = math.asin(0.9 / math.hypot(1.2, 0.6)) - math.atan2(0.6, 1.2)  # two corners touch the two sides
    assert limit - 0.05 < turned < limit + 0.02
    env.close()


@pytest.mark.slow  # a disc under physics, and a rectangle without it, are quick
def test_options_press_with_a_rectangle_under_physics():
    env = OptionsEnv(EscapeRoomEnv(instance=generate(with_physics(SMALL), 1)), include_primitives=False)
    _, info = env.reset(seed=1)
    rng, terminated, ends = np.random.default_rng(0), False, []
    while not terminated and len(ends) < 30:
        _, _, terminated, _, info = env.step(int(rng.choice(np.flatnonzero(info["action_mask"]))))
        ends.append(info["option"]["ended"])
    assert terminated and set(ends[:-1]) <= {"reached"}
    env.close()


# --- primitives -----------------------------------------------------------------------------


def test_walls_beside_the_base_block_its_turns_but_a_disc_turns_anywhere():
    turns = {}
    for footprint in ("rectangle", "disc"):
        rules = Kinematics(make_corridor(dataclasses.replace(ROBOT, footprint=footprint, body_radius=0.3), 0.9))
        state = rules.make_state(rules.instance.starts[0])
        for action in (rules.actions.turns[0],) * 9:
            state = rules.step(state, action).state
        turns[footprint] = state.heading_steps
        assert state.primitives == 9  # a turn that is not made takes its time
    assert turns == {"rectangle": 1, "disc": 9}


def test_a_turn_that_a_wall_blocks_for_one_drive_is_made_again_after_backing_off():
    room = dataclasses.replace(generate(dataclasses.replace(SMALL, obstacles=ObstaclesConfig(count=0)), 0))
    rules = Kinematics(room)
    state = rules.make_state(Start(0.0, 0.0, 0))
    forward, back, left, right = (rules.actions.find(n) for n in ("forward", "back", "strafe-left", "turn-right"))
    for _ in range(8):
        state = rules.step(state, left).state
    assert math.isclose(measure_gap(rules, state), 1e-3, abs_tol=1e-9)
    assert rules.step(state, right).state.heading_steps == 0
    away = rules.step(state, rules.actions.find("strafe-right")).state
    assert rules.step(away, right).state.heading_steps == rules.headings - 1
    assert rules.step(rules.step(state, forward).state, back).state.y == state.y  # it slides along the wall


@pytest.mark.nightly_for("door", "plain", "differential-stay")
@pytest.mark.parametrize(("config", "seeds"), [
    (SMALL, 2),
    (change(dataclasses.replace(SMALL, dynamics=DynamicsConfig(noise=0.2, slip=0.2, slip_kind="any")), joints=1), 2),
    (change(dataclasses.replace(SMALL, dynamics=DynamicsConfig(slip=0.3, slip_kind="neighbour", blocked="stay")),
            drive="differential"), 1),
    (dataclasses.replace(SMALL, exit=ExitConfig(door=True, width=1.6), puzzle=ButtonsConfig(
        count=1, buttons=Panels(width=4.0))), 1),
], ids=["plain", "noise", "differential-stay", "door"])
def test_the_batched_engine_agrees_with_the_scalar_rules(config, seeds):
    found = compare([generate(config, seed) for seed in range(seeds)], 500, copies=10)
    assert found.primitives >= 500 and not found.disagreements and found.close_calls <= 1 and found.worst < 1e-9


@pytest.mark.nightly
def test_the_batched_engine_agrees_with_the_bullet_engine_whose_base_is_a_box():
    room = generate(SMALL, 1)
    batch, bullet = TensorRoom(Rooms(instance=room), autoreset="disabled"), BulletRoom(room)
    assert '<box size="1.2 0.6 1.0"/>' in bullet.rules.robot.urdf.replace(" />", "/>")
    batch.reset(torch.tensor([4]))
    bullet.set_state(batch.get_room_state(0))
    for action in np.random.default_rng(0).integers(6, size=100).tolist():
        batch.step(torch.tensor([action]))
        found, state = batch.get_room_state(0), bullet.step(action).state
        assert abs(found.x - state.x) < 1e-9 and abs(found.y - state.y) < 1e-9
        assert (found.heading_steps, found.touching) == (state.heading_steps, state.touching)
    bullet.close()


def test_random_primitives_never_bring_the_base_nearer_to_a_solid_than_its_clearance():
    rules = Kinematics(generate(dataclasses.replace(SMALL, dynamics=DynamicsConfig(noise=0.3)), 3))
    state, closest = rules.make_state(rules.instance.starts[0], 7), math.inf
    for action in np.random.default_rng(1).integers(6, size=600).tolist():
        state = rules.step(state, action).state
        closest = min(closest, measure_gap(rules, state))
    assert 1e-3 - 1e-7 < closest < 1.5e-3


def test_a_button_is_pressed_by_a_side_that_touches_it_and_by_a_turn_that_brings_a_corner_to_it():
    room = generate(dataclasses.replace(SMALL, obstacles=ObstaclesConfig(count=0)), 0)
    target = dataclasses.replace(room.targets[0], x=0.0, y=4.0, half_x=0.4, half_y=0.05, yaw=0.0)
    rules = Kinematics(dataclasses.replace(room, targets=(target, room.targets[1])))
    reach = rules.instance.compute_press_margin(target)
    for y, touches in ((3.95 - 0.3 - reach + 1e-6, True), (3.95 - 0.3 - reach - 1e-6, False)):
        assert bool(rules.compute_touching(0.0, y, 0, 0.0, (), ()) & 1) == touches
    state = rules.make_state(Start(-0.5, 3.56, 0))
    turned = rules.step(state, rules.actions.find("turn-left"))
    assert not state.touching & 1 and turned.pressed == (0,)


# --- the certificate ------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.nightly_for("strafing")
@pytest.mark.parametrize("drive", ["strafing", "differential"])
def test_rooms_are_certified_for_the_rectangle_through_doorways_that_are_shorter_than_it(drive):
    room = generate(change(NARROW, drive=drive), 2)
    assert NARROW.room.doorway_width < 2 * ROBOT.outer_radius
    assert find_unmet_constraint(room) is None
    planner = RoomPlanner(room)
    plan = planner.solve(planner.rules.make_state(room.starts[0]))
    assert plan.path[0][1] > -1.0 and plan.path[-1][1] < -2.0
    env = EscapeRoomEnv(instance=room)
    env.reset(options={"state": plan.states[0]})
    run = plan.execute(env)
    assert run.escaped and run.as_predicted
    env.close()


def test_a_room_that_the_largest_disc_within_escapes_from_but_not_the_rectangle_is_refused():
    """Two corridors at a right angle: a disc of the base's width gets round the corner, the base does not."""
    walls = ((-0.75, 0.75, 3.25, 0.1), (-1.5, -0.75, 2.5, 0.1), (0.9, -1.6, 0.1, 0.95), (2.4, -0.85, 0.1, 1.7))
    room = generate(RoomConfig(room=ShapeConfig(width=8, depth=8), robot=ROBOT, puzzle=ButtonsConfig(count=1)), 0)
    solids = (*room.solids, *(Solid(x=x, y=y, half_x=a, half_y=b) for x, y, a, b in walls))
    escapes = {}
    for footprint in ("disc", "rectangle"):
        robot = dataclasses.replace(ROBOT, footprint=footprint, body_radius=0.3, body_length=3.0, move_step=0.4,
                                    turn_step_deg=30)
        candidate = dataclasses.replace(room, robot=robot, solids=solids, starts=(Start(-2.0, 0.0, 0),))
        escapes[footprint] = find_unmet_constraint(candidate)
    assert escapes["disc"] is None and "by a sequence of primitives" in (escapes["rectangle"] or "")


# --- the planner ----------------------------------------------------------------------------


def test_headings_and_turns_of_the_planner_s_grid_are_those_of_the_rules():
    planner = RoomPlanner(generate(dataclasses.replace(SMALL, exit=ExitConfig(door=True, width=1.6)), 0))
    maker, rules, fits, can_turn = planner.routes.get_field_maker(), planner.rules, [], []
    for cell in np.random.default_rng(0).choice(np.flatnonzero(maker.standing), 60).tolist():
        x, y = maker.points[cell].tolist()
        states = [rules.make_state(Start(x, y, steps)) for steps in range(maker.classes + 1)]
        free = [measure_gap(rules, state) >= 1e-3 and rules.is_door_shut(
            x, y, state.puzzle, rules.get_rotation(state.heading_steps, 0.0)) for state in states]
        fits += [maker.fits[cell * maker.classes + n] == free[n] for n in range(maker.classes)]
        can_turn += [maker._can_turn[cell * maker.classes + n] == (free[n] and free[n + 1] and rules.can_turn(
            states[n], rules.get_rotation(n + 1, 0.0), rules.turn_step)) for n in range(maker.classes)]
    assert np.mean(fits) > 0.99 and np.mean(can_turn) > 0.99  # but for poses in touch
    assert 0.2 < maker.fits[np.repeat(maker.standing, maker.classes)].mean() < 0.98


def find_fewest(rules: Kinematics, state: RoomState, goal: PoseGoal) -> int | None:
    """Primitives of a shortest plan, by Dijkstra's search over the states themselves, which are finitely many."""
    known, queue, tie = {state.pose: 0}, [(0, 0, state)], itertools.count(1)
    while queue:
        cost, _, here = heapq.heappop(queue)
        if is_reached(goal, here, here, rules):
            return cost
        for action in rules.actions.base:
            after = rules.step(here, action).state
            name = (round(after.x, 6), round(after.y, 6), after.heading_steps)
            if cost + 1 < known.get(name, math.inf):
                known[name] = cost + 1
                heapq.heappush(queue, (cost + 1, next(tie), after))
    return None


@pytest.mark.nightly
def test_plans_are_as_short_as_an_exhaustive_search_of_a_lattice_and_none_is_missed():
    """Quarter turns, moves that are made whole or not at all: places stay on a lattice, and turns decide the way."""
    robot = dataclasses.replace(ROBOT, turn_step_deg=90, move_step=0.5, drive="differential")
    config = dataclasses.replace(SMALL, robot=robot, dynamics=DynamicsConfig(blocked="stay"), puzzle=ButtonsConfig(
        count=1), room=ShapeConfig(width=6, depth=6), obstacles=ObstaclesConfig(count=0))
    box = Solid(x=0.3, y=0.4, half_x=1.0, half_y=0.4)
    room = dataclasses.replace(generate(config, 0), starts=(Start(-2.0, -2.0, 0),))
    room = dataclasses.replace(room, solids=(*room.solids, box), targets=room.targets)
    planner = RoomPlanner(room)
    state, rng, fewest, planned = planner.rules.make_state(room.starts[0]), np.random.default_rng(0), 0, 0
    for _ in range(12):
        x, y = (rng.integers(-4, 5, 2) * 0.5).tolist()
        goal = PoseGoal(x, y, math.radians(int(rng.integers(4)) * 90), 0.05)
        best = find_fewest(planner.rules, state, goal)
        if best is not None and best > 0:
            fewest, planned = fewest + best, planned + planner.plan(state, goal).cost
    assert 0 < fewest <= planned <= 1.03 * fewest


def test_seeds_of_a_press_are_poses_that_touch_it_or_do_so_after_one_primitive():
    room = generate(SMALL, 2)
    planner = RoomPlanner(room)
    maker, rules, goal = planner.routes.get_field_maker(), planner.rules, PressGoal(0)
    seeds = maker.find_seeds(*compute_goal_area(goal, room), None, get_presser(goal, room))
    assert {0, 1} == set(seeds.costs.tolist())
    for number in np.linspace(0, len(seeds.states) - 1, 80).astype(int).tolist():
        cell, heading = divmod(int(seeds.states[number]), seeds.headings)
        x, y = maker.points[cell].tolist()
        state = rules.make_state(Start(x, y, heading))
        assert maker.collision.does_fit(x, y, rules.get_rotation(heading, 0.0))
        after = [rules.step(state, action).state.touching & 1 for action in rules.actions.translations]
        assert state.touching & 1 if seeds.costs[number] == 0 else not state.touching & 1 and any(after)


@pytest.mark.nightly_for("corridor")
@pytest.mark.parametrize("method", ["fields", "corridor"])
def test_plans_come_true_and_are_no_shorter_than_their_bounds(method):
    for seed in range(2):
        room = generate(SMALL, seed)
        planner = RoomPlanner(room, method)
        state = planner.rules.make_state(room.starts[0])
        for goal in ("press-button-1", "press-button-2", "1,1,90"):
            plan = planner.plan(state, goal)
            assert plan.cost >= LegBounds(room).bound_goals(state, [parse_goal(goal, room)])
            assert min(measure_gap(planner.rules, s) for s in plan.states) > 1e-3 - 1e-7


@pytest.mark.nightly
def test_paths_of_poses_are_free_all_along_and_lead_through_a_doorway_that_is_narrower_than_the_base_is_long():
    room = generate(NARROW, 2)
    navigator, rules = Navigator(room), Kinematics(room)
    state, base = rules.make_state(room.starts[0]), room.robot.base
    for goal in (PressGoal(0), ExitGoal()):
        found = navigator.plan((state.x, state.y), goal, heading=rules.get_heading(state))
        assert found.status == "exact" and len(found.headings) == len(found.path) and base is not None
        for a, b in itertools.pairwise(np.column_stack([found.path, found.headings])):
            for x, y, heading in np.linspace(a, b, 60).tolist():
                assert base.measure_gap(x, y, (math.cos(heading), math.sin(heading)), rules.footprints) > 0.0
    assert found.path[0, 1] > -1.0 and found.path[-1, 1] < -2.0
    again = Navigator(room).plan((state.x, state.y), ExitGoal(), heading=rules.get_heading(state))
    assert np.array_equal(again.path, found.path) and np.array_equal(again.headings, found.headings)
    blocked = Navigator(room).plan((state.x, -1.0), ExitGoal(), heading=math.pi / 2)
    assert blocked.status == "invalid-start"


def test_trajectories_keep_to_the_plan_s_own_lines_and_turns():
    planner = RoomPlanner(generate(SMALL, 0))
    plan = planner.solve(planner.rules.make_state(planner.instance.starts[0]))
    trajectory = make_trajectory(plan)
    base = planner.instance.robot.base
    assert base is not None
    for x, y, heading in trajectory.evaluate(np.linspace(0, trajectory.duration, 500))[:, :3].tolist():
        assert base.measure_gap(x, y, (math.cos(heading), math.sin(heading)), planner.rules.footprints) > 5e-4


# --- drawings -------------------------------------------------------------------------------


def test_the_map_shows_the_rectangle_as_it_is_turned():
    room = generate(SMALL, 0)
    rules = Kinematics(room)
    figure = make_map(room, rules.make_state(Start(1.0, 0.5, 9)), panel=False)
    outlines = [patch.get_xy()[:4] for patch in figure.axes[0].patches if isinstance(patch, Polygon)]
    wanted = np.array([(0.7, -0.1), (1.3, -0.1), (1.3, 1.1), (0.7, 1.1)])
    assert any(len(o) == 4 and np.allclose(sorted(o.tolist()), sorted(wanted.tolist())) for o in outlines)


def test_pictures_in_space_show_a_box_of_its_size():
    low, high = (side(make_base_column(ROBOT, 0.2, 0.9).vertices, axis=0).tolist() for side in (np.min, np.max))
    assert np.allclose(low, (-0.6, -0.3, 0.2)) and np.allclose(high, (0.6, 0.3, 0.9))
    assert np.allclose(sorted(compute_base_outline(ROBOT)), [(-0.6, -0.3), (-0.6, 0.3), (0.6, -0.3), (0.6, 0.3)])
