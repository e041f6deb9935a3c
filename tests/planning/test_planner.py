"""The planner's public API: plans that come true, every way to fail, and that the same question has one answer."""

from __future__ import annotations

import dataclasses
import gc
import json
import math
import os
import pickle
import subprocess
import sys
import threading
import tracemalloc

import gymnasium
import numpy as np
import pytest

from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import Solid
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import (
    EscapeError,
    GoalError,
    PlanningFailed,
    PlanningReason,
    StateError,
    UnknownNameError,
    UnsupportedError,
)
from hrl_escape.options.closed_loop import pursue
from hrl_escape.options.options_env import make_options_env
from hrl_escape.planning import routes
from hrl_escape.planning.goals import (
    ExitGoal,
    PoseGoal,
    PressGoal,
    PushGoal,
    RegionGoal,
    is_reached,
    name_goal,
    parse_goal,
)
from hrl_escape.planning.planner import RoomPlanner, get_planner
from tests.command_line import run_here
from tests.covering import cover
from tests.env.rooms import EXTREMES, make_ordered_chain
from tests.planning.legs import assert_legs_cost_at_least_their_bounds

BY_CHANCE = ("light-box", "random-lights", "factored", "four-rooms", "key-chest", "foraging")
KINEMATIC = [name for name in PRESETS if name != "push-block" and name not in BY_CHANCE]


@pytest.fixture(scope="module")
def planner():
    return RoomPlanner(generate(get_preset("paper-two-button"), 0))


@pytest.fixture(scope="module")
def start(planner):
    return planner.rules.make_state(planner.instance.starts[0])


# --- plans come true -------------------------------------------------------------------------


@pytest.mark.nightly_for("puddle-world-fields", 
    "twenty-button-fields", "hanoi-corridor", "puddle-world-corridor", "recipes-fields", "ten-button-corridor",
    "potions-corridor", "deep-sea-corridor", "pin-pad-corridor")
@pytest.mark.parametrize(("name", "method"), cover(KINEMATIC, ["fields", "corridor"]))
def test_solve_escapes_and_every_state_is_the_predicted_one(name, method):
    env = EscapeRoomEnv(name, instance_seed=1)
    env.reset(seed=1)
    plan = RoomPlanner(env.instance, method).solve(env.get_state())
    run = plan.execute(env)
    assert run.escaped and run.as_predicted
    assert run.states == plan.states, "to the last bit"
    assert sum(run.rewards) == plan.compute_return()
    assert [part.start for part in plan.parts] == [0, *(part.stop for part in plan.parts[:-1])]
    assert plan.parts[-1].stop == plan.cost == len(run.rewards)
    assert_legs_cost_at_least_their_bounds(plan, env.instance)
    env.close()


@pytest.mark.nightly_for("light-box")
@pytest.mark.parametrize("name", BY_CHANCE)
def test_legs_cost_at_least_what_geometry_says_where_the_way_out_is_by_chance(name):
    """Of all other presets the plans above are asked."""
    instance = generate(get_preset(name), 0)
    planner = RoomPlanner(instance)
    assert_legs_cost_at_least_their_bounds(planner.solve(planner.rules.make_state(instance.starts[0])), instance)


@pytest.mark.nightly_for("many-obstacles", "sixteen-rooms")
@pytest.mark.parametrize("name", ["smallest", "many-obstacles", "sixteen-rooms", "seven-joints", "door",
                                  "coarse-steps"])
def test_solve_escapes_at_the_extremes_of_the_knobs(name):
    env = EscapeRoomEnv(EXTREMES[name], instance_seed=0)
    env.reset(seed=0)
    run = RoomPlanner(env.instance, time_limit=60).solve(env.get_state()).execute(env)
    assert run.escaped and run.as_predicted
    env.close()


@pytest.mark.parametrize("goal", ["press-button-1", "press-button-2", "go-to-exit", "3,-4", "3,-4,90",
                                  RegionGoal(-2, -1, -6, -5), PressGoal(1), ExitGoal(), PoseGoal(-5, 5, np.pi, 0.3)])
def test_plan_reaches_goals_of_every_kind(planner, start, goal):
    plan = planner.plan(start, goal)
    meant = parse_goal(goal, planner.instance) if isinstance(goal, str) else goal
    for before, action, after in zip(plan.states, plan.primitives, plan.states[1:], strict=False):
        assert planner.rules.step(before, action).state == after
    assert is_reached(meant, *plan.states[-2:], planner.rules)
    assert plan.cost == len(plan.primitives) > 0 and plan.path.shape == (plan.cost + 1, 2)


def test_a_goal_reached_already_takes_nothing(planner, start):
    assert planner.plan(start, "0,0").primitives == ()


def test_a_plan_begun_in_the_middle_of_an_episode_counts_on_from_there(planner, start):
    plan = planner.plan(start._replace(primitives=17, noise_key=5), "press-button-1")
    assert [state.primitives for state in plan.states] == list(range(17, 18 + plan.cost))
    assert plan.states[-1].puzzle == 1


@pytest.mark.nightly
def test_pursuit_escapes_under_noise_and_slip():
    config = get_preset("clutter")
    noisy = dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, noise=0.1, slip=0.1))
    env = EscapeRoomEnv(noisy)
    env.reset(seed=0)
    run = pursue(env)
    assert run.escaped and run.is_reached and sum(run.rewards) == 100 - len(run.rewards)
    assert all(decision["ended"] == "reached" for decision in run.decisions)


def test_pursuit_of_one_goal_ends_there():
    env = EscapeRoomEnv("paper-two-button")
    env.reset(seed=0)
    run = pursue(env, "press-button-2")
    assert run.is_reached and not run.escaped and env.get_state().touching == 2
    assert len(run.states) == len(run.rewards) + 1


# --- the cheapest order --------------------------------------------------------------------------


@pytest.mark.nightly
def test_pairwise_costs_lead_to_an_order_as_good_as_costing_every_leg(monkeypatch):
    """A DAG of eight buttons, two orders of costing it."""
    config = RoomConfig(puzzle=ButtonsConfig(count=8, graph=GraphConfig(kind="tree"), buttons=Panels(width=1.0)))
    from hrl_escape.planning import planner as module

    for seed in range(3):
        instance = generate(config, seed)
        start = RoomPlanner(instance).rules.make_state(instance.starts[0])
        monkeypatch.setattr(module, "REAL_LEGS", 10_000)
        real = RoomPlanner(instance).solve(start).cost
        monkeypatch.setattr(module, "REAL_LEGS", 0)
        assert RoomPlanner(instance).solve(start).cost <= 1.1 * real


def test_ancestors_come_first_and_only_where_needed():
    planner = RoomPlanner(generate(make_ordered_chain(), 0))
    state = planner.rules.make_state(planner.instance.starts[0])
    assert planner.orders.find_ancestors(state, PressGoal(2)) == [PressGoal(0), PressGoal(1), PressGoal(2)]
    assert planner.orders.find_ancestors(state._replace(puzzle=0b001), PressGoal(2)) == [PressGoal(1), PressGoal(2)]
    assert planner.orders.find_ancestors(state, PressGoal(0)) == [PressGoal(0)]


def test_a_robot_set_down_in_an_open_exit_escapes_with_one_primitive(planner, start):
    inside = start._replace(x=6.5, y=6.0, puzzle=0b11)
    plan = planner.solve(inside)
    assert plan.cost == 1 and plan.compute_return() == 99


def test_a_press_that_solves_the_puzzle_inside_the_exit_needs_no_last_leg():
    planner = RoomPlanner(generate(get_preset("paper-one-button"), 0))
    plan = planner.solve(planner.rules.make_state(planner.instance.starts[0]))
    assert [part.name for part in plan.parts] == ["press-button-1"] and plan.compute_return() == 91


# --- failing -----------------------------------------------------------------------------------


def make_walled_in(planner):
    """The same room with a wall across it, so that nothing west of it can be reached."""
    wall = Solid("box", -4.0, 0.0, 0.2, 10.0, height=3.0, role="wall")
    return RoomPlanner(dataclasses.replace(planner.instance, solids=(*planner.instance.solids, wall)))


def fail(planner, state, goal) -> PlanningFailed:
    with pytest.raises(PlanningFailed) as caught:
        planner.plan(state, goal)
    return caught.value


def test_an_unreachable_goal_is_proven_so(planner, start):
    failure = fail(make_walled_in(planner), start, "press-button-2")
    assert failure.reason is PlanningReason.UNREACHABLE_PROVEN
    assert failure.goal == "press-button-2" and failure.start[:2] == (0.0, 0.0) and failure.planners == ("fields",)
    assert failure.seconds > 0


def test_a_goal_inside_a_solid_is_invalid(planner, start):
    failure = fail(make_walled_in(planner), start, PoseGoal(-4.0, 0.0, tolerance=0.1))
    assert failure.reason is PlanningReason.GOAL_INVALID


def test_a_start_inside_a_solid_is_invalid(planner, start):
    assert fail(planner, start._replace(x=9.8), "press-button-1").reason is PlanningReason.START_INVALID


def test_a_target_too_high_for_the_hand_has_no_posture():
    instance = generate(get_preset("arm-two-button"), 0)
    high = (dataclasses.replace(instance.targets[0], z=9.0), instance.targets[1])
    planner = RoomPlanner(dataclasses.replace(instance, targets=high))
    state = planner.rules.make_state(instance.starts[0])
    assert fail(planner, state, "press-button-1").reason is PlanningReason.NO_POSTURE
    assert planner.plan(state, "press-button-2").cost > 0


def test_a_budget_that_runs_out_says_so_at_the_same_place_every_time():
    instance = generate(get_preset("clutter"), 0)
    planner = RoomPlanner(instance, budget=5)
    state = planner.rules.make_state(instance.starts[0])
    assert fail(planner, state, "press-button-4").reason is PlanningReason.BUDGET_EXHAUSTED
    assert str(fail(planner, state, "press-button-4")) == str(fail(planner, state, "press-button-4"))


def test_a_time_limit_that_passes_says_so_and_is_not_remembered():
    instance = generate(get_preset("clutter"), 0)
    planner = RoomPlanner(instance)
    state = planner.rules.make_state(instance.starts[0])
    planner.plan(state, "press-button-1")
    planner.routes.time_limit = 0.0
    assert fail(planner, state, "press-button-4").reason is PlanningReason.TIMEOUT
    planner.routes.time_limit = 60.0
    assert planner.plan(state, "press-button-4").cost > 0


def test_an_escape_that_cannot_be_names_the_part_that_fails(planner, start):
    with pytest.raises(PlanningFailed) as caught:
        make_walled_in(planner).solve(start)
    assert caught.value.goal == "press-button-2" and caught.value.reason is PlanningReason.UNREACHABLE_PROVEN


def test_a_puzzle_without_a_way_names_its_precondition():
    instance = generate(make_ordered_chain(), 0)
    lost = dataclasses.replace(instance, puzzle=dataclasses.replace(instance.puzzle, edge_list=((0, 3), (1, 3))))
    planner = RoomPlanner(lost)
    model = planner.instance.puzzle.symbolic.make_symbolic_model()
    planner.orders._model = dataclasses.replace(model, operators=model.operators[2:])
    with pytest.raises(PlanningFailed) as caught:
        planner.solve(planner.rules.make_state(lost.starts[0]))
    assert caught.value.reason is PlanningReason.PRECONDITION_UNMET


def test_pushing_cannot_be_planned_ahead():
    planner = RoomPlanner(generate(get_preset("push-block"), 0))
    with pytest.raises(UnsupportedError, match="pursue"):
        planner.solve(planner.rules.make_state(planner.instance.starts[0]))


@pytest.mark.parametrize(("text", "error"), [("button-3", UnknownNameError), ("", UnknownNameError),
                                             ("1,2,3,4", GoalError), ("a,b", GoalError), ("nan,1", GoalError),
                                             ("block->plate", UnknownNameError)])
def test_a_goal_that_is_none_is_refused(planner, start, text, error):
    with pytest.raises(error):
        planner.plan(start, text)


@pytest.mark.parametrize(("room", "old", "new"), [
    ("paper-two-button", "button-2", "press-button-2"), ("paper-two-button", "press button-2", "press-button-2"),
    ("paper-two-button", "press(button-2)", "press-button-2"), ("paper-two-button", "meta-02", "press-button-2"),
    ("paper-two-button", "exit", "go-to-exit"), ("paper-two-button", "leave", "go-to-exit"),
    ("paper-two-button", "meta-exit", "go-to-exit"), ("taxi", "grip red", "grip-red"),
    ("taxi", "meta-06", "release-red"), ("sokoban", "push-east box-1", "push-east-box-1"),
    ("push-block", "block-1->plate-1", "push-block-1-to-plate-1"),
    ("push-block", "push block-1 onto plate-1", "push-block-1-to-plate-1"),
])
def test_a_name_of_an_earlier_version_is_refused_with_the_name_of_today(room, old, new):
    instance = generate(get_preset(room), 0)
    with pytest.raises(UnknownNameError, match=rf"unknown goal '.*'; did you mean '{new}'\?"):
        parse_goal(old, instance)
    assert name_goal(parse_goal(new, instance), instance) == new in make_options_env(room).action_names


@pytest.mark.parametrize(("field", "value"), [("heading_steps", 36), ("heading_steps", 10**9), ("x", math.nan),
                                              ("x", 50.0), ("touching", -1), ("puzzle", "on"), ("joint_steps", (1,))])
def test_a_state_that_cannot_be_is_refused_by_its_field_at_every_door(planner, start, field, value):
    state = start._replace(**{field: value})
    for ask in (lambda: planner.plan(state, "press-button-1"), lambda: planner.solve(state),
                lambda: planner.order_goals(state), lambda: planner.routes.find_route(state, ExitGoal()),
                lambda: planner.orders.find_ancestors(state, PressGoal(0)),
                lambda: planner.make_plan(state, (0,), [ExitGoal()], "mine")):
        with pytest.raises(StateError, match=field):
            ask()


@pytest.mark.parametrize("goal", [None, 5, PressGoal(9), PressGoal(-1), PressGoal("a"), PoseGoal(math.nan, 0.0),
                                  PoseGoal(1, 1, tolerance=-1), RegionGoal(3, 1, 0, 0), PushGoal(0, 1)])
def test_what_is_no_goal_of_this_room_is_refused_at_every_door(planner, start, goal):
    for ask in (lambda: planner.plan(start, goal), lambda: planner.routes.find_route(start, goal),
                lambda: planner.orders.find_ancestors(start, goal)):
        with pytest.raises(GoalError):
            ask()


def walk(planner: RoomPlanner, calls: int, seed: int, ask) -> int:
    """Ask from the states of a random walk; memory that is in use afterwards, B."""
    rng, state = np.random.default_rng(seed), planner.rules.make_state(planner.instance.starts[0])
    for _ in range(calls):
        primitive = int(rng.integers(6))
        ask(state, primitive)
        step = planner.rules.step(state, primitive)
        state = planner.rules.make_state(planner.instance.starts[0]) if step.terminated else step.state
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


@pytest.mark.nightly_for("plan")
@pytest.mark.parametrize("by", ["plan", "remember"])
def test_memory_of_routes_is_bounded_however_they_are_learnt(monkeypatch, by):
    monkeypatch.setattr(routes, "MOST_POSES", 400)
    config = RoomConfig(room=ShapeConfig(width=6, depth=6), robot=RobotConfig(body_radius=0.3))
    planner = RoomPlanner(generate(config, 0))

    def ask(state, primitive: int) -> None:
        if by == "plan":
            planner.plan(state, "go-to-exit")
            return
        after = planner.rules.step(state, primitive).state
        place = PoseGoal(after.x, after.y, planner.rules.get_heading(after), 0.1 + 1e-6 * float(state.x))
        planner.routes.remember(state, place, (primitive,))

    tracemalloc.start()
    try:
        once = walk(planner, 160, 0, ask)
        again = walk(planner, 480, 1, ask)
    finally:
        tracemalloc.stop()
    assert again - once < 150_000, "three times as many calls"


@pytest.mark.slow
def test_ten_thousand_plans_grow_a_planner_by_six_mib_at_most():
    planner = RoomPlanner(generate(get_preset("paper-two-button"), 0))
    planner.prepare()
    rng, half = np.random.default_rng(0), 0.9 * planner.instance.reach_x
    start = planner.rules.make_state(planner.instance.starts[0])
    before = 0
    tracemalloc.start()
    try:
        for number in range(10_500):
            if number == 500:  # grids, and memory that searches share
                gc.collect()
                before = tracemalloc.get_traced_memory()[0]
            x, y = rng.uniform(-half, half, 2).tolist()
            planner.plan(start._replace(x=x, y=y, heading_steps=int(rng.integers(planner.rules.headings))),
                         ("press-button-1", "press-button-2", "go-to-exit")[number % 3])
        gc.collect()
        assert tracemalloc.get_traced_memory()[0] - before < 6 * 2**20
    finally:
        tracemalloc.stop()


def test_a_failure_that_is_remembered_holds_no_frames():
    planner = RoomPlanner(generate(get_preset("paper-two-button"), 0))
    state, raised = planner.rules.make_state(planner.instance.starts[0]), []
    for _ in range(2):
        with pytest.raises(PlanningFailed) as caught:
            planner.plan(state, "500,500")
        raised.append(caught.value)
    assert str(raised[0]) == str(raised[1]) and raised[0] is not raised[1]


def test_a_path_planner_is_chosen_by_name(planner, start):
    plan = RoomPlanner(planner.instance, "BITstar").plan(start, "3,-4")
    assert plan.planner == "BITstar" and plan.cost == planner.plan(start, "3,-4").cost
    with pytest.raises(UnknownNameError, match="did you mean 'RRTConnect'|RRTConnect"):
        RoomPlanner(planner.instance, "RRTConect")


def test_goals_and_their_words_belong_together(planner):
    for goal in (PressGoal(1), ExitGoal(), PoseGoal(1.5, -2.0), PoseGoal(1.0, 2.0, np.radians(90))):
        assert parse_goal(name_goal(goal, planner.instance), planner.instance) == goal


def test_failures_survive_pickling(planner, start):
    failure = fail(make_walled_in(planner), start, "press-button-2")
    copy = pickle.loads(pickle.dumps(failure))
    assert (str(copy), copy.reason, copy.goal) == (str(failure), failure.reason, failure.goal)


# --- executing -----------------------------------------------------------------------------------


def test_a_plan_is_not_executed_elsewhere(planner, start):
    plan = planner.plan(start, "press-button-1")
    env = EscapeRoomEnv("paper-two-button")
    env.reset(seed=0)
    env.step(0)
    with pytest.raises(EscapeError, match="starts at"):
        plan.execute(env)
    other = EscapeRoomEnv("paper-one-button")
    other.reset(seed=0)
    with pytest.raises(EscapeError, match="the environment has"):
        plan.execute(other)
    with pytest.raises(EscapeError, match="CartPoleEnv is no room"):
        plan.execute(gymnasium.make("CartPole-v1"))


# --- a plan as a value ------------------------------------------------------------------------------


@pytest.mark.nightly
def test_a_plan_is_json_text_and_picture(planner, start, tmp_path):
    plan = planner.solve(start)
    content = json.loads(json.dumps(plan.to_dict()))
    assert content["cost"] == plan.cost == len(content["primitives"]) and content["return"] == plan.compute_return()
    assert [part["name"] for part in content["parts"]] == ["press-button-1", "press-button-2", "go-to-exit"]
    assert "press-button-2" in str(plan) and str(plan.cost) in str(plan)
    plan.draw(tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 10_000
    assert pickle.loads(pickle.dumps(plan)) == plan


# --- one question, one answer -------------------------------------------------------------------------


def test_remembering_changes_no_plan(planner, start):
    """Plans asked for in another order, by another planner, or again, are the same."""
    other = RoomPlanner(planner.instance)
    goals = ["press-button-2", "go-to-exit", "3,-4,90", "press-button-1"]
    expected = {goal: planner.plan(start, goal).primitives for goal in goals}
    for goal in [*reversed(goals), *goals]:
        assert other.plan(start, goal).primitives == expected[goal]


@pytest.mark.nightly
def test_what_is_remembered_belongs_to_the_whole_pose_and_the_door():
    """One place, but another heading, another touch, another door: each as a planner without memory answers."""
    planner = RoomPlanner(generate(get_preset("clutter"), 0))
    rules = planner.rules
    start = planner.plan(rules.make_state(planner.instance.starts[0]), "press-button-2").states[-1]
    solved = next(puzzle for puzzle in range(16) if planner.instance.puzzle.is_solved(puzzle))
    states = [start, start._replace(heading_steps=(start.heading_steps + 4) % 36), start._replace(touching=0),
              start._replace(puzzle=solved)]
    for goal in ("press-button-2", "press-button-3", "go-to-exit"):
        for state in states:
            answers = []
            for asked in (planner, RoomPlanner(planner.instance)):
                try:
                    answers.append(asked.plan(state, goal).primitives)
                except PlanningFailed as failure:
                    answers.append(failure.reason)
            assert answers[0] == answers[1]


@pytest.mark.nightly
def test_a_plan_names_the_search_that_found_it(planner, start):
    assert planner.solve(start).planner == "joint search"
    assert planner.plan(start, "3,-4").planner == "fields"
    assert planner.solve(start, "BITstar").planner == "BITstar"
    assert planner.plan(start, "3,-4", "corridor").planner == "RRTConnect"
    with pytest.raises(UnknownNameError, match="BITstar"):
        planner.solve(start, "BITster")


@pytest.mark.nightly_for("60-corridor")
@pytest.mark.parametrize(("side", "way"), [(50, "fields"), (60, "corridor")])
def test_a_place_on_a_large_floor_is_reached_round_a_path_and_targets_by_fields(side, way):
    planner = RoomPlanner(generate(RoomConfig(room=ShapeConfig(width=side, depth=side)), 0))
    start = planner.rules.make_state(planner.instance.starts[0])
    place, search = PoseGoal(-side / 3, side / 3), planner.routes.search
    assert search.choose_method(place, ()) == search.choose_method(RegionGoal(0, 2, 0, 2), ()) == way
    assert search.choose_method(PressGoal(0), ()) == search.choose_method(ExitGoal(), ()) == "fields"
    assert search.choose_method(place, (planner.instance.solids[0].footprint,)) == "fields"
    plan = planner.plan(start, place)
    assert plan.planner == ("RRTConnect" if way == "corridor" else "fields")
    assert bool(search._makers) == (way == "fields"), "no grid of the whole floor is made for one place"
    assert plan.cost <= 1.1 * RoomPlanner(planner.instance, "fields").plan(start, place).cost


@pytest.mark.nightly
def test_planners_survive_pickling(planner, start):
    copy = pickle.loads(pickle.dumps(planner))
    assert copy.solve(start).primitives == planner.solve(start).primitives


def test_threads_share_a_planner(planner, start):
    fresh, found = RoomPlanner(planner.instance), []
    goals = ["press-button-1", "press-button-2", "go-to-exit", "3,-4", "-3,4", "5,5"]
    threads = [threading.Thread(target=lambda g=goal: found.append((g, fresh.plan(start, g).primitives)))
               for goal in goals * 3]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(found) == sorted((goal, planner.plan(start, goal).primitives) for goal in goals * 3)


SCRIPT = """
import hashlib
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.presets import get_preset
from hrl_escape.planning.planner import RoomPlanner
plans = []
for name, method in (("paper-two-button", "fields"), ("clutter", "corridor"), ("arm-two-button", "fields")):
    planner = RoomPlanner(generate(get_preset(name), 2), method)
    plans.append(planner.solve(planner.rules.make_state(planner.instance.starts[0])).primitives)
print(hashlib.sha256(repr(plans).encode()).hexdigest())
"""


@pytest.mark.nightly
def test_another_process_makes_the_same_plans():
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True,
                          env=os.environ | {"PYTHONHASHSEED": "7"})
    assert done.stdout.split()[-1] == run_here(SCRIPT).strip() and len(done.stdout.split()[-1]) == 64


def test_the_shared_planner_of_a_room_is_one():
    instance = generate(get_preset("paper-two-button"), 0)
    assert get_planner(instance) is get_planner(dataclasses.replace(instance, name="another name"))
    assert get_planner(instance) is not get_planner(generate(get_preset("paper-one-button"), 0))


def test_a_button_beyond_the_arm_is_refused_with_the_reason():
    instance = generate(get_preset("arm-two-button"), 0)
    high = dataclasses.replace(instance.targets[0], z=5.0)
    instance = dataclasses.replace(instance, targets=(high, *instance.targets[1:]))
    planner = RoomPlanner(instance)
    with pytest.raises(PlanningFailed, match=r"no posture.*too high: button-1 hangs from 4\.80 m up"):
        planner.plan(Kinematics(instance).make_state(instance.starts[0]), "press-button-1")
