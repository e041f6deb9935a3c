"""Time of the planner to find that no way exists, against its time with every grid made in full.

Run: `python -m benchmarks.failed_places` (some minutes on one core); exits with 1 if the 95th percentile of a room
configuration's failures is above 0.2 s (under physics, where arms collide, none is asked for), or if an answer differs.
Each question is the first one that a planner is asked, and counts in CPU time of this process. Questions are places
inside solids, anywhere, too exact, at headings that no turn leads to, within walls, and behind gaps a little narrower
than the body; by hand, panels too high, inside blocks, within walls and behind such gaps. In full means without the
three rules that save time: links are found where a field needs them, isolated areas are explored before a field is
made, and parts of the floor are proven apart from all places of the base where the hand reaches a panel.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import PlanningFailed
from hrl_escape.floor.cost_to_go import FieldMaker
from hrl_escape.planning.goals import Goal, PoseGoal, PressGoal
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.search.primitive_search import PrimitiveSearch, SearchProblem
from hrl_escape.sets import load_benchmark

LIMIT_S = 0.2
LINKS, FIND_PROOF = "_get_links", "_find_proof"
APART = 4.5
"""Distance from the start to walls, blocks and panels, m."""


def list_configs() -> dict[str, RoomConfig]:
    """Room configurations by name: presets, rungs of `ladder-1`, and variants of presets."""
    clutter, arm, rungs = get_preset("clutter"), get_preset("arm-two-button"), load_benchmark("ladder-1")
    oblong = dataclasses.replace(clutter.robot, footprint="rectangle", body_length=1.2, body_width=0.6)
    physics = dataclasses.replace(arm.dynamics, kind="physics")
    return {
        "clutter": clutter, "clutter, rectangle": dataclasses.replace(clutter, robot=oblong),
        "house": rungs["house"].config, "arm-two-button": arm, "reach": rungs["reach"].config,
        "arm-two-button, physics": dataclasses.replace(arm, dynamics=physics),
    }


class Question(NamedTuple):
    """A goal in a room, perhaps an edited one."""

    kind: str
    room: RoomInstance
    goal: Goal


def make_walls(x: float, y: float, half: float, gap: float) -> tuple[Solid, ...]:
    """Four walls round a place, with a gap in the last one; m."""
    away, side = half + 0.1, (half - gap / 2) / 2
    walls = [Solid("box", x + sign * away, y, 0.1, half + 0.2) for sign in (-1, 1)]
    walls.append(Solid("box", x, y - away, half, 0.1))
    return (*walls, *(Solid("box", x + sign * (gap / 2 + side), y + away, side, 0.1) for sign in (-1, 1)))


def choose_place(room: RoomInstance, rng: np.random.Generator) -> tuple[float, float]:
    """A place well inside the room and away from its start."""
    start = room.starts[0]
    while True:
        x, y = (float(rng.uniform(2.5 - reach, reach - 2.5)) for reach in (room.reach_x, room.reach_y))
        if math.hypot(x - start.x, y - start.y) > APART:
            return x, y


def ask_by_body(room: RoomInstance, rng: np.random.Generator) -> Iterator[Question]:
    """One question of each kind about the body's place."""
    x, y = (float(rng.uniform(-reach, reach)) for reach in (room.reach_x, room.reach_y))
    heading, solid = float(rng.uniform(0.0, math.tau)), room.solids[int(rng.integers(len(room.solids)))]
    yield Question("inside", room, PoseGoal(solid.x, solid.y, heading, float(rng.uniform(0.02, 0.2))))
    yield Question("anywhere", room, PoseGoal(x, y, heading, 0.2))
    yield Question("exact", room, PoseGoal(x, y, heading, 0.02))
    yield Question("heading", room, PoseGoal(x, y, heading, 0.5, 0.02))
    for kind, gap in (("walled", 0.0), ("gap", 2 * room.robot.inner_radius - float(rng.uniform(0.0, 0.05)))):
        x, y = choose_place(room, rng)
        walls = make_walls(x, y, room.robot.outer_radius + float(rng.uniform(0.2, 0.8)), gap)
        yield Question(kind, dataclasses.replace(room, solids=room.solids + walls), PoseGoal(x, y, None, 0.3))


def ask_by_hand(room: RoomInstance, rng: np.random.Generator) -> Iterator[Question]:
    """One question of each kind about a panel."""
    number = int(rng.integers(len(room.targets)))
    panel, (x, y) = room.targets[number], choose_place(room, rng)
    gap, block = 2 * room.robot.inner_radius - float(rng.uniform(0.0, 0.05)), float(rng.uniform(1.0, 3.0))
    half = room.robot.outer_radius + float(rng.uniform(0.4, 1.4))
    edits = {
        "high": ((), {"z": panel.z + float(rng.uniform(1.0, 4.0))}),
        "buried": ((Solid("box", x, y, block, block),), {"x": x, "y": y}),
        "walled": (make_walls(x, y, half, 0.0), {"x": x, "y": y}),
        "gap": (make_walls(x, y, half, gap), {"x": x, "y": y}),
    }
    for kind, (solids, moved) in edits.items():
        targets = list(room.targets)
        targets[number] = dataclasses.replace(panel, **moved)
        yield Question(f"hand: {kind}", dataclasses.replace(room, solids=(*room.solids, *solids),
                                                             targets=tuple(targets)), PressGoal(number))


@contextmanager
def make_in_full() -> Iterator[None]:
    """Plan without the rules that save time."""
    make_field, find_proof = FieldMaker.make_field, getattr(PrimitiveSearch, FIND_PROOF)

    def make_all(maker: FieldMaker, *args: Any, **options: Any) -> Any:
        getattr(maker, LINKS)()
        return make_field(maker, *args, **options)

    def prove_by_distance(search: PrimitiveSearch, problem: SearchProblem, maker: FieldMaker) -> Any:
        table = problem.table and dataclasses.replace(problem.table, complete_to=0)
        return find_proof(search, problem._replace(table=table), maker)

    with ExitStack() as stack:
        for owner, name, rule in ((FieldMaker, "make_field", make_all),
                                  (FieldMaker, "is_cut_off", lambda *args: False),
                                  (PrimitiveSearch, FIND_PROOF, prove_by_distance)):
            stack.enter_context(patch.object(owner, name, rule))
        yield


def answer(question: Question) -> tuple[float, tuple[int, ...] | None, str]:
    """CPU seconds of a question, the primitives, None without a way, and the reason."""
    planner = RoomPlanner(question.room)
    state = planner.rules.make_state(question.room.starts[0])
    if isinstance(question.goal, PoseGoal):
        planner.prepare()
    began = time.process_time()
    try:
        plan = planner.plan(state, question.goal)
    except PlanningFailed as failure:
        return time.process_time() - began, None, failure.reason.value
    return time.process_time() - began, plan.primitives, "reached"


def measure(name: str, config: RoomConfig, rooms: int, count: int, kinds: bool) -> bool:
    """Print a line on a room configuration; says whether the limit is kept and all plans are the same."""
    failed: dict[str, list[tuple[float, float]]] = {}
    answered, is_same = 0, True
    for seed in range(rooms):
        room, rng = generate(config, seed), np.random.default_rng(seed)
        for _ in range(count):
            questions = [*ask_by_body(room, rng)]
            questions += ask_by_hand(room, rng) if room.dynamics.press_with == "hand" else []
            for question in questions:
                seconds, plan, reason = answer(question)
                with make_in_full():
                    before, known, _ = answer(question)
                is_same &= plan == known
                answered += plan is not None
                if plan is None:
                    failed.setdefault(question.kind, []).append((seconds, before))
                    failed.setdefault(f"{question.kind}, {reason}", []).append((seconds, before))
    if not failed:
        print(f"{name:24} none failed, {answered} answered", flush=True)
        return is_same
    every = np.array([pair for kind, pairs in failed.items() if ", " not in kind for pair in pairs])
    median, p95, most = np.quantile(every, [0.5, 0.95, 1.0], axis=0)
    print(f"{name:24} {len(every):4} failed, CPU s: median {median[0]:.4f}, p95 {p95[0]:.3f}, worst {most[0]:.2f}; "
          f"in full p95 {p95[1]:.3f}, worst {most[1]:.2f}; {answered} answered, "
          f"{'all the same' if is_same else 'NOT THE SAME'}", flush=True)
    for kind, pairs in sorted(failed.items()) if kinds else ():
        now, before = np.array(pairs).T
        print(f"    {kind:52} {len(now):4}  p95 {np.quantile(now, 0.95):.3f}  worst {now.max():.3f}   "
              f"in full p95 {np.quantile(before, 0.95):.3f}  worst {before.max():.3f}")
    return bool(is_same and (p95[0] <= LIMIT_S or config.dynamics.kind == "physics"))


def main() -> int:
    """Measure everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    configs = list_configs()
    parser.add_argument("--configs", nargs="+", choices=configs, default=list(configs))
    parser.add_argument("--rooms", type=int, default=2, help="rooms of each room configuration")
    parser.add_argument("--count", type=int, default=3, help="questions of each kind in a room")
    parser.add_argument("--kinds", action="store_true", help="a line for each kind of question and reason, too")
    args = parser.parse_args()
    warm = generate(configs["arm-two-button"], 0)  # compiles
    for question in (*ask_by_body(warm, np.random.default_rng(0)), *ask_by_hand(warm, np.random.default_rng(0))):
        answer(question)
    met = [measure(name, configs[name], args.rooms, args.count, args.kinds) for name in args.configs]
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
