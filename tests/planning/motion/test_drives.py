"""Ways of a rectangle that drives and turns on the spot: what they meet, by points of its outline, and their limits."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import pytest

from benchmarks.sampled_motions import make_gripping_config
from hrl_escape.env.config import CONTACT_SKIN
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.geometry import Footprint, Solid, compute_distance_many, stack_footprints
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.sampling.generation import generate
from hrl_escape.floor.clearance import CollisionMap
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.goals import PoseGoal, PressGoal
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.sampled import MotionSampler
from hrl_escape.planning.motion.trajectory import TimedTrajectory, track
from hrl_escape.planning.planner import RoomPlanner

LIMITS = MotionLimits(speed=0.8, turn_speed=1.2)
ROOMS = [("paper-two-button", 0), ("clutter", 0), ("clutter", 3), ("paper-random", 3)]


def make(name: str, seed: int) -> RoomInstance:
    return generate(make_gripping_config(f"{name}, driving rectangle"), seed)


def measure_gaps(places: np.ndarray, size: tuple[float, ...], shapes: Sequence[Footprint]) -> np.ndarray:
    """Distances (n, shapes) of a rectangle at places (n, 3) from shapes, 0 where they meet, by points of its outline.

    The points are 1 cm apart; a shape's corner within the rectangle counts, too.
    """
    shares = np.linspace(-1.0, 1.0, 101)[:, None]
    sides = np.concatenate([shares * (1, 0) + (0, 1), shares * (1, 0) - (0, 1), shares * (0, 1) + (1, 0),
                            shares * (0, 1) - (1, 0)]) * size
    gaps = np.empty((len(places), len(shapes)))
    for row, (x, y, heading) in enumerate(places[:, :3].tolist()):
        turn = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
        for column, shape in enumerate(shapes):
            if math.hypot(shape.x - x, shape.y - y) > 1.0 + math.hypot(shape.half_x, shape.half_y):
                gaps[row, column] = 1.0 - math.hypot(*size)
                continue
            own = np.array([[shape.cos, shape.sin], [-shape.sin, shape.cos]])
            corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (shape.half_x, shape.half_y) @ own
            held = (np.abs((corners + (shape.x - x, shape.y - y)) @ turn.T) <= size).all(axis=1).any()
            points = sides @ turn + (x, y)
            gaps[row, column] = 0.0 if held and not shape.is_disc else compute_distance_many(
                points, stack_footprints([shape])).min()
    return gaps


def list_presses(room: RoomInstance, trajectory: TimedTrajectory, before: int) -> list[int]:
    """Targets whose touch begins."""
    gaps = measure_gaps(trajectory.sample(50.0)[1], room.robot.base.size, [t.footprint for t in room.targets])
    near = np.concatenate([[[bool(before >> k & 1) for k in range(len(room.targets))]], gaps <= 0.02])
    return [int(target) for _, target in np.argwhere(near[1:] & ~near[:-1])]


def drive_round(room: RoomInstance) -> list[tuple[TimedTrajectory, int, int]]:
    """Trajectories to each target twice, each from where the one before has ended, with the touches at its start."""
    sampler, env, found = MotionSampler(room, LIMITS), EscapeRoomContinuousEnv(instance=room), []
    env.reset(seed=0)
    for target in np.repeat(np.arange(len(room.targets)), 2).tolist():
        state = env.get_state()
        trajectory = sampler.plan(state, PressGoal(target))
        found.append((trajectory, target, state.touching))
        assert track(trajectory, env).pressed == (target,)
    return found


@pytest.mark.nightly_for("paper-two-button-0", "clutter-0", "clutter-3", "paper-random-3")
@pytest.mark.parametrize(("name", "seed"), ROOMS)
def test_every_way_presses_its_target_alone_sweeps_no_solid_and_never_goes_sideways(name, seed):
    room = make(name, seed)
    for trajectory, target, touching in drive_round(room):
        times, places, rates = trajectory.sample(50.0)
        shapes = [solid.footprint for solid in room.all_solids]
        assert measure_gaps(places, room.robot.base.size, shapes).min() > 0.9 * CONTACT_SKIN
        assert list_presses(room, trajectory, touching) == [target] == [c.target for c in trajectory.contacts]
        cos, sin = np.cos(places[:, 2]), np.sin(places[:, 2])
        assert np.abs(cos * rates[:, 1] - sin * rates[:, 0]).max() < 1e-9
        strength = trajectory.evaluate(times, 2)
        assert np.hypot(*rates[:, :2].T).max() <= 0.8 + 1e-6 and np.abs(rates[:, 2]).max() <= 1.2 + 1e-6
        assert np.hypot(*strength[:, :2].T).max() <= 1.0 + 1e-6 and np.abs(strength[:, 2]).max() <= 3.0 + 1e-6


@pytest.mark.nightly
def test_one_seed_gives_one_way_and_another_seed_another():
    room = make("clutter", 0)
    state = RoomPlanner(room).rules.make_state(room.starts[0])
    one, same, other = (MotionSampler(room, LIMITS, seed=seed).plan(state, PressGoal(1)) for seed in (0, 0, 1))
    assert (one.positions == same.positions).all() and (one.times == same.times).all()
    assert one.positions.shape != other.positions.shape or (one.positions != other.positions).any()


def make_passage(length: float, width: float) -> tuple[RoomInstance, MotionSampler]:
    """The paper's room in halves that one straight passage connects, too narrow to turn in."""
    room = make("paper-two-button", 0)
    walls = tuple(Solid(x=0.0, y=sign * (5.0 + width / 4.0), half_x=length / 2.0, half_y=5.0 - width / 4.0)
                  for sign in (1.0, -1.0))
    assert 2.0 * room.robot.outer_radius > width > room.robot.body_width
    room = dataclasses.replace(room, solids=(*room.solids, *walls))
    return room, MotionSampler(room, LIMITS)


@pytest.mark.nightly
def test_a_passage_too_narrow_to_turn_in_is_driven_straight_through():
    room, sampler = make_passage(0.6, 0.9)
    state = RoomPlanner(room).rules.make_state(room.starts[0])._replace(x=-6.0, y=3.0, heading_steps=0, touching=0)
    places = sampler.plan(state, PoseGoal(6.0, -3.0, tolerance=0.2)).sample(200.0)[1]
    within = np.abs(places[:, 0]) < 0.3
    assert within.any() and np.ptp(places[within, 2]) < 1e-9
    assert math.hypot(*(places[-1, :2] - (6.0, -3.0))) <= 0.2


def test_it_backs_out_of_a_passage_where_it_cannot_turn():
    room, sampler = make_passage(4.0, 0.8)
    state = RoomPlanner(room).rules.make_state(room.starts[0])._replace(x=1.0, y=0.0, heading_steps=18, touching=0)
    places = sampler.plan(state, PoseGoal(6.0, 0.0, tolerance=0.2)).sample(200.0)[1]
    assert np.ptp(places[places[:, 0] < 2.0, 2]) < 1e-9 and places[-1, 0] >= 5.8


@pytest.mark.nightly
def test_a_turn_is_free_where_the_base_meets_nothing_at_any_angle_of_it():
    collision, rng, seen = CollisionMap(make("clutter", 1), door_shut=True), np.random.default_rng(0), []
    while len(seen) < 100:
        x, y, heading, turn = rng.uniform((-9.0, -9.0, -3.0, -1.0), (9.0, 9.0, 3.0, 1.0))
        if not collision.does_fit(x, y, (math.cos(heading), math.sin(heading))) or collision.is_clear(x, y, 0.58):
            continue
        places = np.column_stack([np.tile((x, y), (60, 1)), heading + turn * np.linspace(0.0, 1.0, 60)])
        gap = measure_gaps(places, collision.base.size, collision.footprints).min()
        seen.append(collision.is_turn_free(x, y, heading, turn))
        assert gap > 0.0 if seen[-1] else gap < 0.01
    assert 10 < sum(seen) < 90


@pytest.mark.nightly
def test_options_of_a_rectangle_that_drives_escape():
    env = OptionsEnv(EscapeRoomContinuousEnv(instance=make("paper-two-button", 0)))
    _, info = env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(40):
        choice = int(rng.choice(np.flatnonzero(info["action_mask"])))
        _, _, terminated, _, info = env.step(choice)
        assert info["option"]["ended"] == "reached" and not info["also_pressed"].any()
        if terminated:
            break
    assert terminated and info["is_success"]
