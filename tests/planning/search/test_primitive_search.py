"""Fewest primitives: plans come true in the environment, are as short as references say, and avoid what they can."""

import dataclasses
import hashlib
import math
import pickle

import numpy as np
import pytest

from benchmarks.planner_contenders import make_queries
from hrl_escape.clock import Clock
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.config import DynamicsConfig, ExitConfig, ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.geometry import Solid, compute_distance, make_footprint
from hrl_escape.env.instance import Rectangle, RoomInstance, Start, Target
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import GoalError, PlanningReason, UnknownNameError, UnsupportedError
from hrl_escape.planning.goals import ExitGoal, PoseGoal, PressGoal, PushGoal, RegionGoal, is_reached
from hrl_escape.planning.search.primitive_search import PrimitiveSearch
from tests.command_line import run_here
from tests.covering import thin
from tests.forks import run_fork


def make_room(*solids, targets=((0, 4.95, 1.0),), exit_area=(3, 4.5, -4.5, -3), start=(0, 0), radius=0.5, **robot):
    """A room of 10 x 10 m with buttons (x, y, half width) on its north wall."""
    walls = [Solid(x=x, y=y, half_x=w, half_y=h, role="wall")
             for x, y, w, h in ((0, 5.1, 5.2, 0.1), (0, -5.1, 5.2, 0.1), (5.1, 0, 0.1, 5.2), (-5.1, 0, 0.1, 5.2))]
    return RoomInstance(
        half_width=5, half_depth=5, solids=(*walls, *solids), exit=Rectangle(*exit_area), starts=(Start(*start),),
        targets=tuple(Target(f"button-{i + 1}", x, y, half_x=half) for i, (x, y, half) in enumerate(targets)),
        robot=RobotConfig(body_radius=radius, **robot), puzzle=ButtonsPuzzle(len(targets)),
    )


def begin(search, **changes):
    return search.kinematics.make_state(search.instance.starts[0])._replace(**changes)


def assert_comes_true(result, goal, rules):
    """Each predicted state is what the kinematics give, and the goal is reached at the end and not before."""
    assert result.is_reached and len(result.states) == len(result.primitives) + 1
    for number, (primitive, before, after) in enumerate(
            zip(result.primitives, result.states[:-1], result.states[1:], strict=True)):
        assert rules.step(before, primitive).state == after
        assert is_reached(goal, before, after, rules) == (number == len(result.primitives) - 1)


# --- plans come true -------------------------------------------------------------------------


@pytest.mark.nightly_for("clutter-corridor", "ten-button-corridor")
@pytest.mark.parametrize("method", ["fields", "corridor"])
@pytest.mark.parametrize("name", ["paper-two-button", "clutter", "larg-2019", "arm-two-button", "ten-button"])
def test_predicted_states_are_the_executed_ones(name, method):
    room = BulletRoom(generate(get_preset(name), 4))
    try:
        search = PrimitiveSearch(room.instance)
        for target in (*range(len(room.instance.targets)), 0):
            state = room.state
            result = search.search(state, PressGoal(target), method=method)
            assert result.is_reached and result.states[0] == state and not result.also_pressed
            for primitive, predicted in zip(result.primitives, result.states[1:], strict=True):
                pressed = room.step(primitive).pressed
                assert room.state == predicted
            assert pressed == (target,)
    finally:
        room.close()


# --- how few ---------------------------------------------------------------------------------


def find_ratios(queries, method):
    """Primitives over those of the reference, a query."""
    results = [query.search.search(query.state, query.goal, method=method) for query in queries]
    assert all(result.is_reached and (result.method == "fields") == (method == "fields") for result in results)
    return [len(result.primitives) / query.fewest for result, query in zip(results, queries, strict=True)]


FLOORS = {"empty": 1.03, "10 obstacles": 1.03, "40 obstacles": 1.05, "interior walls": 1.05}


@pytest.mark.nightly_for("interior walls-1.05")
@pytest.mark.parametrize(("floor", "most"), thin(list(FLOORS.items()), 2, first=1))
def test_primitives_are_within_a_few_percent_of_the_near_exact_reference(floor, most):
    ratios = find_ratios(make_queries(floor, range(1), 8), "fields")
    assert np.mean(ratios) <= most
    assert np.quantile(ratios, 0.95) <= 1.15


@pytest.mark.nightly
def test_corridors_reach_every_goal_a_little_longer():
    queries = [q for floor in (*FLOORS, "narrow passages") for q in make_queries(floor, range(1), 3)]
    assert np.mean(find_ratios(queries, "corridor")) < 1.2


def count_fewest(rules, state, goal, most):
    """Breadth-first over every distinct state: exact, and only good for a few primitives."""
    layer, seen = [state], {state._replace(primitives=0)}
    for depth in range(1, most + 1):
        following = []
        for before in layer:
            for primitive in range(6):
                after = rules.step(before, primitive).state
                if is_reached(goal, before, after, rules):
                    return depth
                key = after._replace(primitives=0)
                if key not in seen:
                    seen.add(key)
                    following.append(after)
        layer = following
    return None


@pytest.mark.nightly
def test_short_plans_are_as_short_as_exhaustive_search_finds():
    search = PrimitiveSearch(make_room(Solid(x=1.2, y=2.5, half_x=0.7, half_y=0.3, yaw=0.4)))
    rng = np.random.default_rng(0)
    found = []
    for _ in range(25):
        state = begin(search, x=float(rng.uniform(-2.5, 2.5)), y=float(rng.uniform(-1, 1.2)),
                      heading_steps=int(rng.integers(36)))
        goal = PressGoal(0) if rng.random() < 0.7 else RegionGoal(2.0, 2.6, -1.5, 0.5)
        if is_reached(goal, state, state, search.kinematics):
            continue
        fewest = count_fewest(search.kinematics, state, goal, 6)
        if fewest is not None:
            result = search.search(state, goal)
            assert_comes_true(result, goal, search.kinematics)
            found.append((len(result.primitives), fewest))
    assert len(found) > 12
    assert all(ours <= fewest + 1 for ours, fewest in found)
    assert sum(ours == fewest for ours, fewest in found) >= len(found) - 1


def test_nine_strafes_left_are_the_plan_for_one_button_of_the_paper():
    search = PrimitiveSearch(generate(get_preset("paper-one-button"), 0))
    assert search.search(begin(search), PressGoal(0)).primitives == (2,) * 9


def test_the_published_room_costs_no_more_than_the_published_code_needs():
    search = PrimitiveSearch(generate(get_preset("larg-2019", size=2, seed=14, handicap=6.0), 0))
    state = begin(search)
    first = search.search(state, PressGoal(0))
    second = search.search(first.states[-1], PressGoal(1))
    exit_ = search.search(state, ExitGoal())
    assert len(first.primitives) <= 17
    assert len(first.primitives) + len(second.primitives) <= 37
    assert len(exit_.primitives) <= 15


@pytest.mark.nightly
def test_a_thin_button_is_reached_by_running_into_the_wall():
    config = RoomConfig(robot=RobotConfig(body_radius=0.5), dynamics=DynamicsConfig(press_margin=0.002),
                        puzzle=ButtonsConfig(count=3, buttons=Panels(width=0.3, thickness=0.005)))
    for seed in range(4):
        search = PrimitiveSearch(generate(config, seed))
        for target in range(3):
            result = search.search(begin(search), PressGoal(target))
            assert_comes_true(result, PressGoal(target), search.kinematics)
            last, before = result.states[-1], result.states[-2]
            assert math.hypot(last.x - before.x, last.y - before.y) < 1.0 - 1e-9


# --- odd robots and rooms --------------------------------------------------------------------

ODD = {
    "8 deg": RoomConfig(robot=RobotConfig(turn_step_deg=8, body_radius=0.5), obstacles=ObstaclesConfig(count=8)),
    "120 deg": RoomConfig(robot=RobotConfig(turn_step_deg=120, body_radius=0.5), obstacles=ObstaclesConfig(count=8)),
    "180 deg": RoomConfig(robot=RobotConfig(turn_step_deg=180, body_radius=0.5), obstacles=ObstaclesConfig(count=8)),
    "0.1 m": RoomConfig(room=ShapeConfig(width=10, depth=10), robot=RobotConfig(move_step=0.1, body_radius=0.4)),
    "5 m": RoomConfig(robot=RobotConfig(move_step=5, body_radius=0.5), obstacles=ObstaclesConfig(count=8)),
    "16 rooms": RoomConfig(room=ShapeConfig(width=40, depth=40, rooms=16, doorway_width=1.8),
                           robot=RobotConfig(body_radius=0.5)),
    "200 m": RoomConfig(room=ShapeConfig(width=200, depth=200), obstacles=ObstaclesConfig(count=15)),
    "tight": RoomConfig(room=ShapeConfig(rooms=4, doorway_width=1.55), robot=RobotConfig(body_radius=0.5),
                        obstacles=ObstaclesConfig(count=15)),
}


@pytest.mark.nightly_for("200 m", "0.1 m", "16 rooms")
@pytest.mark.parametrize("name", ODD)
def test_every_button_of_odd_rooms_is_reached(name):
    search = PrimitiveSearch(generate(ODD[name], 1))
    state = begin(search)
    for target in range(len(search.instance.targets)):
        result = search.search(state, PressGoal(target))
        assert_comes_true(result, PressGoal(target), search.kinematics)
        state = result.states[-1]


def test_plans_start_from_headings_off_the_lattice():
    instance = generate(get_preset("clutter"), 2)
    noisy = dataclasses.replace(instance, dynamics=DynamicsConfig(noise=0.2, slip=0.2))
    search, rules = PrimitiveSearch(noisy), Kinematics(noisy)
    state = rules.make_state(noisy.starts[0], noise_key=5)
    for primitive in (4, 4, 0, 4, 2, 5, 0):
        state = rules.step(state, primitive).state
    assert abs(state.heading_offset) > 1e-3
    exact = Kinematics(instance)
    for goal in (PressGoal(0), PressGoal(3), PoseGoal(state.x + 1, state.y + 1, 1.0, heading_tolerance=0.1)):
        assert_comes_true(search.search(state, goal), goal, exact)


# --- goals -----------------------------------------------------------------------------------


def test_a_button_in_touch_is_left_and_touched_again():
    search = PrimitiveSearch(make_room())
    first = search.search(begin(search), PressGoal(0))
    again = search.search(first.states[-1], PressGoal(0))
    assert_comes_true(again, PressGoal(0), search.kinematics)
    assert len(again.primitives) == 2


def test_a_pose_is_reached_with_its_heading_and_any_heading_is_cheaper():
    search = PrimitiveSearch(make_room(Solid(x=1.5, half_x=0.4, half_y=2)))
    facing, anyhow = PoseGoal(3.5, 0.5, 2.0, tolerance=0.4), PoseGoal(3.5, 0.5, None, tolerance=0.4)
    plans = {goal: search.search(begin(search), goal) for goal in (facing, anyhow)}
    for goal, result in plans.items():
        assert_comes_true(result, goal, search.kinematics)
    heading = search.kinematics.get_heading(plans[facing].states[-1])
    assert abs(heading - 2.0) <= facing.heading_tolerance
    assert len(plans[anyhow].primitives) < len(plans[facing].primitives)


def test_a_region_that_holds_the_start_takes_nothing_and_an_open_exit_one_primitive():
    search = PrimitiveSearch(make_room(start=(4, -4)))
    assert search.search(begin(search), RegionGoal(3, 5, -5, -3)).primitives == ()
    assert search.search(begin(search), ExitGoal()).primitives == ()
    solved = search.search(begin(search, puzzle=1), ExitGoal())
    assert_comes_true(solved, ExitGoal(), search.kinematics)
    assert len(solved.primitives) == 1


def test_edges_of_a_region_count():
    search = PrimitiveSearch(make_room())
    assert search.search(begin(search), RegionGoal(3.0, 3.4, -0.2, 0.2)).primitives == (0, 0, 0)
    assert search.search(begin(search), RegionGoal(-3.4, -3.0, -0.2, 0.2)).primitives == (1, 1, 1)


# --- what is avoided -------------------------------------------------------------------------


def test_other_buttons_are_not_touched_on_the_way():
    # the straight way along the wall sweeps over button-2
    search = PrimitiveSearch(make_room(targets=((3.5, 4.95, 0.4), (0.0, 4.95, 0.8)), start=(-3.5, 4.45)))
    careful = search.search(begin(search), PressGoal(0))
    careless = search.search(begin(search), PressGoal(0), avoid=False)
    for result in (careful, careless):
        assert_comes_true(result, PressGoal(0), search.kinematics)
    assert careless.also_pressed == (1,) and careful.also_pressed == ()
    assert len(careless.primitives) < len(careful.primitives)
    assert not any(state.touching & 2 for state in careful.states)


@pytest.mark.nightly
def test_what_cannot_be_avoided_is_done_and_said():
    # button-2 spans the only way to button-1
    walls = (Solid(x=-3.1, y=1, half_x=1.9, half_y=0.1), Solid(x=3.1, y=1, half_x=1.9, half_y=0.1))
    room = make_room(*walls)
    bar = Target("button-2", 0, 1, half_x=1.2, half_y=0.05, half_z=0.4)
    room = dataclasses.replace(room, targets=(*room.targets, bar), puzzle=ButtonsPuzzle(2))
    search = PrimitiveSearch(room)
    for budget in (300_000, 3_000):  # enough to see that there is no other way, and not
        result = search.search(begin(search), PressGoal(0), budget_expansions=budget)
        assert_comes_true(result, PressGoal(0), search.kinematics)
        assert result.also_pressed == (1,)


def test_an_open_exit_on_the_way_is_gone_round_and_a_shut_one_is_crossed():
    search = PrimitiveSearch(make_room(exit_area=(-1, 1, 1.5, 2.5)))
    solved, unsolved = (search.search(begin(search, puzzle=puzzle), PressGoal(0)) for puzzle in (1, 0))
    assert_comes_true(solved, PressGoal(0), search.kinematics)
    assert not any(search.instance.exit.contains(s.x, s.y) for s in solved.states)
    assert len(unsolved.primitives) < len(solved.primitives)
    careless = search.search(begin(search, puzzle=1), PressGoal(0), avoid=False)
    assert_comes_true(careless, PressGoal(0), search.kinematics)
    steps = zip(careless.states, careless.primitives, strict=False)
    assert not any(search.kinematics.step(state, primitive).terminated for state, primitive in steps)


def test_what_is_to_be_kept_out_of_is_not_met():
    search = PrimitiveSearch(make_room())
    block = make_footprint(0, 2.5, 0.4, 0.4)
    round_it = search.search(begin(search), PressGoal(0), keep_out=[block])
    assert_comes_true(round_it, PressGoal(0), search.kinematics)
    assert all(compute_distance(s.x, s.y, block) >= 0.5 for s in round_it.states)
    assert len(round_it.primitives) > len(search.search(begin(search), PressGoal(0)).primitives)


# --- presses by hand -------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_base_and_arm_together_press_by_hand(seed):
    search = PrimitiveSearch(generate(get_preset("arm-two-button"), seed))
    state = begin(search)
    for target in (0, 1, 1, 0):
        result = search.search(state, PressGoal(target))
        assert_comes_true(result, PressGoal(target), search.kinematics)
        assert result.also_pressed == ()
        state = result.states[-1]


@pytest.mark.nightly
def test_presses_by_hand_are_near_the_fewest_of_a_search_over_base_and_arm():
    room = generate(get_preset("arm-two-button"), 0)
    search = PrimitiveSearch(room)
    rng = np.random.default_rng(1)
    target = room.targets[0]
    pairs = []
    while len(pairs) < 6:
        state = begin(search, x=float(target.x + rng.uniform(-2, 2)), y=float(target.y + rng.uniform(-2, 2)),
                      heading_steps=int(rng.integers(36)))
        if not search.get_maker(True).collision.is_free(state.x, state.y):
            continue
        result = search.search(state, PressGoal(0))
        if len(result.primitives) <= 5:
            pairs.append((len(result.primitives), count_fewest_by_hand(search.kinematics, state, 5)))
    assert all(fewest is not None and ours <= fewest + 1 for ours, fewest in pairs)
    assert sum(ours == fewest for ours, fewest in pairs) >= 5


def count_fewest_by_hand(rules, state, most):
    layer, seen = [state], {state._replace(primitives=0)}
    for depth in range(1, most + 1):
        following = []
        for before in layer:
            for primitive in range(len(rules.actions)):
                after = rules.step(before, primitive).state
                if after.touching & ~before.touching & 1:
                    return depth
                key = after._replace(primitives=0)
                if key not in seen:
                    seen.add(key)
                    following.append(after)
        layer = following
    return None


def test_a_button_out_of_the_hand_s_reach_has_no_posture():
    room = generate(get_preset("arm-two-button"), 0)
    high = dataclasses.replace(room.targets[0], z=8.0)
    search = PrimitiveSearch(dataclasses.replace(room, targets=(high, room.targets[1])))
    assert search.search(begin(search), PressGoal(0)).status is PlanningReason.NO_POSTURE


# --- no plan ---------------------------------------------------------------------------------


def test_each_failure_has_its_reason_and_says_what_came_nearest():
    cut = (Solid(y=2, half_x=5, half_y=0.1), Solid(x=3, y=-3, half_x=1, half_y=1))
    search = PrimitiveSearch(make_room(*cut))
    reasons = {
        PlanningReason.UNREACHABLE_PROVEN: (begin(search), PressGoal(0)),
        PlanningReason.GOAL_INVALID: (begin(search), PoseGoal(3, -3, tolerance=0.2)),
        PlanningReason.START_INVALID: (begin(search, y=2.0), PressGoal(0)),
    }
    for reason, (state, goal) in reasons.items():
        result = search.search(state, goal)
        assert result.status is reason and not result.is_reached and result.primitives == ()
        assert result.nearest is not None and result.states == (state,)


def test_budget_and_deadline_end_a_search_and_more_of_them_finish_it():
    search = PrimitiveSearch(generate(get_preset("clutter"), 0))
    short = search.search(begin(search), PressGoal(1), budget_expansions=5)
    assert short.status is PlanningReason.BUDGET_EXHAUSTED and short.expansions <= 5
    assert search.search(begin(search), PressGoal(1), clock=Clock(0.0)).status is PlanningReason.TIMEOUT
    whole = search.search(begin(search), PressGoal(1))
    assert whole.is_reached and whole.expansions > 5


def test_a_tiny_pose_that_primitives_do_not_hit_is_unreachable_at_this_resolution():
    search = PrimitiveSearch(make_room(turn_step_deg=90.0))  # from (0, 0): whole metres, but for walls
    goal = PoseGoal(0.5, 0.25, tolerance=0.01)
    assert search.search(begin(search), goal).status is PlanningReason.UNREACHABLE_AT_RESOLUTION


@pytest.mark.nightly_for("1.01-0.0-4", "1.002-0.0-0", "1.002-0.13-0")
@pytest.mark.parametrize(("gap", "shift", "grids"), [(1.06, 0.0, 1), (1.04, 0.0, 2), (1.02, 0.0, 3), (1.01, 0.0, 4),
                                                     (1.002, 0.0, 0), (1.01, 0.13, 3), (1.002, 0.13, 0)])
def test_a_gap_that_only_a_fine_grid_shows_is_gone_through_and_a_narrower_one_is_not(gap, shift, grids):
    """The body is 1 m wide, and keeps 1 mm away from all solids."""
    walls = [Solid(x=side * (5 + gap / 2) / 2 + shift / 2, y=1.0, half_x=(5 - gap / 2 - side * shift) / 2, half_y=0.3)
             for side in (-1, 1)]
    search, goal = PrimitiveSearch(make_room(*walls)), PoseGoal(0.0, 3.0)
    result = search.search(begin(search), goal)
    assert len(search._makers) == (grids or 4)
    if grids:
        assert_comes_true(result, goal, search.kinematics)
    else:
        assert result.status is PlanningReason.UNREACHABLE_AT_RESOLUTION and result.expansions == 0


def test_a_pocket_behind_too_narrow_a_gap_takes_no_fine_grid_s_links_from_either_side():
    walls = [Solid(x=3.9, y=1.4, half_x=1.1, half_y=0.1), Solid(x=2.9, y=1.9, half_x=0.1, half_y=0.6),
             Solid(x=2.9, y=4.251, half_x=0.1, half_y=0.749)]  # 2 mm narrower than the body and what it keeps away
    search = PrimitiveSearch(make_room(*walls))
    inside, outside = (begin(search, x=x, y=y) for x, y in ((4.0, 3.0), (0.0, 0.0)))
    for state, other in ((inside, outside), (outside, inside)):
        there = make_footprint(other.x, other.y, 0.0, 0.0)
        assert search.get_collision(True).find_proof(state.x, state.y, there, 0.3) is None
        result = search.search(state, PoseGoal(other.x, other.y, tolerance=0.3))
        assert result.status is PlanningReason.UNREACHABLE_AT_RESOLUTION and result.expansions == 0
    assert {refinement for (_, refinement), maker in search._makers.items() if maker._known_links} == {0}


@pytest.mark.nightly
def test_a_heading_that_no_turn_leads_to_takes_no_fine_grid_s_links():
    search = PrimitiveSearch(generate(get_preset("clutter"), 0))
    goal = PoseGoal(0.0, 0.0, search.kinematics.turn_step / 2, 10.0, 0.01)
    assert search.search(begin(search), goal).status is PlanningReason.UNREACHABLE_AT_RESOLUTION
    assert len(search._makers) == 4 and all(maker._known_links is None for maker in search._makers.values())
    turned = begin(search, heading_offset=search.kinematics.turn_step / 2)
    assert_comes_true(search.search(turned, goal), goal, search.kinematics)


def make_ring(half):
    """Walls round the middle of a room, and a panel there, higher than them; the arm passes through walls."""
    room, away = generate(get_preset("arm-two-button"), 1), half + 0.1
    walls = [Solid(x=side * away, half_x=0.1, half_y=away + 0.1) for side in (-1, 1)]
    walls += [Solid(y=side * away, half_x=half, half_y=0.1) for side in (-1, 1)]
    robot = RobotConfig(joints=3, body_radius=0.4, body_height=0.8, joint_step_deg=40.0, link_length=0.6)
    panel = dataclasses.replace(room.targets[0], x=0.0, y=0.0, z=1.7, yaw=0.0)
    starts = (Start(4.0, 2.0, 0),)
    return dataclasses.replace(room, robot=robot, solids=(*room.solids, *walls), starts=starts,
                               targets=(panel, *room.targets[1:]))


def test_a_panel_behind_walls_is_out_of_reach_only_where_no_posture_reaches_over_them():
    """The body gets through the walls nowhere; how far the hand gets depends on how far its joints lie off whole steps.

    Each search is asked for all postures in turn, so that what it remembers of one must not count for another.
    """
    goal, offsets = PressGoal(0), {"whole": (), "off": (0.3, 0.3, 0.3)}
    reached = {1.06: {"whole", "off"}, 1.18: {"whole"}, 1.26: set()}
    for half, names in reached.items():
        search = PrimitiveSearch(make_ring(half))
        for name, bent in (("off", 0), ("whole", 0), ("whole", 2), ("off", -1)):
            state = begin(search, joint_offsets=offsets[name], joint_steps=(0, bent, 0))
            result = search.search(state, goal)
            if name in names:
                assert_comes_true(result, goal, search.kinematics)
            else:
                assert result.expansions == 0 and result.status is (
                    PlanningReason.UNREACHABLE_AT_RESOLUTION if offsets[name] else PlanningReason.UNREACHABLE_PROVEN)


def test_a_place_behind_the_exit_s_door_is_reached_once_it_opens():
    """The same search is asked before and after, and before again: what was cut off must not stay so, nor open."""
    config = RoomConfig(exit=ExitConfig(door=True, width=2.4), robot=RobotConfig(body_radius=0.5))
    search = PrimitiveSearch(generate(config, 1))
    area = search.instance.exit
    goal = PoseGoal((area.x_min + area.x_max) / 2, (area.y_min + area.y_max) / 2, tolerance=0.3)
    solved = begin(search, puzzle=2 ** len(search.instance.targets) - 1)
    for state, is_open in ((begin(search), False), (solved, True), (begin(search), False)):
        result = search.search(state, goal, avoid=False)
        assert result.is_reached == is_open


def test_what_is_no_goal_or_method_says_so():
    search = PrimitiveSearch(make_room())
    with pytest.raises(GoalError, match="no target 3"):
        search.search(begin(search), PressGoal(3))
    with pytest.raises(UnsupportedError, match="push"):
        search.search(begin(search), PushGoal(0, 1))
    with pytest.raises(UnknownNameError, match="feilds"):
        search.search(begin(search), PressGoal(0), method="feilds")
    with pytest.raises(UnknownNameError, match="RRTConect"):
        search.search(begin(search), PressGoal(0), method="corridor", planner="RRTConect")


# --- reproducible ----------------------------------------------------------------------------

SCRIPT = """
import hashlib
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.presets import get_preset
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.search.primitive_search import PrimitiveSearch
for name in ("clutter", "arm-two-button"):
    search = PrimitiveSearch(generate(get_preset(name), 3))
    state = search.kinematics.make_state(search.instance.starts[0])
    for method in ("fields", "corridor"):
        for target in (1, 0):
            result = search.search(state, PressGoal(target), method=method)
            print(result.primitives, hashlib.sha256(repr(result.states).encode()).hexdigest())
"""


@pytest.mark.nightly
def test_plans_are_the_same_in_every_process_and_in_any_order():
    outputs = {run_fork(SCRIPT, check=True).stdout, run_here(SCRIPT)}
    assert len(outputs) == 1
    search = PrimitiveSearch(generate(get_preset("clutter"), 3))
    result = search.search(begin(search), PressGoal(0))
    line = f"{result.primitives} {hashlib.sha256(repr(result.states).encode()).hexdigest()}"
    assert line in outputs.pop().splitlines()


def test_a_search_survives_pickling():
    search = PrimitiveSearch(generate(get_preset("clutter"), 3))
    copy = pickle.loads(pickle.dumps(search))
    assert copy.search(begin(copy), PressGoal(2)).primitives == search.search(begin(search), PressGoal(2)).primitives


def test_an_exit_door_shuts_the_exit_until_the_puzzle_is_solved():
    config = RoomConfig(exit=ExitConfig(door=True, width=2.4), robot=RobotConfig(body_radius=0.5))
    search = PrimitiveSearch(generate(config, 1))
    assert search.search(begin(search), ExitGoal()).status is PlanningReason.UNREACHABLE_PROVEN
    solved = begin(search, puzzle=2 ** len(search.instance.targets) - 1)
    assert_comes_true(search.search(solved, ExitGoal()), ExitGoal(), search.kinematics)
