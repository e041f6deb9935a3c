"""Make a room: generate or load it, check it, draw it, save it.

Examples:
    hrl-escape room --room clutter#3 --draw room.svg --save room.json --check
    hrl-escape room --room 'larg-2019(size=4)#3'
    hrl-escape room --set room.width=30 obstacles.count=40 --draw room.png
    hrl-escape room --room room.json --json
    hrl-escape room --room four-rooms --difficulty
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.env.engine import check_camera, film, make_engine
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures.video import save_picture
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin
from hrl_escape.env.puzzles.symbolic import SymbolicModel
from hrl_escape.env.sampling.primitive_proof import find_unmet_constraint
from hrl_escape.figures import check_picture_name
from hrl_escape.names import make_console_text


@dataclasses.dataclass(frozen=True)
class RoomArgs(RoomChoice):
    """Options of `hrl-escape room`."""

    check: bool = False
    """Check that the room is solvable: start, targets and exit are connected, and the puzzle's goal is reachable.
    Exit code 1 if not."""
    difficulty: bool = False
    """Measure the difficulty: primitives of the oracle, ten episodes of random options and of the search baseline, the
    random walk where the room has few states, and whether the horizon is too short. Takes seconds to minutes."""
    draw: tuple[Path, ...] = ()
    """Pictures to write: .svg, .pdf or .png for the map."""
    camera: str | None = None
    """Camera that renders .png pictures in place of the map."""
    save: Path | None = None
    """File to write the instance to, as JSON."""
    json: bool = False
    """Print JSON instead of a table."""


def run(args: RoomArgs) -> int:
    """Make, check, draw and save a room; the exit code is 1 if a check fails."""
    for path in args.draw:
        check_picture_name(path)
    if args.camera is not None:
        check_camera(args.camera)
    instance = args.make_instance()
    make_engine(instance).close()  # raises for a robot that cannot be loaded
    report = _describe(instance)
    problem = None
    if args.check:
        problem = find_unmet_constraint(instance) or _find_dead_end(instance.symbolic_model)
        report["check"] = problem or "solvable"
    if args.difficulty:
        report["difficulty"] = instance.difficulty().to_json()
    if args.save is not None:
        instance.save(args.save)
    for path in args.draw:
        _draw(path, instance, args.camera)
    report["files"] = [str(path) for path in (*([args.save] if args.save else []), *args.draw)]
    print(json.dumps(report, indent=2)) if args.json else _print(report, instance)
    return 1 if problem else 0


def _describe(instance: RoomInstance) -> dict[str, Any]:
    """Describe the room as plain values."""
    puzzle, robot = instance.puzzle, instance.robot
    return {
        "name": instance.name,
        "seed": instance.seed,
        "id": instance.id,
        "size": [2 * instance.half_width, 2 * instance.half_depth],
        "walls": sum(solid.role == "wall" for solid in instance.solids),
        "obstacles": sum(solid.role == "obstacle" for solid in instance.solids),
        "exit": {"x": instance.exit.centre[0], "y": instance.exit.centre[1], "door": instance.door is not None},
        "starts": len(instance.starts),
        "puzzle": puzzle.kind,
        "targets": [{"name": t.name, "x": t.x, "y": t.y, "z": t.z} for t in instance.targets],
        "edges": [[puzzle.target_names[a], puzzle.target_names[b]] for a, b in get_mixin(puzzle, Graphed).edges],
        "goal": [puzzle.target_names[i] for i in get_mixin(puzzle, Graphed).goal_targets],
        "robot": robot.kind if robot.joints else "base",
        "joints": robot.joints,
        "dynamics": instance.dynamics.kind,
        "press_with": instance.dynamics.press_with,
        "horizon": instance.horizon,
    }


def _find_dead_end(model: SymbolicModel) -> str | None:
    """Name goals that are unreachable even under delete relaxation, or None if all are reachable."""
    facts = frozenset(model.propositions).difference(*(operator.may_add for operator in model.operators))
    while True:
        reached = facts.union(*(operator.relax(facts) for operator in model.operators))
        if reached == facts:
            break
        facts = reached
    lost = sorted(model.goal - facts)
    return f"the puzzle cannot reach {', '.join(lost)}" if lost else None


def _draw(path: Path, instance: RoomInstance, camera: str | None) -> None:
    if path.suffix.lower() == ".png" and camera is not None:
        rules = Kinematics(instance)
        (frame,) = film(instance, [rules.make_state(instance.starts[0])], camera, 960, 720)
        save_picture(path, frame)
    else:
        from hrl_escape.env.pictures.maps import save_map  # loads matplotlib

        save_map(path, instance)


def _print(report: dict[str, Any], instance: RoomInstance) -> None:
    table = Table(show_header=False, box=None, padding=(0, 2), pad_edge=False)
    table.add_column(style="dim")
    wide, deep = report["size"]
    seed = "" if report["seed"] is None else f", seed {report['seed']}"
    table.add_row("room", f"[bold]{make_console_text(report['name'])}[/bold]{seed}, id {report['id']}")
    table.add_row("floor", f"{wide:g} x {deep:g} m, {report['walls']} walls, {report['obstacles']} obstacles")
    targets = f" x {len(report['targets'])}" if report["targets"] else ""
    goal = f", goal {_join(report['goal'])}" if report["goal"] else ""
    table.add_row("puzzle", f"{report['puzzle']}{targets}{goal}")
    if report["edges"]:
        table.add_row("order", _join(f"{parent} before {child}" for parent, child in report["edges"]))
    arm = f", {report['joints']} joints" if report["joints"] else ""
    table.add_row("robot", f"{report['robot']}{arm}, presses with its {report['press_with']}, {report['dynamics']}")
    table.add_row("exit", f"({report['exit']['x']:.2f}, {report['exit']['y']:.2f}) m"
                  + (", behind a door" if report["exit"]["door"] else ""))
    if "check" in report:
        table.add_row("check", make_console_text(report["check"]))
    for name, value in instance.difficulty().rows if "difficulty" in report else ():
        table.add_row(name, value)
    for path in report["files"]:
        table.add_row("wrote", Text(path))
    Console(soft_wrap=True).print(table)


def _join(names: Iterable[str]) -> str:
    return ", ".join(map(make_console_text, names))
