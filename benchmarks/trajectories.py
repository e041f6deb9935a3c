"""Trajectories of escapes over puzzles, bodies and hands: what each presses, and whether it keeps every limit.

Run: `python benchmarks/trajectories.py --count 1000`; exits with 1 if a trajectory that was made is wrong. Each is
checked independently: rising edges of touch at 1 kHz against the plan, limits at 1 kHz and by the polynomials between
knots, gaps of the base to all solids. A plan without a trajectory is counted by its message.

With `--physics 10` options drive trajectories in Bullet's physics instead, in ten rooms of each of `DRIVEN`, in the
order of an escape; exits with 1 if fewer than 99 % of them end as planned: their own target pressed and no other.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math
import sys
from collections import Counter
from collections.abc import Iterator
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from hrl_escape.env.config import RobotConfig, RoomConfig
from hrl_escape.env.continuous import EscapeRoomContinuousEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EscapeError, GenerationError, UnsupportedError
from hrl_escape.options.meta_actions import list_goals
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.goals import ExitGoal, PressGoal
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.trajectory import TimedTrajectory, Tracker, make_trajectory
from hrl_escape.planning.plan import Plan
from hrl_escape.planning.planner import RoomPlanner, get_planner

PRESETS = ("paper-two-button", "paper-random", "clutter", "ten-button", "twenty-button", "inner-doors", "bit-flip",
           "lights-out", "hanoi", "code-lock", "light-box", "factored", "potions", "recipes", "deep-sea", "four-rooms",
           "puddle-world", "key-chest", "pin-pad", "arm-two-button")
DRIVEN = ("paper-two-button", "paper-random", "clutter", "clutter, rectangle", "clutter, differential",
          "arm-two-button", "arm-four-joints")
"""Room configurations whose rooms are driven in physics."""
MOST_FAILURES = 5
"""Options in a row that may fail before a room is given up."""
SLACK = 1e-6
"""Share of a limit that rounding can exceed."""
CLOCK_ROUNDING = 1e-12
"""Error of a time at a knot, which is a sum, s."""


def list_configs() -> dict[str, RoomConfig]:
    """Room configurations by name: the presets that neither grip nor push, and further bodies and hands."""
    found = {name: get_preset(name) for name in PRESETS}
    found["arm-four-joints"] = change_robot(found["arm-two-button"], joints=4)
    for name in ("clutter", "lights-out", "potions"):
        found[f"{name}, differential"] = change_robot(found[name], drive="differential")
    found["clutter, rectangle"] = change_robot(found["clutter"], footprint="rectangle", body_length=1.0, body_width=0.6)
    return found


def change_robot(config: RoomConfig, **changes: object) -> RoomConfig:
    """A room configuration with other settings of its robot."""
    robot: RobotConfig = dataclasses.replace(config.robot, **changes)  # type: ignore[arg-type]
    return dataclasses.replace(config, robot=robot)


def solve(instance: RoomInstance) -> Plan:
    """The escape of a room."""
    planner = RoomPlanner(instance)
    return planner.solve(planner.rules.make_state(instance.starts[0]))


def list_faults(plan: Plan, trajectory: TimedTrajectory, limits: MotionLimits) -> list[str]:
    """Find what is wrong with a trajectory of a plan."""
    faults, rules = [], Kinematics(plan.instance)
    times, places, _ = trajectory.sample(1000.0)
    wanted, found = list_presses(plan), list_touches(rules, plan.states[0].touching, places)
    ends = list(itertools.accumulate((len(group) for group in wanted), initial=0))
    if len(found) != ends[-1] or any(set(found[a:b]) != set(group)
                                     for a, b, group in zip(ends, ends[1:], wanted, strict=False)):
        faults.append(f"presses {found} for {wanted}")
    stated = [sorted(contact.target for contact in group)  # those at one time have no order
              for _, group in itertools.groupby(trajectory.contacts, lambda contact: contact.time)]
    ends = list(itertools.accumulate(map(len, stated), initial=0))
    if len(found) != ends[-1] or any(sorted(found[a:b]) != group
                                     for a, b, group in zip(ends, ends[1:], stated, strict=False)):
        faults.append(f"states contacts {trajectory.contacts} for {found}")
    if (peak := max(measure_peaks(trajectory, limits).values())) > 1.0 + SLACK:
        faults.append(f"reaches {peak:.4f} of a limit")
    base = plan.instance.robot.base
    shapes = rules.footprints
    for x, y, heading in places[::20, :3].tolist():
        if base.measure_gap(x, y, (math.cos(heading), math.sin(heading)), shapes) <= 0.0:
            faults.append(f"meets a solid at ({x:.3f}, {y:.3f})")
            break
    away = np.hypot(*(places[-1, :2] - plan.path[-1]))
    if away > 1e-9:
        faults.append(f"ends {away:.2g} m from the plan's end")
    return faults


def list_presses(plan: Plan) -> list[tuple[int, ...]]:
    """Targets whose touch begins, primitive by primitive."""
    begun = (b.touching & ~a.touching for a, b in itertools.pairwise(plan.states))
    return [tuple(k for k in range(bits.bit_length()) if bits >> k & 1) for bits in begun if bits]


def list_touches(rules: Kinematics, before: int, places: NDArray[np.float64]) -> list[int]:
    """Targets whose touch begins along places (n, coordinates), in order; targets of the bits `before` are touched."""
    found, home = [], np.array(rules.robot.home)
    still = (0,) * len(home)
    for x, y, heading, *angles in places.tolist():
        now = rules.compute_touching(x, y, 0, heading, still, tuple((np.array(angles) - home).tolist()))
        found += [k for k in range(now.bit_length()) if (now & ~before) >> k & 1]
        before = now
    return found


def measure_peaks(trajectory: TimedTrajectory, limits: MotionLimits) -> dict[str, float]:
    """Largest share of its limit that any coordinate's speed, acceleration and jerk reaches, the base's in the plane.

    Speeds and accelerations are sampled at 1 kHz, and computed from the polynomials between knots: jerk is constant
    there, acceleration greatest at an end, and speed where its derivative is 0 or at an end.
    """
    rates = limits.stack(trajectory.names)
    times = trajectory.sample(1000.0)[0]
    spans = np.diff(trajectory.times)
    starts = trajectory.times[:-1]
    spline = CubicHermiteSpline(trajectory.times, trajectory.positions, trajectory.velocities)
    cubic, square, linear = spline.c[:3]  # (intervals, coordinates) each
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = -((square * linear)[:, :2].sum(axis=1)) / np.maximum(2.0 * (square**2)[:, :2].sum(axis=1), 1e-300)
        tops = np.column_stack([-square / (3.0 * cubic), plane])
    tops = np.clip(np.nan_to_num(tops), 0.0, spans[:, None])
    moments = np.concatenate([times, *(starts + top for top in tops.T), starts + spans])
    rounding = 12.0 * rates[:, 0] * CLOCK_ROUNDING / spans[:, None] ** 3  # of a third derivative
    jerk = np.maximum(np.abs(6.0 * cubic) - rounding, 0.0)
    found = {"speed": trajectory.evaluate(moments, 1), "acceleration": trajectory.evaluate(moments, 2), "jerk": jerk}
    is_base = trajectory.names[:2] == ("x", "y")
    peaks = {}
    for column, (kind, values) in enumerate(found.items()):
        sizes = np.abs(values)
        if is_base:
            sizes[:, :2] = np.hypot(values[:, 0], values[:, 1])[:, None]
        peaks[kind] = float((sizes / rates[:, column]).max(initial=0.0))
    return peaks


def check(count: int, first: int = 0) -> Iterator[tuple[str, int, list[str]]]:
    """Check one trajectory after another: configuration, seed, and faults (refusals begin with `refused`)."""
    configs, limits = list_configs(), MotionLimits()
    for number in range(first, first + count):
        name, seed = list(configs)[number % len(configs)], number // len(configs)
        try:
            plan = solve(generate(configs[name], seed))
        except EscapeError as error:
            yield name, seed, [f"no plan: {type(error).__name__}"]
            continue
        try:
            yield name, seed, list_faults(plan, make_trajectory(plan, limits), limits)
        except UnsupportedError as error:
            yield name, seed, [f"refused: {error}"]


# --- under physics -----------------------------------------------------------------------


def drive(config: RoomConfig, seed: int, planner: str) -> tuple[bool, list[str], list[NDArray[np.float64]]]:
    """Escape from a room in Bullet's physics by tracked options.

    Returns:
        True if it escaped; for each option its error, empty without one; after each step the distance of the
        base, heading and worst joint from the trajectory, shape (3,), m and rad.
    """
    dynamics = dataclasses.replace(config.dynamics, kind="physics")
    room, errors, see = generate(dataclasses.replace(config, dynamics=dynamics), seed), [], Tracker.see

    def see_error(tracker: Tracker, state: RoomState) -> None:
        see(tracker, state)
        x, y, heading, *joints = tracker.error.tolist()
        errors.append(np.array([math.hypot(x, y), heading, max(joints, default=0.0)]))

    flat, escapes = EscapeRoomContinuousEnv(instance=room), get_planner(room)
    env = OptionsEnv(flat, planner=planner)
    env.reset(seed=seed)
    goals = [*(goal for goal in list_goals(room) if isinstance(goal, PressGoal)), ExitGoal()]
    faults, is_over, escaped = [], False, False
    with patch.object(Tracker, "see", see_error):
        while not is_over and not (len(faults) >= MOST_FAILURES and all(faults[-MOST_FAILURES:])):
            following = escapes.order_goals(flat.get_state())[0]
            try:
                _, _, terminated, truncated, info = env.step(goals.index(following))
            except EscapeError as error:
                faults.append(f"raises {type(error).__name__}: {error}")
                break
            option, is_over, escaped = info["option"], terminated or truncated, bool(terminated and info["is_success"])
            others = [target.name for target, hit in zip(room.targets, info["also_pressed"], strict=False) if hit]
            also = f"also presses {', '.join(others)}" if others else ""
            faults.append(also if option["ended"] == "reached" or escaped else option["reason"] or option["ended"])
    env.close()
    return escaped, faults, errors


def drive_all(rooms: int, planner: str, names: tuple[str, ...]) -> bool:
    """Print a row a room configuration; says whether 99 % of all options ended as planned."""
    ended, total = 0, 0
    print(f"{'':24s} escaped  of  options as planned   of  base mm p50    p99  joints rad p99")
    for name in names:
        escaped, faults, errors, driven, seeds = 0, [], [], 0, itertools.count()
        while driven < rooms:
            seed = next(seeds)
            try:
                has_escaped, found, away = drive(list_configs()[name], seed, planner)
            except GenerationError:
                continue
            driven, escaped, faults, errors = driven + 1, escaped + has_escaped, faults + found, errors + away
            for fault in filter(None, found):
                print(f"    {name} {seed}: {fault}", flush=True)
        base, _, joints = np.quantile(np.array(errors), [0.5, 0.99], axis=0).T
        print(f"{name:24s} {escaped:7d} {rooms:3d} {faults.count(''):19d} {len(faults):4d} {1e3 * base[0]:12.2f} "
              f"{1e3 * base[1]:6.1f} {joints[1]:15.4f}", flush=True)
        ended, total = ended + faults.count(""), total + len(faults)
    print(f"{ended} of {total} options ended as planned: {ended / total:.1%}")
    return ended >= 0.99 * total


def main() -> None:
    """Count faults by room configuration."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="number of the first, to continue a run")
    parser.add_argument("--physics", type=int, metavar="ROOMS", help="number of rooms of each kind to drive in physics")
    parser.add_argument("--names", nargs="+", choices=DRIVEN, default=DRIVEN, help="rooms driven in physics")
    parser.add_argument("--planner", default="auto", help="of the options, as in `OptionsEnv`")
    chosen = parser.parse_args()
    if chosen.physics:
        sys.exit(not drive_all(chosen.physics, chosen.planner, tuple(chosen.names)))
    made, refused, unplanned, wrong = Counter[str](), Counter[str](), Counter[str](), 0
    for name, seed, faults in check(chosen.count, chosen.first):
        first = faults[0] if faults else ""
        group = refused if first.startswith("refused") else unplanned if first.startswith("no plan") else made
        group[name] += 1
        if faults:
            print(f"{name} {seed}: {'; '.join(faults)}", flush=True)
        wrong += bool(faults) and group is made
    for name in list_configs():
        print(f"{name:28s} {made[name]:4d} made {refused[name]:4d} refused {unplanned[name]:4d} without a plan")
    print(f"{made.total()} made, {wrong} of them wrong, {refused.total()} refused, {unplanned.total()} without a plan")
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
