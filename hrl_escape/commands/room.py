"""Make a room: generate or load it, check it, drive it, draw it, save it.

Examples:
    hrl-escape room --preset clutter --seed 3 --draw room.svg --save room.json --check
    hrl-escape room --preset larg-2019 --arguments size=4 seed=3
    hrl-escape room --set room.width=30 obstacles.count=40 --draw room.png
    hrl-escape room --preset paper-one-button --drive "strafe-left*9" --draw path.svg drive.gif
    hrl-escape room --load room.json --json
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.env.drawing.video import save_picture, save_video
from hrl_escape.env.engine import check_camera, film
from hrl_escape.env.episode_end import EpisodeEnd
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.symbolic import SymbolicModel
from hrl_escape.env.puzzles.traits import Graphed, get_trait
from hrl_escape.env.sampling.primitive_proof import find_unmet_constraint
from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.figures import VIDEO_FORMATS, check_picture_name
from hrl_escape.names import make_console_text, parse_whole

RANDOM = "random"
MOST_REPEATS = 1_000_000


@dataclasses.dataclass(frozen=True)
class Drive:
    """Record of one episode.

    Attributes:
        primitives: names of the primitives that ran, in order.
        states: one more than primitives.
        rewards: one a primitive.
        pressed: number of a primitive, from 1, and the names of the targets that it pressed.
        end: how the episode ended.
    """

    primitives: tuple[str, ...]
    states: tuple[RoomState, ...]
    rewards: tuple[float, ...]
    pressed: tuple[tuple[int, tuple[str, ...]], ...]
    end: EpisodeEnd

    @property
    def total(self) -> float:
        """Return of the episode, without discount."""
        return float(sum(self.rewards))

    @property
    def path(self) -> list[tuple[float, float]]:
        """Positions of the body's axis, m."""
        return [(state.x, state.y) for state in self.states]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"primitives": list(self.primitives), "return": self.total, "end": self.end.value,
                "path": self.path,
                "pressed": [{"primitive": at, "targets": list(names)} for at, names in self.pressed]}


def parse_primitives(text: str, instance: RoomInstance, seed: int = 0) -> list[int]:
    """Read primitives such as "forward*3, turn-left random*20".

    Args:
        text: names or action numbers, separated by spaces or commas; `*n` repeats, `random` draws.
        instance: the room whose robot they are for.
        seed: seed of the random primitives.

    Returns:
        Action numbers.

    Raises:
        UnknownNameError: no such primitive.
        ConfigError: an impossible number of repetitions.
    """
    names, rng = get_names(instance), np.random.default_rng(seed)
    actions: list[int] = []
    for word in filter(None, re.split(r"[\s,]+", text)):
        name, star, times = word.partition("*")
        count = parse_whole(times) if star else 1
        if count is None or not 0 < count <= MOST_REPEATS:
            raise ConfigError("primitives", word, f"name*n with n from 1 to {MOST_REPEATS}")
        number = parse_whole(name)
        if number is not None and number < len(names):
            name = names[number]
        if name not in (*names, RANDOM):
            raise UnknownNameError("primitive", name, (*names, RANDOM))
        actions += rng.integers(len(names), size=count).tolist() if name == RANDOM else [names.index(name)] * count
    return actions


def get_names(instance: RoomInstance) -> tuple[str, ...]:
    """Names of the room's primitives, in action order."""
    return instance.robot.actions.names


def drive_room(instance: RoomInstance, actions: Sequence[int], seed: int = 0) -> Drive:
    """Run primitives from the start until they or the episode end.

    Args:
        instance: the room.
        actions: action numbers.
        seed: episode seed; fixes the start and the noise.
    """
    env = EscapeRoomEnv(instance=instance)
    env.reset(seed=seed)
    states, rewards, pressed = [env.get_state()], [], []
    end = EpisodeEnd.STOPPED
    for number, action in enumerate(actions, start=1):
        _, reward, terminated, truncated, info = env.step(action)
        states.append(env.get_state())
        rewards.append(float(reward))
        if info["pressed"].any():
            pressed.append((number, tuple(instance.targets[target].name for target in np.flatnonzero(info["pressed"]))))
        end = EpisodeEnd.of_step(bool(info["success"]), terminated, truncated)
        if end.is_over:
            break
    env.close()
    names = get_names(instance)
    done = tuple(names[action] for action in actions[: len(rewards)])
    return Drive(done, tuple(states), tuple(rewards), tuple(pressed), end)


@dataclasses.dataclass(frozen=True)
class RoomArgs(RoomChoice):
    """Options of `hrl-escape room`."""

    check: bool = False
    """Check that the room is solvable: start, targets and exit are connected, and the puzzle's goal is reachable.
    Exit code 1 if not."""
    drive: str = ""
    """Primitives to run from the start, by name or number; * repeats, random draws: "forward*3 turn-left random*20"."""
    episode_seed: int = 0
    """Episode seed of the drive: fixes the start, the noise and the random primitives."""
    draw: tuple[Path, ...] = ()
    """Pictures to write: .svg, .pdf or .png for the map, .gif or .mp4 for a video of the drive."""
    camera: str | None = None
    """Camera that renders .png pictures in place of the map; videos use chase by default."""
    save: Path | None = None
    """File to write the instance to, as JSON."""
    json: bool = False
    """Print JSON instead of a table."""


def run(args: RoomArgs) -> int:
    """Make, check, drive, draw and save as the options say; exit code 1 if a check fails."""
    for path in args.draw:
        check_picture_name(path)
    if args.camera is not None:
        check_camera(args.camera)
    instance = args.make_instance()
    report = _describe(instance)
    problem = None
    if args.check:
        problem = find_unmet_constraint(instance) or _find_dead_end(instance.symbolic_model)
        report["check"] = problem or "solvable"
    drive = drive_room(instance, parse_primitives(args.drive, instance, args.episode_seed), args.episode_seed)
    if args.drive:
        report["drive"] = drive.to_dict()
    if args.save is not None:
        instance.save(args.save)
    for path in args.draw:
        _draw(path, instance, drive, args.camera)
    report["files"] = [str(path) for path in (*([args.save] if args.save else []), *args.draw)]
    print(json.dumps(report, indent=2)) if args.json else _print(report, drive)
    return 1 if problem else 0


def _describe(instance: RoomInstance) -> dict[str, Any]:
    """Description of the room as plain values."""
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
        "edges": [[puzzle.target_names[a], puzzle.target_names[b]] for a, b in get_trait(puzzle, Graphed).edges],
        "goal": [puzzle.target_names[i] for i in get_trait(puzzle, Graphed).goal_targets],
        "robot": robot.kind if robot.joints else "base",
        "joints": robot.joints,
        "dynamics": instance.dynamics.kind,
        "press_with": instance.dynamics.press_with,
        "horizon": instance.horizon,
    }


def _find_dead_end(model: SymbolicModel) -> str | None:
    """Name goals that are unreachable even under delete relaxation; None if all are reachable."""
    facts = frozenset(model.propositions).difference(*(operator.may_add for operator in model.operators))
    while True:
        reached = facts.union(*(operator.relax(facts) for operator in model.operators))
        if reached == facts:
            break
        facts = reached
    lost = sorted(model.goal - facts)
    return f"the puzzle cannot reach {', '.join(lost)}" if lost else None


def _draw(path: Path, instance: RoomInstance, drive: Drive, camera: str | None) -> None:
    kind = path.suffix.lower().lstrip(".")
    if kind in VIDEO_FORMATS:
        save_video(path, film(instance, drive.states, camera or "chase"))
    elif kind == "png" and camera is not None:
        (frame,) = film(instance, drive.states[-1:], camera, 960, 720)
        save_picture(path, frame)
    else:
        from hrl_escape.env.drawing.maps import Trajectory, save_map  # loads matplotlib

        paths = [Trajectory(drive.path, f"{len(drive.primitives)} primitives")] if drive.primitives else []
        save_map(path, instance, drive.states[-1], paths)


def _print(report: dict[str, Any], drive: Drive) -> None:
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
    if drive.primitives:
        table.add_row("drive", f"{len(drive.primitives)} primitives, return {drive.total:g}, {drive.end.words}")
        for number, names in drive.pressed:
            table.add_row("", f"primitive {number} pressed {_join(names)}")
    for path in report["files"]:
        table.add_row("wrote", Text(path))
    Console(soft_wrap=True).print(table)


def _join(names: Iterable[str]) -> str:
    return ", ".join(map(make_console_text, names))
