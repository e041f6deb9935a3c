"""Does `solve` escape every room? Hundreds of generated rooms over all presets and the knobs' extremes.

Run: `python benchmarks/solve_many.py --count 500` (about ten minutes on one core). Each room is
generated, solved, and the plan executed in the environment, where every state must be the predicted
one; where noise, slip, physics or a random puzzle forbid that, meta-actions are pursued closed-loop. Exits with 1 if
any room was not escaped; `--csv` writes a line a room.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path
from typing import Any

from hrl_escape.env.config import (
    DynamicsConfig,
    ExitConfig,
    ObstaclesConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
)
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.bit_flip import BitFlipConfig
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import GenerationError, PlanningFailed
from hrl_escape.options.closed_loop import pursue
from hrl_escape.planning.planner import RoomPlanner


def make_arm_room(joints: int, **robot: Any) -> RoomConfig:
    """Three small targets at different heights that only the hand presses."""
    return RoomConfig(
        room=ShapeConfig(width=12, depth=12),
        robot=RobotConfig(body_radius=0.4, body_height=0.6, joints=joints, **robot),
        puzzle=ButtonsConfig(count=3, buttons=Panels(width=0.4, height=0.4, centre_height=1.0, height_spread=0.3)),
        dynamics=DynamicsConfig(press_with="hand"), obstacles=ObstaclesConfig(count=4),
    )


EXTREMES = {
    "smallest": RoomConfig(room=ShapeConfig(width=5, depth=5), robot=RobotConfig(body_radius=0.2),
                           puzzle=ButtonsConfig(count=1, buttons=Panels(width=0.3))),
    "large": RoomConfig(room=ShapeConfig(width=60, depth=60, rooms=9, doorway_width=4),
                        obstacles=ObstaclesConfig(count=100, size_max=4)),
    "sixteen-rooms": RoomConfig(room=ShapeConfig(width=40, depth=40, rooms=16), robot=RobotConfig(body_radius=0.4),
                                puzzle=ButtonsConfig(count=8, graph=GraphConfig(kind="tree"))),
    "forty-obstacles": RoomConfig(robot=RobotConfig(body_radius=0.4), obstacles=ObstaclesConfig(count=40),
                                  puzzle=ButtonsConfig(count=4)),
    "twelve-in-any-order": RoomConfig(
        puzzle=ButtonsConfig(count=12, buttons=Panels(width=1.0),
                             graph=GraphConfig(kind="edges", edges=tuple((i, 11) for i in range(11))))),
    "twenty-random": RoomConfig(room=ShapeConfig(width=40, depth=40, rooms=4), obstacles=ObstaclesConfig(count=20),
                                puzzle=ButtonsConfig(count=20, graph=GraphConfig(kind="random", max_parents=3))),
    "resetting": RoomConfig(exit=ExitConfig(door=True, width=2.4), room=ShapeConfig(rooms=2),
                            puzzle=ButtonsConfig(count=6, allow_off=True, on_violation="reset")),
    "coarse-steps": RoomConfig(robot=RobotConfig(move_step=3.7, turn_step_deg=45), obstacles=ObstaclesConfig(count=10),
                               start=StartConfig(place="fixed", heading_deg=17)),
    "fine-steps": RoomConfig(robot=RobotConfig(move_step=0.3, turn_step_deg=5), obstacles=ObstaclesConfig(count=10)),
    "bits": RoomConfig(puzzle=BitFlipConfig(count=6, buttons=Panels(width=1.0)), robot=RobotConfig(body_radius=0.4)),
    "hand-3": make_arm_room(3, link_length=0.4),
    "hand-6": make_arm_room(6, link_length=0.25),
    "hand-7": make_arm_room(7, link_length=0.22),
    "kuka": make_arm_room(7, kind="kuka-iiwa"),
    "panda": make_arm_room(7, kind="franka-panda"),
    "noisy": RoomConfig(dynamics=DynamicsConfig(noise=0.1, slip=0.1), obstacles=ObstaclesConfig(count=10),
                        puzzle=ButtonsConfig(count=3)),
    "physics": RoomConfig(dynamics=DynamicsConfig(kind="physics"), robot=RobotConfig(body_radius=0.5),
                          obstacles=ObstaclesConfig(count=8), puzzle=ButtonsConfig(count=3)),
}
FAMILIES = {**{name: get_preset(name) for name in PRESETS}, **EXTREMES}


def solve_room(config: RoomConfig, seed: int) -> dict[str, object]:
    """Generate, plan, execute; returns what happened."""
    began = time.perf_counter()
    try:
        instance = generate(config, seed)
    except GenerationError as error:
        return {"end": "not generated", "why": str(error)}
    planner = RoomPlanner(instance)
    env = EscapeRoomEnv(instance=instance)
    env.reset(seed=seed)
    generated, planned = time.perf_counter() - began, 0.0
    dynamics = instance.dynamics
    try:
        if dynamics.kind == "physics" or dynamics.is_random or instance.puzzle.is_random:
            run = pursue(env, planner=planner)
            escaped, count = run.escaped, len(run.rewards)
            planned = sum(decision["planner_seconds"] for decision in run.decisions)
        else:
            plan = planner.solve(env.get_state())
            planned = plan.seconds
            run = plan.execute(env)
            escaped, count = run.escaped and run.as_predicted, plan.cost
        end, why = ("escaped", "") if escaped else (run.end.words if run.end.is_over else "not escaped", "")
    except PlanningFailed as failure:
        end, why, count = "no plan", str(failure), 0
    finally:
        env.close()
    return {"end": end, "why": why, "primitives": count, "id": instance.id, "generating_s": round(generated, 3),
            "planning_s": round(planned, 3)}


def main() -> int:
    """Solve rooms family by family in turn, so that any count covers all families."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=50, help="rooms in all")
    parser.add_argument("--family", choices=FAMILIES, help="only this family")
    parser.add_argument("--first", type=int, default=0, help="first instance seed")
    parser.add_argument("--csv", type=Path, help="write a line a room to this file")
    arguments = parser.parse_args()
    names = [arguments.family] if arguments.family else list(FAMILIES)
    rows, began = [], time.perf_counter()
    for number in range(arguments.count):
        name, seed = names[number % len(names)], arguments.first + number // len(names)
        row = {"family": name, "seed": seed} | solve_room(FAMILIES[name], seed)
        rows.append(row)
        if row["end"] != "escaped":
            print(f"\n{name}, seed {seed}: {row['end']}. {row['why']}")
        left = (time.perf_counter() - began) / (number + 1) * (arguments.count - number - 1)
        print(f"\r{number + 1}/{arguments.count}, about {left:.0f} s left  ", end="", flush=True)
    missing = [row for row in rows if row["end"] == "not generated"]
    escaped = sum(row["end"] == "escaped" for row in rows)
    seconds = time.perf_counter() - began
    print(f"\nescaped {escaped} of {len(rows) - len(missing)} rooms in {seconds:.0f} s"
          + (f"; {len(missing)} room configurations gave no solvable room" if missing else ""))
    if arguments.csv:
        with arguments.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, ["family", "seed", "end", "why", "primitives", "id", "generating_s",
                                           "planning_s"])
            writer.writeheader()
            writer.writerows(rows)
    return 0 if escaped == len(rows) - len(missing) else 1


if __name__ == "__main__":
    sys.exit(main())
