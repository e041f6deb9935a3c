"""Manifest of the rungs for hubs of environments: a golden solution, the floor and canaries, each with its reward.

    python -m benchmarks.hub_manifest                                    # writes hub-manifest.json and checks it
    python -m benchmarks.hub_manifest --check                            # replays hub-manifest.json
    python -m benchmarks.hub_manifest --rungs pair --package /tmp/pair   # a package for `openenv validate`

OpenEnv's RFC 008 asks an environment to prove its reward: a golden solution reaches the maximum, doing nothing stays at
the floor, and canaries, trajectories that look like success, stay there as well. The reward is the efficiency of the
game, from 0 without an escape to 1. All calls belong to the text interface, in the first test room of a rung.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import yaml

from hrl_escape.agents.spec import ORACLE, AgentSpec
from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.benchmark.agent_env import make_agent_env, make_player
from hrl_escape.cli import run_script
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import VerificationError
from hrl_escape.files import make_folder, read_json, write_json, write_text
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.text import RoomSession, TextEnv, ToolsAgent, make_model

MANIFEST = Path(__file__).parent / "hub-manifest.json"
SEED, FLOOR_MARGIN, MOST_REPEATS = 0, 0.5, 50
Calls = Sequence[tuple[str, Any]]


@dataclasses.dataclass(frozen=True)
class Args:
    """Options of the manifest."""

    rungs: tuple[str, ...] = ()
    """Rungs of ladder-1; all by default."""
    out: Path = MANIFEST
    """File of the manifest."""
    check: bool = False
    """Replay the file and compare the rewards."""
    package: Path | None = None
    """Folder for a package of the first rung: openenv.yaml, oracle and canaries."""


def hash_room(room: RoomInstance) -> str:
    """Return the SHA-256 of a room's values, with its name and seed."""
    return hashlib.sha256(json.dumps(room.to_dict(), sort_keys=True).encode()).hexdigest()


def make_session(room: RoomInstance) -> RoomSession:
    """A game that has begun, with options and primitives."""
    session = RoomSession(EscapeRoomEnv(instance=room), "places")
    session.reset(seed=SEED)
    return session


def play_calls(room: RoomInstance, calls: Calls) -> float:
    """Reward after some calls."""
    session = make_session(room)
    with closing(session.env):
        for name, arguments in calls:
            session.call(name, arguments)
        return session.score().efficiency


def find_golden(room: RoomInstance) -> list[tuple[str, Any]]:
    """Calls of `move` that follow the oracle, which replans after noise; the episode seed fixes the noise."""
    spec = AgentSpec(ORACLE)
    env, recorder = make_agent_env(spec, room, "features")
    with closing(env):
        primitives = [int(step.action) for step, _ in play_episode(make_player(spec, env, recorder), env, SEED)]
    session, calls, done = make_session(room), [], 0
    names = room.robot.actions.names
    with closing(session.env):
        while done < len(primitives):
            times = 1
            while times < MOST_REPEATS and primitives[done:done + times + 1] == [primitives[done]] * (times + 1):
                times += 1
            call = ("move", {"primitive": names[primitives[done]], "times": times})
            session.call(*call)
            calls.append(call)
            done += session.log[-1].duration  # a move ends when something changes
    return calls


def list_canaries(room: RoomInstance) -> dict[str, Calls]:
    """Trajectories that a wrong reward would pay, by name."""
    session = make_session(room)
    options = session.tools()[0]["inputSchema"]["properties"]["option"]["enum"]
    session.env.close()
    leave = ("run_option", {"option": "go-to-exit"})
    return {
        "nothing": [],
        "leave at once": [leave] * 3,
        "look and leave": [("look", {})] * 5 + [leave],
        "claim success": [("escape", {"escaped": True, "reward": 1.0}), ("run_option", {"option": "exit open"}), leave],
        "one option again and again": [("run_option", {"option": options[0]})] * 3,
        "malformed calls": [("run_option", {}), ("run_option", "go-to-exit"), (None, [1]), ("move", {"times": 10**30})],
        "stop before the exit": find_golden(room)[:-1],
    }


def make_entry(rung: str) -> dict[str, Any]:
    """Manifest of one rung."""
    room = load_benchmark("ladder-1")[rung].test[0]
    golden = find_golden(room)
    reward = play_calls(room, golden)
    env = TextEnv(EscapeRoomEnv(instance=room), "names")
    with closing(env):
        for _ in play_episode(ToolsAgent(env, make_model("random")), env, SEED):
            pass
        random = env.score().efficiency
    return {"rung": rung, "room": f"ladder-1/{rung}/test#0", "room_sha256": hash_room(room), "seed": SEED,
            "horizon": room.horizon, "tools": ["run_option", "look", "move"],
            "reward": {"range": [0.0, 1.0], "oracle_tolerance": math.ceil(100 * (1 - reward)) / 100,
                       "floor_margin": FLOOR_MARGIN},
            "golden": {"calls": golden, "reward": reward},
            "floor": {"idle": play_calls(room, []), "random": round(random, 6)},
            "canaries": [{"name": name, "calls": list(calls), "reward": play_calls(room, calls)}
                         for name, calls in list_canaries(room).items()]}


def check_entry(entry: dict[str, Any]) -> None:
    """Replay an entry. Raises `VerificationError` if a reward differs, or one breaks the contract."""
    room = load_benchmark("ladder-1")[entry["rung"]].test[0]
    rules, floor = entry["reward"], entry["floor"]["idle"]
    if hash_room(room) != entry["room_sha256"]:
        raise VerificationError(f"{entry['room']}: the room is another one")
    found = play_calls(room, entry["golden"]["calls"])
    if found != entry["golden"]["reward"] or found < rules["range"][1] - rules["oracle_tolerance"]:
        raise VerificationError(f"{entry['room']}: the golden solution earns {found}")
    if rules["range"][1] - floor < rules["floor_margin"] or play_calls(room, []) != floor:
        raise VerificationError(f"{entry['room']}: doing nothing earns {play_calls(room, [])}")
    for canary in entry["canaries"]:
        if play_calls(room, canary["calls"]) != canary["reward"] or canary["reward"] > floor:
            raise VerificationError(f"{entry['room']}: the canary {canary['name']!r} earns more than the floor")


def write_package(entry: dict[str, Any], folder: Path) -> None:
    """Write a package that `openenv validate` reads: the declarations, the oracle and the canaries as data."""
    make_folder(folder / "oracle")
    write_json(folder / "oracle/calls.json", entry["golden"]["calls"])
    write_json(folder / "canaries.json", entry["canaries"])
    write_text(folder / "openenv.yaml", yaml.safe_dump({
        "name": f"hrl-escape-{entry['rung']}", "version": "0.4.0",
        "validation": {
            "reward": entry["reward"],
            "resources": {"cpu": 1.0, "memory_mb": 2048, "disk_mb": 4096, "episode_timeout_s": 600},
            "capabilities": {"oracle": {"form": "script", "location": "oracle/calls.json"},
                             "verifier": {"kind": "reward_channel"}, "canaries": "canaries.json",
                             "declared_tools": entry["tools"]},
            "task_distribution": {"generator_seed": entry["seed"], "dataset_version": entry["room_sha256"]},
            "types": {"tags": ["game", "tool-use"]}}}, sort_keys=False))


def run(args: Args) -> None:
    """Write or check the manifest."""
    if args.package is not None:
        write_package(make_entry(args.rungs[0] if args.rungs else "pair"), args.package)
        return
    if not args.check:
        rungs = args.rungs or tuple(rung.name for rung in load_benchmark("ladder-1"))
        entries = []
        for rung in rungs:
            entries.append(make_entry(rung))
            print(f"{rung}: golden {entries[-1]['golden']['reward']:.3f}, random {entries[-1]['floor']['random']:.3f}",
                  flush=True)
            write_json(args.out, {"schema": 1, "rungs": entries})
    for entry in read_json(args.out, "manifest")["rungs"]:
        if not args.rungs or entry["rung"] in args.rungs:
            check_entry(entry)
            print(f"{entry['rung']}: the golden solution and {len(entry['canaries'])} canaries replay", flush=True)


if __name__ == "__main__":
    sys.exit(run_script(run))
