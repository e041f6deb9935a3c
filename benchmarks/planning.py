"""Latency of plans in prepared rooms, of cancellation, and memory left behind by ten thousand plans.

Run: `python benchmarks/planning.py` (four minutes on one core, one with `--plans 1000`); exits with 1
if a target is missed. A plan is a whole meta-action, checked by replay; cached is the same question
again. Times are CPU time of this thread, which depends less on a busy machine; wall time is printed as well.
For the number of primitives of plans run `python -m benchmarks.planners --contenders fields --rooms 20 --queries 10`.
"""

from __future__ import annotations

import argparse
import gc
import resource
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.paths.navigator import Navigator
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.requests import PlanningRequest
from hrl_escape.planning.search.primitive_search import PrimitiveSearch

PRESETS = ("paper-one-button", "paper-two-button", "larg-2019", "clutter", "ten-button", "arm-two-button")
MEDIAN_MS, P99_MS, PREPARE_S, CACHED_MS = 5.0, 50.0, 1.0, 0.2
CANCELLED_MS, LONGEST_DELAY_S = 50.0, 0.5
ALLOWED_GROWTH_MB = 4.0
WATCHED = ("fields", "RRTConnect", "answer", "plan")
"""Plans whose memory is watched: of one search, along paths of OMPL, answers to requests, improved now and then, and
`RoomPlanner.plan`, each from another state, with all that it remembers."""


def get_memory_mb() -> float:
    """Resident memory of this process in MB."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def wander(planner: RoomPlanner, state: RoomState, rng: np.random.Generator) -> RoomState:
    """A state that up to forty random moves lead to, with the puzzle as in the beginning."""
    for primitive in rng.integers(6, size=int(rng.integers(40))).tolist():
        state = planner.rules.step(state, primitive).state
    return state._replace(puzzle=planner.instance.puzzle.make_state())


def measure_latency(name: str, rooms: int, queries: int) -> bool:
    """Print one line on a preset; says whether the targets are met."""
    cpu, wall, cached, prepare = [], [], [], []
    for seed in range(rooms):
        planner = RoomPlanner(generate(get_preset(name), seed))
        begin = time.thread_time()
        planner.prepare()
        prepare.append(time.thread_time() - begin)
        rng = np.random.default_rng(seed)
        state = planner.rules.make_state(planner.instance.starts[0])
        planner.routes.find_route(state, PressGoal(0))  # compiles, in the first room
        for _ in range(queries):
            state = wander(planner, state, rng)
            goal = PressGoal(int(rng.integers(len(planner.instance.targets))))
            began, begin = time.perf_counter(), time.thread_time()
            route = planner.routes.find_route(state, goal)
            cpu.append(1e3 * (time.thread_time() - begin))
            wall.append(1e3 * (time.perf_counter() - began))
            begin = time.thread_time()
            planner.routes.find_route(state, goal)
            cached.append(1e3 * (time.thread_time() - begin))
            state = planner.routes.follow(state, route)
    slowest, known = max(prepare[1:]), np.median(cached)
    (median, p99), (median_wall, p99_wall) = np.quantile([cpu, wall], [0.5, 0.99], axis=1).T
    print(f"{name:18} prepare {slowest:5.2f} s   plan, CPU ms: median {median:5.2f}, p99 {p99:5.1f}   "
          f"wall ms: median {median_wall:5.2f}, p99 {p99_wall:5.1f}   cached ms: {known:.3f}", flush=True)
    return bool(median < MEDIAN_MS and p99 < P99_MS and slowest < PREPARE_S and known < CACHED_MS)


def measure_cancellation(calls: int) -> bool:
    """Print the wall time between the cancellation of a call and its result; says whether the median is short."""
    met = []
    for name in ("clutter", "arm-two-button"):
        planner = RoomPlanner(generate(get_preset(name), 5))
        planner.prepare()
        start = planner.rules.make_state(planner.instance.starts[0])
        planner.solve(start)
        waits = []
        for delay in np.random.default_rng(0).uniform(0.0, LONGEST_DELAY_S, size=calls).tolist():
            stop = threading.Event()
            with ThreadPoolExecutor(1) as pool:
                call = pool.submit(planner.answer, PlanningRequest(start, improve=True), stop=stop)
                time.sleep(delay)
                if call.done():
                    continue
                began = time.perf_counter()
                stop.set()
                call.result()
                waits.append(1e3 * (time.perf_counter() - began))
        median, slowest = np.median(waits), max(waits, default=0.0)
        print(f"{name:18} {len(waits)} calls cancelled, wall ms: median {median:.1f}, slowest {slowest:.1f}",
              flush=True)
        met.append(median < CANCELLED_MS)
    return all(met)


def measure_memory(plans: int, kinds: Sequence[str]) -> bool:
    """Print how much memory plans of either kind leave behind; says whether that is little."""
    instance = generate(get_preset("clutter"), 1)
    search, navigator = PrimitiveSearch(instance), Navigator(instance)
    state = search.kinematics.make_state(instance.starts[0])
    grown, wandered, rng = [], state, np.random.default_rng(0)
    planner = RoomPlanner(instance)
    for name in kinds:
        warm, before = plans // 5, 0.0
        for number in range(plans + warm):
            if number == warm:
                before = get_memory_mb()
            target = PressGoal(number % len(instance.targets))
            if name == "plan":
                wandered = wander(planner, wandered, rng)
                planner.plan(wandered, target)
            elif name == "answer":  # planned each time, without a cache
                planner.answer(PlanningRequest(state, target, improve=number % 200 == 0))
                planner = planner.adapt(instance)
            elif name == "fields":
                search.search(state, target)
            else:
                navigator.plan((state.x, state.y), target, name, seed=number)
        grown.append(get_memory_mb() - before)
        print(f"{plans} plans by {name}: {grown[-1]:+.2f} MB", flush=True)
    return max(grown) < ALLOWED_GROWTH_MB


def main() -> int:
    """Measure everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=8, help="rooms of each preset, 2 or more; 0 leaves latency out")
    parser.add_argument("--queries", type=int, default=40, help="plans in each room")
    parser.add_argument("--cancels", type=int, default=40, help="calls that are cancelled in a room; 0 for none")
    parser.add_argument("--plans", type=int, default=10_000, help="plans whose memory is watched; 0 for none")
    parser.add_argument("--memory-of", nargs="+", choices=WATCHED, default=WATCHED, help="plans to watch")
    args = parser.parse_args()
    met = [measure_latency(name, args.rooms, args.queries) for name in PRESETS] if args.rooms else []
    if args.cancels:
        met.append(measure_cancellation(args.cancels))
    if args.plans:
        met.append(measure_memory(args.plans, args.memory_of))
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
