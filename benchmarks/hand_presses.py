"""Presses by hand: how many certified targets are reached, how quickly, and with how few primitives?

Run: `python benchmarks/hand_presses.py --rooms 20` (a minute or two on one core; with `--compare 12` about
five). Each family presses every target of generated rooms, with arms of three joints and more. `cold` is
a first question about a target from a configuration of the arm, the room itself being prepared; `cached`
a second one, from elsewhere; both are processor time.

With `--compare`, that many plans of a family are compared with a fine joint search of base and arm. It is breadth
first over primitives of the base on exact poses, distinguished at 5 cm, with the fewest joint steps at every pose. It
ignores other targets on the way, and can therefore find fewer primitives than possible.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time

import numpy as np
from numba import njit

from hrl_escape.env.config import ObstaclesConfig, RobotConfig, RoomConfig
from hrl_escape.env.geometry import stack_footprints
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.floor.sweeps import compile_geometry
from hrl_escape.planning.arm.joint_lattice import find_touching
from hrl_escape.planning.arm.reacher import UNLIMITED, Reacher
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.search.primitive_search import PrimitiveSearch

THREE = RobotConfig(joints=3, body_radius=0.4, body_height=0.8)
ARMS = {
    "3 joints": THREE,
    "4 joints": dataclasses.replace(THREE, joints=4),
    "6 joints": dataclasses.replace(THREE, joints=6, link_length=0.3),
    "7 joints": dataclasses.replace(THREE, joints=7, link_length=0.3),
    "kuka-iiwa": RobotConfig(kind="kuka-iiwa", joints=7, body_radius=0.4, body_height=0.5),
    "franka-panda": RobotConfig(kind="franka-panda", joints=7, body_radius=0.4, body_height=0.5),
}
BINS = 0.05
_first_contact, _distance = compile_geometry()


def make_family(arm: str, obstacles: int) -> RoomConfig:
    """Two small buttons at different heights in a 12 m room."""
    obstacle = ObstaclesConfig(count=obstacles, size_max=1.0)
    return dataclasses.replace(get_preset("arm-two-button"), robot=ARMS[arm], obstacles=obstacle)


def measure(arm: str, obstacles: int, rooms: int, compare: int) -> None:
    """Press every target of every room, one after the other."""
    cold: list[float] = []
    cached: list[float] = []
    lengths: list[int] = []
    ratios: list[tuple[int, int]] = []
    failures: list[str] = []
    for seed in range(rooms):
        room = generate(make_family(arm, obstacles), seed)
        search = PrimitiveSearch(room)
        search.get_maker(True), search.get_maker(False), search.reacher.list_postures(0)
        state = search.kinematics.make_state(room.starts[0])
        for target in range(len(room.targets)):
            goal, aside = PressGoal(target), search.kinematics.step(state, 4).state
            began = time.process_time()
            found = search.search(state, goal)
            cold.append(time.process_time() - began)
            began = time.process_time()
            search.search(aside, goal)
            cached.append(time.process_time() - began)
            if not found.is_reached:
                failures.append(f"seed {seed}, {room.targets[target].name}: {found.status}")
                continue
            lengths.append(len(found.primitives))
            if len(ratios) < compare and not state.touching >> target & 1:
                most = len(found.primitives)
                ratios.append((most, find_fewest(search.reacher, state, target, most)))
            state = found.states[-1]
    for failure in failures:
        print(f"  {failure}")
    total = len(lengths) + len(failures)
    line = (f"{arm:13} {obstacles:2} obstacles: {len(lengths)} of {total} pressed, mean {np.mean(lengths):.1f} "
            f"primitives, cold {describe(cold)}, cached {describe(cached)}")
    if ratios:
        plans, fewest = np.array(ratios).T
        ratio, worst = np.mean(plans) / np.mean(fewest), max(plans - fewest)
        line += f", {ratio:.3f} of the fewest ({len(ratios)} plans, worst +{worst})"
    print(line, flush=True)


def describe(seconds: list[float]) -> str:
    """Median and 99th percentile."""
    return f"{1000 * np.median(seconds):.1f} ms (p99 {1000 * np.percentile(seconds, 99):.0f})"


# --- the fine joint search -----------------------------------------------------------------


def find_fewest(reacher: Reacher, state: RoomState, target: int, most: int) -> int:
    """Fewest primitives that press a target from a state on the lattice, at most `most`."""
    room, kinematics = reacher.instance, reacher.kinematics
    solids = [s.footprint for s in (*room.solids, *((room.door,) if room.door else ()))]
    angles = kinematics.turn_step * np.arange(kinematics.headings)
    turns = np.round(np.stack([np.cos(angles), np.sin(angles)], axis=1), 15)
    moves = room.robot.move_step * np.stack([turns, -turns, turns[:, ::-1] * (-1, 1), turns[:, ::-1] * (1, -1)])
    table = reacher.make_table(target, state.joint_steps, budget=UNLIMITED)
    boxes = np.array([(t.x, t.y, t.z, t.footprint.cos, t.footprint.sin, t.half_x, t.half_y, t.half_z)
                      for t in room.targets])
    lattice = reacher._get_ordered(state.joint_steps, ()).lattice
    reach = np.hypot(lattice.first[:, 3], lattice.first[:, 7]).max() + lattice.longest
    return _search(stack_footprints(solids), room.robot.body_radius + 1e-3, moves, turns,
                   np.array([room.reach_x, room.reach_y]), table.costs, table.low, table.cell, lattice, boxes, target,
                   reacher.limit, stack_footprints([room.targets[target].footprint])[0], reach + reacher.limit,
                   state.x, state.y, state.heading_steps, most)


@njit
def _shape(row):
    return row[0] > 0.5, row[1], row[2], row[3], row[4], row[5], row[6]


@njit
def _search(solids, radius, moves, turns, half, costs, low, cell, lattice, boxes, target, limit, area, reach, x, y,
            heading, best):
    headings, step = moves.shape[1], math.hypot(moves[0, 0, 0], moves[0, 0, 1])
    columns, rows = int(2 * half[0] / BINS) + 3, int(2 * half[1] / BINS) + 3
    seen = np.zeros((columns, rows, headings), dtype=np.bool_)
    size = columns * rows * headings
    places, facts = np.empty((size, 2)), np.empty((size, 2), dtype=np.int32)
    places[0, 0], places[0, 1], facts[0, 0], facts[0, 1] = x, y, heading, 0
    used, node = 1, 0
    goal = _shape(area)
    while node < used:
        x, y, heading, spent = places[node, 0], places[node, 1], facts[node, 0], facts[node, 1]
        node += 1
        if spent >= best:
            break
        i, j = int(math.floor((x - low[0]) / cell)), int(math.floor((y - low[1]) / cell))
        if 0 <= i < costs.shape[0] and 0 <= j < costs.shape[1]:
            rest = costs[i, j, heading]
            if rest >= 0 and spent + rest < best:
                pose = (x, y, turns[heading, 0], turns[heading, 1])
                _, steps = find_touching(lattice, pose, boxes, target, limit, False, 0, 1)
                best = min(best, spent + steps)
        if spent + 1 + math.ceil(max(_distance(x, y, goal) - reach, 0.0) / step - 1e-9) > best:
            continue
        for action in range(6):
            to_x, to_y, to_heading = x, y, heading
            if action < 4:
                dx, dy = moves[action, heading, 0], moves[action, heading, 1]
                share = 1.0
                for k in range(solids.shape[0]):
                    around = radius + step + solids[k, 5] + solids[k, 6]
                    if abs(x - solids[k, 1]) <= around and abs(y - solids[k, 2]) <= around:
                        share = min(share, _first_contact(x, y, dx, dy, radius, _shape(solids[k])))
                to_x, to_y = x + share * dx, y + share * dy
            else:
                to_heading = (heading + (1 if action == 4 else headings - 1)) % headings
            i, j = int((to_x + half[0]) / BINS) + 1, int((to_y + half[1]) / BINS) + 1
            if 0 <= i < columns and 0 <= j < rows and not seen[i, j, to_heading]:
                seen[i, j, to_heading] = True
                places[used, 0], places[used, 1], facts[used, 0], facts[used, 1] = to_x, to_y, to_heading, spent + 1
                used += 1
    return best


def main() -> None:
    """Measure every family."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=20, help="rooms a family (default 20)")
    parser.add_argument("--compare", type=int, default=0, help="questions a family to search finely (default 0)")
    parser.add_argument("--arms", nargs="+", default=list(ARMS), choices=list(ARMS), help="which arms (default all)")
    arguments = parser.parse_args()
    for arm in arguments.arms:
        for obstacles in (0, 8):
            measure(arm, obstacles, arguments.rooms, arguments.compare)


if __name__ == "__main__":
    main()
