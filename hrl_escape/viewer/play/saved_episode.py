"""Files of played episodes: the room, the seed and every primitive, as JSON."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hrl_escape.env.episode_end import EpisodeEnd
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import EpisodeFileError, EscapeError, FileReadError
from hrl_escape.files import read_json, write_json
from hrl_escape.names import make_file_name

SCHEMA = 2


@dataclasses.dataclass(frozen=True)
class SavedEpisode:
    """Content of an episode's file."""

    instance: RoomInstance  # the room
    seed: int  # of the episode
    moves: tuple[tuple[str, tuple[int, ...], str], ...]  # name, primitives and ending of each move, in order
    total: float  # undiscounted return
    end: EpisodeEnd | None
    """The episode's end; None in a file of schema 1, which only says whether the robot escaped."""

    @property
    def primitives(self) -> tuple[int, ...]:
        """All primitives in order."""
        return tuple(primitive for _, primitives, _ in self.moves for primitive in primitives)

    @property
    def file_name(self) -> str:
        """Default name of the file: room, instance seed, number of primitives, and a hash that tells episodes apart."""
        content = json.dumps([self.instance.id, self.seed, self.moves])
        key = hashlib.sha256(content.encode()).hexdigest()[:8]
        room = make_file_name(f"{self.instance.name}-{self.instance.seed}")
        return f"{room}-{len(self.primitives)}-primitives-{key}.json"


def save_episode(path: str | Path, saved: SavedEpisode) -> None:
    """Write an episode as JSON, atomically."""
    moves: Sequence[dict[str, Any]] = [
        {"name": name, "primitives": list(primitives), "ended": ended} for name, primitives, ended in saved.moves
    ]
    write_json(path, {"schema": SCHEMA, "kind": "episode", "seed": saved.seed, "return": saved.total,
                      "end": saved.end and saved.end.value, "primitives": len(saved.primitives), "moves": moves,
                      "instance": saved.instance.to_dict()})


def load_episode(path: str | Path) -> SavedEpisode:
    """Read an episode.

    Raises:
        EpisodeFileError: the file is damaged or holds something else.
        FileReadError: there is no such file, or it is not JSON.
    """
    content = read_json(path, "recorded episode")
    try:
        if not isinstance(content, dict) or content.get("kind") != "episode":
            raise EpisodeFileError("no recorded episode: save one with the Save button of hrl-escape play")
        if content["schema"] not in (1, SCHEMA):
            raise EpisodeFileError(f"it has schema {content['schema']!r}, this version reads 1 to {SCHEMA}")
        instance = RoomInstance.from_dict(content["instance"])
        count = len(instance.robot.actions)
        moves = tuple((str(m["name"]), tuple(int(p) for p in m["primitives"]), str(m["ended"]))
                      for m in content["moves"])
        if any(not primitives or not all(0 <= p < count for p in primitives) for _, primitives, _ in moves):
            raise EpisodeFileError(f"its primitives are not all numbers from 0 to {count - 1}")
        end = None if content["schema"] == 1 else EpisodeEnd(content["end"])
        return SavedEpisode(instance, int(content["seed"]), moves, float(content["return"]), end)
    except FileReadError:
        raise
    except (EscapeError, KeyError, TypeError, ValueError, OverflowError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else error
        raise EpisodeFileError(f"{path}: {reason}") from None
