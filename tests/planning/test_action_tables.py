"""The action table alone says how far a move goes: random tables through engines, certificate, planner and options."""

import contextlib
import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from benchmarks.conformance import compare
from benchmarks.reference_search import find_fewest_primitives
from hrl_escape import OptionsEnv, RoomPlanner
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.config import DynamicsConfig, ExitConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.primitives import DriveKind, Move, list_slips, make_action_table
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.sampling.primitive_proof import find_unmet_constraint
from hrl_escape.errors import ConfigError
from hrl_escape.floor.cost_to_go import make_collision
from hrl_escape.options.batched.env import BatchedOptionsEnv
from hrl_escape.planning.goals import PoseGoal, PressGoal, is_reached
from hrl_escape.planning.lower_bounds import LegBounds, bound_escape
from hrl_escape.planning.requests import PlanningRequest
from tests.planning.legs import assert_legs_cost_at_least_their_bounds

LEAP = Move("leap", forward=2.0)
PATIENT = settings(max_examples=6, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck),
                   phases=(Phase.explicit, Phase.generate))


def make_room(moves: tuple[Move, ...], seed: int = 0, drive: DriveKind = "strafing", door: bool = False
              ) -> RoomInstance:
    base = RobotConfig(body_radius=0.35, drive=drive, turn_step_deg=15, moves=moves)
    return generate(RoomConfig(room=ShapeConfig(width=9, depth=7), robot=base, puzzle=ButtonsConfig(count=2),
                               exit=ExitConfig(door=door, width=1.5)), seed)


def begin(room: RoomInstance):
    return Kinematics(room).make_state(room.starts[0])


def list_options(room: RoomInstance) -> list[int]:
    """Options that escape: the presses in an order that the puzzle allows, then the exit."""
    names, puzzle = room.puzzle.target_names, room.puzzle
    presses = room.symbolic_model.find_fewest(puzzle.get_facts(puzzle.make_state()))
    assert presses is not None
    return [len(room.robot.actions) + number for number in (*(names.index(op.target) for op in presses), len(names))]


@st.composite
def tables(draw) -> tuple[Move, ...]:
    """One to four further primitives: translations of any length and direction, and turns."""
    length = st.integers(-70, 70).map(lambda n: n / 20)
    translation = st.tuples(length, length, st.just(0)).filter(lambda way: max(map(abs, way)) > 0.1)
    turn = st.tuples(st.just(0.0), st.just(0.0), st.integers(-12, 12).filter(bool))
    found = draw(st.lists(translation | turn, min_size=1, max_size=4))
    return tuple(Move(f"further-{number}", *way) for number, way in enumerate(found))


rooms = st.builds(make_room, tables(), st.integers(0, 9), st.sampled_from(["strafing", "differential"]), st.booleans())


@pytest.mark.nightly
@PATIENT
@given(rooms, st.integers(0, 2**32 - 1))
def test_no_walk_is_shorter_than_the_bound_of_where_it_leads_nor_proven_impossible(room, seed):
    rules, rng = Kinematics(room, is_still=True), np.random.default_rng(seed)
    bounds, opened = LegBounds(room), make_collision(room, door_shut=False)
    for _ in range(40):
        states = [begin(room)]
        for action in rng.choice(rules.actions.base, size=12).tolist():
            states.append(rules.step(states[-1], action).state)
        for count, state in enumerate(states):
            goal = PoseGoal(state.x, state.y, tolerance=1e-6)
            assert bounds.bound_goals(states[0], [goal]) <= count
            assert opened.find_proof(states[0].x, states[0].y, *bounds.get_area(goal)) is None
        for target in range(len(room.targets)):
            found = [count for count, (before, after) in enumerate(zip(states, states[1:], strict=False), 1)
                     if is_reached(PressGoal(target), before, after, rules)]
            assert not found or bounds.bound_goals(states[0], [PressGoal(target)]) <= found[0]


@pytest.mark.nightly
@settings(PATIENT, max_examples=3)
@given(rooms)
def test_plans_are_true_escapes_of_certified_rooms_and_none_is_below_its_bound(room):
    assert find_unmet_constraint(room) is None
    planner, state = RoomPlanner(room), begin(room)
    plan = planner.solve(state)
    assert planner.rules.has_escaped(plan.states[-1]) and bound_escape(room, state) <= plan.cost
    assert_legs_cost_at_least_their_bounds(plan, room)
    answer = planner.answer(PlanningRequest(state, goal=(PressGoal(1), PressGoal(0))))
    assert answer.plan is not None and answer.lower_bound <= answer.plan.cost


@pytest.mark.nightly
@PATIENT
@given(rooms)
def test_options_press_and_leave(room):
    with contextlib.closing(OptionsEnv(EscapeRoomEnv(instance=room))) as env:
        env.reset(seed=0)
        outcomes = [env.step(option) for option in list_options(room)]
    assert outcomes[-1][2]


@pytest.mark.nightly
@settings(PATIENT, max_examples=3)
@given(rooms)
def test_batched_options_press_and_leave(room):
    env = BatchedOptionsEnv(1, instance=room)
    env.reset(torch.tensor([0]))
    for option in list_options(room):
        for _ in range(200):
            done = env.step(torch.full((1,), option))
            if done.where[0]:
                break
        assert done.where[0], "the option goes on for ever"
    assert done.terminated[0]


@pytest.mark.nightly
@PATIENT
@given(rooms, st.sampled_from(["stay", "lateral", "lateral-if-free", "any", "neighbour"]))
def test_the_engines_agree(room, slips):
    if slips.startswith("lateral") and room.robot.drive == "differential":
        slips = "stay"
    for each in (room, dataclasses.replace(room, dynamics=DynamicsConfig(noise=0.1, slip=0.2, slip_kind=slips))):
        found = compare([each], 200, copies=10)
        assert not found.disagreements, found.disagreements[0]
        assert found.worst < 1e-9


@pytest.mark.parametrize("move", [LEAP, Move("slant", forward=0.7, left=-1.1), Move("about", turn=12)])
def test_bullet_moves_as_far_as_the_table_says(move):
    room = make_room((move,))
    engine, rules = BulletRoom(room), Kinematics(room)
    state = rules.make_state(dataclasses.replace(room.starts[0], x=0.0, y=0.0))
    engine.set_state(state)
    after = engine.step(rules.actions.find(move.name)).state
    assert after == rules.step(state, rules.actions.find(move.name)).state
    assert np.hypot(after.x, after.y) == pytest.approx(np.hypot(move.forward, move.left))
    assert after.heading_steps == (state.heading_steps + move.turn) % rules.headings
    engine.close()


def test_a_leap_of_two_metres_halves_a_plan_that_was_proven_to_need_twice_as_many():
    plain, leaping = make_room(()), make_room((LEAP,))
    assert leaping.robot.actions.names == ("forward", "back", "strafe-left", "strafe-right", "leap", "turn-left",
                                           "turn-right")
    rules = Kinematics(leaping)
    state = rules.make_state(dataclasses.replace(leaping.starts[0], x=-2.0, y=0.0, heading_steps=0))
    goal = PoseGoal(2.0, 0.0, tolerance=0.05)
    answers = [RoomPlanner(room).answer(PlanningRequest(state, goal=goal)) for room in (plain, leaping)]
    assert [answer.plan.cost for answer in answers if answer.plan] == [4, 2]
    assert [answer.lower_bound for answer in answers] == [4, 2]
    area, reach = LegBounds(leaping).get_area(goal)
    assert find_fewest_primitives(rules, state, goal, area, reach) == (rules.actions.find("leap"),) * 2


def test_a_turn_of_the_table_replaces_many_turn_steps():
    room = make_room((Move("about", turn=12),), drive="differential")
    rules = Kinematics(room)
    state = rules.make_state(dataclasses.replace(room.starts[0], x=0.0, y=0.0, heading_steps=0))
    goal = PoseGoal(0.0, 0.0, np.pi, 0.05, 0.05)
    plan = RoomPlanner(room).plan(state, goal)
    assert plan.primitives == (rules.actions.find("about"),)


def test_lateral_slips_go_at_right_angles_and_only_there():
    actions = make_action_table(0, moves=(Move("slant", forward=1.0, left=1.0), Move("back-slant", -2.0, 2.0), LEAP))
    names = [{actions.names[to] for to in list_slips("lateral", actions, action)} for action in actions.translations]
    assert names == [{"strafe-left", "strafe-right"}, {"strafe-left", "strafe-right"}, {"forward", "back", "leap"},
                     {"forward", "back", "leap"}, {"back-slant"}, {"slant"}, {"strafe-left", "strafe-right"}]


@pytest.mark.parametrize(("moves", "symmetry"), [
    ((), 4), ((LEAP,), 1), ((LEAP, Move("leap-back", -2.0)), 2),
    (tuple(Move(f"leap-{n}", 2.0 * x, 2.0 * y) for n, (x, y) in enumerate([(1, 0), (0, 1), (-1, 0), (0, -1)])), 4),
    ((Move("about", turn=9),), 4),
])
def test_headings_are_alike_only_where_the_moves_are(moves, symmetry):
    assert make_action_table(0, moves=moves).symmetry == symmetry


@pytest.mark.parametrize(("make", "words"), [
    (lambda: Move("both", forward=1.0, turn=1), "either a displacement or a turn"),
    (lambda: Move("none"), "either a displacement or a turn"),
    (lambda: Move("", forward=1.0), "a name"),
    (lambda: RobotConfig(moves=(Move("forward", forward=2.0),)), "no other primitive"),
    (lambda: RobotConfig(turn_step_deg=90, moves=(Move("spin", turn=3),)), "at most 2 turn steps"),
    (lambda: generate(dataclasses.replace(
        get_preset("sokoban"), robot=dataclasses.replace(get_preset("sokoban").robot, moves=(LEAP,))), 0),
     "none where things are pushed"),
])
def test_impossible_moves_are_refused(make, words):
    with pytest.raises(ConfigError, match=words):
        make()


def test_rooms_without_further_moves_keep_their_ids_and_others_write_theirs():
    assert "moves" not in RobotConfig().to_dict()
    robot = RobotConfig(moves=(LEAP,))
    assert RobotConfig.from_dict(robot.to_dict()) == robot
