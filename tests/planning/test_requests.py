"""The contract of a planning call: results by objective with bounds, improvement, cancellation, many calls."""

from __future__ import annotations

import dataclasses
import json
import math
import pickle
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from benchmarks.reference_search import find_fewest_primitives
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import Solid, compute_distance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, GoalError, PlanningReason, UnknownNameError
from hrl_escape.planning.areas import compute_goal_area
from hrl_escape.planning.goals import PoseGoal, PressGoal
from hrl_escape.planning.motion.limits import MotionLimits, compute_rest_to_rest
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.requests import PlanningRequest, bound_cost, compute_lacking_clearance, compute_plan_cost


@pytest.fixture(scope="module")
def planner():
    return RoomPlanner(generate(get_preset("clutter"), 3))


@pytest.fixture(scope="module")
def start(planner):
    return planner.rules.make_state(planner.instance.starts[0])


@pytest.mark.nightly
def test_an_answer_is_the_plan_of_plan_and_solve(planner, start):
    one = planner.answer(PlanningRequest(start, "press-button-2"))
    assert one.status == "reached" and one.plan is not None
    assert one.plan.primitives == planner.plan(start, "press-button-2").primitives
    assert one.cost == one.plan.cost >= one.lower_bound > 0 and one.gap == one.cost / one.lower_bound - 1
    assert (one.method, one.seed, one.cut_short) == ("fields", 0, False) and one.spent > 0
    escape = planner.answer(PlanningRequest(start))
    assert escape.plan is not None and escape.plan.primitives == planner.solve(start).primitives
    assert escape.lower_bound <= escape.cost
    json.dumps(escape.to_dict())


def test_several_goals_are_reached_in_the_order_given(planner, start):
    result = planner.answer(PlanningRequest(start, ("press-button-1", "0,-5", PressGoal(0))))
    assert result.plan is not None and [part.name for part in result.plan.parts] == ["press-button-1", "go-to-0,-5",
                                                                                     "press-button-1"]
    assert result.plan.name == "press-button-1, go-to-0,-5, press-button-1"
    env = EscapeRoomEnv(instance=planner.instance)
    env.reset(options={"state": start})
    assert result.plan.execute(env).as_predicted
    env.close()


def test_a_failure_is_a_result_with_its_reason(planner, start):
    result = planner.answer(PlanningRequest(start, "go-to-exit", budget=50))
    assert result.plan is None and result.status is PlanningReason.UNREACHABLE_PROVEN
    assert result.cost == math.inf and result.failure is not None and result.to_dict()["cost"] is None
    assert planner.answer(PlanningRequest(start, "press-button-3", budget=1)).status is PlanningReason.BUDGET_EXHAUSTED


def test_requests_that_make_no_sense_are_refused(planner, start):
    for wrong in ({"objective": "beauty"}, {"seed": -1}, {"budget": 0}, {"time_limit": -1.0}, {"goal": ()}):
        with pytest.raises(ConfigError):
            PlanningRequest(start, **wrong)
    with pytest.raises(UnknownNameError):
        planner.answer(PlanningRequest(start, "press-button-1", method="RRRT"))
    with pytest.raises(GoalError):
        planner.answer(PlanningRequest(start, PressGoal(99)))
    with pytest.raises(ConfigError, match="limits.speed"):
        MotionLimits(speed=0.0)


# --- objectives ----------------------------------------------------------------------------------


@pytest.mark.nightly_for("length-True", "clearance-True")
@pytest.mark.parametrize(("objective", "wins"), [("length", True), ("clearance", True), ("time", False)])
def test_each_objective_improves_on_the_fewest_primitives_and_keeps_its_bound(planner, start, objective, wins):
    result = planner.answer(PlanningRequest(start, "press-button-3", objective=objective))
    plain = compute_plan_cost(planner.plan(start, "press-button-3"), result.request)
    assert result.plan is not None and result.cost == compute_plan_cost(result.plan, result.request)
    assert result.lower_bound <= result.cost <= plain and (result.cost < plain or not wins)


def test_the_way_to_the_farthest_goal_as_the_crow_flies_bounds_length_and_time(planner, start):
    """In whatever order the goals stand; nothing bounds clearance."""
    goals, limits = (PressGoal(0), PressGoal(2)), MotionLimits(speed=0.5)
    room = planner.instance
    areas = [compute_goal_area(goal, room) for goal in goals]
    far = max(compute_distance(start.x, start.y, shape) - reach for shape, reach in areas)
    assert far > 1.0
    for order in (goals, goals[::-1]):
        bounds = {objective: bound_cost(room, start, order, PlanningRequest(start, order, objective=objective,
                                                                            limits=limits), 3.0)
                  for objective in ("primitives", "length", "time", "clearance")}
        assert bounds == {"primitives": 3.0, "length": pytest.approx(far), "clearance": 0.0, "time": pytest.approx(
            compute_rest_to_rest(far, limits.speed, limits.acceleration, limits.jerk))}


def test_lacking_clearance_is_the_integral_of_what_a_metre_lacks():
    """A straight way along a wall at a known distance, by arithmetic."""
    instance = generate(get_preset("paper-two-button"), 0)
    planner = RoomPlanner(instance)
    start = planner.rules.make_state(instance.starts[0])._replace(x=-4.0, y=-9.0, heading_steps=0)
    plan = planner.plan(start, "4,-9")
    ys = np.unique(plan.path[:, 1])
    assert len(ys) == 1, "straight along the wall"
    wall = min(compute_distance(0.0, -9.0, solid.footprint) for solid in instance.solids)
    lacks = 1.0 - (wall - instance.robot.body_radius)
    assert compute_lacking_clearance(plan) == pytest.approx(lacks * (plan.path[-1, 0] - plan.path[0, 0]))


def test_times_are_those_of_trapezoids_and_triangles_with_rounded_corners():
    assert compute_rest_to_rest(4.0, 1.0, 1.0, 1e12) == pytest.approx(5.0)  # 1 s up, 3 s at 1 m/s, 1 s down
    assert compute_rest_to_rest(0.25, 1.0, 1.0, 1e12) == pytest.approx(1.0)  # half a second up, half a second down
    assert compute_rest_to_rest(4.0, 1.0, 1.0, 1.0) == pytest.approx(6.0)  # 2 s up and 2 s down, 1 m each
    assert compute_rest_to_rest(2.0, 1.0, 9.0, 1.0) == pytest.approx(4.0)  # 1 s of each jerk: 1/6, 5/6, 5/6, 1/6 m
    planner = RoomPlanner(generate(get_preset("paper-two-button"), 0))
    start = planner.rules.make_state(planner.instance.starts[0])
    result = planner.answer(PlanningRequest(start, "3,0", objective="time"))
    assert result.plan is not None
    assert result.cost == pytest.approx(compute_rest_to_rest(result.plan.cost, 1.0, 1.0, 10.0))


def test_the_first_plan_is_the_answer_unless_a_better_one_is_asked_for(planner, start):
    once = planner.answer(PlanningRequest(start, "press-button-1", budget=20_000))
    more = planner.answer(PlanningRequest(start, "press-button-1", budget=20_000, improve=True))
    assert once.plan is not None and once.cost > once.lower_bound and once.spent < more.spent


@pytest.mark.nightly
def test_improvement_is_monotone_reported_and_reaches_the_reference():
    instance = generate(get_preset("clutter"), 5)
    planner = RoomPlanner(instance)
    start = planner.rules.make_state(instance.starts[0])
    goals = [PressGoal(0), PressGoal(1), PressGoal(2)]
    first_sum = best_sum = fewest_sum = 0
    for goal in goals:
        seen = []
        best = planner.answer(PlanningRequest(start, goal, improve=True), on_improvement=seen.append)
        assert [r.cost for r in seen] == sorted({r.cost for r in seen}, reverse=True)
        assert seen[-1].plan == best.plan and seen[0].plan is not None
        assert seen[0].plan.primitives == planner.plan(start, goal).primitives
        fewest = find_fewest_primitives(planner.rules, start, goal, *compute_goal_area(goal, instance))
        assert fewest is not None and best.lower_bound <= len(fewest)
        first_sum, best_sum, fewest_sum = first_sum + seen[0].cost, best_sum + best.cost, fewest_sum + len(fewest)
    assert best_sum <= first_sum and best_sum <= 1.01 * fewest_sum


@pytest.mark.nightly_for("arm-two-button")
@pytest.mark.parametrize("name", ["paper-two-button", "arm-two-button"])
def test_improvement_ends_when_the_search_nodes_of_its_budget_are_spent(name):
    planner = RoomPlanner(generate(get_preset(name), 5))
    start = planner.rules.make_state(planner.instance.starts[0])
    for goal in (None, "press-button-1"):
        result = planner.answer(PlanningRequest(start, goal, improve=True, budget=30_000))
        assert result.plan is not None and not result.cut_short
        assert result.spent <= 33_000, "a leg may be under way when the last node is spent"


def test_nodes_of_a_search_that_failed_count_as_spent(planner, start):
    result = planner.answer(PlanningRequest(start, "press-button-1", budget=5))
    assert result.status is PlanningReason.BUDGET_EXHAUSTED and 0 < result.spent <= 5
    assert result.failure is not None and pickle.loads(pickle.dumps(result.failure)).expansions == result.spent


@pytest.mark.nightly
def test_answers_are_the_same_in_any_order_and_again(start, planner):
    requests = [PlanningRequest(start, goal, method=method, seed=seed, improve=improve)
                for goal, method, seed, improve in (
                    ("press-button-1", "RRTConnect", 0, False), ("press-button-1", None, 0, True),
                    ("press-button-1", "RRTConnect", 7, False), ("0,3", "BITstar", 1, False))]

    def answer(asked):
        fresh = RoomPlanner(planner.instance)
        return [result.plan and result.plan.primitives for result in map(fresh.answer, asked)]

    there, back = answer(requests), answer(requests[::-1])
    assert there == back[::-1]


# --- other threads and processes -------------------------------------------------------------------


SLOW = PoseGoal(-5.84, 1.29, 4.22, tolerance=0.02)
"""A place that is hard to meet: every finer grid is searched, for seconds."""


@pytest.mark.nightly_for("fields")
@pytest.mark.parametrize("method", ["fields", "RRTConnect"])
def test_a_call_is_cancelled_from_another_thread_at_once(method):
    planner = RoomPlanner(generate(get_preset("clutter"), 0))
    start = planner.rules.make_state(planner.instance.starts[0])
    planner.plan(start, "press-button-1", method)
    waits = []
    for delay in (0.0, 0.02, 0.05, 0.1):
        stop = threading.Event()
        with ThreadPoolExecutor(1) as pool:
            call = pool.submit(planner.answer, PlanningRequest(start, SLOW, method=method), stop=stop)
            time.sleep(delay)
            assert not call.done() or delay == 0.0
            began = time.process_time()
            stop.set()
            result = call.result(600.0)
        waits.append(time.process_time() - began)
        assert result.status is PlanningReason.CANCELLED and result.cut_short
    assert min(waits) < 0.05, waits


@pytest.mark.parametrize("method", ["fields", "RRTConnect"])
def test_a_call_that_is_cancelled_before_it_begins_is_cut_short(planner, start, method):
    stop = threading.Event()
    stop.set()
    result = planner.answer(PlanningRequest(start, "press-button-1", method=method), stop=stop)
    assert result.status is PlanningReason.CANCELLED and result.cut_short and result.plan is None


@pytest.mark.nightly
def test_a_cancelled_call_keeps_the_best_plan_and_the_planner_its_answers(planner, start):
    stop, seen = threading.Event(), []

    def look(result):
        seen.append(result)
        stop.set()

    request = PlanningRequest(start, "press-button-1", objective="clearance")
    result = planner.answer(request, stop=stop, on_improvement=look)
    assert result.plan is not None and result.cut_short and len(seen) == 1
    again = RoomPlanner(planner.instance).answer(request)
    assert planner.answer(again.request).cost == again.cost, "nothing that was cut short is remembered"


def test_calls_of_one_planner_from_several_threads_are_those_of_one(planner, start):
    requests = [PlanningRequest(start, f"press-button-{n}") for n in (1, 2, 3)]
    with ThreadPoolExecutor(3) as pool:
        results = list(pool.map(planner.answer, requests))
    assert [result.plan.parts[0].goal for result in results] == [PressGoal(0), PressGoal(1), PressGoal(2)]
    assert [result.plan.primitives for result in results] == [
        result.plan.primitives for result in map(RoomPlanner(planner.instance).answer, requests)]


@pytest.mark.nightly
def test_a_wall_of_solids_is_no_reason_for_less_clearance_than_the_plain_plan():
    """The way with clearance goes round a block that the plain plan grazes."""
    instance = generate(get_preset("paper-two-button"), 0)
    block = Solid("box", 0.0, -4.0, 0.6, 0.6)
    instance = dataclasses.replace(instance, solids=(*instance.solids, block))
    planner = RoomPlanner(instance)
    start = planner.rules.make_state(instance.starts[0])._replace(x=-4.0, y=-4.0, heading_steps=0)
    plain = planner.answer(PlanningRequest(start, "4,-4"))
    wide = planner.answer(PlanningRequest(start, "4,-4", objective="clearance"))
    assert plain.plan is not None and wide.plan is not None

    def least(plan):
        return min(compute_distance(x, y, block.footprint) for x, y in plan.path) - instance.robot.body_radius

    assert least(wide.plan) > least(plain.plan) + 0.2
