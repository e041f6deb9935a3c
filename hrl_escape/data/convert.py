"""Conversion of files of version 0.3: recordings, recorded games, recorded episodes and saved rooms.

Version 0.3 named options by number (`meta-01`) or in words (`press button-1`). `hrl-escape convert` calls
`convert_data`, and `benchmark/conversion.py` for runs, trained agents and grids.
"""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hrl_escape.agents.old_fields import rename_fields
from hrl_escape.data.recording import RECORDING_FORMAT, load_recording, save_recording
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import EscapeError, FileReadError, InstanceFileError, VerificationError
from hrl_escape.files import list_members, parse_json, read_json, read_text, write_json
from hrl_escape.names import number_options
from hrl_escape.options.meta_actions import list_goals
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.goals import ExitGoal, find_new_name, name_goal
from hrl_escape.sets.grammar import find_set
from hrl_escape.sets.room_spec import renew_room
from hrl_escape.text.recordings import Game, record_game, save_games
from hrl_escape.text.text_env import RoomSession, ToolCall
from hrl_escape.text.words import clean

EPISODE_SCHEMA = 3


def convert_data(path: Path, out: Path) -> str | None:
    """Convert a recording (.npz), recorded games (.jsonl), a recorded episode or a saved room (.json).

    Args:
        path: the file.
        out: file to write.

    Returns:
        Description of the converted file, or None for other kinds of files.

    Raises:
        FileReadError: no such file, or it is damaged.
        VerificationError: a game's replay differs.
        FileWriteError: it cannot be written.
    """
    converters: Mapping[str, Callable[[Path, Path], str | None]] = {
        ".npz": _convert_recording, ".jsonl": _convert_games, ".json": _convert_json}
    convert = converters.get(path.suffix.lower())
    return None if convert is None else convert(path, out)


def name_options(room: RoomInstance) -> tuple[str, ...]:
    """Return the names of a room's options, `go-to-exit` last."""
    return tuple(name_goal(goal, room) for goal in (*list_goals(room), ExitGoal()))


def _convert_recording(path: Path, out: Path) -> str | None:
    try:
        is_recording = "about.npy" in list_members(path, "recording", 2**29)
    except zipfile.BadZipFile:
        is_recording = False
    if not is_recording:
        return None
    recording = load_recording(path, version=1)
    count, actions = recording.primitive_count, list(recording.about["actions"])
    rooms = str(renew_room(str(recording.about["rooms"])))
    if actions[count:] and tuple(actions[count:]) == number_options(len(actions) - count):
        actions[count:] = name_options(find_set(rooms)[0])
    if len(actions) != len(recording.about["actions"]):
        raise FileReadError(f"{path}: it has {len(recording.about['actions'])} actions, and its rooms {len(actions)}")
    about = {**recording.about, "format": RECORDING_FORMAT, "actions": actions, "rooms": rooms}
    save_recording(out, dataclasses.replace(recording, about=about))
    return f"the recording {about['name']}"


def _convert_games(path: Path, out: Path) -> str | None:
    games, lines = [], list[Any]()
    for number, text in enumerate(read_text(path, "recorded game").splitlines(), 1):
        lines.append(parse_json(text, f"{path}, line {number}", "recorded game"))
        if not isinstance(lines[0], dict) or lines[0].get("kind") != "game":
            return None
        if isinstance(lines[-1], dict) and "score" in lines[-1]:
            try:
                games.append(_convert_game(lines))
            except VerificationError:
                raise
            except (AttributeError, KeyError, TypeError, ValueError) as error:
                raise FileReadError(f"{path}, game that ends in line {number}: {error}") from error
            lines = []
    save_games(out, games)
    return f"{len(games)} recorded games"


def _convert_game(lines: Sequence[Any]) -> Game:
    """Replay the calls of a game with the new names of options; raises if the outcome differs."""
    begun, *said, last = lines
    room = _renew_instance(begun["room"])
    env = OptionsEnv(EscapeRoomEnv(instance=room), **rename_fields(begun["options"]))
    try:
        session = RoomSession(env, begun["told"] if "told" in begun else begun["reveal"])
        session.reset(seed=int(begun["seed"]))
        known = [clean(name) for name in name_options(room)]
        for line in said:
            name, arguments = line["call"]
            if name == "run_option" and isinstance(arguments, dict) and isinstance(arguments.get("option"), str):
                option = arguments["option"]
                arguments = {**arguments, "option": find_new_name(option, known) or option}
            session.call(*ToolCall(name, arguments))
        game = record_game(session)
    finally:
        env.close()
    again, before = dataclasses.asdict(game.score), last["score"]
    differ = [name for name in again if name != "characters" and again[name] != before[name]]
    if differ:
        raise VerificationError(f"a game in {room.name!r} has another {differ[0]} when it is played again: "
                                f"{again[differ[0]]}, not {before[differ[0]]}")
    return game


def _convert_json(path: Path, out: Path) -> str | None:
    content = read_json(path, "file of version 0.3")
    if not isinstance(content, dict):
        return None
    if content.get("kind") == "episode":
        return _convert_episode(path, content, out)
    if {"schema", "puzzle", "targets"} <= content.keys():
        content.pop("id", None)
        try:
            room = _renew_instance(content)
        except InstanceFileError as error:
            raise InstanceFileError(f"{path}: {error}") from None
        room.save(out)
        return f"the room {room.name}"
    return None


def _renew_instance(content: Any) -> RoomInstance:
    """Build a room; symbols of its buttons are `marks` in version 0.3 and `cues` now."""
    puzzle = content.get("puzzle") if isinstance(content, dict) else None
    if isinstance(puzzle, dict) and "marks" in puzzle:
        kept = {name: value for name, value in puzzle.items() if name != "marks"}
        content = {**content, "puzzle": {**kept, "cues": puzzle["marks"]}}
    return RoomInstance.from_dict(content)


def _convert_episode(path: Path, content: Mapping[str, Any], out: Path) -> str:
    try:
        room = _renew_instance(content["instance"])
        known = name_options(room)
        moves = [{**move, "name": find_new_name(move["name"], known) or move["name"]} for move in content["moves"]]
        end = None if content["schema"] == 1 else content["end"]
    except (EscapeError, KeyError, TypeError, ValueError) as error:
        raise FileReadError(f"{path}: this recorded episode is damaged: {error}") from error
    write_json(out, {**content, "schema": EPISODE_SCHEMA, "instance": room.to_dict(), "moves": moves, "end": end})
    return "a recorded episode"
