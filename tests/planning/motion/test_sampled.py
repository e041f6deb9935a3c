"""Motions by OMPL and Pinocchio: what they press, checked by what made no part of them, and options over them."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from benchmarks.sampled_motions import make_gripping_config, measure
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.geometry import compute_distance, make_footprint
from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.env.presets import blocks_world, get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import PlanningFailed, UnknownNameError
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.goals import ExitGoal, GripGoal, PressGoal, is_reached
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.sampled import MotionSampler
from hrl_escape.planning.motion.trajectory import track
from hrl_escape.planning.planner import RoomPlanner

WEDGED = (9.499, 9.52)
"""Place in a corner of the paper's room out of which a rectangle of 1.0 x 0.6 m that drives has to turn by and by."""
LIMITS = MotionLimits(speed=0.8, turn_speed=1.2, joint_speed=0.8)


def make(config, seed: int = 0, **settings):
    planner = RoomPlanner(generate(config, seed))
    state = planner.rules.make_state(planner.instance.starts[0])
    return planner, MotionSampler(planner.instance, LIMITS, **settings), state


@pytest.mark.nightly_for("paper-two-button", "ten-button, driving rectangle")
@pytest.mark.parametrize("name", ["paper-two-button", "ten-button, driving rectangle", *(
    pytest.param(name, marks=pytest.mark.slow)
    for name in ("inner-doors", "clutter", "arm-two-button", "arm-four-joints", "clutter, differential",
                 "clutter, rectangle", "clutter, driving rectangle"))])
def test_every_leg_of_an_escape_presses_its_target_alone_and_keeps_all_limits(name):
    legs = measure(name, 0)
    assert all(not leg.faults and not math.isnan(leg.sampled) for leg in legs)
    assert len(legs) > 1 and sum(leg.sampled for leg in legs) < 1.3 * sum(leg.planned for leg in legs)


def test_the_way_of_a_disc_is_nearly_as_short_as_it_can_be():
    planner, sampler, state = make(get_preset("paper-two-button"))
    button = planner.instance.targets[0]
    trajectory = sampler.plan(state, PressGoal(0))
    length = np.hypot(*np.diff(trajectory.sample(100.0)[1][:, :2], axis=0).T).sum()
    straight = compute_distance(state.x, state.y, button.footprint) - planner.instance.robot.body_radius
    assert straight <= length + 0.1 and length < 1.05 * straight + 0.2


def test_one_seed_gives_one_motion_and_the_planner_of_the_way_can_be_chosen():
    config = get_preset("clutter")
    first, again, other = (make(config, **settings)[1] for settings in ({}, {}, {"way_planner": "RRTConnect"}))
    state = make(config)[2]
    found = [sampler.plan(state, PressGoal(1)) for sampler in (first, again, other)]
    assert (found[0].positions == found[1].positions).all() and found[0].duration <= found[2].duration
    named = make(config)[1].plan(state, "press-button-2")
    assert (named.positions == found[0].positions).all()
    with pytest.raises(UnknownNameError, match="button-44"):
        make(config)[1].plan(state, "press-button-44")


@pytest.mark.nightly
def test_a_sampled_motion_is_tracked_to_the_press():
    planner, sampler, state = make(get_preset("arm-two-button"))
    env = EscapeRoomContinuousEnv(instance=planner.instance)
    env.reset(options={"state": state})
    tracking = track(sampler.plan(state, PressGoal(1)), env)
    assert tracking.pressed == (1,) and tracking.distance < 1e-6


@pytest.mark.nightly_for("blocks-world-0", "key-corridor-2", "sokoban-3")
@pytest.mark.parametrize(("config", "seed"), [
    (get_preset("taxi"), 0), (blocks_world(hand=True), 0), (get_preset("key-corridor"), 2), (get_preset("sokoban"), 3),
    *(pytest.param(config, seed, marks=pytest.mark.slow) for seed in range(4, 10)
      for config in (get_preset("taxi"), blocks_world(), blocks_world(hand=True), get_preset("door-key"),
                     get_preset("multi-room"), get_preset("key-corridor"), get_preset("sokoban")))],
    ids=lambda value: getattr(value, "name", value))
def test_sampled_motions_carry_and_push_until_the_robot_is_out(config, seed):
    planner, sampler, state = make(config, seed)
    env = EscapeRoomContinuousEnv(instance=planner.instance, time_limit=1e4)
    env.reset(options={"state": state})
    for part in planner.solve(state).parts:
        before, trajectory = env.get_state(), sampler.plan(env.get_state(), part.goal)
        tracking = track(trajectory, env)
        acts = isinstance(part.goal, GripGoal) and not part.goal.action.startswith("push-")
        assert [grip.action for grip in trajectory.grips] == ([part.goal.action] if acts else [])
        changes = sum(a.puzzle != b.puzzle for a, b in itertools.pairwise(tracking.states))
        assert is_reached(part.goal, before, env.get_state(), planner.rules)
        assert changes == isinstance(part.goal, GripGoal), "nothing else is gripped or pushed"
        assert tracking.distance < 1e-6
        if tracking.end.is_over:  # the last place may be within the exit
            break
    assert tracking.end is EpisodeEnd.ESCAPED


def test_a_hand_that_touches_already_grips_where_it_is_and_leaves_other_places_alone():
    planner, sampler, state = make(get_preset("blocks-world"), 1)
    goal = planner.solve(state).parts[0].goal
    there = planner.plan(state, PressGoal(goal.target)).states[-1]
    trajectory = sampler.plan(there, goal)
    assert np.ptp(trajectory.positions, axis=0).max() == 0.0 and [grip.time for grip in trajectory.grips] == [0.0]
    assert [contact.target for contact in sampler.plan(state, goal).contacts] == [goal.target]
    env = EscapeRoomContinuousEnv(instance=planner.instance)
    env.reset(options={"state": there})
    track(trajectory, env)
    with pytest.raises(PlanningFailed, match="grip"):  # the hand is full
        sampler.plan(env.get_state(), goal)


def test_what_no_way_leads_to_is_a_failure_by_name():
    planner, sampler, state = make(get_preset("clutter"))
    with pytest.raises(PlanningFailed, match="exit"):  # its door is shut
        sampler.plan(state, ExitGoal())
    _, sampler, state = make(make_gripping_config("paper-two-button, driving rectangle"))
    wedged = state._replace(x=WEDGED[0], y=WEDGED[1], heading_steps=0)
    with pytest.raises(PlanningFailed, match="InformedRRTstar"):
        sampler.plan(wedged, PressGoal(0))


@pytest.mark.nightly
@pytest.mark.filterwarnings("error")
def test_a_target_that_is_touched_is_left_and_pressed_again_or_refused():
    planner, sampler, state = make(get_preset("arm-two-button"))
    there = planner.plan(state, PressGoal(0)).states[-1]
    env = EscapeRoomContinuousEnv(instance=planner.instance)
    env.reset(options={"state": there})
    assert there.touching == 1 and track(sampler.plan(there, PressGoal(0)), env).pressed == (0,)
    config = get_preset("paper-two-button")
    small = dataclasses.replace(config, room=dataclasses.replace(config.room, width=12.0, depth=12.0))
    _, sampler, state = make(small)
    close = state._replace(x=3.510349560994655, y=4.796535361150745, heading_steps=0, puzzle=1, touching=1)
    with pytest.raises(PlanningFailed, match="button-1"):  # the nearest place of the goal is where it stands
        sampler.plan(close, PressGoal(0))


@pytest.mark.nightly
def test_options_take_the_plan_of_primitives_where_nothing_is_sampled_or_where_they_are_told_to():
    rectangle, seconds = generate(make_gripping_config("paper-two-button, driving rectangle"), 0), {}
    start = RoomPlanner(rectangle).rules.make_state(rectangle.starts[0])
    wedged = start._replace(x=WEDGED[0], y=WEDGED[1], heading_steps=0)
    for name, room, state in (("wedged", rectangle, wedged), ("rectangle", rectangle, start),
                              ("disc", generate(get_preset("clutter"), 0), None)):
        for planner in ("auto", "fields"):
            env = OptionsEnv(EscapeRoomContinuousEnv(instance=room), planner=planner)
            env.reset(seed=0, options=state and {"state": state})
            _, _, _, _, info = env.step(1)
            assert info["option"]["ended"] == "reached" and np.flatnonzero(info["pressed"]).tolist() == [1]
            seconds[name, planner] = info["duration"]
    assert seconds["wedged", "auto"] == seconds["wedged", "fields"]
    for name in ("rectangle", "disc"):
        assert seconds[name, "auto"] != seconds[name, "fields"]


def test_a_map_keeps_out_of_more_footprints():
    room = generate(get_preset("clutter"), 0)
    plain, shape = CollisionMap(room, door_shut=True), make_footprint(1.0, 2.0, 1.5, 0.4, 0.3)
    more = plain.keep_out([shape])
    places = np.random.default_rng(0).uniform(-6.0, 6.0, (4_000, 2))
    away = np.array([compute_distance(x, y, shape) for x, y in places.tolist()])
    assert (more.are_free(places) == (plain.are_free(places) & (away >= plain.radius - 1e-9))).all()
    assert 20 < (more.are_free(places) != plain.are_free(places)).sum()


@pytest.mark.nightly
def test_a_motion_that_presses_another_target_too_is_not_taken():
    room = generate(get_preset("arm-two-button"), 0)
    first, second = room.targets
    there = dataclasses.replace(second, x=first.x, y=first.y, z=first.z, yaw=first.yaw)  # both in one place
    planner = RoomPlanner(dataclasses.replace(room, targets=(first, there)))
    with pytest.raises(PlanningFailed):
        MotionSampler(planner.instance, LIMITS).plan(planner.rules.make_state(room.starts[0]), PressGoal(0))
