"""Paths of every planner against the exact geometry; statuses, budgets, reproducibility, and planners of strangers."""

import hashlib
import pickle
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.checks import check_path_planner
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.geometry import Solid, compute_distance, compute_distance_many, stack_footprints
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import (
    ConfigError,
    ContractError,
    GoalError,
    PathPlannerError,
    UnknownNameError,
    UnsupportedError,
)
from hrl_escape.planning.goals import ExitGoal, PoseGoal, PressGoal, PushGoal, RegionGoal
from hrl_escape.planning.paths import planners as path_planners
from hrl_escape.planning.paths.navigator import Navigator
from hrl_escape.planning.paths.planners import ANYTIME, list_planners, register_planner
from hrl_escape.planning.paths.problem import DEFAULT_PLANNER, PathProblem
from tests.covering import thin
from tests.floor.test_clearance import make_room
from tests.forks import run_fork

PLANNERS = list_planners()
HIDDEN = PressGoal(3)  # out of sight from the start of `clutter`


@pytest.fixture(scope="module")
def clutter():
    return Navigator(generate(get_preset("clutter"), 1))


@pytest.fixture
def registered():
    """Register planners that are forgotten after the test."""
    names = []

    def register(name, factory):
        register_planner(name, factory)
        names.append(name)

    yield register
    for name in names:
        path_planners.path_planners.unregister(name)


def get_start(navigator):
    return navigator.instance.starts[0].x, navigator.instance.starts[0].y


def assert_is_path(navigator, result, start):
    """The path begins at the start, and the body keeps its clearance all along it, asked of plain distances."""
    assert tuple(result.path[0]) == start
    solids = stack_footprints(navigator.get_collision(True).footprints)
    walk = np.concatenate([np.linspace(a, b, 200) for a, b in zip(result.path[:-1], result.path[1:], strict=True)])
    assert compute_distance_many(walk, solids).min() >= navigator.instance.robot.body_radius + 1e-3 - 1e-8
    assert result.cost == pytest.approx(np.hypot(*np.diff(result.path, axis=0).T).sum())


# --- paths -----------------------------------------------------------------------------------


@pytest.mark.nightly_for("SORRTstar", "InformedRRTstar", "BFMT", "FMT", "BITstar", "BKPIECE1", "KPIECE1")
@pytest.mark.parametrize("planner", PLANNERS)
def test_every_planner_finds_its_way_to_buttons_through_doorways_and_clutter(clutter, planner):
    start, rules = get_start(clutter), Kinematics(clutter.instance)
    for target in range(len(clutter.instance.targets)):
        result = clutter.plan(start, PressGoal(target), planner)
        assert result.status == "exact"
        assert_is_path(clutter, result, start)
        x, y = result.path[-1].tolist()
        assert rules.compute_touching(x, y, 0, 0.0, (), ()) >> target & 1
        assert result.planner == planner and result.seconds > 0 and result.checker_calls > 0


@pytest.mark.nightly_for("BFMT", "BITstar")
@pytest.mark.parametrize("planner", thin(PLANNERS, 2))
def test_every_planner_keeps_the_contract(planner):
    check_path_planner(planner, queries=1)


def test_goals_may_be_a_region_a_pose_or_places(clutter):
    start = get_start(clutter)
    place = find_far_place(clutter.get_collision(True), *start)
    for goal in (PoseGoal(*place, tolerance=0.1), np.array([place]),
                 RegionGoal(place[0] - 0.1, place[0] + 0.1, place[1] - 0.1, place[1] + 0.1)):
        result = clutter.plan(start, goal)
        assert result.status == "exact"
        assert np.abs(result.path[-1] - place).max() <= 0.1 + 1e-9
        assert_is_path(clutter, result, start)


def find_far_place(free, x, y):
    for a, b in np.random.default_rng(5).uniform(-9, 9, (500, 2)).tolist():
        parts = free.get_parts(np.array([[a, b], [x, y]]))
        if free.is_free(a, b) and abs(a - x) > 5 and parts[0] == parts[1]:
            return a, b
    raise AssertionError("a room has far places")


def test_a_body_in_touch_with_walls_still_gets_away_and_back():
    navigator = Navigator(make_room(Solid(x=-4.499 + 1.0 + 0.001 + 0.5, half_x=0.5, half_y=3)))  # 1.0 m + skin wide
    start = (-4.499, 4.499)
    result = navigator.plan(start, np.array([[4.499, -4.499]]))
    assert result.status == "exact"
    assert_is_path(navigator, result, start)


def test_the_exit_is_behind_the_door_until_the_door_is_gone(clutter):
    start = get_start(clutter)
    assert clutter.plan(start, ExitGoal()).status == "no-path"
    assert clutter.plan(start, ExitGoal(), door_shut=False).status == "exact"


# --- statuses --------------------------------------------------------------------------------


def test_each_status_means_what_it_says():
    room = make_room(Solid(y=1, half_x=5, half_y=0.1), Solid(x=3, y=-3, half_x=1, half_y=1))
    navigator = Navigator(room)
    assert navigator.plan((0, -3), np.array([[-4.0, -4.0]])).status == "exact"
    assert navigator.plan((0, 1.2), PoseGoal(-4, -4)).status == "invalid-start"
    assert navigator.plan((0, -3), PoseGoal(3, -3)).status == "invalid-goal"
    apart = navigator.plan((0, -3), PressGoal(0))
    assert apart.status == "no-path" and not len(apart.path) and apart.cost == np.inf and apart.checker_calls == 0


@pytest.mark.parametrize("planner", thin(PLANNERS, 2, 1))
def test_budget_and_time_stop_every_planner_and_leave_nothing_running(clutter, planner):
    threads = threading.active_count()
    start = get_start(clutter)
    few = clutter.plan(start, HIDDEN, planner, budget=40)
    assert len(clutter.plan(start, HIDDEN).path) > 2
    assert few.status == "budget-exhausted" and few.checker_calls <= 50  # a whole motion counts as ten
    began = time.thread_time()
    assert clutter.plan(start, HIDDEN, planner, time_limit=0.0).status == "timeout"
    assert time.thread_time() - began < 0.5
    assert threading.active_count() == threads
    assert clutter.plan(start, HIDDEN, planner).status == "exact"


@pytest.mark.nightly_for("BITstar", "InformedRRTstar", "SORRTstar")
@pytest.mark.parametrize("planner", ANYTIME)
def test_an_anytime_planner_s_path_becomes_shorter_with_its_budget(clutter, planner):
    start = get_start(clutter)
    first = clutter.plan(start, HIDDEN, planner)
    results = [clutter.plan(start, HIDDEN, planner, optimise=True, budget=budget) for budget in (60_000, 120_000)]
    costs = [first.cost, *(result.cost for result in results)]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < costs[0] or planner == "SORRTstar", "its first path is the best it finds here"
    assert all(result.status == "exact" and result.bound <= result.cost for result in results)
    assert results[0].checker_calls >= 60_000 and results[1].checker_calls >= 120_000
    assert_is_path(clutter, results[-1], start)


def test_an_error_in_the_checker_is_one_clear_error_and_the_next_plan_works(clutter, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("in the checker")

    with monkeypatch.context() as patch:
        patch.setattr(PathProblem, "is_free", fail)
        for planner in PLANNERS:
            with pytest.raises(PathPlannerError, match=f"{planner}.*ZeroDivisionError: in the checker"):
                clutter.plan(get_start(clutter), HIDDEN, planner)
    assert clutter.plan(get_start(clutter), HIDDEN).status == "exact"


def test_what_is_no_goal_for_a_path_says_so(clutter):
    with pytest.raises(UnknownNameError, match="RRTConect.*did you mean 'RRTConnect'"):
        clutter.plan((0, 0), PressGoal(0), "RRTConect")
    with pytest.raises(GoalError, match="no target 99"):
        clutter.plan((0, 0), PressGoal(99))
    with pytest.raises(GoalError, match="no prop 0"):
        clutter.plan((0, 0), PushGoal(0, 1))
    blocks = Navigator(generate(get_preset("push-block"), 0))
    with pytest.raises(UnsupportedError, match="push"):
        blocks.plan((0, 0), PushGoal(0, 1))
    with pytest.raises(GoalError, match="hand"):
        Navigator(generate(get_preset("arm-two-button"), 0)).plan((0, 0), PressGoal(0))


# --- reproducible ----------------------------------------------------------------------------

SCRIPT = """
import hashlib, sys
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.presets import get_preset
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.paths.navigator import Navigator
navigator = Navigator(generate(get_preset("clutter"), 1))
start = navigator.instance.starts[0]
for planner in sys.argv[1:]:
    for target in (0, 3):
        path = navigator.plan((start.x, start.y), PressGoal(target), planner, seed=7).path
    print(hashlib.sha256(path.tobytes()).hexdigest())
"""


@pytest.mark.nightly
def test_the_same_seed_gives_the_same_path_in_any_process(clutter):
    planners = [DEFAULT_PLANNER, "BITstar", "RRTstar", "KPIECE1", "FMT"]
    there = run_fork(SCRIPT, *planners, check=True).stdout.split()
    here = [hashlib.sha256(clutter.plan(get_start(clutter), HIDDEN, planner, seed=7)
                           .path.tobytes()).hexdigest() for planner in planners]
    assert there == here
    assert len(set(here)) > 3


def test_seeds_differ(clutter):
    costs = {clutter.plan(get_start(clutter), HIDDEN, seed=seed).cost for seed in range(4)}
    assert len(costs) > 1


@pytest.mark.slow
def test_hundreds_of_plans_grow_no_memory(clutter):
    def get_memory_kib():
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4

    start = get_start(clutter)

    def plan(count):
        for number in range(count):
            clutter.plan(start, HIDDEN, seed=number % 7)

    plan(150)
    before = get_memory_kib()
    plan(350)
    assert get_memory_kib() - before < 600  # a goal's state kept, 32 bytes each, would come to as much


def test_a_navigator_survives_pickling(clutter):
    copy = pickle.loads(pickle.dumps(clutter))
    start = get_start(clutter)
    assert np.array_equal(copy.plan(start, PressGoal(1)).path, clutter.plan(start, PressGoal(1)).path)


# --- planners of strangers -------------------------------------------------------------------


def go_round_the_wall(collision):
    return lambda problem: [problem.start, (-4.0, -3.0), (-4.0, 3.0), problem.goals[0]]


def test_a_stranger_s_planner_serves_by_its_name(registered):
    registered("round-the-wall", go_round_the_wall)
    assert "round-the-wall" in list_planners()
    navigator = Navigator(make_room(Solid(x=1, half_x=4, half_y=0.1)))
    result = navigator.plan((2, -3), np.array([[2.0, 3.0]]), "round-the-wall")
    assert result.status == "exact" and result.path[1:3].tolist() == [[-4, -3], [-4, 3]]
    with pytest.raises(ConfigError, match="no other path planner has"):
        register_planner("round-the-wall", lambda collision: go_round_the_wall(collision))


@pytest.mark.parametrize(("answer", "complaint"), [
    (lambda problem: [problem.start, problem.goals[0]], "collides"),
    (lambda problem: [(0, -4), problem.goals[0]], "begin at the start"),
    (lambda problem: [problem.start, (np.nan, 0)], "finite"),
    (lambda problem: "left", "places"),
    (lambda problem: 1 / 0, "ZeroDivisionError"),
])
def test_what_a_stranger_s_planner_returns_is_not_believed(registered, answer, complaint):
    registered("careless", lambda collision: answer)
    navigator = Navigator(make_room(Solid(x=1, half_x=4, half_y=0.1)))
    with pytest.raises(PathPlannerError, match=f"(?s)careless.*{complaint}"):
        navigator.plan((2, -3), np.array([[2.0, 3.0]]), "careless")


def test_a_path_that_ends_short_of_the_goal_is_approximate(registered):
    registered("lazy", lambda collision: lambda problem: [problem.start, problem.start + (0.5, 0.0)])
    registered("nothing", lambda collision: lambda problem: None)
    navigator = Navigator(make_room())
    assert navigator.plan((2, -3), np.array([[2.0, 3.0]]), "lazy").status == "approximate"
    assert navigator.plan((2, -3), np.array([[2.0, 3.0]]), "nothing").status == "not-found"


def straight(collision):
    return lambda problem: [problem.start, problem.goals[0]] if problem.is_move_free(
        *problem.start, *problem.goals[0]) else None


def test_check_planner_passes_an_honest_planner_that_often_gives_up(registered):
    registered("straight", straight)
    check_path_planner("straight")


def moody(collision):
    asked = []

    def plan(problem):
        asked.append(problem)
        middle = (problem.start + problem.goals[0]) / 2 + (0.01 * len(asked), 0)
        path = [problem.start, middle, problem.goals[0]]
        return path if all(problem.is_move_free(*a, *b) for a, b in zip(path[:-1], path[1:], strict=True)) else None

    return plan


def deaf(collision):
    def plan(problem):
        try:
            return straight(collision)(problem)
        except Exception:
            return [problem.start]

    return plan


@pytest.mark.parametrize(("factory", "claim"), [
    (moody, "whatever was asked before"),
    (deaf, "exception through"),
    (lambda collision: lambda problem: [problem.start, problem.goals[0]], "free motions"),
    (lambda collision: lambda problem: problem.is_free(0, 0) and None, "finds some path"),
])
def test_check_planner_finds_what_breaks_the_contract(registered, factory, claim):
    registered("broken", factory)
    with pytest.raises(ContractError, match=claim):
        check_path_planner("broken")


def test_tiny_bodies_slip_through_narrow_gaps():
    room = make_room(Solid(x=-2.6, half_x=2.4, half_y=0.1), Solid(x=2.6, half_x=2.4, half_y=0.1), radius=0.15)
    assert room.robot == RobotConfig(body_radius=0.15)
    navigator = Navigator(room)
    result = navigator.plan((3, -3), np.array([[3.0, 3.0]]), budget=2_000_000)
    assert result.status == "exact"
    assert min(compute_distance(x, y, s.footprint) for s in room.solids for x, y in result.path.tolist()) >= 0.151
