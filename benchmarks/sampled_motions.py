"""Trajectories by OMPL and Pinocchio against trajectories of plans, from the same states to the same goals.

Run: `python -m benchmarks.sampled_motions --rooms 4`; exits with 1 if a trajectory is wrong. Every leg of every escape
is asked for. What was found is checked as in `benchmarks/trajectories.py`, by touches at 1 kHz, limits and gaps to
solids, and driven in the continuous environment. Things to grip or push are held against the goal and against all else
that the puzzle keeps.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.trajectories import SLACK, change_robot, list_configs, list_touches, measure_peaks, solve
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.presets import (
    blocks_world,
    door_key,
    foraging,
    get_preset,
    key_corridor,
    multi_room,
    sokoban,
    taxi,
)
from hrl_escape.env.puzzles.mixins import Mapped
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EscapeError, GenerationError
from hrl_escape.planning.goals import Goal, GripGoal, PressGoal, is_reached
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.sampled import MotionSampler
from hrl_escape.planning.motion.trajectory import TimedTrajectory, make_trajectory, track
from hrl_escape.planning.planner import RoomPlanner

DRIVING = {f"{name}, driving rectangle": name for name in ("paper-two-button", "clutter", "ten-button", "paper-random")}
"""Presets of room configurations whose robot is a rectangle with a differential drive."""
CARRYING = {"taxi": taxi, "foraging": foraging, "blocks-world": blocks_world,
            "blocks-world, hand": lambda: blocks_world(hand=True), "door-key": door_key, "key-corridor": key_corridor,
            "multi-room": multi_room, "sokoban": sokoban}
"""Room configurations of things to grip, use and push."""
NAMES = ("paper-two-button", "clutter", "ten-button", "inner-doors", "four-rooms", "arm-two-button", "arm-four-joints",
         "clutter, differential", "clutter, rectangle", *DRIVING, *CARRYING)


class Leg(NamedTuple):
    """One goal from one state: seconds of both motions, nan where none was found, CPU seconds of both, and faults."""

    sampled: float
    planned: float
    sampled_cpu: float
    planned_cpu: float
    faults: tuple[str, ...]


def make_gripping_config(name: str) -> RoomConfig:
    """A room configuration by its name."""
    if name in CARRYING:
        return CARRYING[name]()
    if name not in DRIVING:
        return list_configs()[name]
    return change_robot(get_preset(DRIVING[name]), footprint="rectangle", body_length=1.0, body_width=0.6,
                        drive="differential")


def list_faults(rules: Kinematics, state: RoomState, goal: Goal, trajectory: TimedTrajectory) -> list[str]:
    """Find what is wrong with a trajectory to a goal."""
    _, places, _ = trajectory.sample(1000.0)
    found, wanted = list_touches(rules, state.touching, places), [goal.target] if isinstance(goal, PressGoal) else []
    on_map, carries = isinstance(rules.instance.puzzle, Mapped), isinstance(goal, GripGoal)  # a map's pads are floor
    faults = [f"presses {found} for {wanted}"] if found != wanted and not carries and not on_map else []
    if (peak := max(measure_peaks(trajectory, trajectory.limits).values())) > 1.0 + SLACK:
        faults.append(f"reaches {peak:.4f} of a limit")
    base, shapes = rules.instance.robot.base, rules.footprints
    if any(base.measure_gap(x, y, (math.cos(heading), math.sin(heading)), shapes) <= 0.0
           for x, y, heading in places[::20, :3].tolist()):
        faults.append("meets a solid")
    env = EscapeRoomContinuousEnv(instance=rules.instance)
    env.reset(options={"state": state})
    driven = track(trajectory, env)
    changes = sum(before.puzzle != after.puzzle for before, after in itertools.pairwise(driven.states))
    if carries and (changes != 1 or not is_reached(goal, state, driven.states[-1], rules) or driven.distance > 1e-6):
        faults.append(f"changes the puzzle {changes} times and is {driven.distance:.2g} m off when driven")
    elif not carries and ((list(driven.pressed) != wanted and not on_map) or driven.distance > 1e-6):
        faults.append(f"presses {driven.pressed} and is {driven.distance:.2g} m off when driven")
    return faults


def measure(name: str, seed: int) -> list[Leg]:
    """Measure the legs of one room's escape."""
    plan, limits = solve(generate(make_gripping_config(name), seed)), MotionLimits()
    planner, rules = RoomPlanner(plan.instance), Kinematics(plan.instance)
    sampler, legs = MotionSampler(plan.instance, limits), []
    for part in plan.parts:
        state = plan.states[part.start]
        sampled, sampled_cpu = clock(lambda s=state, g=part.goal: sampler.plan(s, g))
        planned, planned_cpu = clock(lambda s=state, g=part.goal: make_trajectory(planner.plan(s, g), limits))
        faults = list_faults(rules, state, part.goal, sampled) if sampled else []
        legs.append(Leg(sampled.duration if sampled else math.nan, planned.duration if planned else math.nan,
                        sampled_cpu, planned_cpu, tuple(faults)))
    return legs


def measure_rooms(name: str, rooms: int) -> Iterator[Leg]:
    """Measure the legs of the first rooms that can be made."""
    seeds = itertools.count()
    while rooms:
        try:
            legs = measure(name, next(seeds))
        except GenerationError:
            continue
        rooms -= 1
        yield from legs


def clock(make: Callable[[], TimedTrajectory]) -> tuple[TimedTrajectory | None, float]:
    """A trajectory, None where none was found, and the CPU seconds of the call."""
    began = time.process_time()
    try:
        found = make()
    except EscapeError:
        found = None
    return found, time.process_time() - began


def main() -> None:
    """Print a row a room configuration."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rooms", type=int, default=4)
    parser.add_argument("--names", nargs="*", default=NAMES)
    chosen, wrong = parser.parse_args(), 0
    print(f"{'':35s} found  of  planned  seconds of motion  CPU ms sampled  planned")
    for name in chosen.names:
        legs = list(measure_rooms(name, chosen.rooms))
        both = np.array([leg[:4] for leg in legs if not math.isnan(leg.sampled + leg.planned)])
        ratio = np.exp(np.mean(np.log(both[:, 0] / both[:, 1]))) if len(both) else math.nan
        sampled, planned = 1000 * np.median(np.array([leg[2:4] for leg in legs]), axis=0)
        print(f"{name:35s} {sum(not math.isnan(leg.sampled) for leg in legs):5d} {len(legs):3d} "
              f"{sum(not math.isnan(leg.planned) for leg in legs):8d} {ratio:18.3f} {sampled:15.0f} {planned:8.0f}",
              flush=True)
        for leg in legs:
            wrong += bool(leg.faults)
            if leg.faults:
                print("   ", "; ".join(leg.faults))
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
