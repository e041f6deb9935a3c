"""A tape of episodes that somebody played in the browser, the window or the terminal, and saved."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hrl_escape.data.record import TapeWriter, make_about
from hrl_escape.data.tape import Tape
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.errors import EpisodeFileError
from hrl_escape.ladder.room_sets import parse_room_set
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.viewer.play.saved_episode import load_episode


def make_played_tape(name: str, rooms: str, paths: Sequence[str | Path]) -> Tape:
    """Make a tape of saved episodes; its decisions are the moves, primitives among them.

    Args:
        name: of the data set.
        rooms: the rooms that were played, as `parse_room_set` reads them, such as `paper-two-button#0`.
        paths: files that `hrl-escape play` saved.

    Raises:
        EpisodeFileError: no episode, a room that is not among `rooms`, or moves that do not lead where they led.
    """
    if not paths:
        raise EpisodeFileError("no episode is given: save some with the Save button of hrl-escape play")
    found = parse_room_set(rooms)
    numbers = {room.id: index for index, room in enumerate(found)}
    writer, envs = TapeWriter(), {}
    for path in paths:
        saved = load_episode(path)
        room = numbers.get(saved.instance.id)
        if room is None or not saved.moves:
            raise EpisodeFileError(f"{path}: " + (f"its room is none of {rooms}" if room is None else
                                                  "nobody moved in this episode"))
        if room not in envs:
            envs[room] = OptionsEnv(EscapeRoomEnv(instance=found[room], observation="features"))
        env = envs[room]
        _, info = env.reset(seed=saved.seed)
        legal, end = info["action_mask"], 0
        for move, primitives, ended in saved.moves:
            if end or move not in env.action_names:
                raise EpisodeFileError(f"{path}: the move {move!r} is none of this room, or comes after the end")
            for primitive in primitives:
                _, _, terminated, truncated, info = env.step(primitive)
                end = 1 if terminated else 2 if truncated else 0
            writer.add_decision(env.action_names.index(move), legal, list(primitives), ended or "reached")
            legal = info["action_mask"]
        writer.end_episode(saved.seed, room, len(saved.moves), np.asarray(legal), end)
    env = next(iter(envs.values()))
    about = make_about(name, "played", rooms, found, env, f"hrl-escape data make {name} --rooms {rooms} --played FILES")
    for each in envs.values():
        each.close()
    return writer.make_tape(about)
