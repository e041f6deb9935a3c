"""Sound files of every kind that the package reads, changed at random, and what reads them."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import random
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import hrl_escape
from benchmarks.leaderboard.page import RESULTS
from benchmarks.leaderboard.results import check
from hrl_escape.agents import load_agent, load_result
from hrl_escape.agents.training.archive import pack_run, unpack_run
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.benchmark.conversion import convert_file
from hrl_escape.benchmark.grid import load_grid
from hrl_escape.benchmark.models import evaluate_model
from hrl_escape.benchmark.recording import record_episode
from hrl_escape.benchmark.run_results import read_episodes
from hrl_escape.data import load_data
from hrl_escape.data.convert import convert_data
from hrl_escape.data.recording import Recording, load_recording, save_recording
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import PlanningFailed
from hrl_escape.files import read_json
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.arm.obstacles import Obstacle
from hrl_escape.planning.best_known import find_best_known, list_start_states
from hrl_escape.planning.fixed_arm import Arm
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.world import World
from hrl_escape.sets.grammar import find_config, find_set
from hrl_escape.sets.manifest import load_manifest
from hrl_escape.text.recordings import Game, RecordedModel, load_games, record_game, replay_game
from hrl_escape.text.text_env import RoomSession, ToolCall
from hrl_escape.viewer.play.episode import SavedEpisode, load_episode, save_episode
from tests.agents.small_envs import ButtonGrid
from tests.agents.training.test_damage import change_bytes, change_value
from tests.benchmark.small import SCHEMATIC, SMALL
from tests.data.small import make_recording
from tests.test_openers import MAP, RUN, SRDF, draw_map, link_run, make_arm, make_run, make_urdf

__all__ = ["KINDS", "FileKind", "change_file"]


MANIFEST = Path(hrl_escape.__file__).parent / "sets" / "data" / "ladder-1.json"


@cache
def get_room(number: int) -> RoomInstance:
    names = ("paper-two-button", "clutter", "arm-two-button", "push-block", "taxi", "key-chest", "hanoi")
    return generate(dataclasses.replace(get_preset(names[number % len(names)]), horizon=20), 0)


def use_room(room: RoomInstance) -> None:
    """Step, observe, plan and wrap a room that was read."""
    for observation in ("state", "objects"):
        env = EscapeRoomEnv(instance=room, observation=observation)
        seen, _ = env.reset(seed=0)
        assert env.observation_space.contains(seen), "an observation is outside its space"
        for action in range(min(4, int(env.action_space.n))):  # type: ignore[attr-defined]
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                break
        env.close()
    OptionsEnv(EscapeRoomEnv(instance=room)).reset(seed=0)
    with contextlib.suppress(PlanningFailed):
        RoomPlanner(room, budget=2_000).solve(list_start_states(room)[0])
    find_best_known(room, list_start_states(room)[0])


class FileKind(NamedTuple):
    """A kind of file.

    Attributes:
        make: writes a sound file, at a path within a folder, with what belongs to it.
        name: that path.
        read: reads it and uses what was read.
        change: changes one value of the sound file's content, or None for bytes alone.
    """

    name: str
    make: Callable[[Path, random.Random], object]
    read: Callable[[Path], object]
    change: Callable[[Path, random.Random], object] | None = None


def nudge(value: Any, chance: random.Random) -> Any:
    """JSON value in which one number is another that is as likely."""
    if isinstance(value, dict) and value:
        name = chance.choice(list(value))
        return {**value, name: nudge(value[name], chance)}
    if isinstance(value, list) and value:
        at = chance.randrange(len(value))
        return [*value[:at], nudge(value[at], chance), *value[at + 1:]]
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        return chance.choice([0, -value, value + 1, value - 1, 2 * value, value / 2, value + 0.01, 1000 * value])
    return value


def change_json(path: Path, chance: random.Random) -> None:
    change = nudge if chance.random() < 0.5 else change_value
    content = change(json.loads(path.read_text()), chance)
    if isinstance(content, dict):
        content.pop("id", None)
    path.write_text(json.dumps(content))


def change_lines(path: Path, chance: random.Random) -> None:
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    at = chance.randrange(len(rows))
    rows[at] = change_value(rows[at], chance)
    path.write_text("".join(f"{json.dumps(row)}\n" for row in rows))


def change_recording(path: Path, chance: random.Random) -> None:
    recording = load_recording(path)
    about = change_value(dict(recording.about), chance)
    if not isinstance(about, dict):
        return
    if chance.random() < 0.3:
        name = chance.choice([field.name for field in dataclasses.fields(Recording) if field.name != "about"])
        array = getattr(recording, name).copy()
        array[chance.randrange(len(array))] = chance.choice([0, 1, 3, 7, 100])
        recording = dataclasses.replace(recording, **{name: array})
    save_recording(path, dataclasses.replace(recording, about=about))


def change_checkpoint(path: Path, chance: random.Random) -> None:
    state = change_value(load_checkpoint(path), chance)
    save_checkpoint(path, state if isinstance(state, dict) else {"state": state})


def read_recording(path: Path) -> None:
    data = load_data(path, observation="state")
    repr(data), data.recording.content
    data.read()
    data.make_env(True, 0.9).reset(seed=0)


@cache
def play_game(number: int) -> Game:
    session = RoomSession(EscapeRoomEnv(instance=get_room(number)))
    session.reset(seed=0)
    for option in list(session.tools()[0]["inputSchema"]["properties"]["option"]["enum"])[:2]:
        session.call("run_option", {"option": option})
    return record_game(session)


@cache
def play_oracle(number: int) -> dict[str, Any]:
    return record_episode("oracle", EscapeRoomEnv(instance=get_room(number))).to_json()


def read_games(path: Path) -> None:
    RecordedModel(path)
    for game in load_games(path):
        replay_game(game)


def in_folder(read: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda path: read(path.parent)


def read_run(folder: Path) -> None:
    load_agent(folder)


def resume_run(folder: Path) -> None:
    from tests.test_openers import continue_run

    continue_run(folder)


def read_summaries(path: Path) -> None:
    link_run(path.parent)
    read_episodes(path.parent, RUN)


EXTREME = ("", "nan", "-1", "1e400", "1e-300", "0", "9" * 5000, "\u2603", "0 0", "1 1e9 1")


def change_xml(path: Path, chance: random.Random) -> None:
    """Change a value of an XML file, or leave out or repeat an element."""
    root = ElementTree.fromstring(path.read_text())
    elements = list(root.iter())
    element = chance.choice(elements)
    if element.attrib and chance.random() < 0.7:
        values = [value for each in elements for value in each.attrib.values()]
        element.set(chance.choice(list(element.attrib)), chance.choice([*values, *EXTREME]))
    elif len(element):
        part = chance.choice(list(element))
        element.remove(part)
        element.extend([part] * chance.choice((0, 2, 3000)))
    path.write_text(ElementTree.tostring(root, encoding="unicode"))


@cache
def play_talk() -> dict[str, str]:
    """Files of a model's finished game."""
    with tempfile.TemporaryDirectory() as folder:
        talk(Path(folder))
        return {path.name: path.read_text() for path in Path(folder).iterdir()}


def talk(folder: Path) -> None:
    """Let a caller play one game of one call, or resume it, and print its row."""
    evaluate_model(lambda transcript, tools: ToolCall("look", {}), rooms=1, most_calls=1, out=folder).describe()


def write_talk(path: Path, chance: random.Random) -> None:
    for name, text in play_talk().items():
        (path.parent / name).write_text(text)


def write_old_games(path: Path, chance: random.Random) -> None:
    lines = [json.loads(line) for line in play_game(chance.randrange(2)).to_lines()]
    lines[0] |= {"schema": 1, "told": lines[0].pop("reveal")}
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))


def write_result(path: Path, chance: random.Random) -> None:
    shutil.copy(chance.choice(sorted(RESULTS.glob("*.json"))), path)


def write(text: str) -> Callable[[Path, random.Random], None]:
    return lambda path, chance: path.write_text(text) and None


def write_groups(path: Path) -> None:
    make_urdf(path.parent)
    path.write_text(SRDF.replace("</robot>", """<group name="arm"><chain base_link="foot" tip_link="boom"/></group>
<group name="all"><group name="arm"/><joint name="j"/><link name="boom"/></group>
<group_state name="ready" group="arm"><joint name="j" value="0.5"/></group_state>
<end_effector name="e" parent_link="boom" group="arm"/><disable_default_collisions link="foot"/></robot>"""))


def use_arm(folder: Path) -> None:
    """Load an arm with its SRDF and plan a motion between obstacles."""
    arm = Arm.from_urdf(folder / "r.urdf", srdf=folder / "r.srdf", group="all", floor=-1.0,
                        obstacles=[Obstacle.mesh("thing", folder / "m.obj", (5.0, 0.0, 0.0))])
    with contextlib.suppress(PlanningFailed):
        arm.plan("home", [0.2] * len(arm.joint_names))
    arm.attach("thing", "home").is_free("home")


def write_map(path: Path, chance: random.Random) -> None:
    draw_map(path.parent / "m.png")
    path.write_text(json.dumps(MAP))


def run_file(name: str, read: Callable[[Path], object], change: Any) -> FileKind:
    return FileKind(f"run/{name}", lambda path, chance: make_run(path.parent), in_folder(read), change)


def pack(path: Path) -> None:
    make_run(path.parent / "run")
    pack_run(path.parent / "run", path)


KINDS: dict[str, FileKind] = {
    "room": FileKind("x.json", lambda path, chance: get_room(chance.randrange(7)).save(path),
                     lambda path: use_room(RoomInstance.from_dict(read_json(path))), change_json),
    "configuration": FileKind("x.json", lambda path, chance: path.write_text(json.dumps(SCHEMATIC.to_dict())),
                              lambda path: generate(find_config(str(path)) or SCHEMATIC, 0), change_json),
    "set": FileKind("x.json", lambda path, chance: find_set("paper-two-button#0..3").save(path),
                    lambda path: find_set(str(path)).make_env().reset(seed=0), change_json),
    "grid": FileKind("x.json", lambda path, chance: path.write_text(json.dumps(SMALL.to_dict())),
                     lambda path: load_grid(path), change_json),
    "manifest": FileKind("x.json", lambda path, chance: path.write_text(json.dumps(read_json(MANIFEST))),
                         load_manifest, change_json),
    "episode": FileKind("x.json", lambda path, chance: save_episode(
        path, SavedEpisode(get_room(0), 0, (("forward", (0, 0), "done"),), -2.0, False)), load_episode, change_json),
    "games": FileKind("x.jsonl", lambda path, chance: path.write_text(
        "".join(f"{line}\n" for line in play_game(chance.randrange(2)).to_lines())), read_games, change_lines),
    "recording": FileKind("x.npz", lambda path, chance: save_recording(path, make_recording()), read_recording,
                          change_recording),
    "run": run_file("run.json", read_run, change_json),
    "log": run_file("log.jsonl", resume_run, change_lines),
    "result": run_file("result.json", load_result, change_json),
    "checkpoint": run_file("checkpoint.npz", lambda folder: load_agent(folder, ButtonGrid(horizon=10)),
                           change_checkpoint),
    "archive": FileKind("x.zip", lambda path, chance: pack(path),
                        lambda path: unpack_run(path, path.parent / "out")),
    "episodes": FileKind("episodes.json", lambda path, chance: path.write_text(
        json.dumps([play_oracle(chance.choice((0, 2, 5)))])), read_summaries, change_json),
    "map": FileKind("m.yaml", write_map, lambda path: World.read(path, RobotConfig(), (4.0, 4.0, 0.0)), change_json),
    "picture": FileKind("m.png", lambda path, chance: write_map(path.with_name("m.yaml"), chance),
                        lambda path: World.read(path.with_name("m.yaml"), RobotConfig(), (4.0, 4.0, 0.0))),
    "URDF": FileKind("arm/r.urdf", lambda path, chance: make_urdf(path.parent), in_folder(make_arm)),
    "SRDF": FileKind("arm/r.srdf", lambda path, chance: make_urdf(path.parent), in_folder(make_arm)),
    "arm": FileKind("arm/r.urdf", lambda path, chance: write_groups(path.with_name("r.srdf")),
                    in_folder(use_arm), change_xml),
    "groups": FileKind("arm/r.srdf", lambda path, chance: write_groups(path), in_folder(use_arm), change_xml),
    "mesh": FileKind("arm/m.obj", lambda path, chance: make_urdf(path.parent), in_folder(make_arm)),
    "old file": FileKind("x.json", write(json.dumps({"agents": ["smdp-dqn", {"name": "dqn"}], "rooms": [
        {"preset": "clutter", "seed": 1}]})), lambda path: convert_file(path, path.with_name("y.json")), change_json),
    "old episode": FileKind("x.json", lambda path, chance: path.write_text(json.dumps(
        {"kind": "episode", "schema": 2, "instance": get_room(0).to_dict(), "moves": [{"name": "meta-01"}],
         "end": None})), lambda path: convert_data(path, path.with_name("y.json")), change_json),
    "old games": FileKind("x.jsonl", write_old_games, lambda path: convert_data(path, path.with_name("y.jsonl")),
                          change_lines),
    "model's game": FileKind("game-000.json", write_talk, in_folder(talk), change_json),
    "model's usage": FileKind("usage.json", write_talk, in_folder(talk), change_json),
    "leaderboard": FileKind("x.json", write_result, lambda path: check(path, 1, 0), change_json),
}
"""All kinds by name."""


def change_file(kind: FileKind, folder: Path, chance: random.Random) -> Path:
    """Write a file of a kind with something changed in it; returns its path."""
    path = folder / kind.name
    path.parent.mkdir(parents=True, exist_ok=True) if "run/" not in kind.name else None
    kind.make(path, chance)
    if kind.change is not None and chance.random() < 0.8:
        kind.change(path, chance)
    elif len(content := path.read_bytes()) > 2:
        path.write_bytes(change_bytes(content, chance))
    return path


